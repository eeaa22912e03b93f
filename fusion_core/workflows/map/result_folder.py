"""What a run of ``map`` wrote, read back as values for display."""

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.exporting.manifest import require_intact
from fusion_core.model.conventions import (
    NS_PER_S,
    BoolArray,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.model.errors import ExportError, ScanLoomError, StampOutsideRange
from fusion_core.model.geometry import planar_from_transform
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.stamps import nearest_stamps
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.ros_map import read_ros_map
from fusion_core.recordings.tum_trajectory import read_tum_trajectory
from fusion_core.workflows.map.options import shown_map

# Log odds of a cell that the trinary picture has as occupied: far above any threshold.
_SURE_LOG_ODDS = 5.0
_TRANSLATION, _ROTATION = "_translation", "_rotation"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapResults:
    """A run's results. Times are stamps in ns.

    ``trusted``: (N,) of the trajectory's poses. ``loops_m``: (L, 4) x, y of both ends of each loop
    closure. ``effective``: (K, 2) stamp in s and effective number of particles, (0, 2) without.
    ``weight_stamps_s``: (M,) where odometries were fused, (0,) elsewhere; ``translation_weights``,
    ``rotation_weights``: (M,) of each by name. ``grid``: None where there is no map.
    """

    report: Mapping[str, Any]
    trajectory: Trajectory
    trusted: BoolArray
    loops_m: FloatArray
    effective: FloatArray
    weight_stamps_s: FloatArray
    translation_weights: Mapping[str, FloatArray]
    rotation_weights: Mapping[str, FloatArray]
    grid: OccupancyGrid | None

    def __post_init__(self) -> None:
        for array in (self.trusted, self.loops_m, self.effective, self.weight_stamps_s):
            read_only(array)


@dataclass(slots=True)
class TrajectoryPoses:
    """A run's trajectory as poses of the LiDAR in the map."""

    source: str
    trajectory: Trajectory

    def at(self, stamp_ns: int) -> FloatArray | None:
        """(x, y, yaw), None before the first scan that was placed and after the last."""
        try:
            return planar_from_transform(self.trajectory.pose_at(stamp_ns))
        except StampOutsideRange:
            return None


def read_map_results(folder: Path) -> MapResults:
    """Read what ``build_map`` wrote. Raises ExportError where a file is not as it writes it."""
    try:
        require_intact(folder, ("report.json", "trajectory.tum", "odometry_weights.csv"), "map")
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        trajectory = read_tum_trajectory(folder / "trajectory.tum").trajectory
        grid = folder / f"map_{shown_map(report)}.yaml"
        require_intact(folder, (grid.name, f"{grid.stem}.pgm"))
        stamps_s, weights = _read_weights(folder / "odometry_weights.csv")
        return MapResults(
            report=report,
            trajectory=trajectory,
            trusted=_read_trusted(trajectory.stamps_ns, report["untrusted"]),
            loops_m=_read_loops(trajectory, report.get("loop_closures", [])),
            effective=_read_pairs(report.get("effective", [])),
            weight_stamps_s=stamps_s,
            translation_weights=_columns_with_suffix(weights, _TRANSLATION),
            rotation_weights=_columns_with_suffix(weights, _ROTATION),
            grid=read_grid(grid) if grid.exists() else None,
        )
    except (OSError, ValueError, KeyError, TypeError, IndexError, ScanLoomError) as error:
        raise ExportError(
            f"cannot be read back: {type(error).__name__}: {error}.",
            file=folder,
            advice="Run it again.",
        ) from error


def _read_trusted(stamps_ns: IntArray, untrusted: list[dict[str, Any]]) -> BoolArray:
    trusted = np.ones(stamps_ns.size, dtype=np.bool_)
    for interval in untrusted:
        first, last = _indices_of_seconds(stamps_ns, [interval["from_s"], interval["to_s"]])
        trusted[first : last + 1] = False
    return trusted


def _read_loops(trajectory: Trajectory, closures: list[dict[str, Any]]) -> FloatArray:
    positions_m = trajectory.T_map_body[:, :2, 3]
    ends_s = [[closure[name] for name in ("first_s", "second_s")] for closure in closures]
    ends = _indices_of_seconds(trajectory.stamps_ns, np.reshape(ends_s, -1).tolist())
    return positions_m[ends].reshape(-1, 4)


def _indices_of_seconds(stamps_ns: IntArray, stamps_s: list[float]) -> IntArray:
    """Indices of stamps that are written in seconds, which rounds them: the nearest are meant."""
    at_ns = np.array([round(stamp_s * NS_PER_S) for stamp_s in stamps_s], dtype=np.int64)
    return nearest_stamps(stamps_ns, at_ns)


def _read_pairs(values: list[Any]) -> FloatArray:
    """(K, 2); null is NaN."""
    return np.array(values, dtype=np.float64).reshape(-1, 2)


def _read_weights(file: Path) -> tuple[FloatArray, dict[str, FloatArray]]:
    """The middle of each step in s, and the columns of weights."""
    if not file.exists():
        return np.empty(0), {}
    with file.open(encoding="utf-8", newline="") as lines:
        names, *rows = csv.reader(lines)
    columns = {name: [row[place] for row in rows] for place, name in enumerate(names)}
    ends_ns = np.array([columns["from_ns"], columns["to_ns"]], dtype=np.float64)
    return ends_ns.mean(axis=0) / NS_PER_S, {
        name: np.array([float(value or "nan") for value in values])
        for name, values in columns.items()
        if name.endswith((_TRANSLATION, _ROTATION))
    }


def _columns_with_suffix(columns: Mapping[str, FloatArray], ending: str) -> dict[str, FloatArray]:
    """The columns whose names end so, without that."""
    return {
        name.removesuffix(ending): values
        for name, values in columns.items()
        if name.endswith(ending)
    }


def read_grid(file: Path) -> OccupancyGrid:
    """A map from its YAML file; each cell is occupied, free or unknown. Raises RecordingError."""
    drawn = read_ros_map(file)
    log_odds = np.full(drawn.occupied.shape, np.nan)
    log_odds[drawn.occupied] = _SURE_LOG_ODDS
    log_odds[drawn.free] = -_SURE_LOG_ODDS
    return OccupancyGrid(
        resolution_m=drawn.resolution_m, origin_m=drawn.origin[:2], log_odds=log_odds
    )


def read_maps(folder: Path) -> dict[str, OccupancyGrid]:
    """Every map that a run of ``fuse`` or ``map`` wrote, by name ("lidar" for map_lidar.yaml).

    Raises ScanLoomError where a file is not as it was written.
    """
    files = sorted(folder.glob("map_*.yaml"))
    require_intact(folder, [name for file in files for name in (file.name, f"{file.stem}.pgm")])
    return {file.stem.removeprefix("map_"): read_grid(file) for file in files}
