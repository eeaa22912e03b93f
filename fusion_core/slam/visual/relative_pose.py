"""The pose of one RGB-D view in another by their features, without a guess of where they are.

Descriptors are matched over the whole images, PnP with RANSAC finds what agrees, a guided search
about each feature's predicted place finds the rest, and all are weighed by their own uncertainty.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray, read_only
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.motion.feature_matching import match_descriptors
from fusion_core.motion.ransac_pnp import ransac_pnp
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.features import SCALE_FACTOR
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.slam.visual.pinhole import camera_parameters, project, unproject
from fusion_core.slam.visual.projection_matching import FeatureGrid, predict_octaves
from fusion_core.slam.visual.relative_pose_refinement import (
    MeasuredFeatures,
    refine_relative_pose,
)

# OpenCV's 0.99 would lose one pose in a hundred.
_RANSAC_CONFIDENCE = 0.9999
# Of a P3P draw and the point that tells its solutions apart.
_PNP_POINTS_MIN = 4
# The second search starts at a better pose, and so finds more.
_ROUNDS = 2


class RelativePoseSettings(StageSettings):
    """The pose between two views that show the same place."""

    match_ratio: float = setting(
        0.85,
        "Ratio test: greatest ratio of the best to the second best descriptor distance",
        ge=1e-6,
        le=1.0,
    )
    distance_max: int = setting(
        64, "Greatest distance of two matching descriptors", unit="bits", ge=1, le=256
    )
    ransac_threshold_px: float = setting(
        3.0, "RANSAC: greatest reprojection error of an inlier", unit="px", ge=1e-6, le=50.0
    )
    ransac_draws: int = setting(500, "RANSAC: most iterations", unit="draws", ge=10, le=100_000)
    search_radius_px: float = setting(
        8.0, "Guided search about a predicted place", unit="px", ge=1e-6, le=200.0
    )
    inliers_min: int = setting(
        25, "Fewest inliers of a valid pose", unit="features", ge=6, le=10_000
    )
    inlier_ratio_min: float = setting(
        0.12,
        "Least ratio of inliers to the features of one view that should be seen in the other",
        ge=0.0,
        le=1.0,
    )
    depth_scale_sigma: float = setting(
        0.01,
        "Standard deviation of the depth scale, common to all depths of a view",
        unit="m/m",
        ge=0.0,
        le=1.0,
    )
    translation_sigma_max_m: float = setting(
        0.1,
        "Greatest standard deviation of the translation; above it the pose is refused",
        unit="m",
        ge=1e-6,
        le=10.0,
    )
    rotation_sigma_max_rad: float = setting(
        0.05,
        "Greatest standard deviation of the rotation; above it the pose is refused",
        unit="rad",
        ge=1e-6,
        le=3.2,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RelativePose:
    """``T_first_second``: (4, 4). ``covariance``: (6, 6) of a small motion of the second view in
    its own frame, rotation first. ``matches``: (M, 2) the features that agree."""

    T_first_second: FloatArray
    covariance: FloatArray
    matches: IntArray

    def __post_init__(self) -> None:
        for array in (self.T_first_second, self.covariance, self.matches):
            read_only(array)


def estimate_relative_pose(
    first: FrameFeatures,
    second: FrameFeatures,
    intrinsics: CameraIntrinsics,
    noise: ObservationNoise,
    settings: RelativePoseSettings,
) -> RelativePose | str:
    """The pose of the second view in the first, or why there is none."""
    matches = match_descriptors(
        first.descriptors,
        second.descriptors,
        ratio_max=settings.match_ratio,
        distance_max=settings.distance_max,
    )
    if len(matches) < _PNP_POINTS_MIN:
        return "too few matches"
    T_first_second = _pose_by_ransac(first, second, matches, intrinsics, settings)
    if T_first_second is None:
        return "matches that contradict each other"
    refined = None
    for _ in range(_ROUNDS):
        guided = _match_guided(first, second, T_first_second, intrinsics, settings)
        refined = refine_relative_pose(
            measured(first, noise, guided[:, 0]),
            measured(second, noise, guided[:, 1]),
            intrinsics,
            T_first_second,
        )
        if refined is None:
            return "matches that contradict each other"
        T_first_second = refined.T_first_second
    assert refined is not None, "there is at least one round"
    matches = guided[refined.is_inlier]
    if len(matches) < settings.inliers_min:
        return f"too few inliers, {len(matches)}"
    expected = _seen_in_both(first, second, T_first_second, intrinsics)
    if len(matches) < settings.inlier_ratio_min * expected:
        return f"{len(matches)} inliers where {expected} features should be seen"
    covariance = refined.covariance.copy()
    # An error of the depth scale moves the pose along the depths, however many they are.
    depths_m = np.concatenate([first.depths_m[matches[:, 0]], second.depths_m[matches[:, 1]]])
    depth_m = float(np.median(depths_m[np.isfinite(depths_m)]))
    covariance[3:, 3:] += np.eye(3) * (settings.depth_scale_sigma * depth_m) ** 2
    rotation_rad, translation_m = (
        float(np.sqrt(np.linalg.eigvalsh(block)[-1]))
        for block in (covariance[:3, :3], covariance[3:, 3:])
    )
    if (
        rotation_rad > settings.rotation_sigma_max_rad
        or translation_m > settings.translation_sigma_max_m
    ):
        return "matches that do not determine the pose"
    return RelativePose(T_first_second=T_first_second, covariance=covariance, matches=matches)


def measured(
    features: FrameFeatures, noise: ObservationNoise, rows: IntArray | slice = slice(None)
) -> MeasuredFeatures:
    """Features of a view, all or some, with their uncertainty."""
    return MeasuredFeatures(
        pixels=features.pixels[rows],
        depths_m=features.depths_m[rows],
        sigmas_px=noise.pixel_sigmas(features.octaves[rows]),
        inverse_depth_sigma=noise.depth_sigma_per_m2,
    )


def points_in_camera_m(features: FrameFeatures, intrinsics: CameraIntrinsics) -> FloatArray:
    """(F, 3) in the optical frame, NaN without depth."""
    return unproject(features.pixels, features.depths_m, camera_parameters(intrinsics))


def _pose_by_ransac(
    first: FrameFeatures,
    second: FrameFeatures,
    matches: IntArray,
    intrinsics: CameraIntrinsics,
    settings: RelativePoseSettings,
) -> FloatArray | None:
    """(4, 4) T_first_second from points of the view in which more of the matches have depth."""
    counts = [
        np.count_nonzero(np.isfinite(view.depths_m[matches[:, side]]))
        for side, view in enumerate((first, second))
    ]
    source = int(counts[1] > counts[0])
    views = (first, second)
    points = points_in_camera_m(views[source], intrinsics)[matches[:, source]]
    has_depth = np.isfinite(points[:, 2])
    if np.count_nonzero(has_depth) < _PNP_POINTS_MIN:
        return None
    seen = views[1 - source].pixels[matches[has_depth, 1 - source]]
    found = ransac_pnp(
        points[has_depth],
        seen,
        intrinsics.matrix,
        draws=settings.ransac_draws,
        threshold=settings.ransac_threshold_px,
        confidence=_RANSAC_CONFIDENCE,
        method=cv2.SOLVEPNP_AP3P,
    )
    if found is None or np.count_nonzero(found[1]) < _PNP_POINTS_MIN:
        return None
    T_target_source, _ = found
    if not np.isfinite(T_target_source).all():
        return None
    return T_target_source if source == 1 else invert_transform(T_target_source)


def _match_guided(
    first: FrameFeatures,
    second: FrameFeatures,
    T_first_second: FloatArray,
    intrinsics: CameraIntrinsics,
    settings: RelativePoseSettings,
) -> IntArray:
    """(M, 2) matches near the places that the pose predicts, from whichever view has depth."""
    T_second_first = invert_transform(T_first_second)
    forward = _search(first, second, T_second_first, intrinsics, settings)
    backward = _search(second, first, T_first_second, intrinsics, settings)[:, ::-1]
    # What both searches find, and what only one could: a feature is matched once.
    is_new = ~np.isin(backward[:, 0], forward[:, 0]) & ~np.isin(backward[:, 1], forward[:, 1])
    return np.concatenate([forward, backward[is_new]])


def _search(
    source: FrameFeatures,
    target: FrameFeatures,
    T_target_source: FloatArray,
    intrinsics: CameraIntrinsics,
    settings: RelativePoseSettings,
) -> IntArray:
    """(M, 2) features of the source and the target's features near their predicted places."""
    points = transform_points(T_target_source, points_in_camera_m(source, intrinsics))
    pixels = project(points, camera_parameters(intrinsics))
    # What comes nearer is found on a coarser level.
    levels = int(max(source.octaves.max(), target.octaves.max())) + 1
    octaves = predict_octaves(
        source.depths_m * SCALE_FACTOR ** source.octaves.astype(np.float64), points[:, 2], levels
    )
    found = FeatureGrid(target).match(
        pixels,
        settings.search_radius_px * SCALE_FACTOR ** octaves.astype(np.float64),
        octaves - 1,
        octaves + 1,
        source.descriptors,
        distance_max=settings.distance_max,
    )
    matched = np.flatnonzero(found >= 0)
    return np.column_stack([matched, found[matched]])


def _seen_in_both(
    first: FrameFeatures,
    second: FrameFeatures,
    T_first_second: FloatArray,
    intrinsics: CameraIntrinsics,
) -> int:
    """How many features of either view, the smaller number, lie in the other's image."""
    counts = []
    for source, T_target_source in (
        (first, invert_transform(T_first_second)),
        (second, T_first_second),
    ):
        points = transform_points(T_target_source, points_in_camera_m(source, intrinsics))
        pixels = project(points, camera_parameters(intrinsics))
        # NaN compares false.
        inside = (pixels >= 0.0) & (pixels <= [intrinsics.width - 1.0, intrinsics.height - 1.0])
        counts.append(int(np.count_nonzero(inside.all(axis=1))))
    return min(counts)
