"""Folders of the TUM RGB-D benchmark, and ICL-NUIM in its layout.

Text files list the images with their stamps: rgb.txt and depth.txt (lines "stamp file"), or
associations.txt (lines "stamp file stamp file"). groundtruth.txt holds the pose of the colour
camera's optical centre. 16-bit depth is in 1/5000 m. Source: Sturm et al., "A Benchmark for the
Evaluation of RGB-D SLAM Systems", and the file formats on the benchmark's pages.

The driver registered the depth images to the distorted colour images, pixel by pixel: depth has the
colour camera's intrinsics, distortion included. The images of the third camera (freiburg3) are
published without distortion.
"""

import os
import re
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from math import hypot, isfinite
from pathlib import Path

import numpy as np

from fusion_core.model.conventions import NS_PER_S, FloatArray, IntArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.geometry import POSITION_MAX_M, make_transform, rotation_from_quaternion
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import CameraIntrinsics, PoseSample
from fusion_core.recordings.decimal_time import ns_from_decimal_seconds
from fusion_core.recordings.images.frame_folder import (
    CAMERA_FRAME,
    WORLD_FRAME,
    frame_stamps_ns,
)
from fusion_core.recordings.images.image_folder import (
    MAX_FILES,
    ImageSeries,
    camera_streams,
    find_camera_parameters,
    read_first_shape,
)
from fusion_core.recordings.quoting import quote_clipped
from fusion_core.recordings.stamped import StampedRecording, StampedStream

UNITS_PER_METRE = 5000.0
# A name that topic selection never takes for odometry.
GROUND_TRUTH_TOPIC = "/camera/ground_truth"

