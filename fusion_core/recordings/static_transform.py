"""One static transform as a ROS 2 recording."""

from pathlib import Path

from fusion_core.model.conventions import FloatArray
from fusion_core.model.sensors import Transform, TransformBatch
from fusion_core.recordings.ros2_writer import Ros2McapWriter


def write_static_transform(
    path: Path, T_parent_child: FloatArray, *, parent: str, child: str
) -> None:
    """Write an .mcap file with one message on /tf_static, at time 0.

    Raises ExportError where the file cannot be written.
    """
    transform = Transform(
        stamp_ns=0, parent=parent, child=child, T_parent_child=T_parent_child.copy()
    )
    with Ros2McapWriter(path) as writer:
        writer.write("/tf_static", TransformBatch(received_ns=0, transforms=(transform,)))
