"""What became of one recording of a batch."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

BatchCommand = Literal["info", "fuse", "map", "evaluate"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """A recording of a batch, done or failed.

    ``name``: of the row, and of the folder of its results below ``runs``; unique in the batch.
    ``recording``: its path relative to the batch's folder, or its address.
    ``robot``: whose it is: recordings of one robot are compared with each other.
    ``error`` and ``advice``: why it failed, None where it did not.
    ``seconds``: that the work took. ``recorded_bytes``: of the recording, None where unknown.
    ``result``: what the command prints under ``--json``, empty where it failed.
    """

    name: str
    recording: str
    robot: str
    command: BatchCommand
    error: str | None
    advice: str | None
    seconds: float
    recorded_bytes: int | None
    warnings: tuple[str, ...]
    result: Mapping[str, Any]

    @property
    def is_done(self) -> bool:
        return self.error is None
