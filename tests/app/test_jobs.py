"""The two kinds of work beside the server's threads: the latest request only, and one long job."""

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from app.jobs.latest import LatestWorker
from app.jobs.long import LongJob
from fusion_core.model.progress import Progress

LONG_S = 20.0


class Gate:
    """Work that stands still until it is let on, and keeps what it was given."""

    def __init__(self) -> None:
        self.begun: list[int] = []
        self.shown: list[int] = []
        self.errors: list[Exception] = []
        self.at_work = threading.Semaphore(0)
        self.may_go_on = threading.Semaphore(0)

    def work(self, request: int, is_newest: Callable[[], bool]) -> None:
        self.begun.append(request)
        self.at_work.release()
        assert self.may_go_on.acquire(timeout=LONG_S)
        if request < 0:
            raise ValueError(f"no work for {request}")
        if is_newest():
            self.shown.append(request)


@pytest.fixture
def gate() -> Gate:
    return Gate()


@pytest.fixture
def worker(gate: Gate) -> Iterator[LatestWorker[int]]:
    worker = LatestWorker("test", gate.work, gate.errors.append)
    yield worker
    worker.close()
    gate.may_go_on.release(100)


def test_what_comes_in_between_is_never_done(gate: Gate, worker: LatestWorker[int]) -> None:
    worker.ask(1)
    assert gate.at_work.acquire(timeout=LONG_S)
    for request in range(2, 200):
        worker.ask(request)
    gate.may_go_on.release(2)
    assert worker.wait(LONG_S)
    # The first was no longer the newest when it was done.
    assert (gate.begun, gate.shown) == ([1, 199], [199])


def test_requests_one_after_the_other_are_all_done(gate: Gate, worker: LatestWorker[int]) -> None:
    for request in (3, 1, 2):
        gate.may_go_on.release()
        worker.ask(request)
        assert worker.wait(LONG_S)
    assert gate.shown == [3, 1, 2]


def test_wait_says_whether_all_is_done(gate: Gate, worker: LatestWorker[int]) -> None:
    assert worker.wait(0.0)
    worker.ask(1)
    assert gate.at_work.acquire(timeout=LONG_S)
    assert not worker.wait(0.0)
    gate.may_go_on.release()
    assert worker.wait(LONG_S)


def test_a_failure_is_told_and_the_next_request_is_done(
    gate: Gate, worker: LatestWorker[int]
) -> None:
    gate.may_go_on.release(2)
    worker.ask(-1)
    assert worker.wait(LONG_S)
    worker.ask(1)
    assert worker.wait(LONG_S)
    assert [str(error) for error in gate.errors] == ["no work for -1"]
    assert gate.shown == [1]


@pytest.mark.parametrize("request_at_work", [1, -1])
def test_a_closed_worker_shows_nothing_and_begins_nothing(gate: Gate, request_at_work: int) -> None:
    worker = LatestWorker("test", gate.work, gate.errors.append)
    worker.ask(request_at_work)
    assert gate.at_work.acquire(timeout=LONG_S)
    worker.ask(2)
    worker.close()
    gate.may_go_on.release(2)
    worker._thread.join(LONG_S)
    assert not worker._thread.is_alive()
    assert (gate.begun, gate.shown, gate.errors) == ([request_at_work], [], [])
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
    assert ends.job(work).wait(LONG_S)
    assert ends.steps == [(done, 3, "counting") for done in range(3)]
    assert ends.ended == [("done", "counted")]


def test_a_failed_job_tells_its_error() -> None:
    def work(progress: Progress) -> None:
        progress(0, None, "trying")
        raise OSError("no space left")

    ends = Ends()
    assert ends.job(work).wait(LONG_S)
    assert ends.ended == [("failed", "no space left")]


def test_a_cancelled_job_stops_at_its_next_report_and_cleans_up() -> None:
    begun, cancelled, cleaned = threading.Event(), threading.Event(), threading.Event()

    def work(progress: Progress) -> None:
        try:
            progress(1, 3, "working")
            begun.set()
            assert cancelled.wait(LONG_S)
            progress(2, 3, "working")
        finally:
            cleaned.set()

    ends = Ends()
    job = ends.job(work)
    assert begun.wait(LONG_S)
    assert not job.wait(0.0)
    job.cancel()
    cancelled.set()
    assert job.wait(LONG_S)
    assert ends.steps == [(1, 3, "working")]
    assert ends.ended == [("cancelled", None)]
    assert cleaned.is_set()


def test_cancelling_a_job_that_has_ended_changes_nothing() -> None:
    ends = Ends()
    job = ends.job(lambda progress: 7)
    assert job.wait(LONG_S)
    job.cancel()
    assert ends.ended == [("done", 7)]
