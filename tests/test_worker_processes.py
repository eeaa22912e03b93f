"""Work in other processes: in order, in bounded memory, and with one clear end."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

from fusion_core.compiled import load_cached
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import ExportError, ScanLoomError, StampOutsideRange, WorkerFailed
from fusion_core.worker_processes import Shared, WorkerPool

_Value = TypeVar("_Value")


def squared(number: int) -> int:
    return number * number


def process_of(_: object) -> int:
    return os.getpid()


def after_one_at_home(done_at_home: Path) -> None:
    """Let another process wait until this one has begun a task."""
    if multiprocessing.parent_process() is None:
        done_at_home.touch()
    while not done_at_home.exists():
        time.sleep(1e-3)


def process_of_both(done_at_home: Path) -> int:
    after_one_at_home(done_at_home)
    return os.getpid()


def is_writable_of_both(work: tuple[FloatArray, Path]) -> tuple[bool, int, FloatArray]:
    """Whether the array can be written to, where, and the array."""
    values, done_at_home = work
    after_one_at_home(done_at_home)
    return values.flags.writeable, os.getpid(), values


def killed(number: int) -> int:
    if multiprocessing.parent_process() is not None:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def refused(number: int) -> int:
    if number == 2:
        raise StampOutsideRange("the pose", stamp_ns=5, start_ns=7, end_ns=9)
    return number


def fails_at_home(work: tuple[int, Path]) -> int:
    number, done_at_home = work
    after_one_at_home(done_at_home)
    if multiprocessing.parent_process() is None:
        raise ExportError("at home.")
    return number


def summed_by_both(work: tuple[Shared[list[int]], Path]) -> tuple[int, tuple[int, int]]:
    """The sum, and which process has the value where."""
    values, done_at_home = work
    after_one_at_home(done_at_home)
    return sum(values.value), (os.getpid(), id(values.value))


class LeavesMarkWhenFreed:
    def __init__(self, mark: Path) -> None:
        self._mark = mark

    def __del__(self) -> None:
        self._mark.touch()


_held: list[LeavesMarkWhenFreed] = []


def says_and_holds(mark: Path) -> None:
    print("said by a worker")
    _held.append(LeavesMarkWhenFreed(mark))


def itself(value: _Value) -> _Value:
    return value


@pytest.fixture(scope="module")
def pool() -> Iterator[WorkerPool]:
    with WorkerPool(2) as running:
        yield running


def test_results_come_in_the_order_of_the_items(pool: WorkerPool) -> None:
    found = list(pool.in_order(squared, range(40), itself))
    assert found == [(number, number * number) for number in range(40)]


def test_an_array_stays_read_only_on_its_way_there_and_back(
    pool: WorkerPool, tmp_path: Path
) -> None:
    kept, free = np.arange(6.0).reshape(2, 3), np.arange(6.0)
    kept.setflags(write=False)
    for values, expected in ((kept, False), (free, True)):
        processes = set()
        work = [(values, tmp_path / f"{expected}")] * 20
        for _, (there, process, back) in pool.in_order(is_writable_of_both, work, itself):
            assert (there, back.flags.writeable) == (expected, expected)
            processes.add(process)
            np.testing.assert_array_equal(back, values)
        assert len(processes) == 2


def test_with_one_worker_all_is_done_here_and_when_it_is_asked_for() -> None:
    taken = []

    def items() -> Iterator[int]:
        for number in range(5):
            taken.append(number)
            yield number

    with WorkerPool(1) as alone:
        alone.start("fusion_core.model.errors")
        found = alone.in_order(process_of, items(), itself)
        assert next(found) == (0, os.getpid())
        assert taken == [0]


def test_items_are_taken_no_further_ahead_than_the_workers_need(pool: WorkerPool) -> None:
    taken = []

    def items() -> Iterator[int]:
        for number in range(100):
            taken.append(number)
            yield number

    for done, _ in pool.in_order(squared, items(), itself):
        assert len(taken) - done <= 4 * pool.workers


def processes_at_work(pool: WorkerPool, done_at_home: Path) -> set[int]:
    """Of forty tasks."""
    work = [done_at_home] * 40
    return {process for _, process in pool.in_order(process_of_both, work, itself)}


def test_this_process_and_another_share_the_work(pool: WorkerPool, tmp_path: Path) -> None:
    processes = processes_at_work(pool, tmp_path / "done")
    assert len(processes) == 2
    assert os.getpid() in processes


def test_an_error_of_this_process_waits_for_its_turn(pool: WorkerPool, tmp_path: Path) -> None:
    found = pool.in_order(fails_at_home, range(40), lambda number: (number, tmp_path / "done"))
    # The first are done elsewhere while this process fails at the one after them.
    assert [next(found)[1] for _ in range(4)] == [0, 1, 2, 3]
    with pytest.raises(ExportError, match="at home"):
        list(found)


def test_after_a_restart_other_processes_do_the_work(tmp_path: Path) -> None:
    with WorkerPool(2) as restarted:
        before = processes_at_work(restarted, tmp_path / "before")
        restarted.restart(load_cached)
        after = processes_at_work(restarted, tmp_path / "after")
    assert len(before) == len(after) == 2
    assert before & after == {os.getpid()}


def test_a_shared_value_is_read_once_by_a_worker(pool: WorkerPool, tmp_path: Path) -> None:
    for values in ([1, 2, 3], [4, 5, 6]):
        work = [(pool.share(values), tmp_path / f"{sum(values)}")] * 20
        found = [result for _, result in pool.in_order(summed_by_both, work, itself)]
        assert {total for total, _ in found} == {sum(values)}
        assert len({identity for _, identity in found}) == 2


def test_an_error_of_a_worker_comes_whole(pool: WorkerPool) -> None:
    found = pool.in_order(refused, range(5), itself)
    with pytest.raises(StampOutsideRange) as caught:
        list(found)
    assert (caught.value.start_ns, caught.value.end_ns) == (7, 9)
    assert str(caught.value) == "the pose at 5 ns: known from 7 to 9 ns."


@pytest.mark.parametrize("raised", [ScanLoomError("a."), ExportError("b.", file="x", advice="Do.")])
def test_errors_are_the_same_after_a_journey(raised: ScanLoomError) -> None:
    kind, args = raised.__reduce__()
    error = kind(*args)
    assert (type(error), str(error), vars(error)) == (type(raised), str(raised), vars(raised))


def test_a_worker_that_dies_is_one_clear_error() -> None:
    before = set(multiprocessing.active_children())
    with WorkerPool(2) as dying, pytest.raises(WorkerFailed, match="a worker process has died"):
        list(dying.in_order(killed, range(20), itself))
    assert set(multiprocessing.active_children()) <= before


def test_no_process_stays_when_the_work_is_given_up() -> None:
    def interrupted(number: int) -> int:
        if number == 9:
            raise KeyboardInterrupt
        return number

    before = set(multiprocessing.active_children())
    with pytest.raises(KeyboardInterrupt), WorkerPool(2) as given_up:
        list(given_up.in_order(squared, range(1000), interrupted))
    assert set(multiprocessing.active_children()) <= before


def test_a_worker_ends_at_once_and_what_it_printed_is_not_lost(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    mark = tmp_path / "freed"
    with WorkerPool(2) as ending:
        ending.start(partial(says_and_holds, mark))
    assert capfd.readouterr().out == "said by a worker\n"
    assert not mark.exists()


PARENT = """
import multiprocessing, sys, time
sys.path[:0] = [{root!r}]
from fusion_core.worker_processes import WorkerPool
from tests.test_worker_processes import itself, process_of
if __name__ == "__main__":
    with WorkerPool(3) as pool:
        pids = {{p for _, p in pool.in_order(process_of, range(40), itself)}}
        print(*[child.pid for child in multiprocessing.active_children()], flush=True)
        sys.stdin.read()
"""


def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    root = str(Path(__file__).parents[1])
    script = tmp_path / "parent.py"
    script.write_text(PARENT.format(root=root), encoding="utf-8")
    with subprocess.Popen(
        [sys.executable, script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=root
    ) as parent:
        assert parent.stdout is not None
        children = [int(pid) for pid in parent.stdout.readline().split()]
        assert len(children) == 2
        parent.kill()
        # The workers hold the other end of the pipe: it is closed once both are gone.
        assert parent.stdout.read() == b""
