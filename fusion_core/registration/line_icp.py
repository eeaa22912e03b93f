"""The iterations of PL-ICP (Censi 2008): pair, trim, take the closed-form step, until it is small.

Some directions of the pose are unobservable: the length of a corridor, the yaw in a round room.
Noise in the lines' normals adds spurious information there, by which the pose would drift. A
direction whose information does not clearly exceed the spurious one is left unchanged.
"""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.registration.line_pairs import (
    LinePairs,
    drop_duplicates,
    find_pairs,
    make_empty_pairs,
    trim_pairs,
)
from fusion_core.registration.local_lines import LocalLines, incidence_cos
from fusion_core.registration.point_to_line import add_point_line_pair, solve_point_to_line
from fusion_core.registration.polar_correspondence import PolarScan

# Coarse phase, set by hand: far from the optimum a quarter of the points gives as good a step as
# all.
_COARSE_STRIDE = 4
_COARSE_ITERATIONS = 10

# Convergence: squared Mahalanobis length of a step, set by hand. Single pairs at the trimming limit
# may alternate for ever, so late iterations stop at a third of a standard deviation.
_COARSE_STEP = 1.0
_FINE_STEP = 1e-3
_LATE_ITERATION = 12
_LATE_STEP = 0.1

# Twice the three unknowns: two points on each of three lines.
PAIRS_MIN = 6

# Ratio of information to spurious information below which a direction is unobservable: the noise
# of the normals is then a quarter of the estimate or more.
_SPURIOUS_FACTOR = 16.0
# Relative error of the smallest eigenvalue that float64 leaves after summing some 1e4 terms.
_ROUNDING_FRACTION = 1e-10


@compiled(error_model="numpy")
def iterate_pl_icp(
    reference: PolarScan,
    lines: LocalLines,
    moving: PolarScan,
    start: FloatArray,
    sigmas_m: tuple[float, float],
    distance_max_m: float,
    trim_sigmas: float,
    iterations_max: int,
) -> tuple[FloatArray, LinePairs, int, bool, float]:
    """Iterate from ``start``, the pose (3,) of the moving sweep in the reference's frame.

    ``sigmas_m``: of the ranges of the reference and of the moving sweep. Returns the pose, its
    pairs, the iterations, whether they converged, and the robust residual over the expected one.

    Duplicates are dropped in the coarse phase, where they are mostly wrong pairs. Near the optimum
    they come from a denser sweep, which the weights account for.
    """
    pose = start.copy()
    pairs = make_empty_pairs(moving.range_m.size)
    # Not the constant itself: what is called with it would be compiled for its value too.
    stride = int(_COARSE_STRIDE)
    limit, scale = np.inf, np.inf
    for iteration in range(1, iterations_max + 1):
        find_pairs(pairs, reference, lines, moving, pose, sigmas_m, distance_max_m, stride)
        if stride > 1:
            drop_duplicates(pairs, reference.range_m.size, stride)
        left, limit, scale = trim_pairs(pairs, trim_sigmas, limit, stride)
        if left < PAIRS_MIN:
            if stride == 1:
                return pose, pairs, iteration, False, scale
            stride = 1
            continue
        step, squared_length = _solve_step(
            pairs, reference, lines, moving, pose, sigmas_m[0], stride
        )
        has_converged = squared_length < (_FINE_STEP if iteration < _LATE_ITERATION else _LATE_STEP)
        if stride == 1 and has_converged and limit <= trim_sigmas * max(scale, 1.0):
            return pose, pairs, iteration, True, scale
        pose += step
        if squared_length < _COARSE_STEP or iteration >= _COARSE_ITERATIONS:
            stride = 1
    return pose, pairs, iterations_max, False, scale


