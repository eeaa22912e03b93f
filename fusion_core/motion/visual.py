"""Visual odometry: features with depth, matched to a keyframe (Li 2022 §3.1).

ORB features of the keyframe are matched by descriptor and refined to subpixels by Lucas-Kanade; PnP
with RANSAC rejects outliers, and planar Gauss-Newton gives the LiDAR's step with its covariance.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from fusion_core.lens.undistortion import undistort_pixels
from fusion_core.model.conventions import (
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    wrap_angle,
)
from fusion_core.model.errors import MissingStream
from fusion_core.model.geometry import (
    invert_transform,
    planar_from_transform,
    transform_points,
)
from fusion_core.model.planar_poses import compose_poses
from fusion_core.model.progress import Progress, silent
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.motion.feature_depths import sample_depths_m
from fusion_core.motion.feature_matching import match_descriptors
from fusion_core.motion.keyframe_chain import KeyframeChain
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from fusion_core.motion.planar_reprojection import (
    FeatureNoise,
    PlanarStepEstimate,
    estimate_planar_step,
)
from fusion_core.motion.ransac_pnp import ransac_pnp
from fusion_core.motion.steps import rotate_covariance
from fusion_core.settings import StageSettings, setting

# Lucas-Kanade refines a match by a few pixels, so a small window and one coarser level suffice (set
# by hand); the criteria are OpenCV's defaults.
_LK_WINDOW = (15, 15)
_LK_LEVELS = 1
_LK_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
# OpenCV's 0.99 would lose one step in a hundred; the cap on draws bounds the time.
_RANSAC_CONFIDENCE = 0.999


class VisualOdometrySettings(StageSettings):
    """Settings of ``visual_odometry``."""

    features_max: int = setting(
        600, "Most ORB features per image", unit="features", ge=50, le=20_000, formerly="features"
    )
    fast_threshold: int = setting(8, "FAST corner threshold", unit="grey levels", ge=1, le=100)
    match_ratio: float = setting(
        0.8,
        "Ratio test: greatest ratio of the best to the second best descriptor distance",
        ge=1e-6,
        le=1.0,
    )
    refinement_max_px: float = setting(
        3.0,
        "Matches that refinement moves farther are rejected",
        unit="px",
        ge=1e-6,
        le=100.0,
        formerly="refine_px",
    )
    ransac_threshold_px: float = setting(
        2.0,
        "RANSAC: greatest reprojection error of an inlier",
        unit="px",
        ge=1e-6,
        le=50.0,
        formerly="ransac_px",
    )
    ransac_draws: int = setting(200, "RANSAC: most iterations", unit="draws", ge=10, le=100_000)
    inliers_min: int = setting(
        12, "Fewest inliers of a valid step", unit="features", ge=6, le=10_000
    )
    inlier_ratio_min: float = setting(
        0.4, "Least ratio of inliers to matches", ge=1e-6, le=1.0, formerly="inlier_share_min"
    )
    feature_sigma_px: float = setting(
        0.4,
        "Standard deviation of a feature's image coordinates",
        unit="px",
        ge=1e-6,
        le=10.0,
        formerly="sigma_px",
    )
    sigma_inflation: float = setting(
        1.8,
        "Factor on the standard deviation of a step, for errors beyond pixel and depth noise",
        ge=1.0,
        le=10.0,
        formerly="noise_factor",
    )
    depth_sigma_per_m2: float = setting(
        0.003, "Standard deviation of a depth over its square", unit="1/m", ge=1e-6, le=1.0
    )
    depth_min_m: float = setting(0.2, "Least depth of a feature", unit="m", ge=1e-6, le=100.0)
    depth_max_m: float = setting(8.0, "Greatest depth of a feature", unit="m", ge=1e-6, le=100.0)
    step_sigma_max_m: float = setting(
        0.2,
        "Greatest standard deviation of a step's translation; above it the step is rejected",
        unit="m",
        ge=1e-6,
        le=10.0,
        formerly="sigma_max_m",
    )
    depth_scale_sigma: float = setting(
        0.005,
        "Standard deviation of the depth scale, common to all depths",
        unit="m/m",
        ge=0.0,
        le=1.0,
        formerly="scale_share",
    )
    keyframe_distance_m: float = setting(
        0.4,
        "Distance at which a new keyframe is taken",
        unit="m",
        ge=1e-6,
        le=100.0,
        formerly="key_step_m",
    )
    keyframe_rotation_rad: float = setting(
        0.3,
        "Rotation at which a new keyframe is taken",
        unit="rad",
        ge=1e-6,
        le=float(np.pi),
        formerly="key_turn_rad",
    )
    keyframe_match_ratio: float = setting(
        0.4,
        "Ratio of the keyframe's matches still found, below which a new keyframe is taken",
        ge=0.0,
        le=1.0,
        formerly="key_match_share",
    )
    unmatched_images_max: int = setting(
        5,
        "Consecutive images without a match after which a new segment starts",
        unit="images",
        ge=0,
        le=10_000,
        formerly="patience",
    )


def visual_odometry(
    frames: Iterable[RgbdFrame],
    intrinsics: CameraIntrinsics,
    T_lidar_camera: FloatArray,
    settings: VisualOdometrySettings | None = None,
    progress: Progress = silent,
) -> OdometryTrajectory:
    """The LiDAR's motion by a camera's images, whose stamps increase, at the images' stamps.

    ``intrinsics``: of the grey images. ``T_lidar_camera``: (4, 4), its optical frame to the
    LiDAR's, whose z axis is taken as vertical. An image that is dark or lacks texture or depth
    gives no step: the pose is kept and the step is marked as not measured.

    Raises MissingStream where there is no image.
    """
    odometry = _VisualOdometry(intrinsics, T_lidar_camera, settings or VisualOdometrySettings())
    for count, frame in enumerate(frames, start=1):
        odometry.add(frame)
        progress(count, None, "visual odometry")
    return odometry.trajectory()


@dataclass(frozen=True, slots=True, eq=False)
class _Features:
    """Of one image. ``pixels``: (M, 2). ``descriptors``: (M, 32). ``points_in_lidar_m``: (M, 3),
    NaN without depth."""

    gray: ByteArray
    pixels: Float32Array
    descriptors: ByteArray
    points_in_lidar_m: FloatArray
    pose: FloatArray


class _VisualOdometry:
    def __init__(
        self,
        intrinsics: CameraIntrinsics,
        T_lidar_camera: FloatArray,
        settings: VisualOdometrySettings,
    ) -> None:
        self._intrinsics, self._T, self._settings = intrinsics, T_lidar_camera, settings
        self._orb = cv2.ORB.create(
            nfeatures=settings.features_max, fastThreshold=settings.fast_threshold
        )
        self._stamps_ns: list[int] = []
        self._chain = KeyframeChain()
        self._keyframe: _Features | None = None
        self._last: _Features | None = None
        self._misses = self._found_most = 0

    def add(self, frame: RgbdFrame) -> None:
        """Place the next image."""
        pose = self._chain.poses[-1].copy() if self._chain.poses else np.zeros(3)
        self._stamps_ns.append(frame.stamp_ns)
        features = self._extract_features(frame, pose)
        if isinstance(features, str):
            self._add_unmatched(pose, features)
            return
        if self._keyframe is None:
            self._start_segment(features)
            return
        found = self._match(self._keyframe, features)
        if isinstance(found, str) and self._last is not None:
            keyframe = self._last
            self._set_keyframe(keyframe)
            found = self._match(keyframe, features)
        if isinstance(found, str):
            if self._misses >= self._settings.unmatched_images_max:
                self._start_segment(features, found)
            else:
                self._add_unmatched(pose, found)
            return
        self._accept_match(features, *found)

    def _extract_features(self, frame: RgbdFrame, pose: FloatArray) -> _Features | str:
        keypoints, descriptors = self._orb.detectAndCompute(frame.gray, None)
        if descriptors is None or len(keypoints) < self._settings.inliers_min:
            return "too few features"
        pixels = np.asarray(cv2.KeyPoint.convert(keypoints), np.float32)
        depth_m = sample_depths_m(frame, pixels)
        settings = self._settings
        # NaN compares false.
        usable = (depth_m > settings.depth_min_m) & (depth_m < settings.depth_max_m)
        if np.count_nonzero(usable) < settings.inliers_min:
            return "too few features with depth"
        rays = np.column_stack([undistort_pixels(pixels, self._intrinsics), np.ones(len(pixels))])
        points = transform_points(self._T, np.where(usable, depth_m, np.nan)[:, np.newaxis] * rays)
        return _Features(frame.gray, pixels, np.asarray(descriptors, dtype=np.uint8), points, pose)

    def _match(self, keyframe: _Features, now: _Features) -> tuple[PlanarStepEstimate, int] | str:
        """The step from a keyframe and its number of inliers, or why there is none."""
        settings = self._settings
        first, second = match_descriptors(
            keyframe.descriptors, now.descriptors, ratio_max=settings.match_ratio
        ).T
        has_depth = np.isfinite(keyframe.points_in_lidar_m[first, 2])
        first, second = first[has_depth], second[has_depth]
        if first.size < settings.inliers_min:
            return "too few matches"
        pixels, kept = self._refine_pixels(keyframe, now, first, second)
        first, pixels = first[kept], pixels[kept]
        if first.size < settings.inliers_min:
            return "too few matches"
        points, seen = keyframe.points_in_lidar_m[first], undistort_pixels(pixels, self._intrinsics)
        start, inliers = self._estimate_by_pnp(points, seen)
        enough = max(settings.inliers_min, round(settings.inlier_ratio_min * first.size))
        if start is None or np.count_nonzero(inliers) < enough:
            return "matches that contradict each other"
        fit = estimate_planar_step(
            points[inliers],
            seen[inliers],
            start,
            self._T,
            FeatureNoise(
                focal_px=self._focal_px,
                sigma_px=settings.feature_sigma_px,
                depth_sigma_per_m2=settings.depth_sigma_per_m2,
            ),
        )
        if fit is None or np.count_nonzero(fit.is_inlier) < settings.inliers_min:
            return "matches that fit no motion on the floor"
        if np.sqrt(fit.covariance[:2, :2].trace()) > settings.step_sigma_max_m:
            return "matches that do not determine the motion"
        return fit, int(np.count_nonzero(fit.is_inlier))

    def _refine_pixels(
        self, keyframe: _Features, now: _Features, first: IntArray, second: IntArray
    ) -> tuple[Float32Array, BoolArray]:
        """(M, 2) refined pixels of the keyframe's features in the image, (M,) which were
        refined."""
        begin, guess = keyframe.pixels[first], now.pixels[second]
        found, status, _ = cv2.calcOpticalFlowPyrLK(
            keyframe.gray,
            now.gray,
            begin[:, np.newaxis, :],
            guess[:, np.newaxis, :].copy(),
            winSize=_LK_WINDOW,
            maxLevel=_LK_LEVELS,
            criteria=_LK_CRITERIA,
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        pixels = np.asarray(found, dtype=np.float32).reshape(-1, 2)
        near = np.linalg.norm(pixels - guess, axis=1) < self._settings.refinement_max_px
        kept: BoolArray = (np.asarray(status).reshape(-1) == 1) & near
        return pixels, kept

    @property
    def _focal_px(self) -> float:
        return 0.5 * (self._intrinsics.fx + self._intrinsics.fy)

    def _estimate_by_pnp(
        self, points: FloatArray, seen: FloatArray
    ) -> tuple[FloatArray | None, BoolArray]:
        """PnP with RANSAC: the planar part of the LiDAR's step, and (M,) the inliers."""
        in_camera = transform_points(invert_transform(self._T), points)
        settings = self._settings
        found = ransac_pnp(
            in_camera,
            seen,
            np.eye(3),
            draws=settings.ransac_draws,
            threshold=settings.ransac_threshold_px / self._focal_px,
            confidence=_RANSAC_CONFIDENCE,
            method=cv2.SOLVEPNP_EPNP,
        )
        if found is None:
            return None, np.zeros(len(points), dtype=np.bool_)
        T_now_keyframe, inliers = found
        step = planar_from_transform(
            self._T @ invert_transform(T_now_keyframe) @ invert_transform(self._T)
        )
        return (step if np.isfinite(step).all() else None), inliers

    def _accept_match(self, features: _Features, fit: PlanarStepEstimate, found: int) -> None:
        assert self._keyframe is not None, "a match has a keyframe"
        settings, step = self._settings, fit.step
        pose = compose_poses(self._keyframe.pose, step)
        noise = fit.covariance * settings.sigma_inflation**2
        self._chain.append(pose, rotate_covariance(float(step[2]), noise), matched=True)
        self._misses = 0
        self._found_most = max(self._found_most, found)
        self._last = replace(features, pose=pose)
        if (
            np.hypot(step[0], step[1]) > settings.keyframe_distance_m
            or abs(wrap_angle(step[2])) > settings.keyframe_rotation_rad
            or found < settings.keyframe_match_ratio * self._found_most
        ):
            self._set_keyframe(self._last)

    def _add_unmatched(self, pose: FloatArray, reason: str) -> None:
        self._misses += 1
        self._chain.append_unmatched(pose, reason)

    def _start_segment(self, features: _Features, reason: str = "") -> None:
        self._set_keyframe(features)
        self._chain.start_segment(features.pose, reason)
        self._misses = 0

    def _set_keyframe(self, keyframe: _Features) -> None:
        self._keyframe, self._last = keyframe, None
        self._chain.keyframe += 1
        self._found_most = 0

    def trajectory(self) -> OdometryTrajectory:
        """The trajectory over all images so far."""
        if not self._stamps_ns:
            raise MissingStream("visual odometry needs an image with depth.")
        return self._chain.to_trajectory(
            "visual", self._stamps_ns, scale_sigma=self._settings.depth_scale_sigma
        )
