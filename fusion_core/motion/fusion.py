"""The odometry of several sources as one (Li 2022 §3.2 and §3.3).

    fused = fuse([wheel, laser, visual], FusionSettings())
    fused.track, fused.weights

All sources have the same stamps, the scans', and are fused step by step, never pose by pose: a
source that was wrong once is not wrong ever after.

``published`` follows (6) to (9) as printed (fusion_published.py). The default propagates variances
(fusion_covariance.py), since (8) lets one source take all within a few steps.
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
    """Which rule fuses, and the settings of both."""

    method: FusionMethod = setting(
        "covariance", "Weights from propagated variances, or by (6) to (9) of Li 2022 as printed"
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FusedOdometry:
    """``track``: named "fused", at the sources' stamps. ``weights``: what each step rests on."""

    trajectory: OdometryTrajectory
    weights: FusionWeights


def fuse_odometry(
    tracks: Sequence[OdometryTrajectory], settings: FusionSettings | None = None
) -> FusedOdometry:
    """Fuse tracks of the same stamps; their names are those of SOURCES, each at most once.

    A step that no source measured is carried on at the last fused velocity, and not measured.
    Raises MissingStream where there is no track, ValueError for other stamps or names.
    """
    settings = settings or FusionSettings()
    if not tracks:
        raise MissingStream("there is no odometry to fuse.")
    names = [track.name for track in tracks]
    if len(set(names)) < len(names) or not set(names) <= set(SOURCES):
        raise ValueError(f"sources are {', '.join(SOURCES)}, each once, got {names}")
    stamps_ns = tracks[0].stamps_ns
    if any(
        track.stamps_ns.shape != stamps_ns.shape or (track.stamps_ns != stamps_ns).any()
        for track in tracks
    ):
        raise ValueError("tracks must have the same stamps to be fused")
    if settings.method == "published":
        track, weights = fuse_as_published(tracks, settings)
    else:
        track, weights = fuse_by_covariance(tracks, settings)
    return FusedOdometry(trajectory=track, weights=weights)
