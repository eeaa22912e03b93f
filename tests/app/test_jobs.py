"""The two kinds of work beside the server's threads: the latest request only, and one long job."""

import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import pytest

from fusion_core.model.progress import Progress
from scanloom.jobs.fair_semaphore import FairSemaphore
from scanloom.jobs.latest_only_worker import LatestOnlyWorker
from scanloom.jobs.long_job import Cancelled, LongJob
from tests.patience import ENOUGH_S


class Gate:
    """Work that stands still until it is let on, and keeps what it was given."""

    def __init__(self) -> None:
        self.begun: list[int] = []
        self.frame_view: list[int] = []
        self.errors: list[Exception] = []
        self.at_work = threading.Semaphore(0)
        self.may_go_on = threading.Semaphore(0)

    def work(self, request: int, is_newest: Callable[[], bool]) -> None:
        self.begun.append(request)
        self.at_work.release()
        assert self.may_go_on.acquire(timeout=ENOUGH_S)
        if request < 0:
            raise ValueError(f"no work for {request}")
        if is_newest():
            self.frame_view.append(request)


@pytest.fixture
def gate() -> Gate:
    return Gate()


@pytest.fixture
def worker(gate: Gate) -> Iterator[LatestOnlyWorker[int]]:
    worker = LatestOnlyWorker("test", gate.work, gate.errors.append)
    yield worker
    worker.close()
    gate.may_go_on.release(100)


def test_what_comes_in_between_is_never_done(gate: Gate, worker: LatestOnlyWorker[int]) -> None:
    worker.submit(1)
    assert gate.at_work.acquire(timeout=ENOUGH_S)
    for request in range(2, 200):
        worker.submit(request)
    gate.may_go_on.release(2)
    assert worker.wait(ENOUGH_S)
    # The first was no longer the newest when it was done.
    assert (gate.begun, gate.frame_view) == ([1, 199], [199])


def test_requests_one_after_the_other_are_all_done(
    gate: Gate, worker: LatestOnlyWorker[int]
) -> None:
    for request in (3, 1, 2):
        gate.may_go_on.release()
        worker.submit(request)
        assert worker.wait(ENOUGH_S)
    assert gate.frame_view == [3, 1, 2]


def test_wait_says_whether_all_is_done(gate: Gate, worker: LatestOnlyWorker[int]) -> None:
    assert worker.wait(0.0)
    worker.submit(1)
    assert gate.at_work.acquire(timeout=ENOUGH_S)
    assert not worker.wait(0.0)
    gate.may_go_on.release()
    assert worker.wait(ENOUGH_S)


def test_a_failure_is_reported_and_the_next_request_is_done(
    gate: Gate, worker: LatestOnlyWorker[int]
) -> None:
    gate.may_go_on.release(2)
    worker.submit(-1)
    assert worker.wait(ENOUGH_S)
    worker.submit(1)
    assert worker.wait(ENOUGH_S)
    assert [str(error) for error in gate.errors] == ["no work for -1"]
    assert gate.frame_view == [1]


@pytest.mark.parametrize("request_at_work", [1, -1])
def test_a_closed_worker_shows_nothing_and_begins_nothing(gate: Gate, request_at_work: int) -> None:
    worker = LatestOnlyWorker("test", gate.work, gate.errors.append)
    worker.submit(request_at_work)
    assert gate.at_work.acquire(timeout=ENOUGH_S)
    worker.submit(2)
    worker.close()
    gate.may_go_on.release(2)
    worker._thread.join(ENOUGH_S)
    assert not worker._thread.is_alive()
    assert (gate.begun, gate.frame_view, gate.errors) == ([request_at_work], [], [])
    assert worker.wait(0.0), "nobody waits for a closed worker"


class Ends:
    """How a long job ended: one entry."""

    def __init__(self) -> None:
        self.ended: list[tuple[str, Any]] = []
        self.steps: list[tuple[int, int | None, str]] = []

    def job(self, work: Callable[[Progress], Any]) -> LongJob:
        return LongJob(
            "test",
            work,
            on_progress=lambda done, total, what: self.steps.append((done, total, what)),
            on_done=lambda result: self.ended.append(("done", result)),
            on_failed=lambda error: self.ended.append(("failed", str(error))),
            on_cancelled=lambda: self.ended.append(("cancelled", None)),
        )


