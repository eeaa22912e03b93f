"""Weighted least squares of point-to-line distances in closed form (Censi 2008, appendix I).

For points p_i, lines n_i · q = h_i and weights w_i, find the R(θ) and t that minimise

    Σ w_i (n_i · (R(θ) p_i + t) - h_i)².

With x = (t, u), u = (cos θ, sin θ), this is a quadratic form under the constraint |u| = 1. t is
eliminated; the Lagrange multiplier of the rest is the largest root of a quartic.
"""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import FloatArray

# Newton from the right of a quartic's largest root: linear by 1/4 at worst, then quadratic.
_NEWTON_STEPS = 100


def fit_point_to_line(
    points_m: FloatArray, normals: FloatArray, offsets_m: FloatArray, weights: FloatArray
) -> FloatArray:
    """(3,) x, y, theta of the global minimum.

    ``points_m``, ``normals``: (n, 2), normals of unit length; ``offsets_m``, ``weights``: (n,).
    NaN where the lines do not determine the translation (fewer than two directions).
    """
    normal_matrix, right_side = np.zeros((4, 4)), np.zeros(4)
    for point, normal, offset, weight in zip(points_m, normals, offsets_m, weights, strict=True):
        add_point_line_pair(
            normal_matrix, right_side, point[0], point[1], normal[0], normal[1], offset, weight
        )
    motion: FloatArray = solve_point_to_line(normal_matrix, right_side)
    return motion


@compiled()
def add_point_line_pair(
    normal_matrix: FloatArray,
    right_side: FloatArray,
    x_m: float,
    y_m: float,
    normal_x: float,
    normal_y: float,
    offset_m: float,
    weight: float,
) -> None:
    """Add one pair to Σ w a aᵀ (4, 4; upper triangle) and Σ w h a (4,), a = d(n · p')/dx."""
    # n · (R p + t) = n_x t_x + n_y t_y + (n · p) cos θ + (n × p)' sin θ.
    along, across = normal_x * x_m + normal_y * y_m, normal_y * x_m - normal_x * y_m
    row = (normal_x, normal_y, along, across)
    for i in range(4):
        scaled = weight * row[i]
        right_side[i] += scaled * offset_m
        for j in range(i, 4):
            normal_matrix[i, j] += scaled * row[j]


@compiled(error_model="numpy")
def solve_point_to_line(normal_matrix: FloatArray, right_side: FloatArray) -> FloatArray:
    """(3,) x, y, theta from the sums of ``add_point_line_pair``; NaN where undetermined."""
    m, g = normal_matrix, right_side
    determinant = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
    trace = m[0, 0] + m[1, 1]
    # Relative rounding of a float64 determinant, with a margin of about 50.
    if not determinant > 1e-14 * trace * trace:
        return np.full(3, np.nan)
    # t = p - Q u, from the derivative by t.
    px = (m[1, 1] * g[0] - m[0, 1] * g[1]) / determinant
    py = (m[0, 0] * g[1] - m[0, 1] * g[0]) / determinant
    qx0 = (m[1, 1] * m[0, 2] - m[0, 1] * m[1, 2]) / determinant
    qy0 = (m[0, 0] * m[1, 2] - m[0, 1] * m[0, 2]) / determinant
    qx1 = (m[1, 1] * m[0, 3] - m[0, 1] * m[1, 3]) / determinant
    qy1 = (m[0, 0] * m[1, 3] - m[0, 1] * m[0, 3]) / determinant
    # Then minimise uᵀ S u - 2 b · u.
    s00 = m[2, 2] - m[0, 2] * qx0 - m[1, 2] * qy0
    s01 = m[2, 3] - m[0, 2] * qx1 - m[1, 2] * qy1
    s11 = m[3, 3] - m[0, 3] * qx1 - m[1, 3] * qy1
    b0 = g[2] - m[0, 2] * px - m[1, 2] * py
    b1 = g[3] - m[0, 3] * px - m[1, 3] * py
    c, s = _minimise_on_unit_circle(s00, s01, s11, b0, b1)
    return np.array([px - qx0 * c - qx1 * s, py - qy0 * c - qy1 * s, np.arctan2(s, c)])


@compiled(error_model="numpy")
def _minimise_on_unit_circle(
    s00: float, s01: float, s11: float, b0: float, b1: float
) -> tuple[float, float]:
    """The u on the unit circle that minimises uᵀ S u - 2 b · u.

    (S + λ) u = b with |u| = 1. In the eigenvectors of S, with eigenvalues l₀ <= l₁, that is
    (λ + l₀)² (λ + l₁)² = b₀² (λ + l₁)² + b₁² (λ + l₀)²; S + λ has no negative eigenvalue at the
    global minimum, which is the largest root.
    """
    half = 0.5 * (s00 - s11)
    radius = np.sqrt(half * half + s01 * s01)
    angle = 0.5 * np.arctan2(s01, half)
    # (c, s) belongs to l₁, (-s, c) to l₀.
    c, s = np.cos(angle), np.sin(angle)
    f0, f1 = c * b1 - s * b0, c * b0 + s * b1
    gap = 2.0 * radius
    # μ = λ + l₀ >= 0: μ² (μ + gap)² = f₀² (μ + gap)² + f₁² μ².
    squares0, squares1 = f0 * f0, f1 * f1
    mu = np.sqrt(squares0 + squares1)
    if mu == 0.0:
        return -s, c
    for _ in range(_NEWTON_STEPS):
        other = mu + gap
        value = mu * mu * other * other - squares0 * other * other - squares1 * mu * mu
        slope = 2.0 * (mu * other * (mu + other) - squares0 * other - squares1 * mu)
        step = value / slope if slope > 0.0 else 0.0
        if not step > 1e-16 * mu:
            break
        mu -= step
    u1 = f1 / (mu + gap)
    # Where b has no part along the smaller eigenvalue, that part of u is free: take it positive.
    u0 = np.copysign(np.sqrt(max(1.0 - u1 * u1, 0.0)), f0)
    # Near |u₁| = 1 the root loses its digits, and the quotient does not.
    if abs(u1) > 0.9 and f0 != 0.0:
        u0 = f0 / mu
    length = np.sqrt(u0 * u0 + u1 * u1)
    u0, u1 = u0 / length, u1 / length
    return c * u1 - s * u0, s * u1 + c * u0
