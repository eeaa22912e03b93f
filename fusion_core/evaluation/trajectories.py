"""How far an estimated trajectory lies from a reference: absolute and relative pose errors.

Sturm et al. 2012, "A Benchmark for the Evaluation of RGB-D SLAM Systems", eqs. (1)-(5). The
reference is interpolated at the estimate's stamps, so that the two need no common rate.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from fusion_core.evaluation.pose_arrays import (
    interpolate_poses,
    project_to_plane,
    relative_poses,
    rotation_angles_rad,
    translation_norms_m,
)
from fusion_core.evaluation.relative_pose import Step, pairs_of_step
from fusion_core.evaluation.statistics import ErrorStatistics
from fusion_core.evaluation.umeyama import Group, Similarity, align_positions
from fusion_core.model.conventions import NS_PER_S, FloatArray, IntArray, read_only
from fusion_core.model.errors import ScanLoomError, SettingsError
from fusion_core.model.trajectory import Trajectory

Alignment = Group | Literal["none"]

MAX_GAP_S = 0.2
"""At an acceleration of 1 m/s² the straight line between poses 0.2 s apart is 5 mm off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PosePairs:
    """Poses of one body at the same instants, estimated and true, each in its own map.

    ``stamps_ns``: (K,), K >= 1, ascending. ``T_map_estimate``, ``T_map_reference``: (K, 4, 4).
    """

    stamps_ns: IntArray
    T_map_estimate: FloatArray
    T_map_reference: FloatArray

    def __post_init__(self) -> None:
        for array in (self.stamps_ns, self.T_map_estimate, self.T_map_reference):
            read_only(array)

    @property
    def reference_path_m(self) -> FloatArray:
        """(K,) distance travelled since the first pose, along the reference."""
        return path_length_m(self.T_map_reference)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseErrors:
    """``translation_m``, ``rotation_rad``: (K,) size of each error, K >= 1."""

    translation_m: FloatArray
    rotation_rad: FloatArray

    def __post_init__(self) -> None:
        read_only(self.translation_m)
        read_only(self.rotation_rad)

    def to_json(self) -> dict[str, Any]:
        """Min, max, mean, median, variance, std and RMSE of both, rotations in degrees."""
        return {
            "translation_m": ErrorStatistics.of(self.translation_m).to_json(),
            "rotation_deg": ErrorStatistics.of(np.degrees(self.rotation_rad)).to_json(),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryReport:
    """Errors of one estimate, and how much of the reference it covers.

    ``time_coverage``: fraction of the reference's time between the first and the last pose
    compared; ``longest_gap_s``: longest time between two of them.
    ``ape``: absolute pose errors (eq. 4) without any alignment, ``ape_aligned`` those after it,
    None for the alignment "none". ``rpe``: relative pose errors (eq. 1) over ``step``, in the
    reference's scale where the scale was estimated.
    """

    estimate_poses: int
    reference_poses: int
    associated: int
    time_coverage: float
    longest_gap_s: float
    path_m: float
    alignment: Alignment
    similarity: Similarity | None
    ape: PoseErrors
    ape_aligned: PoseErrors | None
    step: Step
    rpe: PoseErrors

    def to_json(self) -> dict[str, Any]:
        """All values; rotations in degrees."""
        return {
            "estimate_poses": self.estimate_poses,
            "reference_poses": self.reference_poses,
            "associated": self.associated,
            "associated_share": self.associated / self.estimate_poses,
            "coverage": self.time_coverage,
            "longest_gap_s": self.longest_gap_s,
            "path_m": self.path_m,
            "alignment": self.alignment,
            "T_reference_estimate": None if self.similarity is None else self.similarity.to_json(),
            "absolute": self.ape.to_json(),
            "absolute_aligned": None if self.ape_aligned is None else self.ape_aligned.to_json(),
            "relative": {
                "delta": self.step.delta,
                "unit": self.step.unit,
                "pairs": int(self.rpe.translation_m.size),
                **self.rpe.to_json(),
            },
        }


def evaluate_trajectory(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    alignment: Alignment = "se3",
    step: Step | None = None,
    max_gap_s: float = MAX_GAP_S,
) -> TrajectoryReport:
    """Absolute and relative pose errors of ``estimate``; relative ones over a second by default.

    ``alignment`` fits the estimate's positions to the reference's: ``se3`` in space, ``sim3`` with
    a scale (for a monocular estimate), ``se2`` in the plane, where height, pitch and roll of both
    are dropped from every error.

    Raises SettingsError for a gap that is not positive, ScanLoomError where no poses can be
    compared, the alignment is not determined, or no two poses are a step apart.
    """
    step = Step() if step is None else step
    pairs = associate(estimate, reference, max_gap_s)
    if alignment == "se2":
        pairs = PosePairs(
            stamps_ns=pairs.stamps_ns,
            T_map_estimate=project_to_plane(pairs.T_map_estimate),
            T_map_reference=project_to_plane(pairs.T_map_reference),
        )
    similarity, T_reference_estimate = None, pairs.T_map_estimate
    if alignment != "none":
        similarity = align_positions(
            pairs.T_map_estimate[:, :3, 3], pairs.T_map_reference[:, :3, 3], alignment
        )
        T_reference_estimate = similarity.apply(pairs.T_map_estimate)
    span_ns = int(reference.stamps_ns[-1] - reference.stamps_ns[0])
    compared_ns = int(pairs.stamps_ns[-1] - pairs.stamps_ns[0])
    gaps_ns = np.diff(pairs.stamps_ns)
    return TrajectoryReport(
        estimate_poses=estimate.stamps_ns.size,
        reference_poses=reference.stamps_ns.size,
        associated=pairs.stamps_ns.size,
        # A reference of one pose is covered, since a pose was compared with it.
        time_coverage=compared_ns / span_ns if span_ns else 1.0,
        longest_gap_s=float(gaps_ns.max() / NS_PER_S) if gaps_ns.size else 0.0,
        path_m=float(pairs.reference_path_m[-1]),
        alignment=alignment,
        similarity=similarity,
        ape=absolute_pose_errors(pairs.T_map_estimate, pairs.T_map_reference),
        ape_aligned=None
        if similarity is None
        else absolute_pose_errors(T_reference_estimate, pairs.T_map_reference),
        step=step,
        rpe=relative_pose_errors(pairs, T_reference_estimate, step),
    )


def associate(estimate: Trajectory, reference: Trajectory, max_gap_s: float) -> PosePairs:
    """The estimate's poses with the reference interpolated at their stamps.

    Poses outside the reference, or where it has a gap longer than ``max_gap_s``, are left
    out. Raises SettingsError for a gap that is not positive, ScanLoomError where none is left.
    """
    if not 0.0 < max_gap_s < np.inf:
        raise SettingsError(f"the greatest gap must be positive and finite, got {max_gap_s}.")
    # Bounded, so that it fits an int64.
    gap_ns = round(min(max_gap_s * NS_PER_S, 2.0**62))
    T_map_reference, known = interpolate_poses(reference, estimate.stamps_ns, gap_ns)
    if not known.any():
        raise ScanLoomError(
            f"No pose of the estimate ({_format_span(estimate)}) lies between two of the reference "
            f"({_format_span(reference)}) that are at most {max_gap_s:g} s apart.",
            advice="Check that both use the same clock, or allow a longer gap.",
        )
    return PosePairs(
        stamps_ns=estimate.stamps_ns[known],
        T_map_estimate=estimate.T_map_body[known],
        T_map_reference=T_map_reference,
    )


def absolute_pose_errors(T_map_estimate: FloatArray, T_map_reference: FloatArray) -> PoseErrors:
    """Of (K, 4, 4) poses in one map (eq. 4): E = reference⁻¹ estimate."""
    return _pose_errors(relative_poses(T_map_reference, T_map_estimate))


def path_length_m(T_map_body: FloatArray) -> FloatArray:
    """(K,) length of the path from the first of (K, 4, 4) poses to each."""
    steps_m = np.linalg.norm(np.diff(T_map_body[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps_m)])


def relative_pose_errors(
    pairs: PosePairs, T_reference_estimate: FloatArray, step: Step
) -> PoseErrors:
    """E = (reference motion)⁻¹ (estimated motion) over each step (eq. 1).

    ``T_reference_estimate``: (K, 4, 4) the pairs' estimates, in any map, at the reference's scale.
    Raises ScanLoomError where no two poses are a step apart.
    """
    first, second = pairs_of_step(pairs.stamps_ns, pairs.reference_path_m, step)
    estimated = relative_poses(T_reference_estimate[first], T_reference_estimate[second])
    true = relative_poses(pairs.T_map_reference[first], pairs.T_map_reference[second])
    return _pose_errors(relative_poses(true, estimated))


def _pose_errors(errors: FloatArray) -> PoseErrors:
    return PoseErrors(
        translation_m=translation_norms_m(errors), rotation_rad=rotation_angles_rad(errors)
    )


def _format_span(trajectory: Trajectory) -> str:
    first, last = (int(trajectory.stamps_ns[end]) / NS_PER_S for end in (0, -1))
    return f"{first:.3f} s to {last:.3f} s"
