"""Tasks on their way: a bounded number of them, so that nobody's memory grows with their count."""

import secrets
from collections.abc import Callable, Iterator
from itertools import islice

from distributed import Client, Future, KilledWorker, as_completed

from fusion_core.model.errors import ScanLoomError
from fusion_core.workflows.batch.cluster import (
    asking_scheduler,
    is_connected,
    lost_scheduler,
    thread_count,
)
from fusion_core.workflows.batch.outcome_file import write_outcome
from fusion_core.workflows.batch.run_one import Ending, describe_failure, outcome_of, run_one
from fusion_core.workflows.batch.settings import BatchSettings
from fusion_core.workflows.batch.task import BatchTask


def endings(
    client: Client, tasks: Iterator[BatchTask], settings: BatchSettings
) -> Iterator[Ending]:
    """What becomes of each task, in the order in which they end. Tasks are taken as there is room.

    When the caller stops, those on their way are cancelled. Raises ScanLoomError where the
    scheduler is lost, or nothing more can be written.
    """
    suspects = []
    for task, answer in _answers(
        client, tasks, lambda: settings.tasks_per_worker * thread_count(client)
    ):
        if _worker_died(answer):
            suspects.append(task)
        else:
            yield _ending(client, task, answer)
    # Whatever else was on the worker is suspected with it. Alone, each shows what it does.
    for task, answer in _answers(client, iter(suspects), lambda: 1):
        yield _ending(client, task, answer)


def _answers(
    client: Client, tasks: Iterator[BatchTask], greatest: Callable[[], int]
) -> Iterator[tuple[BatchTask, object]]:
    """Each task with what the worker sent, or with why it sent nothing. ``greatest``: how many may
    be on their way as there are workers now."""
    # Another batch may give the same names to the same scheduler.
    group = f"scanloom-{secrets.token_hex(8)}"
    on_their_way: dict[Future[Ending], BatchTask] = {}

    def submit(task: BatchTask) -> "Future[Ending]":
        with asking_scheduler(client):
            future = client.submit(run_one, task, key=(group, task.item.name), pure=False)
        on_their_way[future] = task
        return future

    try:
        # With its result: a worker that dies right after a recording takes the bare future back.
        first = [submit(task) for task in islice(tasks, greatest())]
        ended = as_completed(first, loop=client.loop, with_results=True, raise_errors=False)
        since_count = 0
        for future, answer in ended:
            yield on_their_way.pop(future), answer
            since_count += 1
            room = 1
            # Workers come and go; to count them for each recording would cost a message each.
            if since_count > len(on_their_way):
                since_count = 0
                room = max(0, greatest() - len(on_their_way))
            for task in islice(tasks, room):
                ended.add(submit(task))
    finally:
        # A client that has lost its scheduler has cancelled them.
        if is_connected(client):
            client.cancel(list(on_their_way))


def _worker_died(answer: object) -> bool:
    return isinstance(answer, tuple) and isinstance(answer[1], KilledWorker)


def _ending(client: Client, task: BatchTask, answer: object) -> Ending:
    if isinstance(answer, Ending):
        if answer.stop is not None:
            raise ScanLoomError(f"{answer.stop} What was done until then stays.")
        return answer
    if not isinstance(answer, tuple):
        raise lost_scheduler(client)
    _, raised, _ = answer
    if isinstance(raised, KilledWorker):
        error = ScanLoomError(
            "its worker process died each time, though it ran alone.",
            advice="It may need more memory than a worker has: use fewer workers.",
        )
    else:
        error = describe_failure(raised)
    outcome = outcome_of(task, result=None, error=error)
    write_outcome(task, outcome)
    return Ending(name=outcome.name, error=outcome.error)
