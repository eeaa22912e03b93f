"""The role of each topic, and which topics are used where none are named."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from fusion_core.model.errors import MissingStream, RecordingError
from fusion_core.model.recording import Recording, Role, Topic
from fusion_core.model.sensors import CameraInfo, DepthImage, SensorValue
from fusion_core.recordings.messages.image_pixels import is_color_encoding, is_depth_encoding

_ROLES: Final[dict[str, Role]] = {
    "sensor_msgs/msg/LaserScan": "lidar",
    "sensor_msgs/msg/CameraInfo": "camera_info",
    "nav_msgs/msg/Odometry": "odometry",
    "geometry_msgs/msg/PoseStamped": "pose",
    "tf2_msgs/msg/TFMessage": "tf",
    "tf/msg/tfMessage": "tf",
    "sensor_msgs/msg/PointCloud2": "points",
    "sensor_msgs/msg/JointState": "joints",
}
_IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_MAX_ATTEMPTS = 5
# image_transport publishes the same images again under the topic's name with one of these.
_TRANSPORTS = ("compressed", "compressedDepth")
# Ground truth is for evaluation: a map built from it would prove nothing.
_GROUND_TRUTH_NAMES = ("ground_truth", "groundtruth", "ground-truth", "truth")


@dataclass(frozen=True, slots=True, kw_only=True)
class Streams:
    """The topics to read.

    ``color`` and ``camera_info`` belong to the depth topic at the same index; None where a depth
    camera has none. ``pose`` is set only where the user names a topic, ``pose_frame`` where the
    user names a frame of ``tf`` instead. ``notes`` report choices among several topics.
    """

    lidar: str | None
    depth: tuple[str, ...]
    color: tuple[str | None, ...]
    camera_info: tuple[str | None, ...]
    odometry: str | None
    tf: str | None
    tf_static: str | None
    pose: str | None
    pose_frame: str | None = None
    notes: tuple[str, ...] = ()


def role_from_type(message_type: str, name: str) -> Role | None:
    """The role by type and name; None for images, whose encoding decides."""
    if message_type in _IMAGE_TYPES:
        return None
    role = _ROLES.get(message_type, "other")
    return "tf_static" if role == "tf" and name.endswith("tf_static") else role


def role_from_encoding(encoding: str, name: str) -> Role:
    """The role of an image topic by the encoding of its images.

    The name decides only for ``mono16``, which drivers use for depth and for infrared.
    """
    if is_depth_encoding(encoding) and (encoding != "mono16" or "depth" in name.lower()):
        return "depth"
    return "color" if is_color_encoding(encoding) else "other"


def unknown_topic_error(name: str, topics: Iterable[Topic], path: Path) -> MissingStream:
    """The error for an unknown topic, naming the known ones."""
    there = ", ".join(topic.name for topic in topics) or "no topics"
    return MissingStream(f"has no topic {name!r}.", file=path, advice=f"It holds {there}.")


def choose_streams(
    recording: Recording,
    *,
    lidar: str | None = None,
    depth: str | Sequence[str] | None = None,
    color: str | Sequence[str] | None = None,
    camera_info: str | Sequence[str] | None = None,
    odometry: str | None = None,
    pose: str | None = None,
) -> Streams:
    """The topics to work with: those named, else those that the recording offers.

    Not named: the LaserScan topic with the most messages; every depth topic, each with the colour
    topic nearest by name and its own CameraInfo; the odometry with the most messages, ground truth
    by its name excluded. ``pose`` may name a PoseStamped or an Odometry topic, or a frame of TF,
    and is never guessed.

    Raises MissingStream for a name that is not there or is of another kind.
    """
    chooser = _StreamChooser(recording)
    depths = chooser.require_topics(depth, "depth")
    if depths is None:
        depths = chooser.one_topic_per_camera("depth")
    colors = chooser.require_topics(color, "color")
    infos = chooser.require_topics(camera_info, "camera_info")
    for named, what in ((colors, "colour"), (infos, "CameraInfo")):
        if named is not None and len(named) != len(depths):
            raise MissingStream(
                f"{len(named)} {what} topics are named for {len(depths)} depth topics.",
                file=recording.path,
                advice="Name one for each depth topic, in the same order.",
            )
    pose_frame = pose if chooser.may_be_frame(pose) else None
    return Streams(
        lidar=chooser.require_topic(lidar, "lidar")
        or chooser.topic_with_most_messages("lidar", "LaserScan"),
        depth=tuple(depths),
        color=tuple(colors or [chooser.color_of(name, len(depths)) for name in depths]),
        camera_info=tuple(infos or [chooser.camera_info_of(name) for name in depths]),
        odometry=chooser.require_topic(odometry, "odometry")
        or chooser.topic_with_most_messages("odometry", "odometry"),
        tf=chooser.topic_with_most_messages("tf", "TF"),
        tf_static=chooser.topic_with_most_messages("tf_static", "static TF"),
        pose=None if pose_frame else chooser.require_topic(pose, "pose", "odometry"),
        pose_frame=pose_frame,
        notes=tuple(chooser.notes),
    )


class _StreamChooser:
    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._topics = {topic.name: topic for topic in recording.topics}
        self.notes: list[str] = []

    def require_topic(self, name: str | None, *roles: Role) -> str | None:
        if name is None:
            return None
        if name not in self._topics:
            raise unknown_topic_error(name, self._recording.topics, self._recording.path)
        topic = self._topics[name]
        if topic.role not in roles:
            fitting = [t.name for t in self._topics.values() if t.role in roles]
            raise MissingStream(
                f"{name} holds {topic.type} and cannot serve as {' or '.join(roles)}.",
                file=self._recording.path,
                advice=f"Topics that can: {', '.join(fitting) or 'none'}.",
            )
        return name

    def may_be_frame(self, name: str | None) -> bool:
        """Whether a name can only be a frame's: tf2 allows no leading slash, and it is no topic."""
        is_topic = name is None or name in self._topics or name.startswith("/")
        return not is_topic and bool(self.topics_with_messages("tf"))

    def require_topics(self, names: str | Sequence[str] | None, role: Role) -> list[str] | None:
        if names is None:
            return None
        listed = [names] if isinstance(names, str) else list(names)
        twice = next((name for name in listed if listed.count(name) > 1), None)
        # Two depth topics may well share a colour camera.
        if role == "depth" and twice is not None:
            raise MissingStream(
                f"{twice} is named twice.",
                file=self._recording.path,
                advice="Name each depth topic once.",
            )
        return [name for name in listed if self.require_topic(name, role)]

    def topics_with_messages(self, role: Role) -> list[str]:
        return [t.name for t in self._topics.values() if t.role == role and t.count > 0]

    def one_topic_per_camera(self, role: Role) -> list[str]:
        """One topic for each camera: its raw images, else the first of their compressed copies."""
        chosen: dict[str, str] = {}
        for name in sorted(self.topics_with_messages(role)):
            camera = _strip_transport(name)
            if camera in chosen:
                self._note(f"{name} repeats the images of {chosen[camera]}.")
            else:
                chosen[camera] = name
        return list(chosen.values())

    def topic_with_most_messages(self, role: Role, what: str) -> str | None:
        names = [n for n in self.topics_with_messages(role) if not _is_ground_truth(n)]
        if not names:
            return None
        best = max(names, key=lambda name: self._topics[name].count)
        if len(names) > 1:
            others = ", ".join(name for name in names if name != best)
            self.notes.append(f"Of {len(names)} {what} topics {best} is taken, not {others}.")
        return best

    def color_of(self, depth: str, depth_count: int) -> str | None:
        """The colour topic whose name has most leading parts in common with the depth topic's."""
        names = self.one_topic_per_camera("color")
        if not names:
            return None
        best = max(names, key=lambda name: _count_shared_parts(name, depth))
        related = _count_shared_parts(best, depth) > 0
        return best if related or (len(names) == 1 and depth_count == 1) else None

    def camera_info_of(self, depth: str) -> str | None:
        """The CameraInfo beside the depth topic, else one of the same frame and image size.

        Another guess could be the colour camera's, whose intrinsics would distort the cloud.
        """
        names = self.topics_with_messages("camera_info")
        folder = _parent(_strip_transport(depth))
        beside = [name for name in names if _parent(name) == folder]
        infos = {name: self._first_value(name) for name in beside or names}
        if len(beside) == 1 and infos[beside[0]] is not None:
            return beside[0]
        image = self._first_value(depth)
        fitting = [name for name, info in infos.items() if _same_camera(image, info)]
        return fitting[0] if fitting else None

    def _first_value(self, name: str) -> SensorValue | None:
        """The value of the first message, or of one of the next if that cannot be read."""
        problem = None
        for index in range(min(self._topics[name].count, _MAX_ATTEMPTS)):
            try:
                return self._recording.read(name, index).value
            except RecordingError as error:
                problem = problem or error
        self._note(f"{name} is not used: {problem}")
        return None

    def _note(self, note: str) -> None:
        if note not in self.notes:
            self.notes.append(note)


def _same_camera(image: object, info: object) -> bool:
    if not isinstance(image, DepthImage) or not isinstance(info, CameraInfo):
        return False
    camera = info.intrinsics
    return (
        camera is not None
        and info.frame_id == image.frame_id
        and (camera.height, camera.width) == image.depth_m.shape
    )


def _is_ground_truth(name: str) -> bool:
    return any(word in name.lower() for word in _GROUND_TRUTH_NAMES)


def _strip_transport(name: str) -> str:
    base, _, last = name.rpartition("/")
    return base if last in _TRANSPORTS else name


def _parent(name: str) -> str:
    return name.rpartition("/")[0]


def _count_shared_parts(first: str, second: str) -> int:
    """How many leading parts two topic names have in common."""
    count = 0
    for a, b in zip(first.strip("/").split("/"), second.strip("/").split("/"), strict=False):
        if a != b:
            break
        count += 1
    return count
