"""The virtual camera that a cloud's intensity image is seen by (Song 2022 §2.2.1, Fig. 5)."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fusion_core.compiled import compiled
from fusion_core.model.conventions import R_BODY_OPTICAL, FloatArray, IntArray, read_only
from fusion_core.model.geometry import make_transform, transform_points

# Nearer points stand on the sensor's own housing, and project anywhere.
_NEAREST_M = 0.05


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VirtualCamera:
    """A pinhole camera without distortion; pixel centres are integers.

    ``T_view_lidar``: (4, 4) LiDAR points to its optical frame. ``focal_px``: of its own pixels.
    """

    T_view_lidar: FloatArray
    focal_px: float
    width: int
    height: int
    cx: float
    cy: float

    def __post_init__(self) -> None:
        read_only(self.T_view_lidar)

    def project(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 2) pixels and (N,) depths of (N, 3) points of the LiDAR; NaN behind the camera."""
        seen = transform_points(self.T_view_lidar, points_m)
        depth_m = np.where(seen[:, 2] > _NEAREST_M, seen[:, 2], np.nan)
        pixels = self.focal_px * seen[:, :2] / depth_m[:, np.newaxis] + (self.cx, self.cy)
        return pixels, depth_m

    def see(self, points_m: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """(K,) which of (N, 3) points of the LiDAR fall into the picture, their (K, 2) pixels and
        (K,) depths: of a whole turn they are few."""
        seen: tuple[IntArray, FloatArray, FloatArray] = _see(
            points_m,
            self.T_view_lidar,
            self.focal_px,
            (self.cx, self.cy),
            (self.width, self.height),
        )
        return seen

    def rays(self, pixels: FloatArray) -> FloatArray:
        """(N, 3) directions with z = 1, in the virtual camera's frame, of (N, 2) pixels."""
        plane = (pixels - (self.cx, self.cy)) / self.focal_px
        return np.concatenate([plane, np.ones((len(plane), 1))], axis=1)

    def with_pixel_size(self, pixel_size: float) -> "VirtualCamera":
        """The same field of view in pixels that are ``pixel_size`` times as wide.

        (9) and (10), 0-based: L = round((u'_max - u'_min) / dx); the paper names height and width
        the other way round there than in (11) and (12).
        """
        return VirtualCamera(
            T_view_lidar=self.T_view_lidar,
            focal_px=self.focal_px / pixel_size,
            width=max(1, round(self.width / pixel_size)),
            height=max(1, round(self.height / pixel_size)),
            # The image's edge, half a pixel before the first centre, stays where it is.
            cx=(self.cx + 0.5) / pixel_size - 0.5,
            cy=(self.cy + 0.5) / pixel_size - 0.5,
        )


@compiled(nogil=True)
def _see(
    points_m: FloatArray,
    T: FloatArray,
    focal_px: float,
    centre_px: tuple[float, float],
    size: tuple[int, int],
) -> tuple[IntArray, FloatArray, FloatArray]:
    """As ``VirtualCamera.see``."""
    index = np.empty(points_m.shape[0], dtype=np.int64)
    pixels, depths = np.empty((points_m.shape[0], 2)), np.empty(points_m.shape[0])
    count = 0
    for n in range(points_m.shape[0]):
        x, y, z = points_m[n]
        depth = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        if not depth > _NEAREST_M:
            continue
        u = focal_px * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / depth + centre_px[0]
        v = focal_px * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / depth + centre_px[1]
        if -0.5 <= u < size[0] - 0.5 and -0.5 <= v < size[1] - 0.5:
            index[count], depths[count] = n, depth
            pixels[count, 0], pixels[count, 1] = u, v
            count += 1
    return index[:count].copy(), pixels[:count].copy(), depths[:count].copy()


def camera_towards(
    direction: FloatArray, *, focal_px: float, width: int, height: int
) -> VirtualCamera:
    """A virtual camera at the LiDAR's origin that looks along a (3,) direction, z of the LiDAR up
    in its image as far as the direction allows."""
    azimuth = float(np.arctan2(direction[1], direction[0]))
    elevation = float(np.arctan2(direction[2], np.hypot(direction[0], direction[1])))
    body = Rotation.from_euler("ZY", [azimuth, -elevation]).as_matrix()
    return VirtualCamera(
        T_view_lidar=make_transform((body @ R_BODY_OPTICAL).T, np.zeros(3)),
        focal_px=focal_px,
        width=width,
        height=height,
        cx=(width - 1) / 2,
        cy=(height - 1) / 2,
    )


def cloud_directions(points_m: FloatArray, field_of_view_rad: float) -> Iterator[FloatArray]:
    """Directions in which virtual cameras look so that together they see the cloud.

    First the paper's, to the cloud's centre (the mean direction of its points), where they have
    one; then, for a cloud that is wider than one field of view, rows of directions over the sphere,
    half a field of view apart, those with points alone.
    """
    rays = points_m / np.linalg.norm(points_m, axis=1, keepdims=True)
    mean = rays.mean(axis=0)
    length = float(np.linalg.norm(mean))
    half = 0.5 * field_of_view_rad
    if length > 0.0:
        centre = mean / length
        if np.quantile(rays @ centre, 0.02) > np.cos(half):
            yield centre
            return
    occupied_min = 0.002 * len(rays)
    # The horizon first, where most cameras look.
    steps = max(0, int(np.ceil((0.5 * np.pi - half) / half)))
    for step in sorted(range(-steps, steps + 1), key=lambda k: (abs(k), -k)):
        elevation = step * half
        around = max(1, round(2.0 * np.pi * np.cos(elevation) / half))
        for azimuth in 2.0 * np.pi * np.arange(around) / around:
            direction = np.array(
                [
                    np.cos(elevation) * np.cos(azimuth),
                    np.cos(elevation) * np.sin(azimuth),
                    np.sin(elevation),
                ]
            )
            if np.count_nonzero(rays @ direction > np.cos(0.5 * half)) >= occupied_min:
                yield direction
