"""What a map A of the plane does, in numbers that a person can picture."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.registration.models import map_points, point_jacobian


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapMeaning:
    """A map near one point: exact everywhere for an affine map, to first order for a homography.

    ``rotation_rad``: of the rotation nearest to it, positive to the left as seen from above.
    ``scale``: square root of the factor of areas; ``scale_x``, ``scale_z``: factors of lengths
    along the two axes; ``least_scale``, ``greatest_scale``: along any direction. ``shear_rad``: how
    much less than a right angle is between the images of the axes. ``shift_m``: (2,) image of the
    origin. ``moved_m``: (2,) how far the point itself moves. ``tilt_per_m``: (2,) share by which
    w' grows per metre to the right and ahead: what lies there is drawn smaller by about as much.
    """

    rotation_rad: float
    scale: float
    scale_x: float
    scale_z: float
    least_scale: float
    greatest_scale: float
    shear_rad: float
    shift_m: FloatArray
    moved_m: FloatArray
    tilt_per_m: FloatArray
    mirrors: bool

    def __post_init__(self) -> None:
        for array in (self.shift_m, self.moved_m, self.tilt_per_m):
            read_only(array)


def meaning_of(A: FloatArray, at_m: FloatArray) -> MapMeaning:
    """The meaning of A (3, 3), row vectors in metres, at a point (2,) that has an image."""
    point = at_m[np.newaxis]
    image_m = map_points(A, point)[0]
    linear = point_jacobian(A, point)[0]
    of_x, of_z = linear
    scale_x, scale_z = float(np.hypot(*of_x)), float(np.hypot(*of_z))
    determinant = float(np.linalg.det(linear))
    greatest, least = np.linalg.svd(linear, compute_uv=False)
    w = float(at_m @ A[:2, 2] + A[2, 2])
    return MapMeaning(
        rotation_rad=float(np.arctan2(of_x[1] - of_z[0], of_x[0] + of_z[1])),
        scale=float(np.sqrt(abs(determinant))),
        scale_x=scale_x,
        scale_z=scale_z,
        least_scale=float(least),
        greatest_scale=float(greatest),
        shear_rad=float(np.arcsin(np.clip(of_x @ of_z / (scale_x * scale_z), -1.0, 1.0))),
        shift_m=image_m - at_m @ linear,
        moved_m=image_m - at_m,
        tilt_per_m=A[:2, 2] / w,
        mirrors=determinant < 0.0,
    )
