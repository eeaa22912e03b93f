"""How well a trajectory reproduces known relations between pairs of its poses.

Kümmerle et al. 2009, "On measuring the accuracy of SLAM algorithms", eqs. (2), (3): no alignment,
so that one early error of heading does not spoil all that follows. Poses are interpolated in time.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.evaluation.pose_arrays import (
    interpolate_poses,
    invert_poses,
    relative_poses,
    rotation_angles_rad,
    translation_norms_m,
)
from fusion_core.evaluation.statistics import ErrorStatistics
from fusion_core.model.conventions import NS_PER_S, FloatArray, read_only
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.relations import Relations
from fusion_core.model.trajectory import Trajectory


@dataclass(frozen=True, slots=True, kw_only=True)
class RelationReport:
    """Errors over the relations whose two instants lie in the trajectory's time span.

    ``translation_m``, ``rotation_rad``: (K,), K >= 1, size of expected⁻¹ · measured.
    ``cartographer_translation_m``: (K,) of measured · expected⁻¹, as Cartographer's tool computes
    it (Hess et al. 2016); the angle of its rotation is the same.
    """

    relations: int
    translation_m: FloatArray
    rotation_rad: FloatArray
    cartographer_translation_m: FloatArray

    def __post_init__(self) -> None:
        for errors in (self.translation_m, self.rotation_rad, self.cartographer_translation_m):
            read_only(errors)

    @property
    def covered(self) -> int:
        """Relations inside the trajectory."""
        return self.translation_m.size

    @property
    def coverage(self) -> float:
        """Fraction of the relations inside the trajectory."""
        return self.covered / self.relations

    def to_json(self) -> dict[str, Any]:
        """Coverage, then mean and std (over N) of each error and of its square."""
        rotation_deg = np.degrees(self.rotation_rad)
        return {
            "relations": self.relations,
            "covered": self.covered,
            "coverage": self.coverage,
            "kuemmerle": _errors_json(self.translation_m, rotation_deg),
            "cartographer": _errors_json(self.cartographer_translation_m, rotation_deg),
        }


def evaluate_relations(trajectory: Trajectory, relations: Relations) -> RelationReport:
    """Compare the motion between the instants of each relation with the one it expects.

    Raises ScanLoomError where no relation lies in the trajectory's time span.
    """
    start_ns, end_ns = trajectory.stamps_ns[0], trajectory.stamps_ns[-1]
    stamps_ns = np.stack([relations.first_stamps_ns, relations.second_stamps_ns])
    inside = ((stamps_ns >= start_ns) & (stamps_ns <= end_ns)).all(axis=0)
    if not inside.any():
        raise ScanLoomError(
            f"No relation lies within the trajectory, {start_ns / NS_PER_S:.3f} s to "
            f"{end_ns / NS_PER_S:.3f} s; they span {stamps_ns.min() / NS_PER_S:.3f} s to "
            f"{stamps_ns.max() / NS_PER_S:.3f} s.",
            advice="Check that both are of one recording and use the same clock.",
        )
    first, second = (interpolate_poses(trajectory, own_ns[inside])[0] for own_ns in stamps_ns)
    measured = relative_poses(first, second)
    expected = relations.T_first_second[inside]
    errors = relative_poses(expected, measured)
    return RelationReport(
        relations=inside.size,
        translation_m=translation_norms_m(errors),
        rotation_rad=rotation_angles_rad(errors),
        cartographer_translation_m=translation_norms_m(measured @ invert_poses(expected)),
    )


def _errors_json(translation_m: FloatArray, rotation_deg: FloatArray) -> dict[str, Any]:
    return {
        "translation_m": _mean_and_std(translation_m),
        "translation_squared_m2": _mean_and_std(translation_m**2),
        "rotation_deg": _mean_and_std(rotation_deg),
        "rotation_squared_deg2": _mean_and_std(rotation_deg**2),
    }


def _mean_and_std(errors: FloatArray) -> dict[str, float]:
    statistics = ErrorStatistics.of(errors)
    return {"mean": statistics.mean, "std": statistics.std}
