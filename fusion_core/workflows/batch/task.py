"""What is run on one recording of a batch, as it is sent to a worker."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from fusion_core.workflows.batch.cache import RemoteCache
from fusion_core.workflows.batch.items import BatchItem
from fusion_core.workflows.batch.outcome import BatchCommand

RUNS, OUTCOMES = "runs", "outcomes"
UNFINISHED = ".unfinished"
"""Where outcomes are written aside."""


def outcome_path(folder: Path, item: BatchItem) -> Path:
    """The file of an item's outcome in the folder of a batch."""
    return folder / OUTCOMES / f"{item.name}.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class CallResult:
    """``result``: what the command prints under ``--json``. ``damage``: why the recording failed
    though the command ended well, None where it did not."""

    result: Mapping[str, Any]
    damage: str | None = None


class BatchCall(Protocol):
    """A command with its options, which each recording is run through. It is pickled."""

    @property
    def command(self) -> BatchCommand: ...

    @property
    def is_repeated(self) -> bool:
        """Whether it runs again on a recording that is done."""

    def options(self) -> dict[str, Any]:
        """What determines the results besides the files, ready for JSON."""

    def files(self, item: BatchItem) -> tuple[Path, ...]:
        """The files and folders that are read besides the recording."""

    def run(self, item: BatchItem, recording: Path, output: Path) -> CallResult:
        """Run the command on ``recording``, where ``item`` lies now, into the folder ``output``.
        Raises ScanLoomError."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchTask:
    """``folder``: of the whole batch. ``version``: of the project that sends it. ``input_state``:
    of all files that are read, "" where it is not known. ``cache``: for what is remote."""

    item: BatchItem
    call: BatchCall
    folder: Path
    version: str
    input_state: str
    cache: RemoteCache

    @property
    def output(self) -> Path:
        return self.folder / RUNS / self.item.name

    @property
    def outcome_file(self) -> Path:
        return outcome_path(self.folder, self.item)

    def request(self) -> dict[str, Any]:
        """What determines the outcome, ready for JSON."""
        room = self.item.room
        return {
            "command": self.call.command,
            "version": self.version,
            "recording": self.item.recording,
            "room": None if room is None else str(room),
            "options": self.call.options(),
            "input_state": self.input_state,
        }
