"""Ray casting of clicks: the pixel of an image plane, or the beam, that a ray hits."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import Float32Array, FloatArray
from fusion_core.model.geometry import rotation_from_quaternion

# A click this far beside a point still means it.
_CLICK_RAD = np.deg2rad(1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """A rectangle in space that shows a picture of ``width_px`` x ``height_px``.

    ``wxyz``, ``position_m``: the pose of its middle; its own axes are those of an image, x right,
    y down, z away from who looks at it.
    """

    width_m: float
    width_px: int
    height_px: int
    wxyz: tuple[float, float, float, float]
    position_m: tuple[float, float, float]

    @property
    def height_m(self) -> float:
        """Pixels are square."""
        return self.width_m * self.height_px / self.width_px

    @property
    def R_lidar_plane(self) -> FloatArray:
        """(3, 3)"""
        w, x, y, z = self.wxyz
        return rotation_from_quaternion(x, y, z, w)

    def hit(
        self, ray_origin_m: FloatArray, ray_direction: FloatArray
    ) -> tuple[float, float, float]:
        """(x_px, y_px, distance in lengths of ``ray_direction``) of where a ray meets the plane.

        Pixel centres are integers. All NaN where the ray does not lead to the rectangle.
        """
        R = self.R_lidar_plane
        origin = R.T @ (np.asarray(ray_origin_m) - np.asarray(self.position_m))
        direction = R.T @ np.asarray(ray_direction)
        nowhere = (float("nan"),) * 3
        if abs(direction[2]) < 1e-9 * float(np.linalg.norm(direction)):
            return nowhere
        distance = -float(origin[2] / direction[2])
        px_per_m = self.width_px / self.width_m
        x_px = float(origin[0] + distance * direction[0]) * px_per_m + 0.5 * (self.width_px - 1)
        y_px = float(origin[1] + distance * direction[1]) * px_per_m + 0.5 * (self.height_px - 1)
        inside = -0.5 <= x_px < self.width_px - 0.5 and -0.5 <= y_px < self.height_px - 0.5
        return (x_px, y_px, distance) if inside and distance > 0.0 else nowhere

    def pixel_at(
        self, ray_origin_m: FloatArray, ray_direction: FloatArray
    ) -> tuple[float, float] | None:
        """(x_px, y_px) that a ray hits, from either side; None where it misses."""
        x_px, y_px, distance = self.hit(ray_origin_m, ray_direction)
        return None if np.isnan(distance) else (x_px, y_px)

    def at_pixel(self, x_px: float, y_px: float) -> FloatArray:
        """(3,) the position of a pixel."""
        m_per_px = self.width_m / self.width_px
        in_plane = np.array(
            [
                (x_px - 0.5 * (self.width_px - 1)) * m_per_px,
                (y_px - 0.5 * (self.height_px - 1)) * m_per_px,
                0.0,
            ]
        )
        point_m: FloatArray = self.R_lidar_plane @ in_plane + np.array(self.position_m)
        return point_m


def nearest_beam(
    beams_m: Float32Array,
    ray_origin_m: FloatArray,
    ray_direction: FloatArray,
    within_rad: float = float(_CLICK_RAD),
) -> int | None:
    """Index of the beam whose point lies nearest to a ray, as seen from its origin; None where all
    lie farther beside it than ``within_rad``. ``beams_m``: (B, 3), NaN where there is no point."""
    if not len(beams_m):
        return None
    away = beams_m.astype(np.float64) - np.asarray(ray_origin_m)
    direction = np.asarray(ray_direction, dtype=np.float64)
    beside = np.linalg.norm(np.cross(away, direction), axis=1)
    angle_rad = np.arctan2(beside, away @ direction)
    angle_rad = np.where(np.isfinite(angle_rad), angle_rad, np.inf)
    best = int(np.argmin(angle_rad))
    return best if angle_rad[best] <= within_rad else None
