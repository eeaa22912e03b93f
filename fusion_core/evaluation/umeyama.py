"""The rigid motion or similarity that aligns positions with others by least squares.

Umeyama 1991, "Least-squares estimation of transformation parameters between two point patterns",
eqs. (34)-(42).
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.model.errors import ScanLoomError

Group = Literal["se2", "se3", "sim3"]

# Ratio of the spread across a path to that along it (as variances) below which it is a line:
# the rotation about it would be determined by rounding errors.
_COLLINEAR_RATIO_MAX = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Similarity:
    """``p_a = scale * rotation @ p_b + translation_m``; a rigid motion where the scale is 1.

    ``rotation``: (3, 3). ``translation_m``: (3,).
    """

    rotation: FloatArray
    translation_m: FloatArray
    scale: float

    def __post_init__(self) -> None:
        read_only(self.rotation)
        read_only(self.translation_m)

    def apply(self, T_b_body: FloatArray) -> FloatArray:
        """(N, 4, 4) T_a_body; the scale applies to the positions only."""
        result = T_b_body.copy()
        result[:, :3, :3] = self.rotation @ T_b_body[:, :3, :3]
        result[:, :3, 3] = self.scale * T_b_body[:, :3, 3] @ self.rotation.T + self.translation_m
        return result

    def to_json(self) -> dict[str, Any]:
        """Rotation matrix row by row, translation and scale."""
        return {
            "rotation": self.rotation.tolist(),
            "translation_m": self.translation_m.tolist(),
            "scale": self.scale,
        }


def align_positions(moving_m: FloatArray, fixed_m: FloatArray, group: Group) -> Similarity:
    """The similarity that moves (N, 3) ``moving_m`` onto (N, 3) ``fixed_m``, N >= 1.

    ``se2`` rotates about z and keeps the height. Raises ScanLoomError where the positions do not
    determine it: all at one point, or, in space, all on one line.
    """
    size = 2 if group == "se2" else 3
    moving, fixed = moving_m[:, :size], fixed_m[:, :size]
    moving_mean, fixed_mean = moving.mean(axis=0), fixed.mean(axis=0)
    moving_variance, fixed_variance = (points.var(axis=0).sum() for points in (moving, fixed))
    covariance = (fixed - fixed_mean).T @ (moving - moving_mean) / len(moving)
    u, singular, v_transposed = np.linalg.svd(covariance)
    if singular[size - 2] <= _COLLINEAR_RATIO_MAX * np.sqrt(moving_variance * fixed_variance):
        raise ScanLoomError(
            f"The positions do not determine an alignment by {group}: they lie on one "
            f"{'point' if size == 2 else 'line or point'}.",
            advice=f"Align by {'none' if size == 2 else 'se2 or none'}.",
        )
    # Without it the optimum may be a mirror image (eq. 39).
    signs = np.ones(size)
    signs[-1] = np.sign(np.linalg.det(u) * np.linalg.det(v_transposed))
    own_rotation = (u * signs) @ v_transposed
    scale = float(singular @ signs / moving_variance) if group == "sim3" else 1.0
    rotation, translation_m = np.eye(3), np.zeros(3)
    rotation[:size, :size] = own_rotation
    translation_m[:size] = fixed_mean - scale * own_rotation @ moving_mean
    return Similarity(rotation=rotation, translation_m=translation_m, scale=scale)
