"""A pose from segments of a 2D LiDAR that lie in planes of a camera's frame, each weighted by what
the line and the plane are worth: Zhang and Pless 2004.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from fusion_core.calibration.board.pose_minimiser import Evaluate, minimise_pose
from fusion_core.calibration.pose_error import pose_error
from fusion_core.model.conventions import BoolArray, FloatArray

_ROUNDS = 6
_VIEW_SD_MAX_M = 0.2
# Beyond this a view is a mistake, and says nothing of how far the others vary.
_FAR_OFF = 5.0


@dataclass(frozen=True, slots=True)
class LaserPlanes:
    """Segments with the boards they lie on, M of them. ``ends_m``: (M, 2, 3) in the LiDAR's plane.
    ``across``: (M, 3) its normal in that plane. ``line_sd_m``: (M,). ``T_camera_board``: (M, 4, 4).
    ``board_covariance``: (M, 6, 6). ``view_sd_m``: how far a whole segment may lie from its board
    besides, by what neither accounts for: a hand that is not still, a sensor's bias."""

    ends_m: FloatArray
    across: FloatArray
    line_sd_m: FloatArray
    T_camera_board: FloatArray
    board_covariance: FloatArray
    view_sd_m: float = 0.0

    def subset(self, chosen: BoolArray) -> "LaserPlanes":
        """The chosen of them."""
        return LaserPlanes(
            self.ends_m[chosen],
            self.across[chosen],
            self.line_sd_m[chosen],
            self.T_camera_board[chosen],
            self.board_covariance[chosen],
            self.view_sd_m,
        )

    def residuals(self, T: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(M, 2) distances of the ends to the planes, and the same whitened."""
        distances = self.distances(T)
        white: FloatArray = np.einsum("mij,mj->mi", self.whitening(T), distances)
        return distances, white

    def distance_jacobian(self, T: FloatArray) -> FloatArray:
        """(M, 2, 6) of the distances by the pose's error."""
        turned = self.ends_m @ T[:3, :3].T
        normals = np.broadcast_to(self.T_camera_board[:, np.newaxis, :3, 2], turned.shape)
        # d(nᵀ(Exp(w) R p + t + τ)) = (R p × n)ᵀ w + nᵀ τ
        jacobian: FloatArray = np.concatenate([np.cross(turned, normals), normals], axis=2)
        return jacobian

    def offset_jacobian(self, T: FloatArray) -> FloatArray:
        """(M, 2) of the distances by an offset of all ranges."""
        rays = self.ends_m / np.linalg.norm(self.ends_m, axis=2, keepdims=True)
        jacobian: FloatArray = np.einsum(
            "mi,mei->me", self.T_camera_board[:, :3, 2], rays @ T[:3, :3].T
        )
        return jacobian

    def distances(self, T: FloatArray) -> FloatArray:
        """(M, 2) of the ends to the planes."""
        seen = self.ends_m @ T[:3, :3].T + T[:3, 3]
        from_origin = seen - self.T_camera_board[:, np.newaxis, :3, 3]
        distances: FloatArray = np.einsum("mi,mei->me", self.T_camera_board[:, :3, 2], from_origin)
        return distances

    def whitening(self, T: FloatArray) -> FloatArray:
        """(M, 2, 2) that makes the distances of a segment's two ends of unit variance."""
        covariance = self.covariance(T) + self.view_sd_m**2
        whitening: FloatArray = np.linalg.inv(np.linalg.cholesky(covariance))
        return whitening

    def covariance(self, T: FloatArray) -> FloatArray:
        """(M, 2, 2) of the distances of a segment's two ends, by its line and its board alone."""
        normals = self.T_camera_board[:, :3, 2]
        seen = self.ends_m @ T[:3, :3].T + T[:3, 3]
        from_origin = seen - self.T_camera_board[:, np.newaxis, :3, 3]
        spread = np.broadcast_to(normals[:, np.newaxis], from_origin.shape)
        # An error of the board's pose turns its normal and moves its origin.
        by_board = np.concatenate([np.cross(spread, from_origin), -spread], axis=2)
        covariance: FloatArray = by_board @ self.board_covariance @ by_board.transpose(0, 2, 1)
        # An error of the line counts as far as it leads out of the plane.
        out = np.einsum("mi,mi->m", normals, self.across @ T[:3, :3].T) * self.line_sd_m
        covariance += (out**2)[:, np.newaxis, np.newaxis] * np.eye(2) + 1e-12 * np.eye(2)
        return covariance


@dataclass(frozen=True, slots=True)
class PlaneFit:
    """``planes``: with the ``view_sd_m`` that explains the residuals. ``residuals_m``: (M, 2).
    ``information``: (6, 6) of POSE_PARAMETERS."""

    T: FloatArray
    planes: LaserPlanes
    residuals_m: FloatArray
    information: FloatArray


def fit_planes(planes: LaserPlanes, T_start: FloatArray, huber: float, free: BoolArray) -> PlaneFit:
    """Levenberg-Marquardt with Huber's weights; parameters that are not free keep their start."""
    T = T_start
    for _ in range(_ROUNDS):
        T_next = minimise_pose(_weighted(planes, T, huber), T_start, T, free)
        step = float(np.abs(pose_error(T_next, T)).max())
        T = T_next
        planes = replace(planes, view_sd_m=_view_sd(planes, T, int(free.sum())))
        if step < 1e-6:
            break
    return PlaneFit(T, planes, planes.distances(T), plane_information(planes, T, huber))


def plane_information(planes: LaserPlanes, T: FloatArray, huber: float) -> FloatArray:
    """(6, 6) of POSE_PARAMETERS at a pose."""
    _, white = planes.residuals(T)
    J = planes.whitening(T) @ planes.distance_jacobian(T)
    information: FloatArray = np.einsum("m,mki,mkj->ij", _weights(white, huber), J, J)
    return information


def offset_effect(planes: LaserPlanes, T: FloatArray, huber: float) -> FloatArray:
    """(6,) the gradient of half the squares by a pose's error where all ranges are a metre too
    long: the covariance times it is how far that moves the pose."""
    _, white = planes.residuals(T)
    whitening = planes.whitening(T)
    J = whitening @ planes.distance_jacobian(T)
    h = np.einsum("mij,mj->mi", whitening, planes.offset_jacobian(T))
    effect: FloatArray = np.einsum("m,mki,mk->i", _weights(white, huber), J, h)
    return effect


def _weighted(planes: LaserPlanes, T: FloatArray, huber: float) -> Evaluate:
    """Residuals and Jacobian with the weights of a pose."""
    _, white = planes.residuals(T)
    weighted = np.sqrt(_weights(white, huber))[:, np.newaxis, np.newaxis] * planes.whitening(T)

    def evaluate(T: FloatArray) -> tuple[FloatArray, FloatArray]:
        residuals: FloatArray = np.einsum("mij,mj->mi", weighted, planes.distances(T))
        return residuals.ravel(), (weighted @ planes.distance_jacobian(T)).reshape(-1, 6)

    return evaluate


def _view_sd(planes: LaserPlanes, T: FloatArray, parameters: int) -> float:
    """The least ``view_sd_m`` under which the squares of the whitened residuals are as many as the
    degrees of freedom; those beyond ``_FAR_OFF`` count as if they were there."""
    count = len(planes.ends_m)
    # The mean of min(r², k²) of two unit normals is 2 (1 - exp(-k²/2)).
    expected = (2 * count - parameters) * (1.0 - np.exp(-0.5 * _FAR_OFF**2))

    covariance, distances = planes.covariance(T), planes.distances(T)

    def excess(view_sd_m: float) -> float:
        inverse = np.linalg.inv(covariance + view_sd_m**2)
        squares = np.einsum("mi,mij,mj->m", distances, inverse, distances)
        return float(np.minimum(squares, _FAR_OFF**2).sum()) - float(expected)

    if expected <= 0.0 or excess(0.0) <= 0.0:
        return 0.0
    if excess(_VIEW_SD_MAX_M) >= 0.0:
        return _VIEW_SD_MAX_M
    return float(brentq(excess, 0.0, _VIEW_SD_MAX_M, xtol=1e-5))


def _weights(white: FloatArray, huber: float) -> FloatArray:
    weights: FloatArray = np.minimum(1.0, huber / np.maximum(np.linalg.norm(white, axis=1), 1e-12))
    return weights


def huber_cost(white: FloatArray, huber: float) -> float:
    """Huber's cost of (M, 2) whitened distances."""
    sizes = np.linalg.norm(white, axis=1)
    linear = huber * (sizes - 0.5 * huber)
    return float(np.where(sizes <= huber, 0.5 * sizes**2, linear).sum())
