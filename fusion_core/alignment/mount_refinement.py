"""The mount's place in the LiDAR's plane, by the distances of depth pixels from the scan's lines.

Around a mount that is nearly right, the pixel under a projected LiDAR point is of the same surface.
Walls and furniture are upright: the pixel's point, laid into the LiDAR's plane, is on the line that
the scan draws there, and its distance from that line is the residual (the metric of Censi 2008). It
is nearly linear in the mount, so that Gauss-Newton finds the optimum, and symmetric about it:
occlusion, holes and the edges of the image do not pull. Depth cameras measure all lengths a little
long or short: that factor is found along.

An upright surface shows neither Delta z nor pitch, only how they move the camera's sight along with
``forward_m``: both are held here.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.alignment.mount_cost import MountCost, points_at_image, turn_points
from fusion_core.alignment.mount_settings import MountPriors
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.rig import Mount
from fusion_core.model.robust import MAD_TO_SIGMA, robust_sigma, welsch_weight

IN_PLANE = np.array([0, 2, 3, 5])
"""Of MOUNT_PARAMETERS: yaw, forward, left, clock offset. The depths' stretch follows them."""

_UNKNOWNS = IN_PLANE.size + 1
# Of these, the clock offset, and the others.
_CLOCK, _NOT_CLOCK = 3, [0, 1, 2, 4]

# Neighbours on each side that a line is fitted to: some 17 points have a quarter of one's noise.
_NEIGHBOURS = 8
# Neighbours farther off than this many tolerances, and lines thicker than one half, are no line.
_NEIGHBOUR_TOLERANCES = 5.0
_LINE_TOLERANCES = 0.6
# Below this cosine between ray and normal a pixel is as wide as the noise on the surface.
_LEAST_COSINE = 0.2
# Residuals that are all but zero have no scale: it is no smaller, in tolerances.
_LEAST_NOISE = MAD_TO_SIGMA * 1e-6
# The start is off by more than the noise: its scale is taken wider at first.
_ANNEALING = (4.0, 2.0)
_MAX_ITERATIONS = 15
# A step this small against the deviation changes nothing.
_LAST_STEP_SD = 0.02
# A fit whose residuals have grown by this factor since its start has run away.
_RUN_AWAY = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class LineResiduals:
    """What one mount leaves, of the points whose pixel is on the scan's line.

    ``values``: (N,) in tolerances along the camera's ray; ``jacobian``: (N, 5) by IN_PLANE and
    the stretch. ``line_error``, ``rate_error``: (N, 5) standard deviation of the jacobian for the
    errors of the line's direction and of the turn rate. ``frame``, ``place``: (N,) when and where
    along the curve.
    """

    values: FloatArray
    jacobian: FloatArray
    line_error: FloatArray
    rate_error: FloatArray
    frame: IntArray
    place: IntArray

    def __post_init__(self) -> None:
        for array in (self.values, self.jacobian, self.line_error, self.rate_error):
            read_only(array)
        read_only(self.frame)
        read_only(self.place)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneFit:
    """A refined mount, (6,) as MOUNT_PARAMETERS, and what its deviations are made from.

    ``stretch``: by which depths are too long, as a fraction. ``residuals``: (N,) in tolerances,
    ``noise`` their standard deviation. ``scores``: (N, 5) gradients of the points' log likelihoods;
    ``information``: (N, 5, 5) their curvatures; ``prior``: (5, 5) information of the prior.
    """

    values: FloatArray
    stretch: float
    residuals: FloatArray
    scores: FloatArray
    information: FloatArray
    prior: FloatArray
    frame: IntArray
    place: IntArray
    noise: float

    @property
    def yaw_per_delay_rad_s(self) -> float:
        """By how much the best yaw turns with the clock offset, the other parameters following."""
        total = self.prior + self.information.sum(axis=0)
        moved = -np.linalg.solve(total[np.ix_(_NOT_CLOCK, _NOT_CLOCK)], total[_NOT_CLOCK, _CLOCK])
        return 1e3 * float(moved[0])


