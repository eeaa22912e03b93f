"""Obstacle outlines of a world, seen from above: the reference for measuring maps.

Li 2022, Fig. 8 (a): the outlines of all obstacles to the robot, three lines and two angles.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only

SAMPLE_STEP_M = 0.01
"""Outlines are sampled at least this densely."""

SENSORS = ("lidar", "camera")

# Faces are parallel within a millimetre per metre.
_PARALLEL_RAD = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObstacleOutline:
    """A polyline (closed where its last point is its first) around an obstacle, or a part of it.

    ``outline_m``: (N, 2), N >= 2, in the world's frame. ``z_min_m``, ``z_max_m``: heights of its
    lower and upper end above the floor. ``seen_by``: for each sensor the samples that it could see,
    as (R, 2) runs [start, end) of sample numbers, ascending and separate.
    """

    name: str
    z_min_m: float
    z_max_m: float
    outline_m: FloatArray
    seen_by: Mapping[str, IntArray]

    def __post_init__(self) -> None:
        _check_points(self.outline_m, self.outline_m.shape[0], f"outline of {self.name}")
        if self.outline_m.shape[0] < 2 or not self.length_m > 0.0:
            raise ValueError(f"the outline of {self.name} has no length")
        if not self.z_min_m <= self.z_max_m:
            raise ValueError(f"{self.name} has a height from {self.z_min_m} m to {self.z_max_m} m")
        for sensor, runs in self.seen_by.items():
            if sensor not in SENSORS:
                raise ValueError(f"{self.name}: no sensor is called {sensor!r}")
            if runs.ndim != 2 or runs.shape[1:] != (2,) or runs.dtype != np.int64:
                raise ValueError(f"runs must be (R, 2) int64, got {runs.shape} {runs.dtype}")
            ends = np.concatenate([[-1], runs.reshape(-1), [self.sample_count + 1]])
            if (np.diff(ends) <= 0).any():
                raise ValueError(
                    f"{self.name}: the runs of {sensor} must ascend within 0 to {self.sample_count}"
                )
            read_only(runs)

    @property
    def length_m(self) -> float:
        """Along the polyline."""
        return float(np.linalg.norm(np.diff(self.outline_m, axis=0), axis=1).sum())

    @property
    def sample_count(self) -> int:
        """As many samples as keep their distance at or below ``SAMPLE_STEP_M``."""
        return max(1, int(np.ceil(self.length_m / SAMPLE_STEP_M - 1e-9)))

    def samples_m(self) -> FloatArray:
        """(S, 2): the middles of ``sample_count`` pieces of equal length along the polyline."""
        steps = np.linalg.norm(np.diff(self.outline_m, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        count = self.sample_count
        at = (np.arange(count) + 0.5) * (along[-1] / count)
        return np.stack([np.interp(at, along, self.outline_m[:, axis]) for axis in (0, 1)], axis=1)

    def seen_samples(self, sensor: str) -> BoolArray:
        """(S,): the samples that a sensor could see; none where it is not named."""
        flags = np.zeros(self.sample_count, dtype=np.bool_)
        for start, end in self.seen_by.get(sensor, ()):
            flags[start:end] = True
        return flags


def find_runs(flags: BoolArray) -> IntArray:
    """(R, 2) runs [start, end) of the true among (S,) flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return edges.astype(np.int64).reshape(-1, 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredLine:
    """A distance to measure in a map: between two parallel faces.

    ``faces_m``: (2, 2, 2), the two ends of each face.
    """

    name: str
    faces_m: FloatArray

    def __post_init__(self) -> None:
        _check_segments(self.faces_m, self.name)
        first, second = unit_directions(self.faces_m)
        if abs(first[0] * second[1] - first[1] * second[0]) > _PARALLEL_RAD:
            raise ValueError(f"the faces of {self.name} are not parallel")

    @property
    def length_m(self) -> float:
        """The true distance."""
        (x, y), _ = unit_directions(self.faces_m)
        between_m = self.faces_m[1].mean(axis=0) - self.faces_m[0].mean(axis=0)
        return float(abs(x * between_m[1] - y * between_m[0]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredAngle:
    """An angle to measure in a map: between two faces.

    ``arms_m``: (2, 2, 2), each face from its end near the vertex to its end far from it.
    """

    name: str
    arms_m: FloatArray

    def __post_init__(self) -> None:
        _check_segments(self.arms_m, self.name)

    @property
    def angle_rad(self) -> float:
        """The true angle, in [0, pi]."""
        first, second = unit_directions(self.arms_m)
        return float(np.arccos(np.clip(first @ second, -1.0, 1.0)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WorldOutline:
    """All obstacles to a robot of height ``robot_height_m``."""

    robot_height_m: float
    obstacles: tuple[ObstacleOutline, ...]
    lines: tuple[MeasuredLine, ...] = ()
    angles: tuple[MeasuredAngle, ...] = ()
    frame_id: str = "map"

    def __post_init__(self) -> None:
        if not self.robot_height_m > 0.0:
            raise ValueError(f"robot_height_m must be positive, got {self.robot_height_m}")


def unit_directions(segments_m: FloatArray) -> FloatArray:
    """(2, 2) unit vectors along two segments (2, 2, 2)."""
    along = segments_m[:, 1] - segments_m[:, 0]
    unit: FloatArray = along / np.linalg.norm(along, axis=1, keepdims=True)
    return unit


def _check_segments(segments_m: FloatArray, name: str) -> None:
    if segments_m.shape != (2, 2, 2):
        raise ValueError(f"{name} must have two segments of two points, got {segments_m.shape}")
    _check_points(segments_m.reshape(-1, 2), 4, name)
    if not (np.linalg.norm(segments_m[:, 1] - segments_m[:, 0], axis=1) > 0.0).all():
        raise ValueError(f"a segment of {name} has no length")
    read_only(segments_m)


def _check_points(points_m: FloatArray, count: int, what: str) -> None:
    if points_m.shape != (count, 2) or points_m.dtype != np.float64:
        raise ValueError(f"{what} must be (N, 2) float64, got {points_m.shape} {points_m.dtype}")
    if not np.isfinite(points_m).all():
        raise ValueError(f"{what} must be finite")
    read_only(points_m)
