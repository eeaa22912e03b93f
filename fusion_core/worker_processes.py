"""Work in other processes, which end with the one that asked for it."""

import itertools
import multiprocessing
import multiprocessing.connection
import multiprocessing.util
import os
import pickle
import signal
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, TypeVar

from threadpoolctl import threadpool_limits

from fusion_core.model.errors import WorkerFailed

_Argument = TypeVar("_Argument")
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
_Value = TypeVar("_Value")

# For each other process: a task in work, and some that wait for it while this process is busy with
# what came before.
_SUBMITTED_AHEAD = 4
# For each worker: tasks whose results wait for an earlier one's, as for that of a process which is
# still starting.
_TAKEN_AHEAD = 4
# Below the priorities of all else that happens at a worker's end.
_LAST = -1000
_THREADS_OF_LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def usable_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Shared(Generic[_Value]):
    """A value that many tasks need. A worker reads it once, from a ``file`` of its pool; a pool
    without processes has none."""

    def __init__(self, value: _Value, file: Path | None) -> None:
        self._value, self._file = value, file
        self._is_written = False

    @property
    def value(self) -> _Value:
        """The value, of this process."""
        return self._value

    def __reduce__(self) -> tuple[Any, ...]:
        assert self._file is not None, "a pool without processes pickles nothing"
        if not self._is_written:
            self._file.write_bytes(pickle.dumps(self._value, protocol=pickle.HIGHEST_PROTOCOL))
            self._is_written = True
        return _read_shared, (self._file,)


# Of this process: the last value is the one of the work that goes on.
_last_read: tuple[Path, Any] | None = None


def _read_shared(file: Path) -> Shared[Any]:
    global _last_read
    if _last_read is None or _last_read[0] != file:
        _last_read = (file, pickle.loads(file.read_bytes()))
    return Shared(_last_read[1], file)


class _Faithful:
    """A value that arrives in another process as it is, arrays that are read-only among it. By the
    pool's own protocol they would arrive writable, and each compiled function that takes one would
    be compiled once more."""

    def __init__(self, value: Any) -> None:
        self._value = value

    def __reduce__(self) -> tuple[Any, ...]:
        return pickle.loads, (pickle.dumps(self._value, protocol=5),)