class ScanLines:
    """The points of all frames that lie on a line of their scan."""

    def __init__(self, problem: MountCost) -> None:
        self._problem = problem
        normals, sd_rad = fit_lines(
            problem.points,
            problem.frame_of_point,
            problem.tolerance_at(np.hypot(*problem.points.T)),
        )
        on_line = np.isfinite(sd_rad)
        self._points = problem.points[on_line]
        self._normals = normals[on_line]
        self._normal_sd_rad = sd_rad[on_line]
        self._frame = problem.frame_of_point[on_line]
        self._place = problem.places()[on_line]

    def residuals(self, values: FloatArray, stretch: float = 0.0) -> LineResiduals:
        """The residuals of one mount (6,), with depths that are too long by ``stretch``."""
        problem, mount = self._problem, Mount.from_vector(values)
        moved = problem.moved(mount)[self._frame]
        points = points_at_image(self._points, moved)
        normals = turn_points(self._normals, -moved[:, 2])
        T_lidar_camera = mount.T_lidar_rig @ problem.T_rig_camera
        index, rays, seen_m = problem.look_up(points, self._frame, T_lidar_camera)
        frame, point, normal = self._frame[index], points[index], normals[index]
        R = T_lidar_camera[frame, :2, :3]
        ray = np.einsum("nij,nj->ni", R, rays)
        seen_m = seen_m / (1.0 + stretch)
        pixel = ray * seen_m[:, None] + T_lidar_camera[frame, :2, 3]
        cosine = np.abs(_dot(ray, normal))
        kept = cosine > _LEAST_COSINE * np.linalg.norm(ray, axis=1)
        index, frame, point, normal = index[kept], frame[kept], point[kept], normal[kept]
        pixel, cosine, seen_m, ray = pixel[kept], cosine[kept], seen_m[kept], ray[kept]
        scale = cosine * problem.tolerance_at(seen_m)
        arm = pixel - [mount.forward_m, mount.left_m]
        # Metres and radians in a millisecond.
        drive, turn = 1e-3 * problem.velocities[frame, :2], 1e-3 * problem.velocities[frame, 2]
        rate_error = np.zeros((index.size, _UNKNOWNS))
        turn_sd = 1e-3 * problem.turn_rate_sd_rad_s[frame]
        rate_error[:, 3] = turn_sd * _cross(normal, point) / scale

        def derivative(direction: FloatArray) -> FloatArray:
            columns = [
                _cross(direction, arm),
                direction[:, 0],
                direction[:, 1],
                -turn * _cross(direction, point) - _dot(direction, drive),
                -seen_m * _dot(ray, direction),
            ]
            stacked: FloatArray = np.stack(columns, axis=1) / scale[:, None]
            return stacked

        along = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
        return LineResiduals(
            values=_dot(pixel - point, normal) / scale,
            jacobian=derivative(normal),
            line_error=derivative(along) * self._normal_sd_rad[index, None],
            rate_error=rate_error,
            frame=frame,
            place=self._place[index],
        )


def refine_in_plane(
    lines: ScanLines, start: FloatArray, priors: MountPriors, free: BoolArray
) -> PlaneFit | None:
    """Iteratively reweighted Gauss-Newton from ``start`` (6,) over the ``free`` of IN_PLANE.

    None where hardly more points than parameters are on lines, and where it runs away: at a wrong
    height the pixels may be of table tops, which are not upright.
    """
    values, stretch, noise, noise_at_start = start.copy(), 0.0, 1.0, np.inf
    prior = np.diag(1.0 / np.append(priors.sd[IN_PLANE], priors.stretch_sd) ** 2)
    moved = np.append(free, True)
    for iteration in range(_MAX_ITERATIONS):
        residuals = lines.residuals(values, stretch)
        if residuals.values.size < 4 * _UNKNOWNS:
            return None
        noise = max(robust_sigma(residuals.values), _LEAST_NOISE)
        if iteration == 0:
            noise_at_start = noise
        widened = noise * (_ANNEALING[iteration] if iteration < len(_ANNEALING) else 1.0)
        scores, weight = _linearize(residuals, widened)
        J = residuals.jacobian
        curvature = (prior + J.T @ (J * weight[:, None]))[np.ix_(moved, moved)]
        from_prior = np.append((values - priors.centre)[IN_PLANE], stretch)
        gradient = scores.sum(axis=0) - prior @ from_prior
        step = np.zeros(_UNKNOWNS)
        step[moved] = np.linalg.solve(curvature, gradient[moved])
        values[IN_PLANE] += step[:-1]
        stretch += float(step[-1])
        sd = np.sqrt(np.diag(np.linalg.inv(curvature)))
        if iteration >= len(_ANNEALING) and (np.abs(step[moved]) < _LAST_STEP_SD * sd).all():
            break
    if noise > _RUN_AWAY * noise_at_start:
        return None
    residuals = lines.residuals(values, stretch)
    scores, weight = _linearize(residuals, noise)
    return PlaneFit(
        values=values,
        stretch=stretch,
        residuals=residuals.values,
        scores=scores,
        information=_information(residuals, weight),
        prior=prior,
        frame=residuals.frame,
        place=residuals.place,
        noise=noise,
    )


