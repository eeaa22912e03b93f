"""What a run of ``fuse`` wrote, read back as values and tables."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from fusion_core.exporting.manifest import require_intact
from fusion_core.files.regular_file import open_regular
from fusion_core.model.errors import ExportError
from fusion_core.model.rig import MOUNT_PARAMETERS, Mount

_TABLES_AND_DOCUMENTS = ("alignment.json", "frames.csv", "samples.parquet", "summary.json")


@dataclass(frozen=True, slots=True, kw_only=True)
class FuseFiles:
    """A run's results. ``mount``: the values that the frames were fused with, and what is known of
    their errors. ``frames``: frames.csv, a row for each depth image."""

    mount: Mount
    frames: pa.Table
    notes: tuple[str, ...]
    alignment: Mapping[str, Any]


def read_fuse_folder(folder: Path) -> FuseFiles:
    """Read what ``fuse`` wrote. Raises ScanLoomError where a file is not as it writes it."""
    require_intact(folder, _TABLES_AND_DOCUMENTS, "fuse")
    try:
        alignment = json.loads((folder / "alignment.json").read_text(encoding="utf-8"))
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        with open_regular(folder / "frames.csv") as stream:
            frames = pyarrow.csv.read_csv(stream)
        return FuseFiles(
            mount=Mount.from_vector(
                np.array([alignment["mount_used"][name] for name in MOUNT_PARAMETERS]),
                tuple(alignment[f"{name}_sd"] for name in MOUNT_PARAMETERS),
            ),
            frames=frames,
            notes=tuple(summary["notes"]),
            alignment=alignment,
        )
    except (OSError, ValueError, KeyError, TypeError, pa.ArrowInvalid) as error:
        raise _unreadable(folder, error) from error


def read_samples(folder: Path) -> pa.Table:
    """samples.parquet: a row for each beam in view of each frame. Raises ExportError."""
    try:
        with open_regular(folder / "samples.parquet") as stream:
            return pq.read_table(stream)
    except (OSError, pa.ArrowInvalid) as error:
        raise _unreadable(folder / "samples.parquet", error) from error


def _unreadable(path: Path, error: Exception) -> ExportError:
    return ExportError(
        f"cannot be read back: {type(error).__name__}: {error}.",
        file=path,
        advice="Run scanloom fuse again.",
    )
