"""Plain folders of images: depth/ and rgb/, color/ or images/, named by number or by time.

A time is decimal seconds or nanoseconds. Frames named by number get the nominal stamp
number / 30 s, counted from the first. Intrinsics and the unit of 16-bit depth come from a file
beside the images (``camera_files``). Depth and colour keep their own stamps; they are not paired.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion_core.model.conventions import IntArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.recording import Recording, Role
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    ColorImage,
    DepthImage,
    SensorValue,
)
from fusion_core.recordings.decimal_time import ns_from_decimal_seconds
from fusion_core.recordings.images.camera_files import (
    CameraFile,
    find_camera_files,
    read_camera_file,
)
from fusion_core.recordings.images.depth_files import (
    check_depth_encoding,
    read_depth,
    read_depth_shape,
)
from fusion_core.recordings.images.frame_files import read_rgb
from fusion_core.recordings.images.frame_folder import (
    CAMERA_FRAME,
    CAMERA_INFO_TOPIC,
    COLOR_TOPIC,
    DEPTH_TOPIC,
    frame_stamps_ns,
)
from fusion_core.recordings.stamped import StampedRecording, StampedStream
from fusion_core.recordings.units import MILLIMETRES_PER_METRE

MAX_FILES = 1 << 20
_DEPTH_FOLDER = "depth"
_COLOR_FOLDERS = ("rgb", "color", "images")
_DEPTH_SUFFIXES = (".png", ".pgm", ".tif", ".tiff", ".npy")
_COLOR_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm")
_NAME = re.compile(r"(?:[A-Za-z][A-Za-z_-]*)?(\d{1,19}(?:\.\d{1,9})?)", re.ASCII)
# Integers below the first are frame numbers; from the second on they are nanoseconds (since 1973).
_END_OF_FRAMES = 10**9
_FIRST_NS = 10**17
_SHAPE_ATTEMPTS = 10


@dataclass(frozen=True, slots=True)
class ImageSeries:
    """The images of one sensor, as names in ``folder``. ``stamp_ns``: (count,), ascending."""

    folder: Path
    names: tuple[str, ...]
    stamp_ns: IntArray

    def file(self, index: int) -> Path:
        """The ``index``-th image."""
        return self.folder / self.names[index]


@dataclass(frozen=True, slots=True)
class DepthCameraParameters:
    """Intrinsics and unit of 16-bit depth; None if no file states them."""

    intrinsics: CameraIntrinsics | None = None
    units_per_metre: float | None = None


def is_image_folder(path: Path) -> bool:
    """Whether a folder has depth/ with images, or depth/ next to a folder of colour images."""
    depth = path / _DEPTH_FOLDER
    if not depth.is_dir():
        return False
    return _color_folder(path) is not None or any(
        _number_or_stamp(Path(child.name), _DEPTH_SUFFIXES) for child in depth.iterdir()
    )


def open_image_folder(path: Path) -> Recording:
    """Open a folder accepted by ``is_image_folder``. Raises RecordingError."""
    warnings: list[str] = []
    depth = _named_images(path / _DEPTH_FOLDER, _DEPTH_SUFFIXES, warnings)
    if depth is None:
        raise RecordingError(
            "has no depth images.",
            file=path / _DEPTH_FOLDER,
            advice=f"Name them by number or time stamp, as {', '.join(_DEPTH_SUFFIXES)}.",
        )
    color_folder = _color_folder(path)
    color = _named_images(color_folder, _COLOR_SUFFIXES, warnings) if color_folder else None
    if color is not None and color.are_numbers != depth.are_numbers:
        warnings.append(
            f"{color.folder.name}/ is left out: its images and those of {_DEPTH_FOLDER}/ are not "
            "both named by number or both by time."
        )
        color = None
    first = min(int(images.values[0]) for images in (depth, color) if images is not None)
    series = depth.series(first)
    camera = find_camera_parameters(series, [path, path / _DEPTH_FOLDER], warnings)
    return StampedRecording(
        path,
        "image folder",
        camera_streams(
            series,
            color.series(first) if color else None,
            camera.intrinsics,
            _units_per_metre(series, camera.units_per_metre, warnings),
        ),
        warnings,
        stamps_are_nominal=depth.are_numbers,
    )


def find_camera_parameters(
    depth: ImageSeries, folders: Sequence[Path], warnings: list[str]
) -> DepthCameraParameters:
    """Parameters from the only camera file in ``folders``; problems are added to ``warnings``."""
    files = [file for folder in folders for file in find_camera_files(folder)]
    if len(files) > 1:
        names = ", ".join(file.name for file in files)
        warnings.append(f"There are no intrinsics: {names} exclude each other.")
    if len(files) != 1:
        return DepthCameraParameters()
    stated = CameraFile()
    try:
        stated = read_camera_file(files[0])
        intrinsics = stated.intrinsics(read_first_shape(depth))
    except RecordingError as error:
        warnings.append(f"There are no intrinsics: {error}")
    except ValueError as error:
        warnings.append(f"There are no intrinsics: {files[0].name}: {error}.")
    else:
        return DepthCameraParameters(intrinsics, stated.units_per_metre)
    return DepthCameraParameters(None, stated.units_per_metre)


def read_first_shape(depth: ImageSeries) -> tuple[int, int]:
    """(rows, columns) of the first image that can be read. Raises RecordingError."""
    last = min(len(depth.names), _SHAPE_ATTEMPTS) - 1
    for index in range(last):
        with suppress(RecordingError):
            return read_depth_shape(depth.file(index))
    return read_depth_shape(depth.file(last))


def camera_streams(
    depth: ImageSeries | None,
    color: ImageSeries | None,
    intrinsics: CameraIntrinsics | None,
    units_per_metre: float,
) -> list[StampedStream]:
    """The topics of a camera, with the intrinsics repeated for each depth image."""
    streams = []
    if depth is not None:
        streams.append(
            _stream(
                DEPTH_TOPIC, "image", "depth", depth, lambda i: _depth(depth, i, units_per_metre)
            )
        )
    if depth is not None and intrinsics is not None:
        streams.append(
            _stream(
                CAMERA_INFO_TOPIC,
                "intrinsics",
                "camera_info",
                depth,
                lambda i: CameraInfo(
                    stamp_ns=int(depth.stamp_ns[i]),
                    received_ns=None,
                    frame_id=CAMERA_FRAME,
                    intrinsics=intrinsics,
                ),
            )
        )
    if color is not None:
        streams.append(_stream(COLOR_TOPIC, "image", "color", color, lambda i: _color(color, i)))
    return streams


def _stream(
    name: str, kind: str, role: Role, series: ImageSeries, value: Callable[[int], SensorValue]
) -> StampedStream:
    return StampedStream(
        name=name, type=kind, role=role, stamps_ns=series.stamp_ns, read_value=value
    )


def _depth(series: ImageSeries, index: int, units_per_metre: float) -> DepthImage:
    depth_m, encoding = read_depth(series.file(index), units_per_metre)
    return DepthImage(
        stamp_ns=int(series.stamp_ns[index]),
        received_ns=None,
        frame_id=CAMERA_FRAME,
        depth_m=depth_m,
        encoding=encoding,
    )


def _color(series: ImageSeries, index: int) -> ColorImage:
    return ColorImage(
        stamp_ns=int(series.stamp_ns[index]),
        received_ns=None,
        frame_id=CAMERA_FRAME,
        rgb=read_rgb(series.file(index)),
    )


def _units_per_metre(depth: ImageSeries, stated: float | None, warnings: list[str]) -> float:
    """``stated``, else millimetres where the values do not speak against it."""
    last = len(depth.names) - 1
    stored = check_depth_encoding([depth.file(index) for index in sorted({0, last // 2, last})])
    if stated is not None:
        if stored.scrambled_bits:
            warnings.append(f"Depth is read as stated, but doubtful: {stored.scrambled_bits}.")
        return stated
    if doubt := stored.scrambled_bits or stored.other_unit:
        raise RecordingError(
            f"is no depth in millimetres: {doubt}.",
            file=depth.folder,
            advice='Convert it to millimetres, or state its unit as "depth_scale" in camera.json.',
        )
    if stored.has_integers:
        warnings.append(
            "Depth is taken as millimetres: no file that can be read says its unit "
            '("depth_scale" in camera.json).'
        )
    return MILLIMETRES_PER_METRE


@dataclass(frozen=True, slots=True)
class _NamedImages:
    """``values``: (count,) frame numbers, or stamps in nanoseconds, ascending."""

    folder: Path
    names: tuple[str, ...]
    values: IntArray
    are_numbers: bool

    def series(self, first: int) -> ImageSeries:
        stamps = frame_stamps_ns(self.values, first) if self.are_numbers else self.values
        return ImageSeries(self.folder, self.names, stamps)


def _color_folder(path: Path) -> Path | None:
    return next((path / name for name in _COLOR_FOLDERS if (path / name).is_dir()), None)


def _named_images(
    folder: Path, suffixes: Iterable[str], warnings: list[str]
) -> _NamedImages | None:
    """The images of a folder, ordered by the number or time in their names; None if none."""
    by_value: dict[int, str] = {}
    kinds: set[bool] = set()
    left_out = 0
    for count, child in enumerate(folder.iterdir()):
        if count == MAX_FILES:
            raise RecordingError(
                f"holds more than {MAX_FILES} files.", file=folder, advice="Split the recording."
            )
        name = Path(child.name)
        if name.suffix.lower() not in suffixes:
            continue
        found = _number_or_stamp(name, suffixes)
        if found is None:
            left_out += 1
            continue
        value, is_number = found
        kinds.add(is_number)
        if value in by_value:
            left_out += 1
        # The listing order of a folder is arbitrary; the choice must not depend on it.
        by_value[value] = min(by_value.get(value, child.name), child.name)
    if len(kinds) > 1:
        raise RecordingError(
            "names some images by number and others by time.",
            file=folder,
            advice="Put them into two folders.",
        )
    if left_out:
        warnings.append(
            f"{folder.name}/: {left_out} images are left out, whose names say no number or time, "
            "or the same as another."
        )
    if not by_value:
        return None
    values = np.array(sorted(by_value), dtype=np.int64)
    names = tuple(by_value[value] for value in values.tolist())
    return _NamedImages(folder, names, values, kinds == {True})


def _number_or_stamp(name: Path, suffixes: Iterable[str]) -> tuple[int, bool] | None:
    """(frame number, True) or (nanoseconds, False) from a file's name; None if neither."""
    match = _NAME.fullmatch(name.stem)
    if match is None or name.suffix.lower() not in suffixes:
        return None
    if "." in match[1]:
        stamp_ns = ns_from_decimal_seconds(match[1])
        return None if stamp_ns is None else (stamp_ns, False)
    number = int(match[1])
    if number < _END_OF_FRAMES:
        return number, True
    return (number, False) if _FIRST_NS <= number < 1 << 63 else None
