"""Whether a part of the image moves otherwise than the camera's pose says, as one.

Something rigid that goes through the image, or goes with the camera, gives as good a pose as the
world does, and tracking follows the one with more features. From one image to the next both are
much the same; between an image and the reference keyframe they have come apart. What there
contradicts the pose and agrees on another motion is a rival. Which of the two is the world's the
images do not say with certainty: the stretch is named.
"""

import cv2
import numpy as np

from fusion_core.model.conventions import Float32Array, FloatArray
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.motion.feature_matching import match_descriptors
from fusion_core.motion.ransac_pnp import ransac_pnp
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.doubtful_stretches import PoseCheck
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.local_map import LocalMap
from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.slam.visual.pinhole import camera_parameters, project, unproject
from fusion_core.slam.visual.tracked_frame import TrackedFrame

# Parts of the image across, by which a motion's share is counted: many features in one say no more
# than a few.
_CELLS_ACROSS = 16
# A feature so many standard deviations off contradicts a pose.
_GATE = 5.0
# Fewest features of a rival, as tracking wants for a pose.
_MATCHES_MIN = 20
_RATIO_MAX = 0.8
_DRAWS, _CONFIDENCE, _THRESHOLD_PX = 100, 0.99, 3.0


class RivalMotionSettings(StageSettings):
    """Settings of ``rival_motion_check``."""

    check_images: int = setting(
        5, "Images from one search for a second motion to the next", ge=1, le=1000
    )
    share_max: float = setting(
        0.1,
        "Part of the image with a motion of its own, above which a pose is doubtful",
        ge=0.0,
        le=1.0,
    )
    gap_images: int = setting(
        30,
        "Images in which two motions may be too alike to tell apart within one doubtful stretch",
        unit="images",
        ge=0,
        le=1000,
    )


def rival_motion_check(
    intrinsics: CameraIntrinsics, settings: RivalMotionSettings, noise: ObservationNoise
) -> PoseCheck:
    """Doubts poses with a rival."""

    def contradiction(_: Float32Array, tracked: TrackedFrame, local: LocalMap) -> float:
        return rival_share(
            local.features,
            tracked.features,
            invert_transform(tracked.T_map_camera) @ local.T_map_reference,
            intrinsics,
            noise,
        )

    return PoseCheck(
        contradiction,
        check_images=settings.check_images,
        share_max=settings.share_max,
        gap_images=settings.gap_images,
        says="of the image moves otherwise than the camera, as one: the trajectory may follow "
        "something that moves",
    )


def rival_share(
    first: FrameFeatures,
    second: FrameFeatures,
    T_second_first: FloatArray,
    intrinsics: CameraIntrinsics,
    noise: ObservationNoise,
) -> float:
    """Part of the second image that contradicts a motion, (4, 4), and agrees on another one; of
    what agrees with either."""
    known = np.flatnonzero(np.isfinite(first.depths_m))
    matches = match_descriptors(first.descriptors[known], second.descriptors, ratio_max=_RATIO_MAX)
    if len(matches) < _MATCHES_MIN:
        return 0.0
    of_first, of_second = known[matches[:, 0]], matches[:, 1]
    camera = camera_parameters(intrinsics)
    points = unproject(first.pixels[of_first], first.depths_m[of_first], camera)
    seen = second.pixels[of_second]
    off = project(transform_points(T_second_first, points), camera) - seen
    sigmas = noise.pixel_sigmas(np.maximum(first.octaves[of_first], second.octaves[of_second]))
    # Behind the camera nothing is seen: NaN contradicts.
    agrees = np.linalg.norm(off, axis=1) <= _GATE * sigmas
    contradicts = np.flatnonzero(~agrees)
    if len(contradicts) < _MATCHES_MIN:
        return 0.0
    fx, fy, cx, cy = camera
    found = ransac_pnp(
        points[contradicts],
        seen[contradicts],
        np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        draws=_DRAWS,
        threshold=_THRESHOLD_PX,
        confidence=_CONFIDENCE,
        method=cv2.SOLVEPNP_EPNP,
    )
    if found is None or np.count_nonzero(found[1]) < _MATCHES_MIN:
        return 0.0
    rival = np.zeros(len(points), np.bool_)
    rival[contradicts[found[1]]] = True
    return _cells(seen[rival], intrinsics) / _cells(seen[rival | agrees], intrinsics)


def _cells(pixels: FloatArray, intrinsics: CameraIntrinsics) -> int:
    """How many parts of the image hold some of (N, 2) pixels."""
    at = np.floor(pixels * (_CELLS_ACROSS / intrinsics.width)).astype(np.int64)
    return len(np.unique(at, axis=0))
