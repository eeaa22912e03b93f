"""Images of a lens as the camera matrix alone would show them."""

import cv2
import numpy as np

from fusion_core.lens.projection import inside_image, project_points
from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray
from fusion_core.model.sensors import CameraIntrinsics


class StraightImages:
    """Images as the camera matrix alone would show them, in the same size.

    ``intrinsics``: of the images as stored.
    """

    def __init__(self, intrinsics: CameraIntrinsics) -> None:
        self._sources: tuple[Float32Array, Float32Array] | None = None
        if not intrinsics.is_straight:
            u, v = np.moveaxis(pixels_under_straight(intrinsics), -1, 0)
            self._sources = u.astype(np.float32), v.astype(np.float32)

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


def pixels_under_straight(intrinsics: CameraIntrinsics) -> FloatArray:
    """(h, w, 2) the stored pixel (u, v) under each of the straight image, a finite one far outside
    where the lens shows none."""
    row, column = np.mgrid[: intrinsics.height, : intrinsics.width]
    rays = np.stack(
        [
            (column - intrinsics.cx) / intrinsics.fx,
            (row - intrinsics.cy) / intrinsics.fy,
            np.ones(row.shape),
        ],
        axis=-1,
    )
    pixels = project_points(rays.reshape(-1, 3), intrinsics)
    # A strong distortion maps to pixels that overflow the integers of whoever looks them up.
    pixels[~inside_image(pixels, intrinsics)] = -2.0 * max(intrinsics.width, intrinsics.height)
    return pixels.reshape(*row.shape, 2)
