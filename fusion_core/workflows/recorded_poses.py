"""Where the LiDAR was: odometry by TF, else by its topic, else what is named by hand.

Recorded motion is odometry, which REP 105 gives in the frame ``odom``: continuous, and drifting.
Poses in ``map`` or ``earth`` are a localisation's own result, near to the truth, and ``world`` is
most often a simulator's or a motion capture's: a map or an error made of them says nothing of the
estimator. They serve only where they are named, as does a topic that is called a ground truth.

A pose that is stamped outside of the recording, or jumps away and back, is left out with a warning.
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
from fusion_core.workflows.stamp_filter import StampFilter, warn_once
from fusion_core.workflows.timed_transforms import TimedTransforms

# The fixed frames of REP 105: odometry's, and those in which a robot is localised.
_ODOM_FRAME = "odom"
_LOCALISED_FRAMES = frozenset({"map", "earth", "world"})
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

    Poses by a localisation cost a warning where they are not named.
    Raises MissingStream where a topic or a frame is named and gives no pose of the LiDAR.
    """
    lidar = frame_name(lidar_frame)
    transforms = RecordedTransforms(recording, streams.tf_static)
    tree = transforms.tree
    if streams.pose is not None:
        return _poses_of_topic(recording, streams.pose, tree, lidar)
    if streams.pose_frame is not None:
        return _poses_in_named_frame(recording, streams, transforms, lidar)
    if streams.tf is not None:
        # Even to odom, a chain by way of the map would be the localisation's.
        for frame in sorted(transforms.add_timed(streams.tf, without=_LOCALISED_FRAMES)):
            _warn_of_localised(recording, streams.tf, frame, named_by=frame)
        if _ever_connected(tree, recording, streams.tf, _ODOM_FRAME, lidar):
            return _TransformLookup(
                tree, _ODOM_FRAME, lidar, _source(streams.tf, _ODOM_FRAME, lidar)
            )
    if streams.odometry is not None:
        frame = _frame_of_poses(recording, streams.odometry)
        if frame not in _LOCALISED_FRAMES:
            return _poses_of_topic(recording, streams.odometry, tree, lidar)
        _warn_of_localised(recording, streams.odometry, frame, named_by=streams.odometry)
    return None


def _warn_of_localised(recording: Recording, topic: str, frame: str, *, named_by: str) -> None:
    warn_once(
        recording,
        f"{topic}: poses in the frame {frame} are a localisation's result or a truth, not odometry "
        f"(REP 105), and are not used; --pose {named_by} would use them",
    )


def _source(topic: str, frame: str, lidar: str) -> str:
    return f"{topic} ({frame} to {lidar})"


def _poses_in_named_frame(
    recording: Recording, streams: Streams, transforms: RecordedTransforms, lidar: str
) -> PoseLookup:
    tf, frame = streams.tf, streams.pose_frame
    assert frame is not None
    assert tf is not None, "a frame is named only where there is TF"
    transforms.add_timed(tf)
    if not _ever_connected(transforms.tree, recording, tf, frame, lidar):
        there = ", ".join(transforms.tree.frames) or "none"
        raise MissingStream(
            f"{frame!r} is no topic, and no frame from which {tf} leads to {lidar!r}.",
            file=recording.path,
            advice=f"Name a topic or a frame. The frames: {there}.",
        )
    return _TransformLookup(transforms.tree, frame, lidar, _source(tf, frame, lidar))


def _frame_of_poses(recording: Recording, topic: str) -> str:
    """The frame in which a topic gives its poses, by its first readable message."""
    for message in recording.messages([topic]):
        if isinstance(message.value, PoseSample):
            return frame_name(message.value.parent)
    return ""


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
