"""One recording of a batch, in a worker: whatever goes wrong costs that recording alone."""

import errno
import os
import time
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from fusion_core.freed_memory import give_freed_memory_back
from fusion_core.model.errors import ExportError, ScanLoomError
from fusion_core.model.names import escape_undecodable_values, printable
from fusion_core.model.project import project_version
from fusion_core.workflows.batch.outcome import Outcome
from fusion_core.workflows.batch.outcome_file import is_done, write_outcome
from fusion_core.workflows.batch.remote import local_copy
from fusion_core.workflows.batch.task import BatchTask, CallResult
from fusion_core.workflows.source import paths_of

_DISK_FULL = {errno.ENOSPC, errno.EDQUOT}


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """What a worker tells of a recording; its outcome is in the file. ``error``: None where it is
    done. ``stop``: why no other recording can be done either."""

    name: str
    error: str | None = None
    stop: str | None = None


def run_one(task: BatchTask) -> Ending:
    """Run the command on a recording and write the outcome; raises nothing."""
    if is_done(task):
        # By a worker that died before it could tell.
        return Ending(name=task.item.name)
    # A process for each core is busy already.
    cv2.setNumThreads(1)
    start_s = time.perf_counter()
    recorded_bytes: int | None = None
    result: CallResult | None = None
    error: ScanLoomError | None = None
    stop: str | None = None
    try:
        _require_version(task)
        with _opened(task) as recording:
            recorded_bytes = _bytes_of(recording) if task.item.room is None else None
            result = task.call.run(task.item, recording, task.output)
        if result.damage is not None:
            error = ScanLoomError(result.damage, file=recording)
    except Exception as raised:  # noqa: BLE001  It must not end the work on other recordings.
        error = describe_failure(raised)
        stop = _full_disk(raised)
    outcome = outcome_of(
        task,
        result=None if error is not None or result is None else dict(result.result),
        error=error,
        seconds=time.perf_counter() - start_s,
        recorded_bytes=recorded_bytes,
    )
    try:
        write_outcome(task, outcome)
    except (ExportError, OSError) as raised:
        stop = stop or str(describe_failure(raised))
    give_freed_memory_back()
    return Ending(name=task.item.name, error=outcome.error, stop=stop)


def outcome_of(
    task: BatchTask,
    *,
    result: dict[str, Any] | None,
    error: ScanLoomError | None,
    seconds: float = 0.0,
    recorded_bytes: int | None = None,
) -> Outcome:
    """The outcome of a task: of its result, or of the error for which it has none."""
    shown: dict[str, Any] = escape_undecodable_values(result or {})
    problem: str | None = None
    if error is not None:
        where = Path(error.file).name if error.file else ""
        is_elsewhere = where not in ("", Path(task.item.place).name)
        problem = printable(f"{where}: {error.problem}" if is_elsewhere else error.problem)
    return Outcome(
        name=task.item.name,
        recording=task.item.recording,
        robot=task.item.robot,
        command=task.call.command,
        error=problem,
        advice=None if error is None else printable(error.advice),
        seconds=seconds,
        recorded_bytes=recorded_bytes,
        warnings=tuple(shown.get("warnings") or shown.get("notes") or ()),
        result=shown,
    )


def describe_failure(error: Exception) -> ScanLoomError:
    """Any failure as one that a person can act on."""
    if isinstance(error, ScanLoomError):
        return error
    if isinstance(error, MemoryError):
        return ScanLoomError(
            "needs more memory than there is.", advice="Run it with fewer workers."
        )
    if isinstance(error, OSError):
        file = None if error.filename is None else str(error.filename)
        return ScanLoomError(
            f"{error.strerror or error}.", file=file, advice="Check the disk and its permissions."
        )
    return ScanLoomError(
        f"failed unexpectedly: {type(error).__name__}: {error}.",
        advice="Run the command on it alone to see where.",
    )


def _opened(task: BatchTask) -> AbstractContextManager[Path]:
    """The recording as a file or folder of this machine."""
    if task.item.is_remote:
        return local_copy(task.item.place, task.cache)
    return nullcontext(Path(task.item.place))


def _require_version(task: BatchTask) -> None:
    own = project_version()
    if own != task.version:
        raise ScanLoomError(
            f"was sent by scanloom {task.version} to a worker with {own}.",
            advice="Install the same version on all machines.",
        )


def _full_disk(error: BaseException | None) -> str | None:
    """The failure as a line where it is due to a full disk, which fails all others too."""
    described = error
    while error is not None:
        if isinstance(error, OSError) and error.errno in _DISK_FULL:
            return str(described)
        error = error.__cause__ or error.__context__
    return None


def _bytes_of(recording: Path) -> int:
    """Raises OSError."""
    total = 0
    for path in paths_of(recording):
        for folder, _, names in os.walk(path):
            total += sum((Path(folder) / name).lstat().st_size for name in names)
        if not path.is_dir():
            total += path.stat().st_size
    return total
