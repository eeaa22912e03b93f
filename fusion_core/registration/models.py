"""The four planar transforms that A may be, and their least-squares fits.

Row-vector convention of Xu 2024 eq. (5): ``(x', z', w') = (x, z, 1) A`` and the mapped point is
``(x'/w', z'/w')``. With the third column of A at (0, 0, 1), as eq. (5) is printed, w' is 1 and A
is affine; a homography needs the division. A is scaled so that w' = 1 at the centroid of the
pairs that it was fitted to, and a point with w' <= 0 (beyond the horizon) has no image: NaN.

Least squares minimise the errors in D alone, so noise in L shrinks an affine fit across a wall
whose width is of the noise's size; ``Fit.condition`` shows that case.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fusion_core.model.conventions import FloatArray, read_only

TransformModel = Literal["rigid", "similarity", "affine", "homography"]

# From the simplest to the richest.
MODELS: tuple[TransformModel, ...] = ("rigid", "similarity", "affine", "homography")
PARAMETERS: dict[TransformModel, int] = {"rigid": 3, "similarity": 4, "affine": 6, "homography": 8}
MINIMAL_PAIRS: dict[TransformModel, int] = {
    "rigid": 2,
    "similarity": 2,
    "affine": 3,
    "homography": 4,
}

# Beyond this condition the digits of a float64 no longer determine A (the condition comes
# from normal equations, which square it).
SINGULAR_CONDITION = 1e7

# A safeguard: from a DLT start, far fewer steps are needed.
_GAUSS_NEWTON_STEPS_MAX = 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransformFit:
    """A transform fitted to pairs.

    ``A``: (3, 3). ``unit_covariance``: (9, 9) covariance of A's entries, row by row, for
    independent errors of 1 m on each axis of D. ``condition``: condition number of the design
    matrix in coordinates with zero mean and unit spread. Where it reaches SINGULAR_CONDITION the
    pairs do not determine it and the arrays are NaN.
    """

    A: FloatArray
    unit_covariance: FloatArray
    condition: float

    def __post_init__(self) -> None:
        read_only(self.A)
        read_only(self.unit_covariance)


def apply_transform(A: FloatArray, points_m: FloatArray) -> FloatArray:
    """(m, 2) points through one A (3, 3) to (m, 2), NaN where a point has no image (eq. 8)."""
    mapped = _homogeneous(points_m) @ A
    w = np.where(mapped[:, 2:] > 0.0, mapped[:, 2:], np.nan)
    image: FloatArray = mapped[:, :2] / w
    return image


def residuals(A: FloatArray, lidar_m: FloatArray, depth_m: FloatArray) -> FloatArray:
    """``||L A - D||`` of eq. (6): A (..., 3, 3) and (m, 2) points give (..., m) metres.

    NaN where a point has no image or A is NaN.
    """
    columns = _homogeneous(lidar_m).T
    with np.errstate(invalid="ignore", over="ignore"):
        across = A[..., :, 0] @ columns
        along = A[..., :, 1] @ columns
        # In an affine transform w' is 1 everywhere, and dividing a stack of draws by it costs most.
        if A[..., :2, 2].any():
            w = A[..., :, 2] @ columns
            w[~(w > 0.0)] = np.nan
            across /= w
            along /= w
        across -= depth_m[:, 0]
        along -= depth_m[:, 1]
        distance: FloatArray = np.sqrt(across * across + along * along)
    return distance


def solve_least_squares(
    model: TransformModel, lidar_m: FloatArray, depth_m: FloatArray
) -> FloatArray:
    """Closed-form least squares of ``L A = D``: (..., n, 2) twice give A (..., 3, 3).

    All leading axes are solved at once. Rigid and similarity: Umeyama 1991 in the plane, where
    the rotation that is no reflection has a closed form. Affine: the normal equations of eq. (5).
    Homography: normalised DLT (Hartley 1997). A sample that does not determine A gives NaN
    or an arbitrary A; it never raises.
    """
    lidar_mean = lidar_m.mean(axis=-2, keepdims=True)
    depth_mean = depth_m.mean(axis=-2, keepdims=True)
    lidar, depth = lidar_m - lidar_mean, depth_m - depth_mean
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if model == "homography":
            return _direct_linear_transform(lidar, depth, lidar_mean, depth_mean)
        linear = _linear_part(model, lidar, depth)
        A = np.zeros((*linear.shape[:-2], 3, 3))
        A[..., :2, :2] = linear
        A[..., 2:, :2] = depth_mean - lidar_mean @ linear
        A[..., 2, 2] = 1.0
    return A


def fit_transform(model: TransformModel, lidar_m: FloatArray, depth_m: FloatArray) -> TransformFit:
    """Least squares over all pairs, (m, 2) twice, with condition and covariance.

    The homography is refined by Gauss-Newton on the distances in D, since the DLT's own error
    is no distance; so its residuals compare with those of the other models.
    """
    centre_lidar, spread_lidar = _centre_and_spread(lidar_m)
    centre_depth, spread_depth = _centre_and_spread(depth_m)
    # One unit for both sides, or a rigid transform would not stay rigid.
    unit_m = max(spread_lidar, spread_depth)
    if min(spread_lidar, spread_depth) * SINGULAR_CONDITION <= unit_m:
        return _undetermined_fit(np.inf)
    lidar, depth = (lidar_m - centre_lidar) / unit_m, (depth_m - centre_depth) / unit_m
    A = solve_least_squares(model, lidar, depth)
    if model == "homography" and np.isfinite(A).all():
        A = _refine_homography(A, lidar, depth)
    if not np.isfinite(A).all():
        return _undetermined_fit(np.inf)

    directions = _tangent(model, A)
    design = (_entry_jacobian(A, lidar) @ directions).reshape(-1, directions.shape[1])
    if not np.isfinite(design).all():
        return _undetermined_fit(np.inf)
    squared, axes = np.linalg.eigh(design.T @ design)
    condition = float(np.sqrt(squared[-1] / squared[0])) if squared[0] > 0.0 else np.inf
    if condition >= SINGULAR_CONDITION:
        return _undetermined_fit(condition)
    axes = directions @ axes
    covariance = axes / squared @ axes.T / unit_m**2

    to_unit_lidar = _normalising_transform(centre_lidar, unit_m)
    from_unit_depth = np.linalg.inv(_normalising_transform(centre_depth, unit_m))
    # The Kronecker product, which numpy's own takes longer for than for all else here.
    change = to_unit_lidar[:, None, :, None] * from_unit_depth.T[None, :, None, :]
    change = change.reshape(9, 9)
    return TransformFit(
        A=to_unit_lidar @ A @ from_unit_depth,
        unit_covariance=change @ covariance @ change.T,
        condition=condition,
    )


def point_covariance(A: FloatArray, covariance: FloatArray, points_m: FloatArray) -> FloatArray:
    """(m, 2, 2) covariance of the images of exact points, from that of A's entries (9, 9)."""
    jacobian = _entry_jacobian(A, points_m)
    propagated: FloatArray = jacobian @ covariance @ jacobian.swapaxes(-1, -2)
    return propagated


