"""An RGB-D camera's pixels for maps in space: their rays, their colours, and both images as a lens
without distortion would show them."""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.lens.straight_images import StraightImages
from fusion_core.lens.undistortion import undistort_pixels
from fusion_core.mapping.depth_camera import depth_intrinsics
from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthGeometry:
    """Of depth images of one size. ``rays``: (h, w, 2) x / z and y / z of each pixel.
    ``straight``: both images of a frame without distortion."""

    intrinsics: CameraIntrinsics
    rays: FloatArray
    straight: StraightImages


class KeyframeImages:
    """The geometry of a camera's depth images, whatever their size.

    ``intrinsics``: of the colour images as stored, with their distortion.
    """

    def __init__(self, intrinsics: CameraIntrinsics) -> None:
        self._intrinsics = intrinsics
        self._geometries: dict[tuple[int, int], DepthGeometry] = {}

    def geometry(self, depth_m: Float32Array) -> DepthGeometry:
        """Of depth images of this size. Raises MappingFailed where the camera cannot have it."""
        shape = depth_m.shape
        if shape not in self._geometries:
            intrinsics = depth_intrinsics(self._intrinsics, shape)
            v, u = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
            pixels = np.column_stack([u.ravel(), v.ravel()])
            self._geometries[shape] = DepthGeometry(
                intrinsics=intrinsics,
                rays=undistort_pixels(pixels, intrinsics).reshape(*shape, 2),
                straight=StraightImages(intrinsics),
            )
        return self._geometries[shape]


def colors_of_depth(frame: RgbdFrame) -> ByteArray:
    """(h, w, 3) the colour of each depth pixel; grey where the frame has no colours."""
    height, width = frame.depth_m.shape
    image = frame.gray if frame.rgb is None else frame.rgb
    if image.shape[:2] != (height, width):
        smaller = width < image.shape[1]
        method = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
        image = np.asarray(cv2.resize(image, (width, height), interpolation=method), dtype=np.uint8)
    if image.ndim == 2:
        image = image[:, :, np.newaxis].repeat(3, axis=2)
    return image
