"""What is known of the LiDAR's motion before SLAM."""

from dataclasses import replace
from typing import Literal

from fusion_core.model.errors import MissingStream
from fusion_core.model.recording import Recording
from fusion_core.recordings.topics import Streams, choose_streams
from fusion_core.workflows.poses import Poses, recorded_poses

MotionKind = Literal["recorded", "wheel", "laser", "visual", "fused", "none"]


def map_streams(recording: Recording, lidar_topic: str | None, pose_topic: str | None) -> Streams:
    """As always, but with the LiDAR's own odometry where there is one: written with each scan, it
    has the scan's very stamp, while another topic's must be interpolated."""
    streams = choose_streams(recording, lidar=lidar_topic, pose=pose_topic)
    own = f"{streams.lidar}/odom"
    if not any(topic.name == own and topic.role == "odometry" for topic in recording.topics):
        return streams
    return choose_streams(recording, lidar=lidar_topic, pose=pose_topic, odometry=own)


def recorded_motion(
    recording: Recording, streams: Streams, lidar_frame: str, *, wheel_only: bool
) -> Poses:
    """The LiDAR's poses by what was recorded; ``wheel_only``: by odometry, not by TF.

    Raises MissingStream where that is not there.
    """
    if wheel_only:
        streams = replace(streams, tf=None, pose=None)
    poses = recorded_poses(recording, streams, lidar_frame)
    if poses is None:
        what = "odometry" if wheel_only else "recorded pose"
        raise MissingStream(
            f"holds no {what}.", file=recording.path, advice="Use --motion none with SLAM."
        )
    return poses
