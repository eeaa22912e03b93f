"""Where the LiDAR was: recorded poses from TF, else odometry, else a topic named by hand.

A ground truth is never used unless it is named. A pose that is stamped outside of the recording, or
jumps away and back, is left out with a warning.
"""

from typing import Protocol

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import MissingStream, RecordingError, ScanLoomError
from fusion_core.model.geometry import planar_from_transform
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import PoseSample, Transform, TransformBatch
from fusion_core.model.transform_tree import TransformTree
from fusion_core.recordings.topics import Streams
from fusion_core.workflows.recorded_transforms import RecordedTransforms, frame_name
from fusion_core.workflows.stamp_filter import StampFilter
from fusion_core.workflows.timed_transforms import TimedTransforms

# The fixed frame (REP 105), best first.
_MAP_FRAMES = ("map", "odom", "world")
_POSE_FRAME = "scanloom_pose_parent"


class PoseLookup(Protocol):
    """Poses of the LiDAR at any instant. ``source``: where they come from, for people."""

    source: str

    def at(self, stamp_ns: int) -> FloatArray | None:
        """(x, y, yaw) of T_map_lidar, None where it is not known."""
        ...


class _TransformLookup:
    def __init__(self, tree: TransformTree, map_frame: str, lidar_frame: str, source: str) -> None:
        self._tree, self._map, self._lidar = tree, map_frame, lidar_frame
        self.source = source

    def at(self, stamp_ns: int) -> FloatArray | None:
        try:
            return planar_from_transform(self._tree.lookup(self._map, self._lidar, stamp_ns))
        except ScanLoomError:
            # Before the first pose and after the last there is none.
            return None


def recorded_poses(recording: Recording, streams: Streams, lidar_frame: str) -> PoseLookup | None:
    """The recorded poses of the LiDAR, None where the recording has none.

    Raises MissingStream where a pose topic is named and holds no pose.
    """
    lidar = frame_name(lidar_frame)
    transforms = RecordedTransforms(recording, streams.tf_static)
    tree = transforms.tree
    if streams.pose is not None:
        return _poses_of_topic(recording, streams.pose, tree, lidar)
    if streams.tf is not None:
        transforms.add_timed(streams.tf)
    if streams.tf is not None and lidar in tree.frames:
        for frame in _MAP_FRAMES:
            if frame in tree.frames and _ever_connected(tree, recording, streams.tf, frame, lidar):
                return _TransformLookup(tree, frame, lidar, f"{streams.tf} ({frame} to {lidar})")
    if streams.odometry is not None:
        return _poses_of_topic(recording, streams.odometry, tree, lidar)
    return None


def _ever_connected(
    tree: TransformTree, recording: Recording, topic: str, target: str, source: str
) -> bool:
    count = next(entry.count for entry in recording.topics if entry.name == topic)
    for index in {0, count // 2, count - 1}:
        try:
            batch = recording.read(topic, index).value
        except RecordingError:
            # Iteration has warned of it already.
            continue
        if not isinstance(batch, TransformBatch) or not batch.transforms:
            continue
        try:
            tree.lookup(target, source, batch.transforms[0].stamp_ns)
        except ScanLoomError:
            continue
        return True
    return False


def _poses_of_topic(
    recording: Recording, topic: str, tree: TransformTree, lidar_frame: str
) -> PoseLookup:
    """Poses of a topic. The body is the message's child where static transforms join it to the
    LiDAR; otherwise the LiDAR itself is taken to be what the topic means."""
    body = ""
    found = False
    timed = TimedTransforms()
    # Equal stamps are kept: an odometry may publish twice at one instant.
    for message in StampFilter(recording, strictly=False).accepted(recording.messages([topic])):
        sample = message.value
        if not isinstance(sample, PoseSample):
            continue
        if not found:
            body = frame_name(sample.child)
            found = True
        named = Transform(
            stamp_ns=sample.stamp_ns,
            parent=_POSE_FRAME,
            child=body or lidar_frame,
            T_parent_child=sample.T_parent_child.copy(),
        )
        timed.add(named, message.received_ns)
    timed.add_inliers_to(tree, topic, recording)
    if not found:
        raise MissingStream(f"{topic} holds no poses.", file=recording.path)
    if not body or _are_connected(tree, body, lidar_frame):
        return _TransformLookup(tree, _POSE_FRAME, lidar_frame, topic)
    source = f"{topic} (of {body}, taken as {lidar_frame}: no static transforms join the two)"
    return _TransformLookup(tree, _POSE_FRAME, body, source)


def _are_connected(tree: TransformTree, body: str, lidar_frame: str) -> bool:
    try:
        tree.lookup(body, lidar_frame, 0)
    except ScanLoomError:
        return False
    return True
