"""Paths of a robot: a closed route, and a smooth path that weaves along it."""

from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from fusion_core.model.conventions import FloatArray, wrap_angle

_STEP_M = 0.01
_WAYPOINT_STEP_M = 0.2


class RobotPath(Protocol):
    """Where a robot is at any time."""

    def pose(self, time_s: float) -> FloatArray:
        """(x, y, yaw) of the robot's base in the world."""
        ...


def closed_curve(waypoints_m: FloatArray) -> FloatArray:
    """(N, 2) points about a centimetre apart on the smooth closed curve through (W, 2) waypoints.

    The first point is not repeated at the end.
    """
    looped = np.concatenate([waypoints_m, waypoints_m[:1]])
    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(looped, axis=0), axis=1))])
    spline = CubicSpline(knots, looped, bc_type="periodic")
    count = int(np.ceil(knots[-1] / _STEP_M))
    curve: FloatArray = spline(np.arange(count) * (knots[-1] / count))
    return curve


def round_corners(corners_m: FloatArray, radius_m: float) -> FloatArray:
    """(W, 2) waypoints, at most 0.2 m apart, of a closed polygon (N, 2) with rounded corners.

    Where two corners are too near to each other for ``radius_m``, their arcs are smaller.
    """
    before = np.roll(corners_m, 1, axis=0) - corners_m
    after = np.roll(corners_m, -1, axis=0) - corners_m
    waypoints: list[FloatArray] = []
    for corner, back, ahead in zip(corners_m, before, after, strict=True):
        lengths = np.linalg.norm(back), np.linalg.norm(ahead)
        u, v = back / lengths[0], ahead / lengths[1]
        half = 0.5 * np.arccos(np.clip(u @ v, -1.0, 1.0))
        cut_m = min(radius_m / np.tan(half), 0.49 * min(lengths))
        # Seen from the arc's centre its two ends are pi - 2 * half apart.
        middle = (u + v) / np.linalg.norm(u + v) * (cut_m / np.cos(half))
        start, end = u * cut_m - middle, v * cut_m - middle
        opening = np.pi - 2.0 * half
        steps = max(2, int(np.ceil(opening * np.linalg.norm(start) / _WAYPOINT_STEP_M)))
        fraction = np.linspace(0.0, 1.0, steps + 1)[:, None]
        arc = np.sin((1.0 - fraction) * opening) * start + np.sin(fraction * opening) * end
        waypoints.append(corner + middle + arc / np.sin(opening))
    straight: list[FloatArray] = []
    for here, there in zip(waypoints, [*waypoints[1:], waypoints[0]], strict=True):
        gap = there[0] - here[-1]
        steps = max(1, int(np.ceil(np.linalg.norm(gap) / _WAYPOINT_STEP_M)))
        fraction = (np.arange(1, steps) / steps)[:, None]
        straight += [here, here[-1] + fraction * gap]
    return np.concatenate(straight)


class WeavingPath:
    """A path of constant speed along a closed route, weaving so that the robot turns both ways.

    A sideways sine of amplitude a and wavelength λ turns the heading by ±2πa/λ. The heading is
    the path's tangent, as of a robot on two wheels. A time delay between sensors shows only in
    such changes of the turning rate: under steady turning it looks like a yaw.
    """

    WEAVE_M = 0.07
    WAVELENGTH_M = 1.0

    def __init__(
        self,
        route_m: FloatArray,
        *,
        speed_m_s: float,
        start: float,
        weave_m: float = WEAVE_M,
        wavelength_m: float = WAVELENGTH_M,
    ) -> None:
        """``route_m``: (W, 2) waypoints; ``start`` in [0, 1): where on the route at time 0.

        ``length_m`` is that of one round. ``weave_m``, ``wavelength_m``: a and λ.
        """
        middle = closed_curve(route_m)
        ahead = np.roll(middle, -1, axis=0) - np.roll(middle, 1, axis=0)
        tangent = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        # A whole number of waves closes the path.
        waves = max(1, round(len(middle) * _STEP_M / wavelength_m))
        phase = np.arange(len(middle)) * (2.0 * np.pi * waves / len(middle))
        woven = middle + normal * (weave_m * np.sin(phase))[:, None]
        looped = np.concatenate([woven, woven[:1]])
        travelled = np.concatenate(
            [[0.0], np.cumsum(np.linalg.norm(np.diff(looped, axis=0), axis=1))]
        )
        self.length_m = float(travelled[-1])
        self._position = CubicSpline(travelled, looped, bc_type="periodic")
        self._tangent = self._position.derivative()
        self.speed_m_s = speed_m_s
        self._start_m = start * self.length_m

    def pose(self, time_s: float) -> FloatArray:
        """(x, y, yaw) of the robot's base in the world."""
        along = (self._start_m + self.speed_m_s * time_s) % self.length_m
        x, y = self._position(along)
        dx, dy = self._tangent(along)
        return np.array([x, y, wrap_angle(np.arctan2(dy, dx))])
