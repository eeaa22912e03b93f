"""What a run of ``fuse`` wrote, read back as values and tables."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion_core.evaluation.fuse_folder import open_fuse_folder, read_frames_table, read_mount
from fusion_core.exporting.manifest import require_intact
from fusion_core.files.regular_file import open_regular
from fusion_core.model.errors import ExportError
from fusion_core.model.rig import Mount

if TYPE_CHECKING:
    import pyarrow as pa

_TABLES_AND_DOCUMENTS = ("alignment.json", "frames.csv", "samples.parquet", "summary.json")


@dataclass(frozen=True, slots=True, kw_only=True)
class FuseFiles:
    """A run's results. ``mount``: the values that the frames were fused with, and what is known of
    their errors. ``frames``: frames.csv, a row for each depth image."""

    mount: Mount
    frames: "pa.Table"
    notes: tuple[str, ...]
    alignment: Mapping[str, Any]


def read_fuse_folder(folder: Path) -> FuseFiles:
    """Read what ``fuse`` wrote. Raises ScanLoomError where a file is not as it writes it."""
    require_intact(folder, _TABLES_AND_DOCUMENTS, "fuse")
    opened = open_fuse_folder(folder)
    summary = folder / "summary.json"
    try:
        notes = tuple(json.loads(summary.read_text(encoding="utf-8"))["notes"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _unreadable(summary, error) from error
    return FuseFiles(
        mount=read_mount(opened),
        frames=read_frames_table(opened),
        notes=notes,
        alignment=opened.alignment,
    )


def read_samples(folder: Path) -> "pa.Table":
    """samples.parquet: a row for each beam in view of each frame. Raises ExportError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = folder / "samples.parquet"
    try:
        with open_regular(file) as stream:
            return pq.read_table(stream)
    except (OSError, pa.ArrowInvalid) as error:
        raise _unreadable(file, error) from error


def _unreadable(file: Path, error: Exception) -> ExportError:
    return ExportError(
        f"cannot be read back: {type(error).__name__}: {error}.",
        file=file,
        advice="Run scanloom fuse again.",
    )
