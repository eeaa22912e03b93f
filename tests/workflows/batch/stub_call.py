"""A command that does what the name of the recording says, and counts how often it was called."""

import errno
import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fusion_core.model.errors import RecordingError
from fusion_core.workflows.batch.items import BatchItem
from fusion_core.workflows.batch.outcome import BatchCommand
from fusion_core.workflows.batch.task import CallResult

MCAP_MAGIC = b"\x89MCAP0\r\n"


@dataclass(frozen=True, kw_only=True)
class StubCall:
    """``counts``: a folder with a byte for each call, in a file of the recording's name."""

    counts: Path
    command: BatchCommand = "info"
    is_repeated: bool = False
    choice: str = ""

    def options(self) -> dict[str, Any]:
        return {"choice": self.choice}

    def files(self, item: BatchItem) -> tuple[Path, ...]:
        return ()

    def run(self, item: BatchItem, recording: Path, output: Path) -> CallResult:
        with (self.counts / item.name).open("ab") as counted:
            counted.write(b".")
        what = recording.stem.split("_")[0]
        if what == "error":
            raise RecordingError("holds\nnothing.", file=recording, advice="Record again.")
        if what == "bug":
            raise ZeroDivisionError("of this test")
        if what == "memory":
            raise MemoryError
        if what == "full":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(output))
        if what == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if what == "damage":
            return CallResult(result={}, damage="is damaged.")
        return CallResult(result={"size": recording.stat().st_size, "warnings": ["a warning"]})

    def count(self, name: str) -> int:
        """How often it was called for the recording of this name."""
        counted = self.counts / name
        return counted.stat().st_size if counted.exists() else 0


def write_recordings(folder: Path, *names: str) -> Path:
    """Files that look like recordings."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / f"{name}.mcap").write_bytes(MCAP_MAGIC)
    return folder
