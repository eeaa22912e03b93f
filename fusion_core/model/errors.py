"""Typed errors. Each names the file or value at fault and what to do about it."""

from pathlib import Path
from typing import Any

from fusion_core.model.names import escape_undecodable


class ScanLoomError(Exception):
    """A failure that a person can act on: what is wrong, in which file, and what to do.

    ``str(error)`` is one line; ``file`` and ``advice`` go into ``--json`` output. All are readable.
    """

    def __init__(self, problem: str, *, file: Path | str | None = None, advice: str = "") -> None:
        self.problem = escape_undecodable(problem)
        self.file = None if file is None else escape_undecodable(str(file))
        self.advice = escape_undecodable(advice)
        where = f"{self.file}: " if self.file else ""
        then = f" {self.advice}" if advice else ""
        super().__init__(f"{where}{self.problem}{then}")

    def __reduce__(self) -> tuple[Any, ...]:
        # Errors of other processes come pickled, those whose arguments have names too.
        return _unpickled, (type(self), self.args, vars(self))


def _unpickled(
    kind: type[ScanLoomError], args: tuple[Any, ...], values: dict[str, Any]
) -> ScanLoomError:
    error = kind.__new__(kind, *args)
    error.args = args
    vars(error).update(values)
    return error


class RecordingError(ScanLoomError):
    """A recording, or a part of it, cannot be read."""


class SettingsError(ScanLoomError):
    """A setting is unknown, of the wrong type or out of range."""


class AlignmentFailed(ScanLoomError):
    """The data do not determine an offset (u, v) or a mount."""


class RegistrationFailed(ScanLoomError):
    """No acceptable map A explains the pairs of a frame, or no motion two sweeps."""


class CalibrationFailed(ScanLoomError):
    """The data do not determine the extrinsics or the intrinsics."""


class EvaluationFailed(ScanLoomError):
    """The data do not determine what is to be measured."""


class MissingStream(ScanLoomError):
    """The recording lacks a required stream, or has none of the given name."""


class ExportError(ScanLoomError):
    """A result cannot be written to the requested place."""


class LabelStoreError(ScanLoomError):
    """A label store cannot be used, or an action in it cannot be taken back."""


class WorkerFailed(ScanLoomError):
    """A process that shared in the work has ended before its time."""


class FramesNotConnected(MissingStream):
    """No chain of recorded transforms leads from one frame to the other."""


class StampOutsideRange(ScanLoomError):
    """A pose is requested at an instant outside its samples.

    ``start_ns`` and ``end_ns`` are the first and last instant with a pose.
    """

    def __init__(self, problem: str, *, stamp_ns: int, start_ns: int, end_ns: int) -> None:
        super().__init__(f"{problem} at {stamp_ns} ns: known from {start_ns} to {end_ns} ns.")
        self.stamp_ns = stamp_ns
        self.start_ns = start_ns
        self.end_ns = end_ns


class MappingFailed(ScanLoomError):
    """The scans give no map, or one that is larger than the settings allow."""


class VolumeTooLarge(MappingFailed):
    """A map in space takes more memory than the settings allow; a coarser one may fit."""
