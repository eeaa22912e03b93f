"""Ray casting of clicks: the beam that a ray hits."""

import numpy as np

from fusion_core.model.conventions import Float32Array, FloatArray

# A click this far beside a point still means it.
_CLICK_RAD = np.deg2rad(1.0)


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
