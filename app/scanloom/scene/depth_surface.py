"""A depth image as points in space, and their colours."""

from dataclasses import dataclass, fields

import cv2
import numpy as np

from fusion_core.model.conventions import (
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import ColorImage, DepthImage
from scanloom.plots.palette import color_map

# What a browser draws on a processor alone beside everything else, 15 times a second.
_MAX_POINTS = 20_000
# Squares overlap a little, or a slanted surface shows stripes.
_OVERLAP = 1.8
# Of the points, so many have a footprint that is at most as large as the squares.
_FOOTPRINT_PERCENT = 70.0
# Sizes are steps of this ratio, so that they seldom change from frame to frame.
_SIZE_STEP = 1.15
# Shapes of a colour and a depth image that show the same view differ by less (a row or two).
_ASPECT_TOLERANCE = 0.02
# A few of the points' steps: beyond that a pixel has no depth.
_NEAR_PLACE = 0.02
# Share of a point's own colour under marks whose colours must not be mistaken.
_MUTED_SHARE = 0.22


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthSurface:
    """(N, 3) points of a depth image in the LiDAR's frame, with their (N,) depths along the optical
    axis and places in the image, each from 0 to 1. ``point_m``: the side of the square that a point
    stands for."""

    points_m: Float32Array
    depth_m: Float32Array
    down: Float32Array
    right: Float32Array
    point_m: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                read_only(value)


NO_SURFACE = DepthSurface(
    points_m=np.empty((0, 3), dtype=np.float32),
    depth_m=np.empty(0, dtype=np.float32),
    down=np.empty(0, dtype=np.float32),
    right=np.empty(0, dtype=np.float32),
    point_m=0.01,
)


def depth_surface(
    depth_m: Float32Array, camera: Camera, T_lidar_camera: FloatArray
) -> DepthSurface:
    """Every k-th pixel of every k-th row of an upright (H, W) depth image, about 20,000 at most."""
    height, width = depth_m.shape
    step = max(1, int(np.ceil(np.sqrt(height * width / _MAX_POINTS))))
    rows = np.arange(step // 2, height, step)
    columns = np.arange(step // 2, width, step)
    depth = depth_m[step // 2 :: step, step // 2 :: step].astype(np.float32)
    down_place, right_place = np.nonzero(np.isfinite(depth))
    depth = depth[down_place, right_place]
    intrinsics = camera.intrinsics
    x = ((columns - intrinsics.cx) / intrinsics.fx).astype(np.float32)[right_place]
    y = ((rows - intrinsics.cy) / intrinsics.fy).astype(np.float32)[down_place]
    T = T_lidar_camera.astype(np.float32)
    points = np.empty((depth.size, 3), dtype=np.float32)
    for axis in range(3):
        points[:, axis] = depth * (T[axis, 0] * x + T[axis, 1] * y + T[axis, 2]) + T[axis, 3]
    return DepthSurface(
        points_m=points,
        depth_m=depth,
        down=((rows + 0.5) / height).astype(np.float32)[down_place],
        right=((columns + 0.5) / width).astype(np.float32)[right_place],
        point_m=_point_size_m(depth, step / intrinsics.fx),
    )


def point_at(surface: DepthSurface, place: tuple[float, float]) -> Float32Array | None:
    """(3,) the point nearest to a place in the image (down and right, each from 0 to 1), None where
    the surface has none near it."""
    if not surface.depth_m.size:
        return None
    away = np.hypot(surface.down - place[0], surface.right - place[1])
    nearest = int(np.argmin(away))
    point: Float32Array = surface.points_m[nearest]
    return point if away[nearest] < _NEAR_PLACE else None


def _point_size_m(depth_m: Float32Array, width_per_depth: float) -> float:
    """The footprint of most points, rounded to a step of sizes."""
    if not depth_m.size:
        return 0.01
    size_m = _OVERLAP * width_per_depth * float(np.percentile(depth_m, _FOOTPRINT_PERCENT))
    return float(_SIZE_STEP ** np.round(np.log(max(size_m, 1e-3)) / np.log(_SIZE_STEP)))


def is_registered(color: ColorImage, depth: DepthImage) -> bool:
    """Whether a colour image shows the depth image's view: by its frame and its shape."""
    height, width = color.rgb.shape[:2]
    aspect = width / height * depth.depth_m.shape[0] / depth.depth_m.shape[1]
    return color.frame_id == depth.frame_id and abs(aspect - 1.0) < _ASPECT_TOLERANCE


def colors_by_image(surface: DepthSurface, upright_rgb: ByteArray) -> ByteArray:
    """(N, 3) colours of the points from an upright (H, W, 3) image of the same view."""
    height, width = upright_rgb.shape[:2]
    rows: IntArray = (surface.down * height).astype(np.int64)
    columns: IntArray = (surface.right * width).astype(np.int64)
    return np.asarray(upright_rgb[rows, columns])


def colors_by_depth(surface: DepthSurface, near_m: float, far_m: float) -> ByteArray:
    """(N, 3) colours of the points, dark at ``near_m`` and bright at ``far_m``."""
    fraction = (surface.depth_m - near_m) / max(far_m - near_m, 1e-3)
    return np.asarray(color_map("cividis")[(255.0 * np.clip(fraction, 0.0, 1.0)).astype(np.uint8)])


def muted(colors: ByteArray, brightness: tuple[float, float]) -> ByteArray:
    """(N, 3) colours, nearly grey and between two brightnesses (0 to 255), so that marks of any
    colour stand out."""
    if not len(colors):
        return colors
    grey = cv2.cvtColor(colors[np.newaxis], cv2.COLOR_RGB2GRAY)[0, :, np.newaxis]
    low, high = brightness
    lifted = low + (high - low) / 255.0 * grey.astype(np.float32)
    own = colors.astype(np.float32) - grey
    return np.clip(lifted + _MUTED_SHARE * own, 0.0, 255.0).astype(np.uint8)