def point_jacobian(A: FloatArray, points_m: FloatArray) -> FloatArray:
    """(m, 2, 2): entry [i, a, b] is the derivative of the image's axis b by the point's axis a."""
    mapped = _homogeneous(points_m) @ A
    image = mapped[:, None, :2] / mapped[:, None, 2:]
    derivative: FloatArray = (A[:2, :2] - A[:2, 2:] * image) / mapped[:, 2:, None]
    return derivative


def _homogeneous(points: FloatArray) -> FloatArray:
    """The hat of eq. (5): (..., 2) to (..., 3)."""
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)


def _centre_and_spread(points_m: FloatArray) -> tuple[FloatArray, float]:
    centre = points_m.mean(axis=0)
    return centre, float(np.sqrt(np.mean((points_m - centre) ** 2)))


def _normalising_transform(centre_m: FloatArray, unit_m: float) -> FloatArray:
    """(3, 3) that takes a row vector in metres to one about the centre, in units of ``unit_m``."""
    scale = 1.0 / unit_m
    return np.array(
        [[scale, 0.0, 0.0], [0.0, scale, 0.0], [-centre_m[0] * scale, -centre_m[1] * scale, 1.0]]
    )


def _linear_part(model: TransformModel, lidar: FloatArray, depth: FloatArray) -> FloatArray:
    """(..., 2, 2) from centred points, through their second moments."""
    x, z = lidar[..., 0], lidar[..., 1]
    moment = lidar.swapaxes(-1, -2) @ depth
    if model == "affine":
        xx, xz, zz = (x * x).sum(-1), (x * z).sum(-1), (z * z).sum(-1)
        adjugate = np.stack([zz, -xz, -xz, xx], axis=-1).reshape(*xx.shape, 2, 2)
        solved: FloatArray = adjugate @ moment / (xx * zz - xz * xz)[..., None, None]
        return solved
    cosine = moment[..., 0, 0] + moment[..., 1, 1]
    sine = moment[..., 0, 1] - moment[..., 1, 0]
    length = np.hypot(cosine, sine) if model == "rigid" else (lidar**2).sum((-1, -2))
    turned = np.stack([cosine, sine, -sine, cosine], axis=-1).reshape(*cosine.shape, 2, 2)
    scaled: FloatArray = turned / length[..., None, None]
    return scaled