def test_a_job_reports_its_steps_in_order_and_its_result() -> None:
    def work(progress: Progress) -> str:
        for done in range(3):
            progress(done, 3, "counting")
        return "counted"

    ends = Ends()
    assert ends.job(work).wait(ENOUGH_S)
    assert ends.steps == [(done, 3, "counting") for done in range(3)]
    assert ends.ended == [("done", "counted")]


def test_a_failed_job_tells_its_error() -> None:
    def work(progress: Progress) -> None:
        progress(0, None, "trying")
        raise OSError("no space left")

    ends = Ends()
    assert ends.job(work).wait(ENOUGH_S)
    assert ends.ended == [("failed", "no space left")]


def test_a_cancelled_job_stops_at_its_next_report_and_cleans_up() -> None:
    begun, cancelled, cleaned = threading.Event(), threading.Event(), threading.Event()

    def work(progress: Progress) -> None:
        try:
            progress(1, 3, "working")
            begun.set()
            assert cancelled.wait(ENOUGH_S)
            progress(2, 3, "working")
        finally:
            cleaned.set()

    ends = Ends()
    job = ends.job(work)
    assert begun.wait(ENOUGH_S)
    assert not job.wait(0.0)
    job.cancel()
    cancelled.set()
    assert job.wait(ENOUGH_S)
    assert ends.steps == [(1, 3, "working")]
    assert ends.ended == [("cancelled", None)]
    assert cleaned.is_set()


def test_cancelling_a_job_that_has_ended_changes_nothing() -> None:
    ends = Ends()
    job = ends.job(lambda progress: 7)
    assert job.wait(ENOUGH_S)
    job.cancel()
    assert ends.ended == [("done", 7)]


def test_work_that_is_cancelled_is_reported_to_nobody(gate: Gate) -> None:
    done: list[int] = []

    def work(request: int, is_newest: Callable[[], bool]) -> None:
        done.append(request)
        raise Cancelled

    worker = LatestOnlyWorker("test", work, gate.errors.append)
    for request in (1, 2):
        worker.submit(request)
        assert worker.wait(ENOUGH_S)
    worker.close()
    assert (done, gate.errors) == ([1, 2], [])


class Queue:
    """Threads that take turns, each at work until it is let go."""

    def __init__(self, turns: FairSemaphore) -> None:
        self.turns = turns
        self.changed = threading.Condition()
        self.at_work: list[int] = []
        self.began: list[int] = []
        self.waiting: set[int] = set()
        self.gave_up: set[int] = set()
        self._let_go: set[int] = set()
        self._threads: list[threading.Thread] = []

    def come(self, number: int) -> None:
        """The next in the queue."""
        thread = threading.Thread(target=self._work, args=(number,), daemon=True)
        self._threads.append(thread)
        thread.start()
        self.until(lambda: number in self.waiting or number in self.at_work)

    def let_go(self, number: int) -> None:
        """End its work, or its waiting."""
        with self.changed:
            self._let_go.add(number)
            self.changed.notify_all()

    def until(self, condition: Callable[[], bool]) -> None:
        with self.changed:
            assert self.changed.wait_for(condition, ENOUGH_S)

    def _work(self, number: int) -> None:
        def waiting() -> None:
            with self.changed:
                self.waiting.add(number)
                self.changed.notify_all()
                if number in self._let_go:
                    self.gave_up.add(number)
                    raise Cancelled

        with suppress(Cancelled), self.turns.acquired(waiting), self.changed:
            self.at_work.append(number)
            self.began.append(number)
            self.changed.notify_all()
            self.changed.wait_for(lambda: number in self._let_go)
            self.at_work.remove(number)
            self.changed.notify_all()


def test_so_many_work_at_once_and_the_others_in_their_order() -> None:
    queue = Queue(FairSemaphore(2))
    for number in range(5):
        queue.come(number)
    assert queue.at_work == [0, 1]
    # One that waits may give up.
    queue.let_go(3)
    queue.until(lambda: 3 in queue.gave_up)
    queue.let_go(1)
    queue.until(lambda: queue.at_work == [0, 2])
    queue.let_go(0)
    queue.until(lambda: queue.at_work == [2, 4])
    assert queue.began == [0, 1, 2, 4]
    for number in (2, 4):
        queue.let_go(number)
    queue.until(lambda: queue.at_work == [])
