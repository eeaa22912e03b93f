"""Folders of depth and colour images: 7-Scenes, Redwood (Open3D) and slambook layouts.

They have no time stamps: the nominal stamp of a frame is its number / 30 s, counted from the first.
It is also used as log time. Depth is in millimetres.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fusion_core.model.conventions import NS_PER_S, FloatArray, IntArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.geometry import POSITION_MAX_M, rigid_fault
from fusion_core.model.recording import Recording, Role
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    ColorImage,
    DepthImage,
    PoseSample,
    SensorValue,
)
from fusion_core.recordings.images.camera_files import read_intrinsics
from fusion_core.recordings.images.frame_files import (
    read_image,
    read_matrix,
    read_pose_lines,
    read_rgb,
    read_trajectory_log,
)
from fusion_core.recordings.stamped import StampedRecording, StampedStream
from fusion_core.recordings.units import depth_m_from_millimetres

DEPTH_TOPIC = "/camera/depth/image_raw"
COLOR_TOPIC = "/camera/color/image_raw"
CAMERA_INFO_TOPIC = "/camera/depth/camera_info"
POSE_TOPIC = "/camera/pose"
CAMERA_FRAME = "camera"
WORLD_FRAME = "world"
_FRAMES_PER_S = 30

_SEVEN_SCENES_NAME = re.compile(r"frame-(\d{6})\.(depth\.png|color\.(?:png|jpg)|pose\.txt)$")
_NUMBERED_IMAGE = re.compile(r"(\d{1,12})\.(png|jpg|jpeg)$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class FrameLayout:
    """The files of a folder by frame number.

    ``poses``: for each frame the file of its pose, or the matrix read from a file of all poses.
    """

    format: str
    depth: Mapping[int, Path]
    color: Mapping[int, Path]
    intrinsics: Path | None
    poses: Mapping[int, Path | FloatArray]
    warnings: tuple[str, ...] = ()


def frame_layout(path: Path) -> str | None:
    """The name of the folder's layout, or None."""
    if next(_seven_scenes_files(path), None) is not None:
        return "7-Scenes folder"
    if not (path / "depth").is_dir() or not (path / "color").is_dir():
        return None
    # These files also imply millimetres: TUM and ICL-NUIM folders look alike and have 1/5000 m.
    if (path / "trajectory.log").is_file() or any(path.glob("camera_*.json")):
        return "Redwood folder"
    return "slambook folder" if (path / "pose.txt").is_file() else None


def open_frame_folder(path: Path) -> Recording:
    """Open a folder in a layout known to ``frame_layout``. Raises RecordingError."""
    name = frame_layout(path)
    if name is None:
        raise RecordingError(
            "is no folder of frames.",
            file=path,
            advice="Known layouts are those of 7-Scenes, Redwood and slambook.",
        )
    layout = _seven_scenes(path, name) if name == "7-Scenes folder" else _numbered(path, name)
    if not layout.depth:
        raise RecordingError(
            "has no depth images.", file=path, advice="Put them into depth/ as numbered PNG files."
        )
    return _recording(path, layout)


def frame_stamps_ns(numbers: IntArray, first: int) -> IntArray:
    """(count,) nominal stamps of frame numbers, 0 at the number ``first``."""
    return (numbers - first) * NS_PER_S // _FRAMES_PER_S


def _recording(path: Path, layout: FrameLayout) -> Recording:
    first = min(min(layout.depth), min(layout.color, default=min(layout.depth)))
    warnings = list(layout.warnings)

    def stream(
        name: str,
        kind: str,
        role: Role,
        files: Collection[int],
        value: Callable[[int, int], SensorValue],
    ) -> StampedStream:
        numbers = np.array(sorted(files), dtype=np.int64)
        stamps = frame_stamps_ns(numbers, first)
        return StampedStream(
            name=name,
            type=kind,
            role=role,
            stamps_ns=stamps,
            read_value=lambda index: value(int(numbers[index]), int(stamps[index])),
        )

    streams = [stream(DEPTH_TOPIC, "image", "depth", layout.depth, partial(_depth, layout.depth))]
    if layout.color:
        read_color = partial(_color, layout.color)
        streams.append(stream(COLOR_TOPIC, "image", "color", layout.color, read_color))
    if layout.poses:
        streams.append(
            stream(POSE_TOPIC, "pose", "pose", layout.poses, partial(_pose, layout.poses))
        )
    if layout.intrinsics is not None:
        try:
            shape = _depth_pixels(layout.depth[min(layout.depth)]).shape
            read_info = partial(_camera_info, read_intrinsics(layout.intrinsics, shape))
        except RecordingError as error:
            warnings.append(f"There are no intrinsics: {error}")
        else:
            streams.append(
                stream(CAMERA_INFO_TOPIC, "intrinsics", "camera_info", layout.depth, read_info)
            )
    return StampedRecording(path, layout.format, streams, warnings, stamps_are_nominal=True)


