"""Depth camera parameter files: ROS YAML, JSON (Open3D or plain keys), and text.

Every function raises RecordingError with the file's name.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fusion_core.model.errors import RecordingError
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.recordings.calibration_files.document import NUMBERS_ALONE
from fusion_core.recordings.calibration_files.stated_camera import stated_camera
from fusion_core.recordings.images.frame_files import read_text
from fusion_core.recordings.safe_yaml import load_yaml, require_number

_STEMS = (
    "calibration",
    "camera",
    "camera-intrinsics",
    "camera_info",
    "camera_intrinsics",
    "intrinsic",
    "intrinsics",
)
_MAX_TEXT_BYTES = 64 << 10
_SCALE_KEYS = ("depth_scale", "depth_factor")
# Set by hand: coarser units do not resolve a wall, with finer ones 16 bits end below 1 m.
_UNITS_PER_METRE = (100.0, 100_000.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraFile:
    """Parameters of a depth camera from a file.

    ``pinhole``: fx, fy, cx, cy in pixels. ``shape``: (rows, columns) of its images.
    ``units_per_metre`` is that of 16-bit depth. Each is None if the file does not state it.
    """

    pinhole: tuple[float, float, float, float] | None = None
    shape: tuple[int, int] | None = None
    distortion_model: str = "plumb_bob"
    distortion: tuple[float, ...] = ()
    units_per_metre: float | None = None

    def intrinsics(self, shape: tuple[int, int]) -> CameraIntrinsics | None:
        """The intrinsics for images of ``shape``. Raises ValueError if the sizes differ."""
        if self.pinhole is None:
            return None
        if self.shape not in (None, shape):
            raise ValueError(
                f"it is for images of {self.shape[::-1]}, the depth images are {shape[::-1]}"
            )
        fx, fy, cx, cy = self.pinhole
        return CameraIntrinsics(
            width=shape[1],
            height=shape[0],
            fx=fx,
            fy=fy,
            cx=cx,
            cy=cy,
            distortion_model=self.distortion_model,
            distortion=self.distortion,
        )


def find_camera_files(folder: Path) -> list[Path]:
    """The camera parameter files directly in a folder, sorted by name."""
    names = {stem + suffix for stem in _STEMS for suffix in _PARSERS}
    return [folder / name for name in sorted(names) if (folder / name).is_file()]


def read_camera_file(file: Path) -> CameraFile:
    """The camera parameters in a file. Raises RecordingError.

    Text and plain keys hold fx, fy, cx, cy. A matrix is row-major, except ``intrinsic_matrix``,
    which Open3D writes column-major. ``depth_scale`` is units per metre, or metres per unit if it
    is below 1.
    """
    text = read_text(file, _MAX_TEXT_BYTES)
    try:
        return _PARSERS[file.suffix](text)
    except (ValueError, OverflowError) as error:
        raise RecordingError(
            f"states no camera: {error}.",
            file=file,
            advice="It needs fx, fy, cx, cy and the size of the depth images.",
        ) from error


def read_intrinsics(file: Path, shape: tuple[int, int]) -> CameraIntrinsics:
    """The intrinsics in a file for images of ``shape`` (rows, columns). Raises RecordingError."""
    stated = read_camera_file(file)
    try:
        intrinsics = stated.intrinsics(shape)
    except ValueError as error:
        raise RecordingError(
            f"{error}.", file=file, advice="Put the depth camera's own file there."
        ) from error
    if intrinsics is None:
        raise RecordingError(
            "states no intrinsics.", file=file, advice="It needs fx, fy, cx, cy and the size."
        )
    return intrinsics


def _units_from_scale(depth_scale: float) -> float:
    least, most = _UNITS_PER_METRE
    units = 1.0 / depth_scale if 0.0 < depth_scale < 1.0 else depth_scale
    if not least <= units <= most:
        raise ValueError(f"depth_scale {depth_scale:g} gives no depth; millimetres are 1000")
    return units


def _camera_from_text(text: str) -> CameraFile:
    values = [float(word) for word in text.split()]
    return CameraFile(pinhole=stated_camera({NUMBERS_ALONE: values}).pinhole)


def _camera_from_json(text: str) -> CameraFile:
    try:
        return _camera_from_mapping(json.loads(text))
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _camera_from_yaml(text: str) -> CameraFile:
    return _camera_from_mapping(load_yaml(text))


def _camera_from_mapping(camera: object) -> CameraFile:
    if not isinstance(camera, dict):
        raise ValueError("it holds no keys")
    scale_key = next((key for key in _SCALE_KEYS if key in camera), None)
    units_per_metre = _units_from_scale(require_number(camera, scale_key)) if scale_key else None
    if scale_key is not None and len(camera) == 1:
        return CameraFile(units_per_metre=units_per_metre)
    stated = stated_camera(camera)
    if stated.size is None:
        raise ValueError("width is missing or no finite number")
    return CameraFile(
        pinhole=stated.pinhole,
        shape=(stated.size[1], stated.size[0]),
        distortion_model=stated.distortion_model,
        distortion=stated.distortion,
        units_per_metre=units_per_metre,
    )


_PARSERS: dict[str, Callable[[str], CameraFile]] = {
    ".json": _camera_from_json,
    ".yaml": _camera_from_yaml,
    ".yml": _camera_from_yaml,
    ".txt": _camera_from_text,
}
