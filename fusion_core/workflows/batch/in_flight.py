"""Tasks on their way: a bounded number of them, so that nobody's memory grows with their count."""

import secrets
from collections.abc import Iterator
from itertools import islice

from distributed import Client, Future, KilledWorker, as_completed

from fusion_core.model.errors import ScanLoomError
from fusion_core.workflows.batch.cluster import thread_count
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
    # Another batch may give the same names to the same scheduler.
    group = f"scanloom-{secrets.token_hex(8)}"
    on_their_way: dict[Future[Ending], BatchTask] = {}

    def submit(task: BatchTask) -> "Future[Ending]":
        future = client.submit(run_one, task, key=(group, task.item.name), pure=False)
        on_their_way[future] = task
        return future

    def room() -> int:
        return settings.tasks_per_worker * thread_count(client) - len(on_their_way)

    try:
        ended = as_completed(map(submit, islice(tasks, room())), loop=client.loop)
        since_count = 0
        for future in ended:
            task = on_their_way.pop(future)
            yield _ending(client, future, task)
            since_count += 1
            # Workers come and go; to count them for each recording would cost a message each.
            count = 1 if since_count < len(on_their_way) else max(1, room())
            since_count = 0 if count != 1 else since_count
            for each in islice(tasks, count):
                ended.add(submit(each))
    finally:
        client.cancel(list(on_their_way))


def _ending(client: Client, future: "Future[Ending]", task: BatchTask) -> Ending:
    if future.status == "finished":
        ending: Ending = future.result()
        if ending.stop is not None:
            raise ScanLoomError(f"{ending.stop} What was done until then stays.")
        return ending
    if future.status != "error":
        raise ScanLoomError(
            "the scheduler is lost.",
            file=client.scheduler.address if client.scheduler else None,
            advice="Call again: what is done is not done again.",
        )
    raised = future.exception()
    if isinstance(raised, KilledWorker):
        error = ScanLoomError(
            f"its worker process died {raised.allowed_failures + 1} times, the last one on "
            f"{raised.last_worker.address}.",
            advice="It may need more memory than a worker has: use fewer workers.",
        )
    else:
        error = describe_failure(raised)
    outcome = outcome_of(task, result=None, error=error)
    write_outcome(task, outcome)
    return Ending(name=outcome.name, error=outcome.error)
