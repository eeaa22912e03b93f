"""Relative poses of keyframes, as dense alignment measures them, in a bundle adjustment.

The residual of one is the small motion from the measured T_second_first to the poses'; a robust sum
over all joins that over the observations. A small motion acts on T_camera_map from the left.
"""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.slam.visual.observation_noise import CHI2_POSE
from fusion_core.slam.visual.pose_optimisation import multiply_transforms


@compiled(nogil=True)
def alignment_cost(
    poses: FloatArray, pairs: IntArray, T_second_first: FloatArray, information: FloatArray
) -> float:
    """Half the robust sum of A alignments. ``poses``: (K, 4, 4) T_camera_map. ``pairs``: (A, 2)
    rows of it, first and second, with ``T_second_first`` (A, 4, 4), ``information`` (A, 6, 6)."""
    total = 0.0
    for a in range(len(pairs)):
        r = _residual(poses[pairs[a, 0]], poses[pairs[a, 1]], T_second_first[a])
        chi2 = 0.0
        for i in range(6):
            for j in range(6):
                chi2 += r[i] * information[a, i, j] * r[j]
        total += 0.5 * chi2 if chi2 <= CHI2_POSE else np.sqrt(CHI2_POSE * chi2) - 0.5 * CHI2_POSE
    return total


@compiled(nogil=True)
def add_alignments(
    poses: FloatArray,
    free: IntArray,
    pairs: IntArray,
    T_second_first: FloatArray,
    information: FloatArray,
    S: FloatArray,
    b: FloatArray,
) -> None:
    """Add those alignments to the normal equations, ``S`` (6 F, 6 F) and ``b`` (6 F,).

    ``free``: (K,) the number of each keyframe among those that move, -1 for a fixed one. The
    residual moves by xi_second - Ad(T_second_first) xi_first.
    """
    J = np.zeros((6, 12))
    rows = np.empty(12, np.int64)
    for a in range(len(pairs)):
        first, second = pairs[a, 0], pairs[a, 1]
        r = _residual(poses[first], poses[second], T_second_first[a])
        T = multiply_transforms(poses[second], _inverted(poses[first]))
        J[:] = 0.0
        for i in range(6):
            J[i, 6 + i] = 1.0
            rows[i] = 6 * free[first] + i if free[first] >= 0 else -1
            rows[6 + i] = 6 * free[second] + i if free[second] >= 0 else -1
        for j in range(3):
            for i in range(3):
                J[i, j] = -T[i, j]
                J[3 + i, 3 + j] = -T[i, j]
            # Ad(T) = [R, 0; [t]x R, R], rotation first.
            J[3, j] = -(T[1, 3] * T[2, j] - T[2, 3] * T[1, j])
            J[4, j] = -(T[2, 3] * T[0, j] - T[0, 3] * T[2, j])
            J[5, j] = -(T[0, 3] * T[1, j] - T[1, 3] * T[0, j])
        weighted = information[a] @ J
        wr = information[a] @ r
        chi2 = 0.0
        for i in range(6):
            chi2 += r[i] * wr[i]
        weight = _weight(chi2)
        for m in range(12):
            if rows[m] < 0:
                continue
            for i in range(6):
                b[rows[m]] += weight * J[i, m] * wr[i]
                for n in range(12):
                    if rows[n] >= 0:
                        S[rows[m], rows[n]] += weight * J[i, m] * weighted[i, n]


@compiled(nogil=True)
def _residual(T_first: FloatArray, T_second: FloatArray, T: FloatArray) -> FloatArray:
    """(6,) the small motion from T, (4, 4) T_second_first, to what the poses say; to first order,
    as a motion that an alignment measures is small."""
    D = multiply_transforms(multiply_transforms(T_second, _inverted(T_first)), _inverted(T))
    r = np.empty(6)
    r[0] = 0.5 * (D[2, 1] - D[1, 2])
    r[1] = 0.5 * (D[0, 2] - D[2, 0])
    r[2] = 0.5 * (D[1, 0] - D[0, 1])
    r[3] = D[0, 3] - 0.5 * (r[1] * D[2, 3] - r[2] * D[1, 3])
    r[4] = D[1, 3] - 0.5 * (r[2] * D[0, 3] - r[0] * D[2, 3])
    r[5] = D[2, 3] - 0.5 * (r[0] * D[1, 3] - r[1] * D[0, 3])
    return r


@compiled(nogil=True)
def _weight(chi2: float) -> float:
    """Huber."""
    return 1.0 if chi2 <= CHI2_POSE else np.sqrt(CHI2_POSE / chi2)


@compiled(nogil=True)
def _inverted(T: FloatArray) -> FloatArray:
    """(4, 4) of a rigid motion."""
    inverse = np.eye(4)
    for i in range(3):
        for j in range(3):
            inverse[i, j] = T[j, i]
            inverse[i, 3] -= T[j, i] * T[j, 3]
    return inverse