@compiled(error_model="numpy")
def _solve_step(
    pairs: LinePairs,
    reference: PolarScan,
    lines: LocalLines,
    moving: PolarScan,
    pose: FloatArray,
    sigma_m: float,
    stride: int,
) -> tuple[FloatArray, float]:
    """The step (3,) of the pose, and its squared Mahalanobis length."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    normal_matrix, right_side, spurious = np.zeros((4, 4)), np.zeros(4), np.zeros((3, 3))
    for i in range(0, pairs.partner.size, stride):
        j = pairs.partner[i]
        if j < 0:
            continue
        x = moving.range_m[i] * (c * moving.cos[i] - s * moving.sin[i])
        y = moving.range_m[i] * (s * moving.cos[i] + c * moving.sin[i])
        normal_x, normal_y = lines.normal_x[j], lines.normal_y[j]
        weight = pairs.weight_per_m2[i]
        offset = normal_x * x + normal_y * y - pairs.residual_m[i]
        add_point_line_pair(normal_matrix, right_side, x, y, normal_x, normal_y, offset, weight)
        across = sigma_m * incidence_cos(reference, lines, j, j)
        add_spurious_information(
            spurious, x, y, normal_x, normal_y, weight * across**2 / lines.spread_m2[j]
        )

    m = normal_matrix
    information = np.array(
        [[m[0, 0], m[0, 1], m[0, 3]], [m[0, 1], m[1, 1], m[1, 3]], [m[0, 3], m[1, 3], m[3, 3]]]
    )
    # Root mean square distance of the points: what a rotation by one radian moves them by.
    lever_m = max(np.sqrt((m[2, 2] + m[3, 3]) / (m[0, 0] + m[1, 1])), 1e-6)
    strength, directions, is_unobservable = find_unobservable_directions(
        information, spurious, lever_m
    )
    if is_unobservable.any():
        # Half the derivative of the sum of squares at zero motion, u = (1, 0).
        gradient = (
            m[0, 2] - right_side[0],
            m[1, 2] - right_side[1],
            (m[2, 3] - right_side[3]) / lever_m,
        )
        step: FloatArray = np.zeros(3)
        for k in range(3):
            if is_unobservable[k]:
                continue
            along = 0.0
            for a in range(3):
                along += directions[a, k] * gradient[a]
            for a in range(3):
                step[a] -= directions[a, k] * along / strength[k]
        step[2] /= lever_m
    else:
        step = solve_point_to_line(normal_matrix, right_side)
    squared_length = 0.0
    for a in range(3):
        for b in range(3):
            squared_length += step[a] * information[a, b] * step[b]
    return step, squared_length


@compiled()
def add_spurious_information(
    spurious: FloatArray, x_m: float, y_m: float, normal_x: float, normal_y: float, weight: float
) -> None:
    """Add the information (3, 3) due to the noise of one normal, whose variance is in
    ``weight``."""
    row = (-normal_y, normal_x, normal_x * x_m + normal_y * y_m)
    for i in range(3):
        for j in range(3):
            spurious[i, j] += weight * row[i] * row[j]


@compiled(error_model="numpy")
def find_unobservable_directions(
    information: FloatArray, spurious: FloatArray, lever_m: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Which directions of (x, y, yaw · lever) the pairs do not determine.

    ``information``, ``spurious``: (3, 3) of (x, y, yaw). Returns the eigenvalues (3,) and
    eigenvectors (3, 3; columns) of the information with the yaw in units of 1 / lever, and (3,)
    which of them are unobservable.
    """
    scale = (1.0, 1.0, 1.0 / lever_m)
    scaled, noise = np.empty((3, 3)), np.empty((3, 3))
    for a in range(3):
        for b in range(3):
            scaled[a, b] = information[a, b] * scale[a] * scale[b]
            noise[a, b] = spurious[a, b] * scale[a] * scale[b]
    strength, directions = np.linalg.eigh(scaled)
    is_unobservable = np.zeros(3, dtype=np.bool_)
    for k in range(3):
        noise_along = 0.0
        for a in range(3):
            for b in range(3):
                noise_along += directions[a, k] * noise[a, b] * directions[b, k]
        limit = _SPURIOUS_FACTOR * noise_along + _ROUNDING_FRACTION * strength[2]
        is_unobservable[k] = strength[k] <= limit
    return strength, directions, is_unobservable
