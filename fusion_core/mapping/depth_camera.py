"""The camera of depth images: its intrinsics in their size, and images without its distortion."""

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array
from fusion_core.model.errors import MappingFailed
from fusion_core.model.sensors import CameraIntrinsics


def depth_intrinsics(intrinsics: CameraIntrinsics, shape: tuple[int, int]) -> CameraIntrinsics:
    """Of depth images of ``shape`` (height, width) that show the same as those of ``intrinsics``.

    Raises MappingFailed where the camera cannot have them.
    """
    try:
        return intrinsics.scaled_to(shape)
    except ValueError as error:
        raise MappingFailed(
            f"a depth image of {shape[1]} x {shape[0]} pixels is not of a camera with images of "
            f"{intrinsics.width} x {intrinsics.height}: {error}."
        ) from error


class StraightImages:
    """Images as the camera matrix alone would show them, in the same size.

    ``intrinsics``: of the images as stored.
    """

    def __init__(self, intrinsics: CameraIntrinsics) -> None:
        self._sources: tuple[Float32Array, Float32Array] | None = None
        if any(intrinsics.distortion) or intrinsics.is_fisheye:
            self._sources = _stored_pixels(intrinsics)

    def depth(self, depth_m: Float32Array) -> Float32Array:
        """(h, w) metres; NaN where the lens shows nothing."""
        if self._sources is None:
            return depth_m
        # A depth between two surfaces would be neither: the nearest pixel.
        straight = cv2.remap(
            depth_m,
            *self._sources,
            cv2.INTER_NEAREST,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        )
        return np.asarray(straight, np.float32)

    def color(self, rgb: ByteArray) -> ByteArray:
        """(h, w, 3); black where the lens shows nothing."""
        if self._sources is None:
            return rgb
        straight = cv2.remap(rgb, *self._sources, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        return np.asarray(straight, np.uint8)


def _stored_pixels(intrinsics: CameraIntrinsics) -> tuple[Float32Array, Float32Array]:
    """(h, w) u and v of the stored pixel under each straight one, far outside for none."""
    width, height = intrinsics.width, intrinsics.height
    K, coefficients = intrinsics.matrix, intrinsics.opencv_distortion
    # One more row and column, for the steps from each pixel to the next.
    arguments = K, coefficients, np.eye(3), K, (width + 1, height + 1), cv2.CV_32FC1
    if intrinsics.is_fisheye:
        maps = cv2.fisheye.initUndistortRectifyMap(*arguments)
    else:
        maps = cv2.initUndistortRectifyMap(*arguments)
    u, v = np.asarray(maps[0], np.float32), np.asarray(maps[1], np.float32)
    # Where the polynomial of the distortion folds back, the map turns over: from there outwards it
    # shows once more what the lens shows nearer to the axis.
    right_u, right_v = (np.diff(map_, axis=1)[:-1] for map_ in (u, v))
    down_u, down_v = (np.diff(map_, axis=0)[:, :-1] for map_ in (u, v))
    is_turned = right_u * down_v - down_u * right_v <= 0.0
    u, v = u[:-1, :-1].copy(), v[:-1, :-1].copy()
    if is_turned.any():
        row, column = np.mgrid[:height, :width]
        radius = np.hypot(
            (column - intrinsics.cx) / intrinsics.fx, (row - intrinsics.cy) / intrinsics.fy
        )
        is_beyond = radius >= radius[is_turned].min()
        u[is_beyond] = v[is_beyond] = -2.0 * max(width, height)
    return u, v
