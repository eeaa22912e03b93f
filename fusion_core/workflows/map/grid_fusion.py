"""Two named grids of a run fused cell by cell (Fu 2024 §3.2): alignment, both rules, report and
files."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.evaluation.truth_arrays import UNREADABLE_ARRAYS, read_arrays
from fusion_core.exporting.figures_fusion import write_fusion_figure, write_misalignment_figure
from fusion_core.exporting.manifest import require_intact
from fusion_core.exporting.ros_map import trinary_pixels
from fusion_core.files.npz import write_arrays
from fusion_core.mapping.bayes import cell_evidence, fuse_grids
from fusion_core.mapping.grid_misalignment import (
    GridFusionSettings,
    GridMisalignment,
    estimate_misalignment,
)
from fusion_core.mapping.moved_grid import move_grid
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import ExportError, MissingStream, RegistrationFailed
from fusion_core.model.grid_fusion import FusionRule, GridFusion
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.recording import Recording
from fusion_core.recordings.topics import Streams

__all__ = [
    "EVIDENCE_NAME",
    "FusedGrids",
    "cell_evidence",
    "differing_places_m",
    "fuse_named_grids",
    "fusion_notes",
    "fusion_report",
    "read_evidence",
    "require_two_sensors",
    "write_fusion",
]

EVIDENCE_NAME = "evidence.npz"
_LOG_ODDS = "log_odds_"
_AXES = (("dx_m", 0), ("dy_m", 1), ("yaw_rad", 2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FusedGrids:
    """Two grids, how they lie on each other, and their fusion.

    ``given``: the two grids as they were drawn. ``misalignment``: of the second on the first, None
    where nothing of it is observable, for ``reason``. ``is_moved``: whether the second was moved by
    it before fusing. ``rule``: the one whose grid is the result.
    """

    given: Mapping[str, OccupancyGrid]
    misalignment: GridMisalignment | None
    reason: str
    is_moved: bool
    fusion: GridFusion
    rule: FusionRule

    @property
    def result(self) -> OccupancyGrid:
        """The fused grid by the run's rule."""
        return self.fusion.fused(self.rule)


def require_two_sensors(recording: Recording, streams: Streams, rule: FusionRule) -> None:
    """Raise MissingStream unless the recording has both a LiDAR and depth images to draw."""
    if streams.lidar is not None and streams.depth:
        return
    missing = "2D LiDAR" if streams.lidar is None else "depth image"
    raise MissingStream(
        f"has no {missing}: --fusion {rule} takes the LiDAR's grid and the camera's.",
        file=recording.path,
        advice="Use --fusion none.",
    )


def fuse_named_grids(
    grids: Mapping[str, OccupancyGrid], rule: FusionRule, settings: GridFusionSettings
) -> FusedGrids:
    """Fuse two independent grids of one resolution, given by name.

    Raises ValueError unless there are two, in one frame, on one raster.
    """
    (first, base), (second, other) = grids.items()
    found, reason = None, ""
    try:
        found = estimate_misalignment(base, other, settings)
    except RegistrationFailed as error:
        reason = str(error)
    is_moved = settings.alignment == "apply" and found is not None
    if is_moved and found is not None:
        other = move_grid(other, found.pose_first_second)
    return FusedGrids(
        given=dict(grids),
        misalignment=found,
        reason=reason,
        is_moved=is_moved,
        fusion=fuse_grids({first: base, second: other}),
        rule=rule,
    )


def fusion_report(fused: FusedGrids) -> dict[str, Any]:
    """The entry of report.json on the fusion.

    ``cells`` and ``rules_differ`` are by the more probable state; the map files keep a margin and
    draw a cell between their two thresholds as unknown: ``drawn_cells_differ`` are the pixels by
    which map_fused.pgm of the two rules differ.
    """
    fusion = fused.fusion
    drawn_differ = trinary_pixels(fusion.table) != trinary_pixels(fusion.bayes)
    return {
        "rule": fused.rule,
        "grids": list(fusion.names),
        "cells": fusion.count_states(),
        "rules_differ": int(fusion.rules_differ.sum()),
        "drawn_cells_differ": int(drawn_differ.sum()),
        "misalignment": _misalignment_report(fused),
    }


def fusion_notes(fused: FusedGrids) -> list[str]:
    """For people: how the two grids lie on each other, and where the rules disagree."""
    first, second = fused.fusion.names
    differ = int(fused.fusion.rules_differ.sum())
    notes = [
        f"The {first} grid and the {second} grid are fused by {fused.rule}; in {differ} cells "
        "Table 3 has an obstacle that (10) does not have."
    ]
    found = fused.misalignment
    if found is None:
        return [*notes, f"Misalignment of the two grids: not observable, {fused.reason}"]
    text = ", ".join(_axis_text(found, name, axis) for name, axis in _AXES)
    what = "more than chance" if found.is_significant else "no more than chance"
    then = "the second is moved by it" if fused.is_moved else "not applied"
    return [*notes, f"Misalignment of {second} on {first}: {text}: {what}; {then}."]


