"""The files that hold a calibrated pose."""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from fusion_core.exporting.extrinsics_files import (
    require_result_suffix,
    write_extrinsics,
    write_ros_transform,
    write_urdf_joint,
)
from fusion_core.files.atomic import require_folder_of
from fusion_core.files.inputs import require_apart
from fusion_core.model.extrinsics import ExtrinsicsEstimate
from fusion_core.model.names import printable
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.recordings.static_transform import write_static_transform

_BESIDE = (".yaml", ".urdf", ".tf.mcap")


def result_paths(output: Path) -> tuple[Path, ...]:
    """The files that ``write_result`` writes for ``output``, which comes first.

    Raises ExportError where it ends in neither .json nor .toml.
    """
    require_result_suffix(output)
    return output, *(output.with_name(output.stem + suffix) for suffix in _BESIDE)


def require_result_apart(output: Path, inputs: Collection[Path]) -> None:
    """Raise ExportError where a file of the result is an input, or has no folder; to be asked
    before the work."""
    require_folder_of(output)
    for path in result_paths(output):
        require_apart(path, inputs)


def write_result(
    output: Path,
    estimate: ExtrinsicsEstimate,
    *,
    inputs: Collection[Path],
    camera_frame: str = "camera",
    lidar_frame: str = "lidar",
    intrinsics: CameraIntrinsics | None = None,
    more: Mapping[str, Any] | None = None,
) -> tuple[Path, ...]:
    """Write ``output`` (.json or .toml), and beside it .yaml (ROS), .urdf (a fixed joint) and
    .tf.mcap (a static transform in a ROS 2 recording). Returns what was written, ``output`` first.

    ``intrinsics`` and ``more`` go into ``output``, as ``write_extrinsics`` says. What cannot be
    printed of a frame's name, which comes out of a recording, is written as escapes.

    Raises ExportError where a file cannot be written or is one of ``inputs``.
    """
    require_result_apart(output, inputs)
    paths = result_paths(output)
    _, yaml, urdf, mcap = paths
    camera_frame, lidar_frame = printable(camera_frame), printable(lidar_frame)
    T_camera_lidar = estimate.T_camera_lidar
    write_ros_transform(yaml, T_camera_lidar, parent=camera_frame, child=lidar_frame)
    write_urdf_joint(urdf, T_camera_lidar, parent=camera_frame, child=lidar_frame)
    write_static_transform(mcap, T_camera_lidar, parent=camera_frame, child=lidar_frame)
    # Last, so that the result is complete where this file is.
    write_extrinsics(
        output,
        estimate,
        camera_frame=camera_frame,
        lidar_frame=lidar_frame,
        intrinsics=intrinsics,
        more=more,
    )
    return paths
