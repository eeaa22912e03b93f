"""The mounting of a LiDAR on a turning axis and the planes that it sees, estimated together.

Song's (7) measures the points of one half turn from planes fitted to the other. Here the points of
both are measured from planes that are unknowns themselves, in the cloud of the whole turn, where
each point has its own axis angle: no plane is taken as known, and the axis may turn during a scan.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.calibration.turning.turn import Turn, rotate_about_z
from fusion_core.model.conventions import FloatArray, IntArray, read_only
from fusion_core.model.robust import robust_sigma

_ITERATIONS_MAX = 25
# Radians and metres: a hundredth of what the best turn determines.
_STEP_MIN = 1e-7
_TUKEY = 4.685
# Below this cosine of incidence a beam says little about its plane.
_COSINE_MIN = 0.1
_MOUNTING, _PLANE = 4, 3


@dataclass(frozen=True, slots=True)
class BundleSolution:
    """``parameters``: (4,) θ, β, Δx, Δy. ``normals``: (P, 3), ``offsets_m``: (P,) the planes in
    ``rig``. ``covariance``: (4, 4). ``information``: (P, 4, 4) what each plane says about the
    parameters. ``residuals_m``: (N,) distances of the points. ``sigma_m``: (P,) their scale.
    ``converged``: whether the last step was negligible."""

    parameters: FloatArray
    normals: FloatArray
    offsets_m: FloatArray
    covariance: FloatArray
    information: FloatArray
    residuals_m: FloatArray
    sigma_m: FloatArray
    converged: bool

    def __post_init__(self) -> None:
        for array in (self.parameters, self.normals, self.offsets_m, self.covariance):
            read_only(array)


def solve_bundle(
    turn: Turn,
    plane_of: IntArray,
    parameters: FloatArray,
    normals: FloatArray,
    offsets_m: FloatArray,
    *,
    iterations_max: int = _ITERATIONS_MAX,
) -> BundleSolution:
    """Least squares of the points' distances from their planes, reweighted by Tukey's function.

    ``plane_of``: (N,) the plane of each point of ``turn``. ``parameters``, ``normals``,
    ``offsets_m``: where to start. The covariance is the sandwich estimate with the scans as
    clusters: it needs neither equal nor independent errors within a scan. It is NaN where the
    planes do not determine the parameters.
    """
    parameters, normals, offsets_m = parameters.copy(), normals.copy(), offsets_m.copy()
    converged = False
    system = _System(turn, plane_of, parameters, normals, offsets_m)
    for _ in range(iterations_max):
        step = system.solve()
        if step is None:
            break
        change, tangent, shift = step
        parameters = parameters + change
        normals = normals + np.einsum("pij,pj->pi", system.tangents, tangent)
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        offsets_m = offsets_m + shift
        system = _System(turn, plane_of, parameters, normals, offsets_m)
        if np.abs(change).max() < _STEP_MIN:
            converged = True
            break
    return BundleSolution(
        parameters=parameters,
        normals=normals,
        offsets_m=offsets_m,
        covariance=system.covariance(turn.scan_indices),
        information=system.information(),
        residuals_m=system.residuals_m,
        sigma_m=system.sigma_m,
        converged=converged,
    )


class _System:
    """The normal equations at one estimate, each plane's own unknowns eliminated."""

    def __init__(
        self,
        turn: Turn,
        plane_of: IntArray,
        parameters: FloatArray,
        normals: FloatArray,
        offsets_m: FloatArray,
    ) -> None:
        self._plane_of = plane_of
        self._count = len(normals)
        in_axis = turn.in_axis(parameters)
        mounting = turn.mounting(parameters)
        from_lidar = in_axis - mounting[:3, 3]
        length = np.linalg.norm(from_lidar, axis=1, keepdims=True)
        in_rig = rotate_about_z(in_axis, turn.axis_angles_rad)
        normal = normals[plane_of]
        self.residuals_m = np.einsum("ij,ij->i", normal, in_rig) - offsets_m[plane_of]
        normal_in_axis = rotate_about_z(normal, -turn.axis_angles_rad)
        cosine = np.einsum("ij,ij->i", normal_in_axis, from_lidar) / length[:, 0]
        # Derivatives are taken where the beam meets the plane, not at the measured point: that
        # place is free of the range's noise, which would else bias the product of the two.
        correction = -np.divide(
            self.residuals_m,
            cosine,
            out=np.zeros_like(cosine),
            where=np.abs(cosine) > _COSINE_MIN,
        )
        along = (correction / length[:, 0])[:, np.newaxis] * from_lidar
        arm = from_lidar + along
        met = rotate_about_z(in_axis + along, turn.axis_angles_rad)
        c, s = np.cos(parameters[0]), np.sin(parameters[0])
        # d(Rx Ry v)/dθ = x × v', d/dβ = (Rx y) × v', with v' the rotated vector.
        by_theta = np.cross([1.0, 0.0, 0.0], arm)
        by_beta = np.cross([0.0, c, s], arm)
        self._by_mounting = np.column_stack(
            [
                np.einsum("ij,ij->i", normal_in_axis, by_theta),
                np.einsum("ij,ij->i", normal_in_axis, by_beta),
                normal_in_axis[:, :2],
            ]
        )
        self.tangents = _tangents(normals)
        tangent = self.tangents[plane_of]
        self._by_plane = np.column_stack(
            [np.einsum("nij,ni->nj", tangent, met), np.full(len(met), -1.0)]
        )
        usable = np.abs(cosine) > _COSINE_MIN
        self.sigma_m = _scales(self.residuals_m, plane_of, self._count)
        ratio = self.residuals_m / (_TUKEY * self.sigma_m[plane_of])
        inside = usable & (np.abs(ratio) < 1.0)
        precision = np.where(inside, 1.0 / self.sigma_m[plane_of] ** 2, 0.0)
        self._weights = precision * (1.0 - ratio**2) ** 2
        # The slope of the weighted residual, of which the covariance is made.
        self._slopes = precision * (1.0 - ratio**2) * (1.0 - 5.0 * ratio**2)

    def solve(self) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Changes of the parameters (4,), the normals (P, 2) and the offsets (P,)."""
        blocks = self._blocks(self._weights)
        gradient = self._weights * self.residuals_m
        mounting = self._by_mounting.T @ gradient
        plane = self._sums(self._by_plane * gradient[:, np.newaxis])
        if blocks.singular:
            return None
        gain = np.linalg.solve(blocks.planes, plane[..., np.newaxis])[..., 0]
        right = mounting - np.einsum("pij,pj->i", blocks.mixed, gain)
        change: FloatArray = -np.linalg.solve(blocks.reduced.sum(axis=0), right)
        back = np.einsum("pij,i->pj", blocks.mixed, change)
        planes = -gain - np.linalg.solve(blocks.planes, back[..., np.newaxis])[..., 0]
        return change, planes[:, :2].astype(np.float64), planes[:, 2].astype(np.float64)

    def information(self) -> FloatArray:
        """(P, 4, 4), zero for a plane that does not determine its own unknowns."""
        return self._blocks(self._weights).reduced

    def covariance(self, clusters: IntArray) -> FloatArray:
        """(4, 4) of the parameters; NaN where the planes do not determine them."""
        blocks = self._blocks(self._slopes)
        if blocks.singular:
            return np.full((_MOUNTING, _MOUNTING), np.nan)
        bread = np.linalg.inv(blocks.reduced.sum(axis=0))
        gains = np.linalg.solve(blocks.planes, np.swapaxes(blocks.mixed, 1, 2))
        own = self._by_mounting - np.einsum("nj,nji->ni", self._by_plane, gains[self._plane_of])
        scores = own * (self._weights * self.residuals_m)[:, np.newaxis]
        _, cluster = np.unique(clusters, return_inverse=True)
        count = int(cluster.max()) + 1
        sums = np.stack(
            [np.bincount(cluster, scores[:, i], minlength=count) for i in range(_MOUNTING)], axis=1
        )
        # What four parameters take from the scatter of the clusters' sums.
        small_sample = count / max(count - _MOUNTING, 1)
        covariance: FloatArray = small_sample * bread @ (sums.T @ sums) @ bread
        return covariance

    def _blocks(self, weights: FloatArray) -> "_Blocks":
        count = self._count
        mounting = np.zeros((count, _MOUNTING, _MOUNTING))
        mixed = np.zeros((count, _MOUNTING, _PLANE))
        planes = np.zeros((count, _PLANE, _PLANE))
        for index in range(count):
            chosen = np.flatnonzero(self._plane_of == index)
            a, b = self._by_mounting[chosen], self._by_plane[chosen]
            w = weights[chosen][:, np.newaxis]
            mounting[index] = a.T @ (w * a)
            mixed[index] = a.T @ (w * b)
            planes[index] = b.T @ (w * b)
        return _Blocks(mounting, mixed, planes)

    def _sums(self, rows: FloatArray) -> FloatArray:
        sums: FloatArray = np.stack(
            [
                np.bincount(self._plane_of, rows[:, column], minlength=self._count)
                for column in range(rows.shape[1])
            ],
            axis=1,
        )
        return sums


class _Blocks:
    """Of the normal matrix: per plane (P, …) the mounting's part, the mixed and the plane's own.

    ``reduced``: (P, 4, 4) what is left for the mounting when the plane's unknowns are eliminated.
    """

    def __init__(self, mounting: FloatArray, mixed: FloatArray, planes: FloatArray) -> None:
        self.mixed, self.planes = mixed, planes
        self.singular = bool((np.linalg.cond(planes) > 1e12).any())
        if self.singular:
            self.reduced = np.zeros_like(mounting)
            return
        gains = np.linalg.solve(planes, np.swapaxes(mixed, 1, 2))
        self.reduced = mounting - mixed @ gains
        self.singular = bool(np.linalg.cond(self.reduced.sum(axis=0)) > 1e12)


def _tangents(normals: FloatArray) -> FloatArray:
    """(P, 3, 2) two unit vectors across each normal, as columns."""
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, least)
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    tangents: FloatArray = np.stack([first, np.cross(normals, first)], axis=2)
    return tangents


def _scales(residuals_m: FloatArray, plane_of: IntArray, count: int) -> FloatArray:
    """(P,) robust standard deviations of the residuals of each plane."""
    scales = np.array([robust_sigma(residuals_m[plane_of == index]) for index in range(count)])
    # Exact data have no scatter, and need a scale above rounding.
    floored: FloatArray = np.maximum(scales, 1e-6)
    return floored
