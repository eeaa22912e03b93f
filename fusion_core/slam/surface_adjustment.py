"""Poses, surfaces and odometry adjusted together: the last step of pose graph SLAM.

A bundle adjustment of a planar LiDAR. The unknowns are the keyframes' poses, the offset of each
side of each surface element along its normal, and the scale of each odometry. The sum of squares is

    Σ returns  (n · (T_map_scan p - c) - offset)² / σ(range)²
  + Σ odometry  ‖ Log of the measured step⁻¹ · the poses' step ‖² by the step's covariance
  + Σ neighbours  the same with the pose graph's step, by the graph's own deviations
  + Σ odometry  (scale - 1)² / σ_scale²

The map is an unknown and not a reference: what two keyframes have in common is an error of their
relation alone, and a surface that many have seen is not counted as known beforehand. σ(range) is
estimated from the residuals. An odometry counts by its own covariance, which is widened where its
residuals are larger than that, so that neither sensor is trusted beyond what the other confirms.
The steps between neighbouring keyframes are what odometry adds, and no absolute poses: their errors
are nearly independent, while those of its path are not, and loops that it has closed are in its
steps already. What is common to all steps is its scale (a camera's depths, a wheel's diameter).
The last sum is weak, and keeps what no surface determines, as along a corridor.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only, wrap_angle
from fusion_core.model.planar_poses import relative_pose
from fusion_core.model.progress import Progress, silent
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from fusion_core.motion.resample import resample_odometry
from fusion_core.settings import setting
from fusion_core.slam.surface_elements import (
    SurfaceElementSettings,
    associate_returns,
    find_surface_elements,
)

# Of residuals in standard deviations: the weight falls beyond the first (Huber), and is zero beyond
# the second, where a return belongs to another surface.
_HUBER, _CUTOFF = 2.0, 5.0
# Of chi-square with three degrees of freedom: its median, and its 0.999 quantile.
_CHI2_MEDIAN, _CHI2_MAX = 2.366, 16.27
# How much more than the normals' errors their directions must say; set by hand.
_OBSERVABLE_FACTOR = 10.0
# The first keyframe stays; an offset that nothing determines does, too. Numerics.
_ANCHOR_SIGMA, _FREE_SIGMA = 1e-6, 1e2


class SurfaceAdjustmentSettings(SurfaceElementSettings):
    """Adjustment of keyframes, surfaces and odometry."""

    rounds: int = setting(
        3, "Times that surfaces are found and all is adjusted; 0 leaves the poses", ge=0, le=50
    )
    keyframes_max: int = setting(
        6000,
        "Larger maps are not adjusted: 4,400 take 15 s and 0.3 GB",
        unit="keyframes",
        ge=2,
        le=100_000,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AdjustedPoses:
    """``poses_map_node``: (K, 3). ``odometry_names``. ``odometry_scales``: of each odometry, by
    which its steps are multiplied, 1 for one without error.
    ``odometry_factors``: of each, by what its standard deviations are widened, at least 1.
    ``is_adjusted``: whether there were surfaces to adjust by."""

    poses_map_node: FloatArray
    odometry_names: tuple[str, ...] = ()
    odometry_scales: tuple[float, ...] = ()
    odometry_factors: tuple[float, ...] = ()
    is_adjusted: bool = False

    def __post_init__(self) -> None:
        read_only(self.poses_map_node)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Steps:
    """M steps from ``first`` to ``second``, (M,): ``measured`` (M, 3) with ``information``
    (M, 3, 3). ``scale_sigma``: of a factor common to all, 0 for none."""

    first: IntArray
    second: IntArray
    measured: FloatArray
    information: FloatArray
    scale_sigma: float

    def residuals(self, poses: FloatArray, scale: float) -> FloatArray:
        """(M, 3) the poses' step minus the measured one, in the first's axes."""
        residuals = relative_pose(poses[self.first], poses[self.second]) - self.measured * [
            scale,
            scale,
            1.0,
        ]
        residuals[:, 2] = wrap_angle(residuals[:, 2])
        return residuals


def adjust_to_surfaces(
    poses_map_node: FloatArray,
    keyframe_points_m: Sequence[FloatArray],
    stamps_ns: IntArray,
    is_connected: BoolArray,
    steps_information: FloatArray,
    settings: SurfaceAdjustmentSettings,
    odometries: Sequence[OdometryTrajectory] = (),
    progress: Progress = silent,
) -> AdjustedPoses:
    """Adjust (K, 3) poses; the first one stays.

    ``keyframe_points_m``: K arrays (n, 2) in the frame of each. ``stamps_ns``: (K,).
    ``is_connected``: (K,) False keeps its pose and is no part of the map. ``steps_information``:
    (K - 1, 3, 3) of the graph's step from each keyframe to the next. ``odometries``: that share no
    measurement with the points.
    """
    taken = np.flatnonzero(is_connected)
    untouched = AdjustedPoses(poses_map_node=poses_map_node.copy())
    if settings.rounds == 0 or not 2 <= taken.size <= settings.keyframes_max:
        return untouched
    points_m = np.concatenate([keyframe_points_m[node] for node in taken.tolist()])
    node_of = np.repeat(
        np.arange(taken.size), [len(keyframe_points_m[node]) for node in taken.tolist()]
    )
    poses = poses_map_node[taken].copy()
    steps = [_graph_steps(poses, taken, steps_information)]
    steps += [_odometry_steps(track, stamps_ns[taken]) for track in odometries]
    scales, factors = [1.0] * len(steps), [1.0] * len(steps)
    is_adjusted = False
    for done in range(settings.rounds):
        progress(done, settings.rounds, "adjusting to surfaces")
        system = _System(poses, points_m, node_of, settings)
        if not system.has_surfaces:
            break
        for number, of in enumerate(steps):
            system.add_steps(number, of, scales[number], factors[number])
        poses, changes = system.solve(len(steps))
        scales = [scale + change for scale, change in zip(scales, changes, strict=True)]
        # The graph's own steps are declared, and not measured again.
        factors = [1.0] + [
            _widening(of, poses, scale) for of, scale in zip(steps[1:], scales[1:], strict=True)
        ]
        is_adjusted = True
    if not is_adjusted:
        return untouched
    adjusted = poses_map_node.copy()
    adjusted[taken] = poses
    return AdjustedPoses(
        poses_map_node=adjusted,
        odometry_names=tuple(track.name for track in odometries),
        odometry_scales=tuple(scales[1:]),
        odometry_factors=tuple(factors[1:]),
        is_adjusted=True,
    )


def _graph_steps(poses: FloatArray, taken: IntArray, information: FloatArray) -> _Steps:
    """The steps as they are between keyframes (n,), ``taken``, that follow each other."""
    first = np.flatnonzero(np.diff(taken) == 1)
    return _Steps(
        first=first,
        second=first + 1,
        measured=relative_pose(poses[first], poses[first + 1]),
        information=information[taken[first]],
        scale_sigma=0.0,
    )


def _odometry_steps(track: OdometryTrajectory, stamps_ns: IntArray) -> _Steps:
    """The steps between keyframes that it has measured."""
    at_nodes = resample_odometry(track, stamps_ns)
    first = np.flatnonzero(at_nodes.measured)
    information = np.asarray(np.linalg.inv(at_nodes.step_covariance[first]), dtype=np.float64)
    return _Steps(
        first=first,
        second=first + 1,
        measured=at_nodes.steps[first],
        information=information,
        scale_sigma=track.scale_sigma,
    )


def _chi2(of: _Steps, residuals: FloatArray) -> FloatArray:
    chi2: FloatArray = np.einsum("mi,mij,mj->m", residuals, of.information, residuals)
    return chi2


def _widening(of: _Steps, poses: FloatArray, scale: float) -> float:
    """How much larger the residuals of most steps are than their deviations, at least 1."""
    if not len(of.first):
        return 1.0
    middle = float(np.median(_chi2(of, of.residuals(poses, scale))))
    return max(1.0, float(np.sqrt(middle / _CHI2_MEDIAN)))


class _System:
    """The normal equations of one Gauss-Newton step at (K, 3) poses.

    Unknowns: 3 K of the poses (x, y, yaw in map axes), one for each side of each element, and one
    for the scale of each kind of steps.
    """

    def __init__(
        self,
        poses: FloatArray,
        points_m: FloatArray,
        node_of: IntArray,
        settings: SurfaceAdjustmentSettings,
    ) -> None:
        from scipy.sparse import csr_array, diags_array

        self._poses = poses
        origins_m = poses[node_of, :2]
        c, s = np.cos(poses[node_of, 2]), np.sin(poses[node_of, 2])
        turned_m = np.stack(
            [c * points_m[:, 0] - s * points_m[:, 1], s * points_m[:, 0] + c * points_m[:, 1]],
            axis=1,
        )
        in_map_m = origins_m + turned_m
        elements = find_surface_elements(in_map_m, settings)
        self.has_surfaces = len(elements) > 0
        if not self.has_surfaces:
            return
        found = associate_returns(elements, in_map_m, origins_m, settings)
        sizes = np.abs(found.residuals_m) / found.sigmas_m
        weights = found.sigmas_m**-2.0 * np.minimum(1.0, _HUBER / np.maximum(sizes, 1e-12))
        weights[sizes > _CUTOFF] = 0.0
        self._sides = 2 * len(elements)
        nodes, arms_m = node_of[found.returns], turned_m[found.returns]
        normals = _observable_normals(
            found.normals, found.normal_variances, weights, nodes, len(poses)
        )
        by_yaw = normals[:, 1] * arms_m[:, 0] - normals[:, 0] * arms_m[:, 1]
        rows = np.arange(len(found))
        jacobian = csr_array(
            (
                np.concatenate([normals[:, 0], normals[:, 1], by_yaw, -np.ones(rows.size)]),
                (
                    np.tile(rows, 4),
                    np.concatenate(
                        [3 * nodes, 3 * nodes + 1, 3 * nodes + 2, 3 * len(poses) + found.sides]
                    ),
                ),
            ),
            shape=(rows.size, 3 * len(poses) + self._sides),
        )
        self._normal = jacobian.T @ diags_array(weights) @ jacobian
        self._slope = jacobian.T @ (weights * found.residuals_m)
        self._steps: list[tuple[int, _Steps, float, float]] = []

    def add_steps(self, number: int, of: _Steps, scale: float, factor: float) -> None:
        """Steps at their scale, their deviations widened by a factor."""
        self._steps.append((number, of, scale, factor))

    def solve(self, kinds: int) -> tuple[FloatArray, list[float]]:
        """The poses after the step, and what it adds to the scale of each kind of steps."""
        from scipy.sparse import csc_array, diags_array
        from scipy.sparse.linalg import splu

        poses, inner = self._poses, len(self._slope)
        size = inner + kinds
        slope = np.concatenate([self._slope, np.zeros(kinds)])
        diagonal = np.full(size, _FREE_SIGMA**-2.0)
        diagonal[:3] = _ANCHOR_SIGMA**-2.0
        rows, columns, values = [], [], []
        for number, of, scale, factor in self._steps:
            place = inner + number
            diagonal[place] = (of.scale_sigma or _ANCHOR_SIGMA) ** -2.0
            slope[place] += (scale - 1.0) * diagonal[place]
            residuals = of.residuals(poses, scale)
            chi2 = _chi2(of, residuals) / factor**2
            weight = np.minimum(1.0, np.sqrt(_CHI2_MAX / np.maximum(chi2, 1e-12))) / factor**2
            information = weight[:, np.newaxis, np.newaxis] * of.information
            jacobian = _step_jacobian(of, poses)
            unknowns = np.concatenate(
                [
                    3 * of.first[:, np.newaxis] + np.arange(3),
                    3 * of.second[:, np.newaxis] + np.arange(3),
                    np.full((len(of.first), 1), place),
                ],
                axis=1,
            )
            np.add.at(
                slope, unknowns, np.einsum("mia,mij,mj->ma", jacobian, information, residuals)
            )
            values.append(np.einsum("mia,mij,mjb->mab", jacobian, information, jacobian).ravel())
            rows.append(np.repeat(unknowns, 7, axis=1).ravel())
            columns.append(np.tile(unknowns, (1, 7)).ravel())
        inside = self._normal.tocoo()
        values.append(inside.data)
        rows.append(inside.coords[0])
        columns.append(inside.coords[1])
        normal = csc_array(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
            shape=(size, size),
        ) + diags_array(diagonal)
        # Symmetric and positive definite: no pivoting is needed.
        factors = splu(
            csc_array(normal),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        change = factors.solve(-slope)
        moved = poses + change[: poses.size].reshape(-1, 3)
        moved[:, 2] = wrap_angle(moved[:, 2])
        # Anchored, but for rounding.
        moved[0] = poses[0]
        return moved, change[inner:].tolist()


def _observable_normals(
    normals: FloatArray,
    variances: FloatArray,
    weights: FloatArray,
    nodes: IntArray,
    count: int,
) -> FloatArray:
    """(N, 2) the normals without the direction of which a keyframe's returns say nothing.

    Along a corridor the normals' own errors look like a measurement: a direction is observable
    where the normals say much more of it than their variances (N,) do.
    """
    information = np.zeros((count, 2, 2))
    for row in range(2):
        for column in range(2):
            information[:, row, column] = np.bincount(
                nodes, weights * normals[:, row] * normals[:, column], count
            )
    by_error = np.bincount(nodes, weights * variances, count)
    values, axes = np.linalg.eigh(information)
    is_open = values[:, 0] < _OBSERVABLE_FACTOR * by_error
    open_axes = np.where(is_open[:, np.newaxis], axes[:, :, 0], 0.0)[nodes]
    along = np.einsum("nx,nx->n", normals, open_axes)
    observable: FloatArray = normals - along[:, np.newaxis] * open_axes
    return observable


def _step_jacobian(of: _Steps, poses: FloatArray) -> FloatArray:
    """(M, 3, 7) of the residuals by both poses and the scale."""
    first = poses[of.first]
    step = relative_pose(first, poses[of.second])
    c, s = np.cos(first[:, 2]), np.sin(first[:, 2])
    jacobian = np.zeros((len(first), 3, 7))
    jacobian[:, 0, 0], jacobian[:, 0, 1], jacobian[:, 0, 2] = -c, -s, step[:, 1]
    jacobian[:, 1, 0], jacobian[:, 1, 1], jacobian[:, 1, 2] = s, -c, -step[:, 0]
    jacobian[:, 0, 3], jacobian[:, 0, 4] = c, s
    jacobian[:, 1, 3], jacobian[:, 1, 4] = -s, c
    jacobian[:, 2, 2], jacobian[:, 2, 5] = -1.0, 1.0
    jacobian[:, :2, 6] = -of.measured[:, :2]
    return jacobian