_DEPTH_LIST, _COLOR_LIST, _PAIR_LIST = "depth.txt", "rgb.txt", "associations.txt"
_GROUND_TRUTH_LIST = "groundtruth.txt"
_MAX_LIST_BYTES = 64 << 20
_MAX_LINE_BYTES = 4096
_QUATERNION_LENGTHS = (1e-6, 1e6)
_CAMERA_NAME = re.compile(r"(?:^|_)(?:freiburg|fr)([123])(?![0-9A-Za-z])", re.IGNORECASE)
# fx, fy, cx, cy and k1, k2, p1, p2, k3 of the colour cameras, for 640 x 480 pixels, as the
# benchmark publishes them.
_PUBLISHED = {
    "1": ((517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "2": ((520.9, 521.0, 325.1, 249.7), (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "3": ((535.4, 539.2, 320.1, 247.6), ()),
}
_PUBLISHED_SHAPE = (480, 640)


def is_tum_folder(path: Path) -> bool:
    """Whether a folder has an image list and a folder of images."""
    lists = (_DEPTH_LIST, _COLOR_LIST, _PAIR_LIST)
    return any((path / name).is_file() for name in lists) and any(
        (path / name).is_dir() for name in ("depth", "rgb")
    )


def open_tum_folder(path: Path) -> Recording:
    """Open a folder accepted by ``is_tum_folder``. Raises RecordingError."""
    warnings: list[str] = []
    depth_list, color_list = _read_image_lists(path, warnings)
    lists = [listed for listed in (depth_list, color_list) if listed.names]
    if not lists:
        raise RecordingError(
            f"lists no images that are there{f' ({warnings[0]})' if warnings else ''}.",
            file=path,
            advice=f"{_DEPTH_LIST} and {_COLOR_LIST} hold a stamp and a file on each line.",
        )
    nominal = all(listed.is_numbered for listed in lists)
    first = min(min(listed.stamps_ns) for listed in lists) // NS_PER_S if nominal else None
    depth, color = (listed.series(first, warnings) for listed in (depth_list, color_list))
    intrinsics, units_per_metre = None, UNITS_PER_METRE
    if depth is not None:
        camera = find_camera_parameters(depth, [path], warnings)
        intrinsics = camera.intrinsics or _published_intrinsics(path, depth, warnings)
        units_per_metre = camera.units_per_metre or UNITS_PER_METRE
    streams = camera_streams(depth, color, intrinsics, units_per_metre)
    streams += _ground_truth_streams(path / _GROUND_TRUTH_LIST, nominal, warnings)
    return StampedRecording(path, "TUM RGB-D folder", streams, warnings, stamps_are_nominal=nominal)


@dataclass(slots=True)
class _ImageList:
    """Images in the order of a list's lines.

    ``is_numbered``: every stamp is only the number in its file's name, as in ICL-NUIM.
    """

    folder: Path
    list_name: str
    stamps_ns: "array[int]" = field(default_factory=lambda: array("q"))
    names: list[str] = field(default_factory=list)
    is_numbered: bool = True

    def add(self, stamp: str, name: str) -> str | None:
        """Add an image; returns the reason if it is rejected."""
        stamp_ns = ns_from_decimal_seconds(stamp)
        if stamp_ns is None:
            return f"{quote_clipped(stamp)} is no stamp in seconds"
        parts = name.replace("\\", "/").split("/")
        if parts[0] == "" or ":" in parts[0] or ".." in parts:
            return f"{quote_clipped(name)} is outside of the folder"
        if not os.path.isfile(f"{self.folder}/{name}"):  # noqa: PTH113  # Lists have 10^6 lines.
            return f"{quote_clipped(name)} is not there"
        stem = parts[-1].rpartition(".")[0]
        self.is_numbered &= stamp.isdecimal() and stem.isdecimal() and int(stamp) == int(stem)
        self.stamps_ns.append(stamp_ns)
        self.names.append(name)
        return None

    def series(self, first_number: int | None, warnings: list[str]) -> ImageSeries | None:
        """The images by time; None if empty. ``first_number``: stamps are nominal, from it."""
        if not self.names:
            return None
        stamps = np.array(self.stamps_ns, dtype=np.int64)
        order = _sorting_order(stamps, self.list_name, warnings)
        stamps = stamps[order]
        if first_number is not None:
            stamps = frame_stamps_ns(stamps // NS_PER_S, first_number)
        return ImageSeries(self.folder, tuple(self.names[i] for i in order.tolist()), stamps)


def _read_image_lists(path: Path, warnings: list[str]) -> tuple[_ImageList, _ImageList]:
    """Depth and colour images from their lists; from associations.txt if both are missing."""
    depth, color = _ImageList(path, _DEPTH_LIST), _ImageList(path, _COLOR_LIST)

    def take_pair(fields: list[str]) -> str | None:
        if len(fields) != 4:
            return "it is no stamp file stamp file"
        pair = [(fields[0], fields[1]), (fields[2], fields[3])]
        by_depth = {"depth" in name.lower(): (stamp, name) for stamp, name in pair}
        if len(by_depth) != 2:
            return "not one of its two files is named depth"
        return depth.add(*by_depth[True]) or color.add(*by_depth[False])

    def take_image(listed: _ImageList, fields: list[str]) -> str | None:
        return listed.add(*fields) if len(fields) == 2 else "it is no stamp and file"

    singles = [listed for listed in (depth, color) if (path / listed.list_name).is_file()]
    for listed in singles:
        _parse_lines(path / listed.list_name, partial(take_image, listed), warnings)
    if not singles:
        depth.list_name = color.list_name = _PAIR_LIST
        _parse_lines(path / _PAIR_LIST, take_pair, warnings)
    return depth, color


def _parse_lines(file: Path, take: Callable[[list[str]], str | None], warnings: list[str]) -> None:
    """Pass the fields of each line to ``take``, which returns a reason if it rejects them.

    Unreadable files and rejected lines are skipped with a warning.
    """
    refused, first_reason = 0, ""
    try:
        if file.stat().st_size > _MAX_LIST_BYTES:
            raise RecordingError(
                f"is larger than {_MAX_LIST_BYTES} bytes.", file=file, advice="Split the recording."
            )
        with file.open("rb") as stream:
            lines = iter(partial(stream.readline, _MAX_LINE_BYTES), b"")
            for number, line in enumerate(lines, start=1):
                if number > MAX_FILES:
                    warnings.append(f"{file.name}: what follows line {MAX_FILES} is left out.")
                    break
                try:
                    fields = line.decode().split()
                except UnicodeDecodeError:
                    reason: str | None = "it is no text"
                else:
                    reason = take(fields) if fields and not fields[0].startswith("#") else None
                if reason is not None:
                    refused += 1
                    first_reason = first_reason or f"line {number}: {reason}"
    except OSError as error:
        warnings.append(f"{file.name} cannot be read: {error.strerror or error}.")
    except RecordingError as error:
        warnings.append(str(error))
    if refused:
        warnings.append(f"{file.name}: {refused} lines are left out; the first, {first_reason}.")


def _ground_truth_streams(file: Path, nominal: bool, warnings: list[str]) -> list[StampedStream]:
    if not file.is_file():
        return []
    if nominal:
        warnings.append(f"{file.name} is left out: the images have numbers and no stamps.")
        return []
    stamps_ns: array[int] = array("q")
    poses = array("d")

    def take(fields: list[str]) -> str | None:
        stamp_ns = ns_from_decimal_seconds(fields[0])
        try:
            values = [float(text) for text in fields[1:]]
        except ValueError:
            values = []
        if stamp_ns is None or len(values) != 7:
            return "it is no stamp tx ty tz qx qy qz qw"
        least, most = _QUATERNION_LENGTHS
        if not all(map(isfinite, values)) or not least < hypot(*values[3:]) < most:
            return "its pose is no rigid transform"
        if max(map(abs, values[:3])) > POSITION_MAX_M:
            return f"its position lies farther than {POSITION_MAX_M:g} m"
        stamps_ns.append(stamp_ns)
        poses.extend(values)
        return None

    _parse_lines(file, take, warnings)
    if not stamps_ns:
        return []
    unsorted_ns = np.array(stamps_ns, dtype=np.int64)
    order = _sorting_order(unsorted_ns, file.name, warnings)
    ordered_ns = unsorted_ns[order]
    ordered: FloatArray = np.array(poses).reshape(-1, 7)[order]

    def pose(index: int) -> PoseSample:
        return PoseSample(
            stamp_ns=int(ordered_ns[index]),
            received_ns=None,
            parent=WORLD_FRAME,
            child=CAMERA_FRAME,
            T_parent_child=make_transform(
                rotation_from_quaternion(*ordered[index, 3:]), ordered[index, :3]
            ),
        )

    return [
        StampedStream(
            name=GROUND_TRUTH_TOPIC, type="pose", role="pose", stamps_ns=ordered_ns, read_value=pose
        )
    ]


def _published_intrinsics(
    path: Path, depth: ImageSeries, warnings: list[str]
) -> CameraIntrinsics | None:
    """The published intrinsics of the camera in the folder's name; None if it names none."""
    match = _CAMERA_NAME.search(path.resolve().name)
    if match is None:
        return None
    try:
        shape = read_first_shape(depth)
    except RecordingError as error:
        warnings.append(f"There are no intrinsics: {error}")
        return None
    if shape != _PUBLISHED_SHAPE:
        warnings.append(
            f"There are no intrinsics: those of freiburg{match[1]} are for images of "
            f"{_PUBLISHED_SHAPE[::-1]}, the depth images are {shape[::-1]}."
        )
        return None
    warnings.append(
        f"The intrinsics are those published for the camera of freiburg{match[1]}, known by the "
        "folder's name; a camera.json in the folder would take their place."
    )
    (fx, fy, cx, cy), distortion = _PUBLISHED[match[1]]
    return CameraIntrinsics(
        width=shape[1], height=shape[0], fx=fx, fy=fy, cx=cx, cy=cy, distortion=distortion
    )


def _sorting_order(stamps_ns: IntArray, list_name: str, warnings: list[str]) -> IntArray:
    """Indices that sort the stamps; lines with equal stamps keep their order."""
    if (np.diff(stamps_ns) < 0).any():
        warnings.append(f"{list_name}: its stamps do not ascend; its lines are sorted.")
    return np.argsort(stamps_ns, kind="stable")
