"""Where the evidence of an image and a prior on the guess's errors put a pose, coarse to fine."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from fusion_core.calibration.pose_error import apply_pose_error
from fusion_core.calibration.refinement.alignment_evidence import EvidenceLevel
from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.model.geometry import transform_points

# Of each level; the simplex has shrunk to a fiftieth of a step by then, or lies in noise.
_EVALUATIONS_MAX = 250
_STEP_MIN = 0.02
_NATS_MIN = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class PosePosterior:
    """Minus the logarithm of how probable a pose is, but for a constant.

    Errors (6,) are those of POSE_PARAMETERS from ``T_guess``. ``precision``: (6, 6) of the prior.
    ``weight``: of the evidence's nats, below 1 since neighbouring points tell of one thing.
    """

    T_guess: FloatArray
    precision: FloatArray
    weight: float

    def __post_init__(self) -> None:
        read_only(self.precision)

    def cost(self, error: FloatArray, level: EvidenceLevel) -> float:
        information = level.information(apply_pose_error(self.T_guess, error)).sum()
        return float(-self.weight * information + 0.5 * error @ self.precision @ error)


def bearing_metric(points_in_lidar_m: FloatArray, T_camera_lidar: FloatArray) -> FloatArray:
    """(6, 6) M so that δᵀ M δ is the mean square, in rad² on the image plane of focal length 1, by
    which a small error δ moves points in the image."""
    points = transform_points(T_camera_lidar, points_in_lidar_m)
    depth = points[:, 2]
    points, depth = points[depth > 0.0], depth[depth > 0.0]
    turned = points - T_camera_lidar[:3, 3]
    # d(x / z): along the image's axes for moves along the camera's.
    by_move = np.zeros((len(depth), 2, 3))
    by_move[:, 0, 0] = by_move[:, 1, 1] = 1.0 / depth
    by_move[:, 0, 2] = -points[:, 0] / depth**2
    by_move[:, 1, 2] = -points[:, 1] / depth**2
    # ω turns R p alone: it moves a point by ω x R p.
    by_turn = np.cross(turned[:, np.newaxis, :], by_move)
    by_error = np.concatenate([by_turn, by_move], axis=2)
    squares: FloatArray = np.einsum("nij,nik->jk", by_error, by_error)
    return squares / max(1, len(depth))


def step_basis(metric: FloatArray, precision: FloatArray, step_rad: float) -> FloatArray:
    """(6, 6) columns along which a step of 1 moves the image by ``step_rad``, or the pose by a
    standard deviation of the prior where the image shows less of it."""
    values, vectors = np.linalg.eigh(metric / step_rad**2 + precision)
    basis: FloatArray = vectors / np.sqrt(values)
    return basis


def search_pose(
    posterior: PosePosterior,
    levels: Sequence[EvidenceLevel],
    bases: Sequence[FloatArray],
    start: FloatArray,
    *,
    report: Callable[[], None] = lambda: None,
) -> FloatArray:
    """(6,) the error at a minimum of the cost, level after level, by Nelder & Mead's simplex.

    ``bases``: for each level the (6, k) directions of the search and their first steps; what they
    do not span stays as at the ``start``. Derivatives are of no use: evidence of sparse points is
    rough, and the simplex is as large as the blur.
    """
    error = start
    for level, basis in zip(levels, bases, strict=True):
        error = error + basis @ _lowest_steps(posterior, level, basis, error)
        report()
    return error


def _lowest_steps(
    posterior: PosePosterior, level: EvidenceLevel, basis: FloatArray, origin: FloatArray
) -> FloatArray:
    def cost(steps: FloatArray) -> float:
        return posterior.cost(origin + basis @ steps, level)

    found = minimize(
        cost,
        np.zeros(basis.shape[1]),
        method="Nelder-Mead",
        options={
            "initial_simplex": _simplex(basis.shape[1]),
            "maxfev": _EVALUATIONS_MAX,
            "xatol": _STEP_MIN,
            "fatol": _NATS_MIN,
        },
    )
    return np.asarray(found.x, dtype=np.float64)


def _simplex(dimensions: int) -> FloatArray:
    """(k + 1, k) corners with steps of 1 about the origin."""
    corners = np.concatenate([np.zeros((1, dimensions)), np.eye(dimensions)])
    centred: FloatArray = corners - corners.mean(axis=0)
    return centred
