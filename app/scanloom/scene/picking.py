"""What a person points at in the scene: the beam that a click's ray hits, and those in a box."""

import numpy as np

from fusion_core.model.conventions import Float32Array, FloatArray, IntArray
from fusion_core.model.geometry import invert_transform, transform_points

# A click this far beside a point still means it.
_CLICK_RAD = np.deg2rad(1.0)


def points_in_box(
    points_m: Float32Array,
    T_world_camera: FloatArray,
    fov_rad: float,
    aspect: float,
    box: tuple[float, float, float, float],
) -> IntArray:
    """Indices of the points, (N, 3), that a camera sees within a box of its picture.

    ``T_world_camera``: (4, 4), of the optical frame; ``fov_rad``: vertical; ``aspect``: width over
    height; ``box``: left, top, right, bottom, from 0 to 1.
    """
    x, y, z = transform_points(invert_transform(T_world_camera), points_m.astype(np.float64)).T
    half = np.tan(0.5 * fov_rad)
    # Behind the camera nothing is seen.
    depth = np.where(z > 0.0, z, np.nan)
    u = 0.5 + 0.5 * x / (depth * half * aspect)
    v = 0.5 + 0.5 * y / (depth * half)
    left, top, right, bottom = box
    inside: IntArray = np.flatnonzero((u >= left) & (u <= right) & (v >= top) & (v <= bottom))
    return inside


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