class WorkerPool:
    """Processes for functions whose arguments and results can be pickled.

    ``workers``: how many, this process among them; by default one for each core that may be used.
    With one there is no other: each task is done where its result is asked for. The others start
    with the first task, or before it with ``start``.

    A worker that dies, as when the system has no memory left, ends the work: WorkerFailed.
    """

    def __init__(self, workers: int | None = None) -> None:
        if workers is not None and workers < 1:
            raise ValueError("a pool has a worker")
        self.workers = workers or usable_cores()
        self._executor: ProcessPoolExecutor | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._number = itertools.count()

    def __enter__(self) -> "WorkerPool":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        executor, self._executor = self._executor, None
        if executor is not None:
            if kind is not None:
                # Nobody wants what they are at.
                for process in list(executor._processes.values()):
                    process.terminate()
                if sys.version_info < (3, 11, 5):
                    # There a thread that writes a task to them would wait for ever.
                    vars(executor)["_call_queue"]._reader.close()
            executor.shutdown(cancel_futures=True)
        folder, self._folder = self._folder, None
        if folder is not None:
            folder.cleanup()

    @property
    def is_parallel(self) -> bool:
        """Whether tasks are done in other processes."""
        return self.workers > 1

    def start(self, prepare: Callable[[], None]) -> None:
        """Start the processes and let each ``prepare`` for its tasks, without waiting for them."""
        if self.is_parallel:
            for _ in range(self.workers - 1):
                self._running().submit(prepare)

    def restart(self, prepare: Callable[[], None]) -> None:
        """Let other processes ``prepare`` and take the places of the present ones, whose memory is
        freed. All results were taken."""
        if self._executor is not None:
            self._executor.shutdown()
            self._executor = None
            self.start(prepare)

    def share(self, value: _Value) -> Shared[_Value]:
        """A value for the arguments of many tasks."""
        if not self.is_parallel:
            return Shared(value, None)
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="scanloom-")
        return Shared(value, Path(self._folder.name) / f"{next(self._number)}.pickle")

    def in_order(
        self,
        function: Callable[[_Argument], _Result],
        items: Iterable[_Item],
        argument_of: Callable[[_Item], _Argument],
        submitted_ahead: int = _SUBMITTED_AHEAD,
    ) -> Iterator[tuple[_Item, _Result]]:
        """Each item with the result of its task, in the order of the items.

        While this process would wait for a result, it does tasks itself. Items are taken a bounded
        number ahead, so that memory does not grow with theirs. ``submitted_ahead``: tasks that each
        other process has at a time; 1 shares a few long ones best.
        """
        if not self.is_parallel:
            for item in items:
                yield item, function(argument_of(item))
            return
        ahead = submitted_ahead * (self.workers - 1)
        coming = iter(items)
        taken: deque[tuple[_Item, Future[_Result]]] = deque()
        is_over = False
        while not is_over or taken:
            may_take = not is_over and len(taken) < _TAKEN_AHEAD * self.workers
            # What the caller does with a result takes this process, not the others: they are given
            # their next tasks first.
            is_for_others = may_take and sum(not future.done() for _, future in taken) < ahead
            if not is_for_others and taken and (not may_take or taken[0][1].done()):
                item, future = taken.popleft()
                yield item, _result_of(future)
                continue
            try:
                item = next(coming)
            except StopIteration:
                is_over = True
                continue
            argument = argument_of(item)
            if is_for_others:
                taken.append((item, self._submit(function, argument)))
            else:
                taken.append((item, _done_here(function, argument)))

    def _submit(self, function: Callable[..., _Result], *values: Any) -> "Future[_Result]":
        try:
            return self._running().submit(_call, function, *map(_Faithful, values))
        except BrokenProcessPool as error:
            raise _died() from error

    def _running(self) -> ProcessPoolExecutor:
        if self._executor is None:
            # A fork would copy the locks of other threads as they are.
            self._executor = ProcessPoolExecutor(
                self.workers - 1, multiprocessing.get_context("spawn"), initializer=_begin
            )
        return self._executor


def _call(function: Callable[..., Any], *values: Any) -> Any:
    """A task as another process does it."""
    return _Faithful(function(*values))


def _done_here(function: Callable[[_Argument], _Result], argument: _Argument) -> "Future[_Result]":
    """A task as it is done by this process: an error waits for its turn too."""
    future: Future[_Result] = Future()
    try:
        future.set_result(function(argument))
    except Exception as error:  # noqa: BLE001  # raised where the result is asked for
        future.set_exception(error)
    return future


def _result_of(future: "Future[_Result]") -> _Result:
    try:
        return future.result()
    except BrokenProcessPool as error:
        raise _died() from error


def _died() -> WorkerFailed:
    return WorkerFailed(
        "a worker process has died, perhaps for lack of memory.",
        advice="Use fewer --workers: with 1 there are no other processes.",
    )


def _begin() -> None:
    """The first that a worker does: an interruption is its parent's to answer, its parent's end is
    its own, it uses one core, and its end is short."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Of libraries that are loaded later, and of those that are loaded already.
    os.environ.update(dict.fromkeys(_THREADS_OF_LIBRARIES, "1"))
    threadpool_limits(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    multiprocessing.util.Finalize(None, _end_at_once, exitpriority=_LAST)


def _end_at_once() -> None:
    """The last that a worker does. Python would first free, one by one, all that it has imported
    and compiled, and its parent waits for its end."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None, "a worker has one"
    multiprocessing.connection.wait([parent.sentinel])
    os._exit(1)
