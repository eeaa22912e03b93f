"""What a file states of a camera, under the keys that ROS, OpenCV, Open3D, KITTI and OpenCalib use.

Functions raise ValueError, which says what is wrong as part of a sentence.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.recordings.calibration_files.document import NUMBERS_ALONE, flat_numbers
from fusion_core.recordings.calibration_files.opencalib import opencalib_entry
from fusion_core.recordings.safe_yaml import require_number

_MAX_SIDE = 1 << 16
_MATRIX_KEYS = ("camera_matrix", "K", "k", "cam_K")
# KITTI's left colour camera, rectified.
_PROJECTION_KEYS = ("P2", "P_rect_02")
_SIZE_KEYS = (
    ("width", "height"),
    ("image_width", "image_height"),
    ("img_dist_w", "img_dist_h"),
)
_DISTORTION_KEYS = ("distortion_coefficients", "distortion", "D", "d", "cam_dist")
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
# Numbers of coefficients in OpenCV's models.
_DISTORTION_SIZES = (0, 4, 5, 8, 12, 14)
# Matrices that were computed have such a skew instead of none, in pixels.
_SKEW_MAX = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedCamera:
    """``pinhole``: fx, fy, cx, cy in pixels. ``size``: (width, height), None if not stated.

    ``is_size_certain``: OpenCalib's tools do not read the size in their own files, and examples
    that come with them state another one than their images have.
    """

    pinhole: tuple[float, float, float, float]
    size: tuple[int, int] | None
    distortion_model: str
    distortion: tuple[float, ...]
    is_size_certain: bool = True


def stated_camera(keys: Mapping[str, Any]) -> StatedCamera:
    """The camera of a file's keys."""
    opencalib = opencalib_entry(keys, "cam_K")
    camera = keys if opencalib is None else opencalib
    key = next((key for key in _DISTORTION_KEYS if key in camera), None)
    if any(projection in camera for projection in _PROJECTION_KEYS):
        # The images that a projection is for have been rectified.
        distortion: tuple[float, ...] = ()
    elif key is not None:
        distortion = tuple(_finite(camera, key))
    elif "k1" in camera:
        distortion = tuple(require_number(dict(camera), name, 0.0) for name in _COEFFICIENTS)
    else:
        distortion = ()
    if len(distortion) not in _DISTORTION_SIZES:
        raise ValueError(f"it has {len(distortion)} distortion coefficients")
    return StatedCamera(
        pinhole=_pinhole(camera),
        size=_size(camera),
        distortion_model=str(camera.get("distortion_model") or "plumb_bob"),
        distortion=distortion,
        is_size_certain=opencalib is None,
    )


def _pinhole(camera: Mapping[str, Any]) -> tuple[float, float, float, float]:
    if "intrinsic_matrix" in camera:
        # Open3D writes it by columns.
        by_column = _finite(camera, "intrinsic_matrix")
        return _pinhole_of_matrix([*by_column[0::3], *by_column[1::3], *by_column[2::3]])
    for key in _MATRIX_KEYS:
        if key in camera:
            return _pinhole_of_matrix(_finite(camera, key))
    for key in _PROJECTION_KEYS:
        if key in camera:
            values = _finite(camera, key)
            if len(values) != 12:
                raise ValueError(f"{key} has {len(values)} numbers, not 3 x 4")
            return _pinhole_of_matrix(np.reshape(values, (3, 4))[:, :3].ravel().tolist())
    if NUMBERS_ALONE in camera:
        values = _finite(camera, NUMBERS_ALONE)
        if len(values) != 4:
            return _pinhole_of_matrix(values)
        fx, fy, cx, cy = values
        return fx, fy, cx, cy
    fx, fy, cx, cy = (require_number(dict(camera), key) for key in ("fx", "fy", "cx", "cy"))
    return fx, fy, cx, cy


def _pinhole_of_matrix(k: Sequence[float]) -> tuple[float, float, float, float]:
    if len(k) != 9 or abs(k[1]) > _SKEW_MAX or [k[3], *k[6:]] != [0.0, 0.0, 0.0, 1.0]:
        raise ValueError(f"{len(k)} numbers are no 3 x 3 matrix fx 0 cx, 0 fy cy, 0 0 1")
    return k[0], k[4], k[2], k[5]


def _size(camera: Mapping[str, Any]) -> tuple[int, int] | None:
    if "S_rect_02" in camera:
        sides = dict(zip(_SIZE_KEYS[0], _finite(camera, "S_rect_02"), strict=False))
        return _pixels(sides, "width"), _pixels(sides, "height")
    for width, height in _SIZE_KEYS:
        if width in camera or height in camera:
            return _pixels(camera, width), _pixels(camera, height)
    return None


def _pixels(camera: Mapping[str, Any], key: str) -> int:
    value = require_number(dict(camera), key)
    if not value.is_integer() or not 0 < value <= _MAX_SIDE:
        raise ValueError(f"{key} {value:g} is no number of pixels")
    return int(value)


def _finite(camera: Mapping[str, Any], key: str) -> list[float]:
    try:
        values = flat_numbers(camera[key])
    except ValueError as error:
        raise ValueError(f"{key} holds no list of numbers: {error}") from None
    if not np.isfinite(values).all():
        raise ValueError(f"{key} is missing or no finite number")
    return [float(value) for value in values]
