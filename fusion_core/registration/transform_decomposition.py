"""Decomposition of a planar transform A into rotation, scale, shear, translation, perspective."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.registration.models import apply_transform, point_jacobian


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransformDecomposition:
    """The parameters of a transform at one point.

    For an affine transform they hold everywhere, for a homography to first order about the point.

    ``rotation_rad``: of the nearest rotation, counter-clockwise seen from above. ``scale``: square
    root of the area ratio |det|. ``scale_x``, ``scale_z``: length ratios along the two axes;
    ``scale_min``, ``scale_max``: the singular values. ``shear_rad``: a right angle minus the angle
    between the images of the axes. ``translation_m``: (2,) image of the origin.
    ``displacement_m``: (2,) image of the point minus the point. ``perspective_per_m``: (2,)
    relative growth of w' per metre along x and z, which shrinks the image by about as much.
    """

    rotation_rad: float
    scale: float
    scale_x: float
    scale_z: float
    scale_min: float
    scale_max: float
    shear_rad: float
    translation_m: FloatArray
    displacement_m: FloatArray
    perspective_per_m: FloatArray
    is_mirrored: bool

    def __post_init__(self) -> None:
        for array in (self.translation_m, self.displacement_m, self.perspective_per_m):
            read_only(array)


def decompose_transform(A: FloatArray, at_m: FloatArray) -> TransformDecomposition:
    """Decompose A (3, 3), row vectors in metres, at a point (2,) that has an image."""
    point = at_m[np.newaxis]
    image_m = apply_transform(A, point)[0]
    linear = point_jacobian(A, point)[0]
    of_x, of_z = linear
    scale_x, scale_z = float(np.hypot(*of_x)), float(np.hypot(*of_z))
    determinant = float(np.linalg.det(linear))
    greatest, least = np.linalg.svd(linear, compute_uv=False)
    w = float(at_m @ A[:2, 2] + A[2, 2])
    return TransformDecomposition(
        rotation_rad=float(np.arctan2(of_x[1] - of_z[0], of_x[0] + of_z[1])),
        scale=float(np.sqrt(abs(determinant))),
        scale_x=scale_x,
        scale_z=scale_z,
        scale_min=float(least),
        scale_max=float(greatest),
        shear_rad=float(np.arcsin(np.clip(of_x @ of_z / (scale_x * scale_z), -1.0, 1.0))),
        translation_m=image_m - at_m @ linear,
        displacement_m=image_m - at_m,
        perspective_per_m=A[:2, 2] / w,
        is_mirrored=determinant < 0.0,
    )
