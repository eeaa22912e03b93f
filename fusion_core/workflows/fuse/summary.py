"""The summary of a run of ``fuse``: as text, as JSON, and as stored in the folder of results."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.files.atomic import write_text
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.number_text import with_deviation
from fusion_core.model.rig import MOUNT_PARAMETERS

_KEPT = ("frames", "paired", "classes", "scores", "notes")


@dataclass(frozen=True, kw_only=True)
class FuseSummary:
    """The summary of a run. ``document`` is alignment.json's content; ``scores`` counts the frames
    in the columns of Table 1; ``pose_source`` says where the maps' poses come from, None without;
    ``grids`` are the maps by name. The last two are not set where a run is skipped."""

    output: Path
    skipped: bool
    document: dict[str, Any]
    frames: int
    paired: int
    lidar_counts: dict[str, int]
    scores: dict[str, int]
    notes: tuple[str, ...]
    pose_source: str | None = None
    grids: Mapping[str, OccupancyGrid] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """One machine-readable result."""
        return {
            "output": str(self.output),
            "skipped": self.skipped,
            "frames": self.frames,
            "paired": self.paired,
            "classes": self.lidar_counts,
            "scores": self.scores,
            "alignment": self.document,
            "notes": list(self.notes),
        }

    def lines(self) -> list[str]:
        """The same for people."""
        if self.skipped:
            return [f"{self.output} already holds this result; nothing was done (--force redoes)."]
        document = self.document
        virtual = " (virtual LiDAR)" if document["virtual_lidar"] else ""
        lines = [
            f"preset     {document['preset']}{virtual}, pairs along the {document['row_model']}",
            f"offset     u = {document['u']:.2f} samples, v = {document['v']:.1f}, "
            f"{document['metric']} score {document['score']:.3f}",
            *_mount_lines(document),
            f"frames     {self.paired} of {self.frames} depth images paired with a scan",
        ]
        counts = ", ".join(f"{name} {count}" for name, count in self.lidar_counts.items())
        lines.append(f"LiDAR      {counts}")
        lines.extend(f"note       {note}" for note in self.notes)
        lines.append(f"results    {self.output}")
        return lines


def _mount_lines(document: dict[str, Any]) -> Iterator[str]:
    units = {"rad": ("deg", 180.0 / np.pi), "m": ("m", 1.0), "ms": ("ms", 1.0)}
    roll = ("roll_rad",) if "roll_rad" in document else ()
    for name in (*MOUNT_PARAMETERS, *roll):
        unit, factor = units[name.rsplit("_", 1)[1]]
        label = name.rsplit("_", 1)[0].replace("_", " ")
        if document[f"{name}_sd"] is None:
            yield f"mount      {label}: not observable in this recording"
        else:
            value, sd = document[name] * factor, document[f"{name}_sd"] * factor
            is_level = name in roll and document["roll_used_rad"] == 0.0
            level = ", taken as level" if is_level else ""
            number = " +- ".join(with_deviation(value, sd))
            yield f"mount      {label} {number} {unit}{level}"


def write_summary(folder: Path, summary: FuseSummary) -> None:
    """summary.json: what ``read_summary`` needs beside alignment.json."""
    document = summary.to_json()
    kept = {key: document[key] for key in _KEPT}
    write_text(folder / "summary.json", json.dumps(kept, indent=2) + "\n")


def read_summary(output: Path) -> FuseSummary:
    """The summary of a run whose results are there already."""
    summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    return FuseSummary(
        output=output,
        skipped=True,
        document=json.loads((output / "alignment.json").read_text(encoding="utf-8")),
        frames=summary["frames"],
        paired=summary["paired"],
        lidar_counts=summary["classes"],
        scores=summary["scores"],
        notes=tuple(summary["notes"]),
    )
