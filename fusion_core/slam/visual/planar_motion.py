"""Visual SLAM's trajectory as the planar motion of a LiDAR on the same robot.

An image is placed by what it sees of the local map, so that the step between two images has the
covariance of both fits, however many images lie between them. From one reference keyframe to the
next the errors of the local map add up. What all steps have in common is the scale of the depths,
of which neither images nor loops know anything.
"""

from dataclasses import replace

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import MissingStream
from fusion_core.model.geometry import invert_transform, planar_from_transform
from fusion_core.motion.keyframe_chain import KeyframeChain
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.drift import adjoints
from fusion_core.slam.visual.visual_slam import VisualSlamResult

NAME = "visual-slam"


class PlanarMotionSettings(StageSettings):
    """Visual SLAM as a motion prior."""

    depth_scale_sigma: float = setting(
        0.005,
        "Standard deviation of the depth scale, common to all depths",
        unit="m/m",
        ge=0.0,
        le=1.0,
    )


def planar_motion(
    result: VisualSlamResult, T_lidar_camera: FloatArray, settings: PlanarMotionSettings
) -> OdometryTrajectory:
    """The LiDAR's motion at the images' stamps, by its own covariances.

    ``T_lidar_camera``: (4, 4), the optical frame to the LiDAR's, whose z axis is taken as vertical:
    the first image's LiDAR is the origin. Height, roll and pitch are taken as known in the
    covariance. An image that was lost repeats the pose before it, and its step is not measured.

    Raises MissingStream where no image has a pose.
    """
    if not result.is_tracked.any():
        raise MissingStream("visual SLAM has placed no image.")
    T_camera_lidar = invert_transform(T_lidar_camera)
    # A motion of the LiDAR in its own axes, as one of T_camera_map from the left.
    by_motion = -adjoints(T_camera_lidar[np.newaxis])[0][:, [3, 4, 2]]
    chain, pose = KeyframeChain(), np.zeros(3)
    reasons = {
        image: stretch.reason
        for stretch in result.lost
        for image in range(stretch.first, stretch.last + 1)
    }
    for image, is_tracked in enumerate(result.is_tracked.tolist()):
        if not is_tracked:
            chain.append_unmatched(pose, reasons.get(image, "lost"))
            continue
        pose = planar_from_transform(T_lidar_camera @ result.T_map_camera[image] @ T_camera_lidar)
        chain.keyframe = int(result.references[image])
        information = result.information[image]
        if not np.isfinite(information).all():
            chain.start_segment(pose)
            continue
        chain.append(pose, np.linalg.inv(by_motion.T @ information @ by_motion), matched=True)
    track = chain.to_trajectory(NAME, result.stamps_ns.tolist())
    return replace(track, scale_sigma=settings.depth_scale_sigma)
