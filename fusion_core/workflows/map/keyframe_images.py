"""An RGB-D camera's pixels for maps in space: their rays, their colours, and both images as a lens
without distortion would show them."""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.calibration.projection import project_points
from fusion_core.calibration.undistortion import undistort_pixels
from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray
from fusion_core.model.errors import MappingFailed
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.workflows.map.rgbd_frames import scaled_intrinsics


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthGeometry:
    """Of depth images of one size. ``rays``: (h, w, 2) x / z and y / z of each pixel.

    ``source_u``, ``source_v``: (h, w) float32 the stored pixel under each pixel of the image
    without distortion; None where the lens has none.
    """

    intrinsics: CameraIntrinsics
    rays: FloatArray
    source_u: Float32Array | None = None
    source_v: Float32Array | None = None

    def without_distortion(
        self, depth_m: Float32Array, rgb: ByteArray
    ) -> tuple[Float32Array, ByteArray]:
        """Both images, (h, w) and (h, w, 3); NaN and black where the lens shows nothing."""
        if self.source_u is None or self.source_v is None:
            return depth_m, rgb
        # A depth between two surfaces would be neither: the nearest pixel.
        straight_m = cv2.remap(
            depth_m,
            self.source_u,
            self.source_v,
            cv2.INTER_NEAREST,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        )
        straight = cv2.remap(
            rgb, self.source_u, self.source_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT
        )
        return np.asarray(straight_m, dtype=np.float32), np.asarray(straight, dtype=np.uint8)


class KeyframeImages:
    """The geometry of a camera's depth images, whatever their size.

    ``intrinsics``: of the colour images as stored, with their distortion.
    """

    def __init__(self, intrinsics: CameraIntrinsics) -> None:
        self._intrinsics = intrinsics
        self._geometries: dict[tuple[int, int], DepthGeometry] = {}

    def geometry(self, depth_m: Float32Array) -> DepthGeometry:
        """Of depth images of this size. Raises MappingFailed where the camera cannot have it."""
        height, width = depth_m.shape
        if (height, width) not in self._geometries:
            try:
                intrinsics = scaled_intrinsics(self._intrinsics, (height, width))
            except ValueError as error:
                raise MappingFailed(
                    f"a depth image of {width} x {height} pixels is not of a camera with images of "
                    f"{self._intrinsics.width} x {self._intrinsics.height}: {error}."
                ) from error
            self._geometries[height, width] = _depth_geometry(intrinsics)
        return self._geometries[height, width]


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


def _depth_geometry(intrinsics: CameraIntrinsics) -> DepthGeometry:
    height, width = intrinsics.height, intrinsics.width
    v, u = np.mgrid[:height, :width].astype(np.float64)
    pixels = np.column_stack([u.ravel(), v.ravel()])
    rays = undistort_pixels(pixels, intrinsics).reshape(height, width, 2)
    source_u, source_v = None, None
    if any(intrinsics.distortion) or intrinsics.is_fisheye:
        x = (pixels[:, 0] - intrinsics.cx) / intrinsics.fx
        y = (pixels[:, 1] - intrinsics.cy) / intrinsics.fy
        stored = project_points(np.column_stack([x, y, np.ones(len(x))]), intrinsics)
        # Outside the image: nothing is there.
        stored[np.isnan(stored)] = -2.0 * max(width, height)
        source_u, source_v = stored.T.reshape(2, height, width).astype(np.float32)
    return DepthGeometry(intrinsics=intrinsics, rays=rays, source_u=source_u, source_v=source_v)
