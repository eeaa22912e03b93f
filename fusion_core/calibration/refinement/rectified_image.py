"""An image as a pinhole without distortion would have taken it, at the resolution that is needed.

Costs project the same points some thousand times; without distortion that is a division.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.lens.projection import inside_image, project_points
from fusion_core.model.conventions import BoolArray, ByteArray, Float32Array, FloatArray, read_only
from fusion_core.model.sensors import CameraIntrinsics


@dataclass(frozen=True, slots=True, kw_only=True)
class RectifiedImage:
    """``grey``: (h, w) float32. ``known``: (h, w) where the given image has it. ``pinhole``: fx,
    fy, cx, cy in its pixels."""

    grey: Float32Array
    known: BoolArray
    pinhole: tuple[float, float, float, float]

    def __post_init__(self) -> None:
        read_only(self.grey)
        read_only(self.known)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        return self.grey.shape[1], self.grey.shape[0]

    def project(self, points_in_camera_m: FloatArray) -> FloatArray:
        """(N, 2) pixels of (N, 3) points, NaN where they are not ahead."""
        fx, fy, cx, cy = self.pinhole
        depth = points_in_camera_m[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = np.where(depth > 0.0, 1.0 / depth, np.nan)
        u = fx * points_in_camera_m[:, 0] * inverse + cx
        v = fy * points_in_camera_m[:, 1] * inverse + cy
        return np.stack([u, v], axis=1)

    def inside(self, pixels: FloatArray, margin: float = 0.0) -> BoolArray:
        """(N,) whether pixels lie in the image, widened by a ``margin`` of its width."""
        width, height = self.size_px
        more = margin * width
        u, v = pixels[:, 0], pixels[:, 1]
        found: BoolArray = (u >= -more) & (u < width + more) & (v >= -more) & (v < height + more)
        return found


def rectify_image(
    grey: ByteArray | Float32Array, intrinsics: CameraIntrinsics, scale: float
) -> RectifiedImage:
    """The image at ``scale`` (<= 1) times its resolution, with the same focal length beside that.

    A fisheye's is cut where a pinhole of its focal length and size ends.
    """
    width = max(2, round(intrinsics.width * scale))
    height = max(2, round(intrinsics.height * scale))
    x, y = width / intrinsics.width, height / intrinsics.height
    # The edge of the image, half a pixel before the first one's centre, stays the edge.
    pinhole = (
        intrinsics.fx * x,
        intrinsics.fy * y,
        (intrinsics.cx + 0.5) * x - 0.5,
        (intrinsics.cy + 0.5) * y - 0.5,
    )
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([(u - pinhole[2]) / pinhole[0], (v - pinhole[3]) / pinhole[1]], axis=-1)
    rays = np.concatenate([rays.reshape(-1, 2), np.ones((width * height, 1))], axis=1)
    pixels = project_points(rays, intrinsics)
    known = inside_image(pixels, intrinsics)
    # Averages over what becomes one pixel, before every few pixels are picked.
    source = np.asarray(grey, dtype=np.float32)
    shrink = max(x, y)
    if shrink < 1.0:
        source = np.asarray(cv2.GaussianBlur(source, (0, 0), 0.5 / shrink), dtype=np.float32)
    maps = np.where(known[:, np.newaxis], pixels, -1.0).astype(np.float32)
    maps = maps.reshape(height, width, 2)
    picked = cv2.remap(
        source,
        np.ascontiguousarray(maps[..., 0]),
        np.ascontiguousarray(maps[..., 1]),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return RectifiedImage(
        grey=np.asarray(picked, dtype=np.float32),
        known=known.reshape(height, width),
        pinhole=pinhole,
    )
