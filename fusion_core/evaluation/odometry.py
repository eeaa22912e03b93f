"""Drift of odometry relative to the distance travelled.

Over straight segments as in Li 2022 (Table 5: the sum of |estimated - true distance| over the sum
of true distances), over the whole path, and over all its segments of one length (Geiger et al.
2012, "Are we ready for autonomous driving?"), which one early error of heading does not spoil.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.evaluation.pose_arrays import project_to_plane, relative_poses
from fusion_core.evaluation.relative_pose import Step
from fusion_core.evaluation.trajectories import (
    MAX_GAP_S,
    PoseErrors,
    PosePairs,
    absolute_pose_errors,
    associate,
    path_length_m,
    relative_pose_errors,
)
from fusion_core.model.conventions import FloatArray, IntArray, read_only
from fusion_core.model.trajectory import Trajectory

SEGMENT_M = 1.0
STRAIGHT_MIN_M = 1.0
"""On a shorter segment millimetres of noise weigh much, and every curve looks straight."""
# A robot steered by hand does not drive straighter.
_LATERAL_MAX_M = 0.1
_LATERAL_RATIO_MAX = 0.06
_DETOUR_RATIO_MAX = 0.05
_DETOUR_FLOOR_M = 0.005


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StraightSegments:
    """Distances between the ends of straight segments, one after another: Li 2022, Table 5.

    ``true_m``, ``estimated_m``: (K,), K >= 0. ``begin_ns``: (K,) where each begins.
    """

    begin_ns: IntArray
    true_m: FloatArray
    estimated_m: FloatArray

    def __post_init__(self) -> None:
        for array in (self.begin_ns, self.true_m, self.estimated_m):
            read_only(array)

    @property
    def error(self) -> float | None:
        """Σ |estimated - true| / Σ true, None where no segment is straight."""
        if not self.true_m.size:
            return None
        return float(np.abs(self.estimated_m - self.true_m).sum() / self.true_m.sum())

    def to_json(self) -> dict[str, Any]:
        """The error and the distances it is computed from."""
        return {
            "error": self.error,
            "stretches": int(self.true_m.size),
            "true_m": self.true_m.tolist(),
            "estimated_m": self.estimated_m.tolist(),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryReport:
    """Drift of planar odometry over ``path_m`` metres of the reference.

    ``estimated_path_m``: the length by the odometry over the same time. ``straight``: Li's
    distances. ``end``: error of the last pose when the first ones coincide. ``segments``: errors
    over all segments of ``segment_m``.
    """

    path_m: float
    estimated_path_m: float
    straight: StraightSegments
    end: PoseErrors
    segment_m: float
    segments: PoseErrors

    @property
    def distance_error(self) -> float:
        """|estimated - true distance| / true distance."""
        return abs(self.estimated_path_m - self.path_m) / self.path_m

    def to_json(self) -> dict[str, Any]:
        """Errors as fractions of the path, and in degrees per metre."""
        return {
            "path_m": self.path_m,
            "estimated_path_m": self.estimated_path_m,
            "distance_error": self.distance_error,
            "straight": self.straight.to_json(),
            "end": _per_metre(self.end, self.path_m),
            "stretch_m": self.segment_m,
            "stretches": int(self.segments.translation_m.size),
            "over_stretches": _per_metre(self.segments, self.segment_m),
        }


def evaluate_odometry(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    segment_m: float = SEGMENT_M,
    max_gap_s: float = MAX_GAP_S,
) -> OdometryReport:
    """Drift of ``estimate`` against ``reference``, both as x, y, yaw.

    Distances are summed from pose to pose at the estimate's stamps, so that noise of the reference
    adds to its path where the poses are dense.

    Raises SettingsError for a segment or gap that is not positive, ScanLoomError where no poses can
    be compared, or the reference is shorter than a segment.
    """
    step = Step(delta=segment_m, unit="m")
    pairs = associate(estimate, reference, max_gap_s)
    pairs = PosePairs(
        stamps_ns=pairs.stamps_ns,
        T_map_estimate=project_to_plane(pairs.T_map_estimate),
        T_map_reference=project_to_plane(pairs.T_map_reference),
    )
    segments = relative_pose_errors(pairs, pairs.T_map_estimate, step)
    estimated, true = (
        relative_poses(poses[:1], poses[-1:])
        for poses in (pairs.T_map_estimate, pairs.T_map_reference)
    )
    return OdometryReport(
        path_m=float(pairs.reference_path_m[-1]),
        estimated_path_m=float(path_length_m(pairs.T_map_estimate)[-1]),
        straight=find_straight_segments(pairs),
        end=absolute_pose_errors(estimated, true),
        segment_m=segment_m,
        segments=segments,
    )


def find_straight_segments(
    pairs: PosePairs, *, length_min_m: float = STRAIGHT_MIN_M
) -> StraightSegments:
    """The reference's straight segments, from one turn to the next, measured end to end.

    A segment grows as long as it stays within 10 cm of the line between its ends and is at most
    5 % longer. It counts if that line has at least ``length_min_m`` and the deviation from it is at
    most 6 % of its length, which excludes arcs. ``pairs`` hold planar poses.
    """
    positions = pairs.T_map_reference[:, :2, 3]
    path_m = pairs.reference_path_m
    chosen: list[tuple[int, int]] = []
    begin = 0
    for end in range(1, path_m.size + 1):
        if end < path_m.size:
            chord_m, deviation_m = _chord_and_deviation_m(positions[begin : end + 1])
            detour_m = path_m[end] - path_m[begin] - chord_m
            if deviation_m <= _LATERAL_MAX_M and detour_m <= max(
                _DETOUR_RATIO_MAX * chord_m, _DETOUR_FLOOR_M
            ):
                continue
        chord_m, deviation_m = _chord_and_deviation_m(positions[begin:end])
        if chord_m >= length_min_m and deviation_m <= _LATERAL_RATIO_MAX * chord_m:
            chosen.append((begin, end - 1))
        begin = end - 1
    first = np.array([pair[0] for pair in chosen], dtype=np.int64)
    last = np.array([pair[1] for pair in chosen], dtype=np.int64)
    true_m, estimated_m = (
        np.linalg.norm(poses[last, :2, 3] - poses[first, :2, 3], axis=1)
        for poses in (pairs.T_map_reference, pairs.T_map_estimate)
    )
    return StraightSegments(begin_ns=pairs.stamps_ns[first], true_m=true_m, estimated_m=estimated_m)


def _chord_and_deviation_m(positions: FloatArray) -> tuple[float, float]:
    """Length of the line between the ends of (M, 2) positions, and their greatest distance from
    it."""
    chord = positions[-1] - positions[0]
    chord_m = float(np.linalg.norm(chord))
    away = positions - positions[0]
    if chord_m == 0.0:
        return 0.0, float(np.linalg.norm(away, axis=1).max())
    return chord_m, float(np.abs(away[:, 0] * chord[1] - away[:, 1] * chord[0]).max() / chord_m)


def _per_metre(errors: PoseErrors, path_m: float) -> dict[str, float]:
    return {
        "translation_error": float(errors.translation_m.mean()) / path_m,
        "rotation_deg_per_m": float(np.degrees(errors.rotation_rad.mean())) / path_m,
    }
