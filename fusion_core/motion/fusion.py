"""Fusion of wheel, laser and visual odometry (Li 2022 §3.2 and §3.3).

    fused = fuse_odometry([wheel, laser, visual], FusionSettings())
    fused.trajectory, fused.weights

All sources have the stamps of the scans. Their steps are fused, not their poses, so that one wrong
step of a source does not offset all poses after it.

``published`` follows (6) to (9) as printed (fusion_published.py). The default propagates
covariances (fusion_covariance.py), since with (8) one source takes all the weight within a few
steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from fusion_core.model.errors import MissingStream
from fusion_core.motion.fusion_covariance import CovarianceFusionSettings, fuse_by_covariance
from fusion_core.motion.fusion_published import PublishedFusionSettings, fuse_as_published
from fusion_core.motion.fusion_weights import FusionWeights
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from fusion_core.settings import setting

FusionMethod = Literal["covariance", "published"]

SOURCES = ("wheel", "laser", "visual")


class FusionSettings(CovarianceFusionSettings, PublishedFusionSettings):
    """The fusion rule, and the settings of both rules."""

    method: FusionMethod = setting(
        "covariance", "Weights from propagated covariances, or by (6) to (9) of Li 2022 as printed"
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FusedOdometry:
    """``trajectory``: named "fused", at the sources' stamps. ``weights``: of each source and
    step."""

    trajectory: OdometryTrajectory
    weights: FusionWeights


def fuse_odometry(
    trajectories: Sequence[OdometryTrajectory], settings: FusionSettings | None = None
) -> FusedOdometry:
    """Fuse trajectories with the same stamps, named after SOURCES, each at most once.

    A step that no source measured repeats the last fused velocity and is marked as not measured.
    Raises MissingStream without any trajectory, ValueError for other stamps or names.
    """
    settings = settings or FusionSettings()
    if not trajectories:
        raise MissingStream("there is no odometry to fuse.")
    names = [trajectory.name for trajectory in trajectories]
    if len(set(names)) < len(names) or not set(names) <= set(SOURCES):
        raise ValueError(f"sources are {', '.join(SOURCES)}, each once, got {names}")
    stamps_ns = trajectories[0].stamps_ns
    if any(
        trajectory.stamps_ns.shape != stamps_ns.shape or (trajectory.stamps_ns != stamps_ns).any()
        for trajectory in trajectories
    ):
        raise ValueError("trajectories must have the same stamps to be fused")
    if settings.method == "published":
        trajectory, weights = fuse_as_published(trajectories, settings)
    else:
        trajectory, weights = fuse_by_covariance(trajectories, settings)
    return FusedOdometry(trajectory=trajectory, weights=weights)