def _linearize(residuals: LineResiduals, noise: float) -> tuple[FloatArray, FloatArray]:
    """(N, 5) scores and (N,) weights of Welsch's loss."""
    weight = welsch_weight(residuals.values, noise) / noise**2
    return -(weight * residuals.values)[:, None] * residuals.jacobian, weight


def _information(residuals: LineResiduals, weight: FloatArray) -> FloatArray:
    """(N, 5, 5) information of each point. What the errors of lines and turn rates add to the
    squares of the jacobian is none, and is taken out."""
    J, L, R = residuals.jacobian, residuals.line_error, residuals.rate_error
    squares = (one[:, :, None] * one[:, None, :] for one in (J, L, R))
    true, of_lines, of_rates = squares
    information: FloatArray = weight[:, None, None] * (true - of_lines - of_rates)
    return information


def fit_lines(
    points_m: FloatArray, frame: IntArray, tolerance_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N, 2) unit normals of the lines through the points' neighbours in their scan, and (N,) the
    standard deviation of their directions, NaN where the neighbours are on no line.

    ``frame``: (N,) of each point; ``tolerance_m``: (N,) at each.
    """
    count = points_m.shape[0]
    sums = np.zeros((count, 6))
    for offset in range(-_NEIGHBOURS, _NEIGHBOURS + 1):
        other = np.clip(np.arange(count) + offset, 0, count - 1)
        apart = points_m[other] - points_m
        near = np.hypot(*apart.T) < _NEIGHBOUR_TOLERANCES * tolerance_m
        near &= (frame[other] == frame) & (other == np.arange(count) + offset)
        x, y = apart.T
        terms = np.stack([np.ones(count), x, y, x * x, x * y, y * y], axis=1)
        sums += np.where(near[:, None], terms, 0.0)
    n, x, y, xx, xy, yy = sums.T
    n = np.maximum(n, 1.0)
    xx, xy, yy = xx / n - (x / n) ** 2, xy / n - x * y / n**2, yy / n - (y / n) ** 2
    spread = np.hypot(0.5 * (xx - yy), xy)
    long, short = 0.5 * (xx + yy) + spread, np.maximum(0.5 * (xx + yy) - spread, 0.0)
    direction = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    # The variance of a slope, with two parameters of the line taken from the points.
    degrees = np.maximum(n - 2.0, 1.0)
    sd_rad = np.sqrt(short / degrees / np.maximum(long, 1e-12))
    is_line = (n >= _NEIGHBOURS) & (np.sqrt(short) < _LINE_TOLERANCES * tolerance_m)
    is_line &= long > 9.0 * short
    normals = np.stack([-np.sin(direction), np.cos(direction)], axis=1)
    return normals, np.where(is_line, sd_rad, np.nan)


def _dot(first: FloatArray, second: FloatArray) -> FloatArray:
    total: FloatArray = (first * second).sum(axis=1)
    return total


def _cross(direction: FloatArray, arm: FloatArray) -> FloatArray:
    """How fast ``arm`` moves along ``direction`` under a turn about the origin."""
    moved: FloatArray = direction[:, 1] * arm[:, 0] - direction[:, 0] * arm[:, 1]
    return moved