def _camera_info(intrinsics: CameraIntrinsics, number: int, stamp_ns: int) -> CameraInfo:
    return CameraInfo(
        stamp_ns=stamp_ns, received_ns=None, frame_id=CAMERA_FRAME, intrinsics=intrinsics
    )


def _seven_scenes_files(path: Path) -> Iterator[tuple[int, str, Path]]:
    for child in path.iterdir():
        match = _SEVEN_SCENES_NAME.match(child.name)
        if match is not None:
            yield int(match[1]), match[2].partition(".")[0], child


def _seven_scenes(path: Path, name: str) -> FrameLayout:
    files: dict[str, dict[int, Path]] = {"depth": {}, "color": {}, "pose": {}}
    for number, kind, file in _seven_scenes_files(path):
        files[kind][number] = file
    intrinsics = path / "camera-intrinsics.txt"
    return FrameLayout(
        format=name,
        depth=files["depth"],
        color=files["color"],
        intrinsics=intrinsics if intrinsics.is_file() else None,
        poses=files["pose"],
    )


def _numbered(path: Path, name: str) -> FrameLayout:
    """depth/N.png and color/N.jpg|png, with the poses of all frames in one file."""
    depth, color = _numbered_images(path / "depth"), _numbered_images(path / "color")
    read_poses, file = (
        (read_trajectory_log, path / "trajectory.log")
        if name == "Redwood folder"
        else (read_pose_lines, path / "pose.txt")
    )
    warnings: list[str] = []
    poses: dict[int, Path | FloatArray] = {}
    numbers = sorted(depth)
    if file.is_file():
        by_place = read_poses(file, warnings)
        poses = {numbers[i]: pose for i, pose in by_place.items() if i < len(numbers)}
        if len(poses) != len(numbers):
            warnings.append(
                f"{file.name} has {len(by_place)} poses for {len(numbers)} depth images; "
                "they are paired in order."
            )
    cameras = sorted(path.glob("camera_*.json"))
    if len(cameras) > 1:
        names = ", ".join(camera.name for camera in cameras)
        warnings.append(f"There are no intrinsics: {names} exclude each other.")
    return FrameLayout(
        format=name,
        depth=depth,
        color=color,
        intrinsics=cameras[0] if len(cameras) == 1 else None,
        poses=poses,
        warnings=tuple(warnings),
    )


def _numbered_images(folder: Path) -> dict[int, Path]:
    matches = ((_NUMBERED_IMAGE.match(child.name), child) for child in sorted(folder.iterdir()))
    return {int(match[1]): child for match, child in matches if match is not None}


def _depth(files: Mapping[int, Path], number: int, stamp_ns: int) -> DepthImage:
    return DepthImage(
        stamp_ns=stamp_ns,
        received_ns=None,
        frame_id=CAMERA_FRAME,
        depth_m=depth_m_from_millimetres(_depth_pixels(files[number])),
        encoding="16UC1",
    )


def _depth_pixels(file: Path) -> np.ndarray[Any, Any]:
    pixels = read_image(file, cv2.IMREAD_UNCHANGED)
    if pixels.dtype != np.uint16 or pixels.ndim != 2:
        raise RecordingError(
            f"is no depth image: {pixels.dtype} of shape {pixels.shape}.",
            file=file,
            advice="Depth is 16-bit PNG in millimetres.",
        )
    return pixels


def _color(files: Mapping[int, Path], number: int, stamp_ns: int) -> ColorImage:
    rgb = read_rgb(files[number])
    return ColorImage(stamp_ns=stamp_ns, received_ns=None, frame_id=CAMERA_FRAME, rgb=rgb)


def _pose(poses: Mapping[int, Path | FloatArray], number: int, stamp_ns: int) -> PoseSample:
    """The pose T_world_camera, as in all three layouts."""
    source = poses[number]
    if isinstance(source, Path):
        matrix = read_matrix(source, (4, 4))
        where = str(source)
    else:
        matrix, where = source, f"the pose of frame {number}"
    if fault := rigid_fault(matrix):
        raise RecordingError(
            f"{where} is not a rigid transform: {fault}.",
            advice="Tracking was lost there; the frame has no pose.",
        )
    if np.abs(matrix[:3, 3]).max() > POSITION_MAX_M:
        raise RecordingError(
            f"{where} lies farther than {POSITION_MAX_M:g} m: {matrix.tolist()}.",
            advice="Check the source of the poses.",
        )
    return PoseSample(
        stamp_ns=stamp_ns,
        received_ns=None,
        parent=WORLD_FRAME,
        child=CAMERA_FRAME,
        T_parent_child=matrix,
    )
