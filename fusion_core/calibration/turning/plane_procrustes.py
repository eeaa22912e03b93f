"""Song 2022, (2) to (7): the rotation and shift between the two views of planes, half a turn apart.

Misprints, read as follows: (2) maps right to left, (5) and (7) left to right: here left to right.
(3) needs N_Rᵀ, (4) has one N_L too many. φ = V Uᵀ of (6) is corrected to det = +1, else it may be
a reflection.
"""

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fusion_core.calibration.turning.half_turn_planes import PlanePair
from fusion_core.model.conventions import FloatArray
from fusion_core.model.robust import robust_sigma

_DISAGREE_SIGMAS = 4.0
_DISAGREE_MIN_M = 1e-3
_PAIRS_MIN = 3


def procrustes_rotation(normals_left: FloatArray, normals_right: FloatArray) -> FloatArray:
    """(3, 3) φ of (6): the proper rotation with the greatest Σ N_R · φ N_L, for (P, 3) normals."""
    u, _, vt = np.linalg.svd(normals_left.T @ normals_right)
    proper = np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)])
    rotation: FloatArray = vt.T @ proper @ u.T
    return rotation


def plane_offset(
    normals_right: FloatArray, offsets_left_m: FloatArray, offsets_right_m: FloatArray
) -> FloatArray:
    """(3,) Δ of (4), x_right = φ x_left + Δ: least squares of N_R · Δ = α_R - α_L, (P,) each.

    What no plane's normal shows stays 0 (the least norm).
    """
    solution, *_ = np.linalg.lstsq(normals_right, offsets_right_m - offsets_left_m, rcond=1e-6)
    return np.asarray(solution, dtype=np.float64)


def refine_pose(
    rotation: FloatArray, offset_m: FloatArray, pairs: tuple[PlanePair, ...]
) -> tuple[FloatArray, FloatArray]:
    """φ and Δ that minimise (7) by Levenberg-Marquardt, each plane with the weight 1/m(i)."""
    normals = [pair.normal_right for pair in pairs]
    weights = [1.0 / np.sqrt(len(pair.points_left_m)) for pair in pairs]

    def residuals(change: FloatArray) -> FloatArray:
        turned = Rotation.from_rotvec(change[:3]).as_matrix() @ rotation
        parts = [
            weight
            * (
                pair.points_left_m @ (turned.T @ normal)
                + normal @ (offset_m + change[3:])
                - pair.offset_right_m
            )
            for pair, normal, weight in zip(pairs, normals, weights, strict=True)
        ]
        return np.concatenate(parts)

    solution = least_squares(residuals, np.zeros(6), method="lm")
    change = solution.x
    return (
        Rotation.from_rotvec(change[:3]).as_matrix() @ rotation,
        offset_m + change[3:],
    )


def half_turn_pose(
    pairs: tuple[PlanePair, ...],
) -> tuple[FloatArray, FloatArray, tuple[PlanePair, ...]]:
    """φ and Δ by (6), (4) and (7), and the pairs that agree with them.

    A front of a cupboard is easily taken for the wall behind it: a pair whose distances disagree
    with those of most others is left out, until none is.
    """
    while True:
        normals_right = np.stack([pair.normal_right for pair in pairs])
        offsets_left = np.array([pair.offset_left_m for pair in pairs])
        offsets_right = np.array([pair.offset_right_m for pair in pairs])
        rotation = procrustes_rotation(
            np.stack([pair.normal_left for pair in pairs]), normals_right
        )
        offset_m = plane_offset(normals_right, offsets_left, offsets_right)
        rotation, offset_m = refine_pose(rotation, offset_m, pairs)
        # Of the middle of what was seen: far from it small angles move the plane.
        middles = np.stack([pair.points_left_m.mean(axis=0) for pair in pairs])
        apart_m = (
            np.einsum("pi,pi->p", normals_right, middles @ rotation.T + offset_m) - offsets_right
        )
        agrees = np.abs(apart_m) <= max(_DISAGREE_SIGMAS * robust_sigma(apart_m), _DISAGREE_MIN_M)
        if agrees.all() or agrees.sum() < _PAIRS_MIN:
            return rotation, offset_m, pairs
        pairs = tuple(pair for pair, kept in zip(pairs, agrees, strict=True) if kept)


def mounting_from_half_turn(
    rotation: FloatArray, offset_m: FloatArray, lidar_in_axis_m: FloatArray
) -> tuple[FloatArray, float]:
    """(4,) θ, β, Δx, Δy of φ and Δ, and the angle about the axis in φ, which no mounting explains.

    With E = Rx(θ) Ry(β), S half a turn about z and t = (Δx, Δy, 0), a point seen twice has
    E x_L + t = S (E S x_R + t), hence x_R = φ x_L + Δ with φ = Ry(β) Rx(2θ) Ry(β) and
    Δ = 2 Ry(β) Rx(θ) t: twice the mounting error, as Song says below (1).

    ``lidar_in_axis_m``: (3,) where the LiDAR is by design. It tilts about itself: off the axis
    that moves the points by (1 - E) of this, which is no part of Δx, Δy.
    """
    theta, beta = 0.0, 0.0
    # φ32 - φ23 = 2 cos β sin 2θ and φ13 - φ31 = sin 2β (1 + cos 2θ): the fixed point is reached to
    # rounding in a few steps, as cos β and cos 2θ hardly differ from 1.
    for _ in range(20):
        sin_2theta = 0.5 * (rotation[2, 1] - rotation[1, 2]) / np.cos(beta)
        theta = 0.5 * float(np.arcsin(np.clip(sin_2theta, -1.0, 1.0)))
        sin_2beta = (rotation[0, 2] - rotation[2, 0]) / (1.0 + np.cos(2.0 * theta))
        beta = 0.5 * float(np.arcsin(np.clip(sin_2beta, -1.0, 1.0)))
    back = Rotation.from_euler("YX", [beta, theta]).as_matrix().T
    tilted = Rotation.from_euler("XY", [theta, beta]).as_matrix() @ lidar_in_axis_m
    shift_m = 0.5 * back @ offset_m - (lidar_in_axis_m - tilted)
    about_axis_rad = 0.5 * float(rotation[1, 0] - rotation[0, 1])
    return np.array([theta, beta, shift_m[0], shift_m[1]]), about_axis_rad
