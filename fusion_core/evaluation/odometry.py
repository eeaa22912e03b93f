"""How far odometry drifts, relative to the path: what a person expects of a metre travelled.

Over the whole path as Li 2022 has it (Table 5: distances summed, over the true distance), and over
all its stretches of one length (Geiger et al. 2012, "Are we ready for autonomous driving?"), which
one early error of heading does not spoil.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.evaluation.pose_stacks import planar, relative
from fusion_core.evaluation.relative_pose import Step
from fusion_core.evaluation.trajectories import (
    GREATEST_GAP_S,
    PoseErrors,
    PosePairs,
    absolute_errors,
    associate,
    relative_errors,
    travelled_m,
)
from fusion_core.model.trajectory import Trajectory

STRETCH_M = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryReport:
    """Drift of planar odometry over ``path_m`` metres of the reference.

    ``estimated_path_m`` is what the odometry says of the same time. ``end``: error of the last pose
    when the first ones coincide. ``stretches``: errors over all stretches of ``stretch_m``.
    """

    path_m: float
    estimated_path_m: float
    end: PoseErrors
    stretch_m: float
    stretches: PoseErrors

    @property
    def distance_error(self) -> float:
        """|estimated - true distance| / true distance."""
        return abs(self.estimated_path_m - self.path_m) / self.path_m

    def to_json(self) -> dict[str, Any]:
        """Errors as shares of the path, and in degrees a metre."""
        return {
            "path_m": self.path_m,
            "estimated_path_m": self.estimated_path_m,
            "distance_error": self.distance_error,
            "end": _per_metre(self.end, self.path_m),
            "stretch_m": self.stretch_m,
            "stretches": int(self.stretches.translation_m.size),
            "over_stretches": _per_metre(self.stretches, self.stretch_m),
        }


def evaluate_odometry(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    stretch_m: float = STRETCH_M,
    greatest_gap_s: float = GREATEST_GAP_S,
) -> OdometryReport:
    """Drift of ``estimate`` against ``reference``, both as x, y, yaw.

    Distances are summed from pose to pose of the estimate: a reference with noise should not be
    much finer than its noise.

    Raises SettingsError for a stretch or gap that is not positive, ScanLoomError where no poses can
    be compared, or the reference is shorter than a stretch.
    """
    step = Step(delta=stretch_m, unit="m")
    pairs = associate(estimate, reference, greatest_gap_s)
    pairs = PosePairs(
        stamps_ns=pairs.stamps_ns,
        T_map_estimate=planar(pairs.T_map_estimate),
        T_map_reference=planar(pairs.T_map_reference),
    )
    stretches = relative_errors(pairs, pairs.T_map_estimate, step)
    estimated, true = (
        relative(poses[:1], poses[-1:]) for poses in (pairs.T_map_estimate, pairs.T_map_reference)
    )
    return OdometryReport(
        path_m=float(pairs.path_along_reference_m[-1]),
        estimated_path_m=float(travelled_m(pairs.T_map_estimate)[-1]),
        end=absolute_errors(estimated, true),
        stretch_m=stretch_m,
        stretches=stretches,
    )


def _per_metre(errors: PoseErrors, path_m: float) -> dict[str, float]:
    return {
        "translation_error": float(errors.translation_m.mean()) / path_m,
        "rotation_deg_per_m": float(np.degrees(errors.rotation_rad.mean())) / path_m,
    }