def _direct_linear_transform(
    lidar: FloatArray, depth: FloatArray, lidar_mean: FloatArray, depth_mean: FloatArray
) -> FloatArray:
    """Normalised DLT of centred points, (..., n, 2) twice, moved back to their means."""
    unit = np.sqrt((lidar**2).mean((-1, -2)))[..., None, None]
    rows = _cross_rows(_homogeneous(lidar / unit), depth / unit)
    rows = rows.reshape(*rows.shape[:-3], -1, 9)
    gram = rows.swapaxes(-1, -2) @ rows
    # With w' = 1 at the centroid the last entry is 1 and the others solve eight equations. The
    # ridge, at the level of rounding, lets one undetermined sample pass without failing the stack.
    ridge = 1e-14 * np.trace(gram, axis1=-2, axis2=-1)[..., None, None] * np.eye(8)
    system = gram[..., :8, :8] + ridge
    system = np.where(np.isfinite(system).all((-1, -2), keepdims=True), system, np.eye(8))
    A = np.ones((*gram.shape[:-2], 9))
    A[..., :8] = -np.linalg.solve(system, gram[..., :8, 8:])[..., 0]
    A = A.reshape(*gram.shape[:-2], 3, 3)
    A[..., :2, 2:] /= unit
    A[..., 2:, :2] *= unit
    # Undo the means: N_L A N_D^-1, written out because it is done for each sample of a stack.
    A[..., 2:, :] -= lidar_mean @ A[..., :2, :]
    A[..., :, :2] += A[..., :, 2:] * depth_mean
    return A


def _cross_rows(lidar_hat: FloatArray, depth: FloatArray) -> FloatArray:
    """(..., n, 2, 9): the two DLT equations of each pair in the entries of A, row by row.

    They are also w' times the derivative of the image ``depth`` by those entries.
    """
    rows = np.zeros((*depth.shape, 9))
    rows[..., 0, 0::3] = lidar_hat
    rows[..., 1, 1::3] = lidar_hat
    rows[..., :, 2::3] = -lidar_hat[..., None, :] * depth[..., :, None]
    return rows


def _entry_jacobian(A: FloatArray, points: FloatArray) -> FloatArray:
    """(m, 2, 9): derivative of each point's image by the entries of A, row by row."""
    hat = _homogeneous(points)
    w = (hat @ A)[:, 2]
    w = np.where(w > 0.0, w, np.nan)
    jacobian: FloatArray = _cross_rows(hat, apply_transform(A, points)) / w[:, None, None]
    return jacobian


def _tangent(model: TransformModel, A: FloatArray) -> FloatArray:
    """(9, parameters): the directions in which the model lets the entries of A move."""
    entry = np.eye(9)
    if model == "affine":
        return entry[:, [0, 1, 3, 4, 6, 7]]
    if model == "homography":
        # All but A's own direction, which changes its scale and no image.
        basis: FloatArray = np.linalg.svd(A.reshape(1, 9))[2][1:].T
        return basis
    scale_cos, scale_sin = entry[:, 0] + entry[:, 4], entry[:, 1] - entry[:, 3]
    if model == "similarity":
        return np.stack([scale_cos, scale_sin, entry[:, 6], entry[:, 7]], axis=1)
    rotated = A[0, 0] * scale_sin - A[0, 1] * scale_cos
    return np.stack([rotated, entry[:, 6], entry[:, 7]], axis=1)


def _refine_homography(A: FloatArray, lidar: FloatArray, depth: FloatArray) -> FloatArray:
    """Gauss-Newton on the squared distances in D; a step that does not lower them ends it."""
    cost = float(np.sum((apply_transform(A, lidar) - depth) ** 2))
    for _ in range(_GAUSS_NEWTON_STEPS_MAX):
        if not np.isfinite(cost):
            break
        directions = _tangent("homography", A)
        design = (_entry_jacobian(A, lidar) @ directions).reshape(-1, directions.shape[1])
        error = (depth - apply_transform(A, lidar)).reshape(-1)
        step = np.linalg.lstsq(design, error, rcond=None)[0]
        moved = A + (directions @ step).reshape(3, 3)
        moved = moved / moved[2, 2]
        moved_cost = float(np.sum((apply_transform(moved, lidar) - depth) ** 2))
        if not moved_cost < cost:
            break
        has_converged = cost - moved_cost <= 1e-12 * cost
        A, cost = moved, moved_cost
        if has_converged:
            break
    return A


def _undetermined_fit(condition: float) -> TransformFit:
    return TransformFit(
        A=np.full((3, 3), np.nan), unit_covariance=np.full((9, 9), np.nan), condition=condition
    )