def write_fusion(folder: Path, fused: FusedGrids, heading: str) -> None:
    """``evidence.npz``, the fusion's picture, and that of the alignment before it.

    The evidence: ``names`` of the two grids, ``log_odds_NAME`` of each, (rows, columns) with NaN
    where unknown and row 0 at the smallest y, ``resolution_m``, and ``origin_m`` x, y of the outer
    corner of cell (0, 0) in the map frame.
    """
    fusion = fused.fusion
    second = fusion.names[1]
    write_arrays(
        folder / EVIDENCE_NAME,
        {
            "names": np.array(fusion.names),
            **{_LOG_ODDS + name: grid.log_odds for name, grid in fusion.layers.items()},
            "resolution_m": np.array(fusion.table.resolution_m),
            "origin_m": np.array(fusion.table.origin_m),
        },
    )
    write_fusion_figure(folder / "fusion.png", heading, fusion)
    moved = fused.given[second]
    text = "not observable"
    if fused.misalignment is not None:
        moved = move_grid(moved, fused.misalignment.pose_first_second)
        found = fused.misalignment
        text = ", ".join(_axis_text(found, name, axis) for name, axis in _AXES)
    write_misalignment_figure(
        folder / "misalignment.png", heading, fused.given, {second: moved}, text
    )


def read_evidence(folder: Path) -> dict[str, OccupancyGrid]:
    """The two grids that a run fused, by name, with their log-odds, on one canvas.

    Raises ExportError where the run fused none or the file is not as it was written.
    """
    path = folder / EVIDENCE_NAME
    if not path.exists():
        raise ExportError(
            "holds no evidence of a fusion.", file=folder, advice="Run map with --fusion table."
        )
    require_intact(folder, (EVIDENCE_NAME,), "map")
    try:
        arrays = read_arrays(path)
        x_m, y_m = arrays["origin_m"].astype(np.float64).tolist()
        return {
            name: OccupancyGrid(
                resolution_m=float(arrays["resolution_m"].astype(np.float64)),
                origin_m=(x_m, y_m),
                log_odds=arrays[_LOG_ODDS + name].astype(np.float64, copy=False),
            )
            for name in arrays["names"].astype(str).tolist()
        }
    except (OSError, KeyError, TypeError, *UNREADABLE_ARRAYS) as error:
        raise ExportError(
            f"cannot be read back: {type(error).__name__}: {error}.",
            file=path,
            advice="Run it again.",
        ) from error


def differing_places_m(grids: Mapping[str, OccupancyGrid]) -> FloatArray:
    """(N, 2) middles of the cells, in the map frame, whose state by Table 3 is another than by
    (10), row by row. ``grids``: two by name, as ``read_evidence`` gives them."""
    fusion = fuse_grids(grids)
    row, column = np.nonzero(fusion.rules_differ)
    cells = np.column_stack([column, row]) + 0.5
    places_m: FloatArray = np.array(fusion.table.origin_m) + fusion.table.resolution_m * cells
    return places_m


def _misalignment_report(fused: FusedGrids) -> dict[str, Any]:
    found = fused.misalignment
    if found is None:
        return {"observable": False, "reason": fused.reason, "applied": False}
    report: dict[str, Any] = {"observable": bool(np.isfinite(found.shift).any())}
    for name, axis in _AXES:
        known = bool(np.isfinite(found.shift[axis]))
        report[name] = float(found.shift[axis]) if known else None
        report[f"sigma_{name}"] = float(found.sigma[axis]) if known else None
    return report | {
        "about_m": found.centre_m.tolist(),
        "not_observable": [name for name, axis in _AXES if np.isnan(found.shift[axis])],
        "pairs": found.pairs,
        "more_than_chance": found.is_significant,
        "applied": fused.is_moved,
    }


def _axis_text(found: GridMisalignment, name: str, axis: int) -> str:
    value, sigma = float(found.shift[axis]), float(found.sigma[axis])
    label, unit = name.rsplit("_", 1)
    if np.isnan(value):
        return f"{label} not observable"
    if unit == "rad":
        return f"{label} {np.rad2deg(value):+.2f} ± {np.rad2deg(sigma):.2f} deg"
    return f"{label} {100.0 * value:+.1f} ± {100.0 * sigma:.1f} cm"
