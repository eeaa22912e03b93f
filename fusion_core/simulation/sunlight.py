"""Daylight outside, and sun through the windows: bright patches that stay where they are."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, read_only

# A ray towards the sun ends this far inside the window, so that the pane does not block it.
_INSIDE_M = 0.02
# Points this near to the plane of an outer wall lie on it.
_WALL_M = 0.001


@dataclass(frozen=True, slots=True, kw_only=True)
class Sunlight:
    """Parallel light through rectangular windows of a building, outside of which it is day.

    ``direction``: (3,) unit, the way that the light travels. ``windows_m``: (W, 3, 3) of each
    window a corner and its two edges. ``size_m``: the building spans 0…size in x and y.
    """

    direction: FloatArray
    windows_m: FloatArray
    size_m: tuple[float, float]

    def __post_init__(self) -> None:
        if self.direction.shape != (3,) or self.windows_m.shape[1:] != (3, 3):
            raise ValueError("direction must be (3,) and windows_m (W, 3, 3)")
        read_only(self.direction)
        read_only(self.windows_m)

    def is_outside(self, points_m: FloatArray) -> BoolArray:
        """(N,) whether a point (N, 3) lies outside the building."""
        flat = points_m[:, :2]
        beyond = (flat < -_WALL_M) | (flat > np.array(self.size_m) + _WALL_M)
        outside: BoolArray = beyond[:, 0] | beyond[:, 1]
        return outside

    def source_of_light(self, points_m: FloatArray) -> tuple[BoolArray, FloatArray]:
        """(N,) whether the way from a point (N, 3) to the sun leads through a window, and (N, 3)
        where it does, just inside (the point itself elsewhere).

        Whether something stands in the way is for the ray caster to say.
        """
        through = np.zeros(len(points_m), dtype=np.bool_)
        source_m = points_m.copy()
        for corner, along, up in self.windows_m:
            normal = np.cross(along, up)
            slope = float(self.direction @ normal)
            if slope == 0.0:
                continue
            travelled_m = (points_m - corner) @ normal / slope
            in_pane = points_m - travelled_m[:, None] * self.direction - corner
            a, b = in_pane @ along / (along @ along), in_pane @ up / (up @ up)
            enters = (travelled_m > 2.0 * _INSIDE_M) & (np.abs(a - 0.5) <= 0.5)
            enters &= (np.abs(b - 0.5) <= 0.5) & ~through
            back_m = (travelled_m[enters] - _INSIDE_M)[:, None] * self.direction
            source_m[enters] = points_m[enters] - back_m
            through |= enters
        return through, source_m
