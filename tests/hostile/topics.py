"""A recording whose topics and frame ids do harm where they are not taken for text."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from fusion_core.model.sensors import PoseSample, TransformBatch
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.ros2_writer import Ros2McapWriter

# HTML, Markdown, quotes of both kinds, and letters that are written from right to left.
MARKUP = (
    '<img src=x onerror="window.taken=1">![a](x)**bold**</textarea></div>'
    "\"'`<script>window.taken=2</script>\u05d0\u05d1\u05d2"
)
# As long as readers take a topic and a frame id. Topics with marks that turn the direction of
# writing are refused.
_LONG = "w" * 800
_FRAME = f"{MARKUP}\u202egpj{'w' * 3900}"
# By the first letters of a topic. What belongs together keeps a common beginning.
_BEFORE_TOPIC = {
    "/scan": f"/{MARKUP}",
    "/camera/depth": f"/{MARKUP}{_LONG}",
    "/camera/color": f"/{_LONG}",
    "/odom": f"/{_LONG}{MARKUP}",
    "/ground_truth": f"/{MARKUP}",
}


def hostile_topic(topic: str) -> str:
    """A topic of the recording that is rewritten; those of transforms keep their names, by which
    they are known."""
    before = next((name for at, name in _BEFORE_TOPIC.items() if topic.startswith(at)), "")
    return f"{before}{topic}"


def hostile_frame(frame_id: str) -> str:
    """A frame id of the recording that is rewritten."""
    return f"{_FRAME}/{frame_id}"


def write_with_hostile_names(source: Path, path: Path) -> None:
    """Write a recording of LiDAR, depth images, odometry and transforms under hostile names."""
    with open_recording(source) as recording, Ros2McapWriter(path) as writer:
        roles = {topic.name: topic.role for topic in recording.topics}
        for message in recording.messages():
            is_odometry = roles[message.topic] == "odometry"
            value = _renamed(message.value)
            writer.write(hostile_topic(message.topic), value, odometry=is_odometry)


def _renamed(value: Any) -> Any:
    match value:
        case TransformBatch():
            return replace(value, transforms=tuple(map(_between_renamed, value.transforms)))
        case PoseSample():
            return _between_renamed(value)
    return replace(value, frame_id=hostile_frame(value.frame_id))


def _between_renamed(value: Any) -> Any:
    return replace(value, parent=hostile_frame(value.parent), child=hostile_frame(value.child))
