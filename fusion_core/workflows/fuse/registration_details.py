"""Details of a frame's registration for display: its pairs in the plane, RANSAC's draws, A as
rotation, scale and translation, and the residuals along the curve.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.denoising.correspondence import planar_points
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.registration.models import apply_transform
from fusion_core.registration.ransac import Registration
from fusion_core.registration.transform_decomposition import (
    TransformDecomposition,
    decompose_transform,
)
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_match import FrameMatch

__all__ = [
    "Consensus",
    "PlanarPairs",
    "RansacDraw",
    "Registration",
    "ResidualCurve",
    "TransformDecomposition",
    "consensus_probabilities",
    "decompose_registration",
    "draw_at",
    "planar_pairs",
    "residual_curve",
]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanarPairs:
    """The m pairs of a frame as (m, 2) points, x to the right and z ahead, NaN where missing.

    ``mapped_m``: the LiDAR's points mapped by A, ``inliers``: (m,) pairs that agree with it; None
    where there is no A.
    """

    lidar_m: FloatArray
    depth_m: FloatArray
    mapped_m: FloatArray | None
    inliers: BoolArray | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RansacDraw:
    """One draw of RANSAC.

    ``pairs``: (n,) the drawn ones of the m pairs. ``A``: (3, 3) fitted to them, NaN where they do
    not determine it. ``is_inlier``: (m,) pairs that agree with A, none where it is NaN.
    ``mapped_m``: (m, 2) the LiDAR's points mapped by A.
    """

    index: int
    pairs: IntArray
    A: FloatArray
    is_inlier: BoolArray
    mapped_m: FloatArray

    @property
    def inliers(self) -> int:
        """Number of pairs that agree."""
        return int(self.is_inlier.sum())


@dataclass(frozen=True, slots=True, kw_only=True)
class Consensus:
    """``inlier_fraction``: c, inliers of A among the valid pairs; ``clean_probability``: cⁿ that a
    draw of n pairs holds inliers only; ``any_clean_probability``: that at least one of the N draws
    did, 1 - (1 - cⁿ)^N."""

    inlier_fraction: float
    clean_probability: float
    any_clean_probability: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ResidualCurve:
    """The pairs with both values, (k,), by rising azimuth.

    ``residual_mm``: what eq. (6) compares with ``epsilon_mm``; depth - LiDAR along the beam, or in
    the paper's own pairs the length of L A - D. ``pair_class``: codes of NoiseClass, the worse of
    the pair's two: a burr before a conflict before good.
    """

    azimuth_deg: FloatArray
    residual_mm: FloatArray
    epsilon_mm: FloatArray
    pair_class: IntArray

    def __post_init__(self) -> None:
        for array in (self.azimuth_deg, self.residual_mm, self.epsilon_mm, self.pair_class):
            read_only(array)


def planar_pairs(match: FrameMatch) -> PlanarPairs:
    """The pairs that registration was given."""
    found = match.registration
    if found is not None:
        lidar_m = found.draws.lidar_points_m
        return PlanarPairs(
            lidar_m=lidar_m,
            depth_m=found.draws.depth_points_m,
            mapped_m=apply_transform(found.A, lidar_m),
            inliers=found.inliers,
        )
    pairs = match.correspondence
    return PlanarPairs(
        lidar_m=planar_points(pairs, pairs.lidar_range_m),
        depth_m=planar_points(pairs, pairs.depth_as_range_m),
        mapped_m=None,
        inliers=None,
    )


def draw_at(registration: Registration, index: int) -> RansacDraw:
    """A draw of the chosen model, before refinement. Raises IndexError."""
    draw = registration.draws[index]
    lidar_m = registration.draws.lidar_points_m
    return RansacDraw(
        index=draw.index,
        pairs=draw.pairs,
        A=draw.A,
        is_inlier=draw.is_inlier,
        mapped_m=apply_transform(draw.A, lidar_m),
    )


def consensus_probabilities(registration: Registration) -> Consensus:
    """How likely the draws were to hold a clean one, by the inliers of A."""
    inlier_fraction = int(registration.inliers.sum()) / registration.valid
    clean = inlier_fraction**registration.draws.sample_size
    missed = (1.0 - clean) ** len(registration.draws)
    return Consensus(
        inlier_fraction=inlier_fraction,
        clean_probability=clean,
        any_clean_probability=1.0 - missed,
    )


def decompose_registration(registration: Registration) -> TransformDecomposition:
    """A as rotation, scale and translation, at the mean of its inliers."""
    middle_m = registration.draws.lidar_points_m[registration.inliers].mean(axis=0)
    return decompose_transform(registration.A, middle_m)


def residual_curve(frame: FusedFrame) -> ResidualCurve:
    """The residuals of a frame with their thresholds and classes."""
    pairs = frame.match.correspondence
    shown = np.flatnonzero(np.isfinite(pairs.residual_m))
    # Beams on both sides of the scan's seam are neighbours where the camera looks backwards.
    middle_rad = float(np.angle(np.exp(1j * pairs.azimuth_rad).sum()))
    from_middle = np.angle(np.exp(1j * (pairs.azimuth_rad[shown] - middle_rad)))
    order = np.argsort(from_middle, kind="stable")
    shown = shown[order]
    return ResidualCurve(
        azimuth_deg=np.rad2deg(middle_rad + from_middle[order]),
        residual_mm=1e3 * pairs.residual_m[shown],
        epsilon_mm=1e3 * frame.classes.epsilon_m[shown],
        pair_class=frame.pair_class[shown],
    )
