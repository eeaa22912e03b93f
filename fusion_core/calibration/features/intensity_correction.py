"""How a LiDAR's intensity falls with range and incidence angle, fitted to the cloud and undone.

I = ρ r⁻ⁿ cosᵐ α, with the reflectance ρ of each surface as its noise. What a driver has already
corrected is found to need none: both exponents are then about zero.
"""

import cv2
import numpy as np

from fusion_core.model.conventions import Float32Array, FloatArray

# Range⁻⁴ is a target smaller than the beam, cos² a surface that scatters little to the side.
_RANGE_EXPONENT_MAX, _ANGLE_EXPONENT_MAX = 4.0, 2.0
# Fewer pixels do not tell the exponents from the scene.
_PIXELS_MIN = 500
# Pixels across the window that a surface's normal is fitted in.
_NORMAL_WINDOW_PX = 9
_GRAZING_COSINE = 0.1
# Distances from a window's plane, of the range: noise of 3 cm at 1 m has 0.03.
_PLANE_MISFIT_MAX = 0.04
_ROUNDS = 10


def corrected_intensity(
    intensity: FloatArray, points_m: Float32Array, window_px: int = _NORMAL_WINDOW_PX
) -> FloatArray:
    """(H, W) intensity at the median range and head-on, NaN where there is none."""
    range_m = np.linalg.norm(points_m, axis=2).astype(np.float64)
    cosine = incidence_cosine(points_m, window_px)
    usable = np.isfinite(intensity) & (intensity > 0.0) & np.isfinite(cosine) & (range_m > 0.0)
    if np.count_nonzero(usable) < _PIXELS_MIN:
        return intensity
    middle_m = float(np.median(range_m[usable]))
    log_range = np.log(range_m[usable] / middle_m)
    log_cosine = np.log(np.maximum(cosine[usable], _GRAZING_COSINE))
    n, m = _fit_exponents(np.log(intensity[usable]), log_range, log_cosine)
    cosine = _with_neighbours(np.maximum(cosine, _GRAZING_COSINE), 3 * window_px)
    with np.errstate(invalid="ignore"):
        corrected: FloatArray = intensity * (range_m / middle_m) ** n / cosine**m
    return corrected


def _with_neighbours(cosine: FloatArray, window_px: int) -> FloatArray:
    """(H, W) with a mean of the surroundings where there is no value, 1 where they have none."""
    known = np.isfinite(cosine)
    window = (window_px, window_px)
    count = cv2.boxFilter(known.astype(np.float64), -1, window, normalize=False)
    total = cv2.boxFilter(np.where(known, cosine, 0.0), -1, window, normalize=False)
    around = np.where(count > 0.5, total / np.maximum(count, 1.0), 1.0)
    return np.where(known, cosine, around)


def _fit_exponents(
    log_intensity: FloatArray, log_range: FloatArray, log_cosine: FloatArray
) -> tuple[float, float]:
    """n and m by least absolute deviations (iteratively weighted): reflectances have outliers."""
    design = np.stack([np.ones_like(log_range), -log_range, log_cosine], axis=1)
    weight: FloatArray = np.ones(len(design))
    solution: FloatArray = np.zeros(3)
    for _ in range(_ROUNDS):
        weighted = design * weight[:, np.newaxis]
        # Parts of the design that the cloud does not show apart get nothing.
        solution = np.linalg.pinv(weighted.T @ design, hermitian=True) @ (
            weighted.T @ log_intensity
        )
        weight = 1.0 / np.maximum(np.abs(log_intensity - design @ solution), 0.02)
    return (
        float(np.clip(solution[1], 0.0, _RANGE_EXPONENT_MAX)),
        float(np.clip(solution[2], 0.0, _ANGLE_EXPONENT_MAX)),
    )


def incidence_cosine(points_m: Float32Array, window_px: int = _NORMAL_WINDOW_PX) -> FloatArray:
    """(H, W) |cos| of the angle between each pixel's beam and its surface's normal, NaN where the
    (H, W, 3) points around are too few.

    Inverse depths of a plane are linear over the image, so is the inverse range along a ray: the
    plane is the least-squares one of the window, n·p = 1.
    """
    known = np.isfinite(points_m[..., 0])
    p = np.where(known[..., np.newaxis], points_m, 0.0).astype(np.float64)
    window = (window_px, window_px)

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(cv2.boxFilter(values, -1, window, normalize=False), dtype=np.float64)

    normal_matrix = np.empty((*p.shape[:2], 3, 3))
    for i in range(3):
        for j in range(i, 3):
            normal_matrix[..., i, j] = normal_matrix[..., j, i] = total(p[..., i] * p[..., j])
    right = np.stack([total(p[..., i]) for i in range(3)], axis=-1)
    count = total(known.astype(np.float64))
    enough = known & (count >= 6)
    # A plane through the origin has no n with n·p = 1; nor is it seen.
    trace = np.trace(normal_matrix, axis1=-2, axis2=-1)
    normal_matrix += (1e-9 * trace + 1e-12)[..., np.newaxis, np.newaxis] * np.eye(3)
    normals = np.linalg.solve(normal_matrix, right[..., np.newaxis])[..., 0]
    length = np.linalg.norm(normals, axis=-1) * np.linalg.norm(p, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.abs((normals * p).sum(axis=-1)) / length
        # Of a least-squares plane Σ (n·p - 1)² = N - n·Σp: relative distances from it.
        misfit = 1.0 - (normals * right).sum(axis=-1) / np.maximum(count, 1.0)
    # A window across a depth edge has a plane too, at a slant that is no surface's.
    return np.where(enough & (misfit <= _PLANE_MISFIT_MAX**2), cosine, np.nan)
