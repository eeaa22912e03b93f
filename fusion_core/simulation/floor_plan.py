"""Where furniture may stand: inside the room, apart from each other, off the robot's route."""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.simulation.furniture import Footprint, Maker
from fusion_core.simulation.paths import closed_curve
from fusion_core.simulation.solids import Mesh, Opening

_TRIES = 60
_GAP_M = 0.08


class FloorPlan:
    """Collects the furniture of a room while it is planned.

    ``route_m``: (W, 2) waypoints of the route. ``clearance_m``: the least distance between the
    route and any furniture.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        size_m: tuple[float, float],
        route_m: FloatArray,
        *,
        clearance_m: float,
    ) -> None:
        self.size_m = size_m
        self.route_m = route_m
        self.blocks: list[Footprint] = []
        self.meshes: list[Mesh] = []
        self._rng = rng
        self._curve = closed_curve(route_m)
        self._clearance_m = clearance_m
        self._kept_free: list[Footprint] = []

    def place(self, footprint: Footprint, make: Maker) -> None:
        """Put a piece exactly here."""
        self.blocks.append(footprint)
        self.meshes.append(make(footprint, self._rng))

    def add_mesh(self, mesh: Mesh) -> None:
        """Add what stands on no floor, such as a lintel."""
        self.meshes.append(mesh)

    def keep_free(self, footprint: Footprint) -> None:
        """Let nothing be placed here by chance."""
        self._kept_free.append(footprint)

    def keep_open(self, openings: Sequence[Sequence[Opening]]) -> None:
        """Let nothing be placed by chance in front of a wall's doors and windows."""
        width, depth = self.size_m
        for side, holes in enumerate(openings):
            for hole in holes:
                s0, s1 = hole.start_m, hole.end_m
                strips = [
                    (s0, 0.0, s1, 0.7),
                    (width - 0.7, s0, width, s1),
                    (width - s1, depth - 0.7, width - s0, depth),
                    (0.0, depth - s1, 0.7, depth - s0),
                ]
                self.keep_free(strips[side])

    def against_wall(
        self, widths_m: tuple[float, float], depths_m: tuple[float, float], make: Maker
    ) -> None:
        """Put a piece with its back to a wall where there is room; leave it out where not."""
        for _ in range(_TRIES):
            width, depth = self._rng.uniform(*widths_m), self._rng.uniform(*depths_m)
            side = int(self._rng.integers(4))
            along = self.size_m[side % 2]
            if width >= along:
                continue
            s0 = float(self._rng.uniform(0.0, along - width))
            s1 = s0 + width
            far_x, far_y = self.size_m
            footprint = [
                (s0, 0.0, s1, depth),
                (far_x - depth, s0, far_x, s1),
                (s0, far_y - depth, s1, far_y),
                (0.0, s0, depth, s1),
            ][side]
            if self._fits(footprint):
                self.place(footprint, make)
                return

    def standing_free(
        self, widths_m: tuple[float, float], depths_m: tuple[float, float], make: Maker
    ) -> None:
        """Put a piece anywhere in the room where there is space; leave it out where not."""
        for _ in range(_TRIES):
            width, depth = self._rng.uniform(*widths_m), self._rng.uniform(*depths_m)
            x0 = float(self._rng.uniform(0.3, self.size_m[0] - 0.3 - width))
            y0 = float(self._rng.uniform(0.3, self.size_m[1] - 0.3 - depth))
            footprint = (x0, y0, x0 + width, y0 + depth)
            if self._fits(footprint):
                self.place(footprint, make)
                return

    def _fits(self, footprint: Footprint) -> bool:
        x0, y0, x1, y1 = footprint
        for other in [*self.blocks, *self._kept_free]:
            apart_x = x0 > other[2] + _GAP_M or x1 < other[0] - _GAP_M
            apart_y = y0 > other[3] + _GAP_M or y1 < other[1] - _GAP_M
            if not (apart_x or apart_y):
                return False
        return distance_to_footprint(self._curve, footprint) >= self._clearance_m


def distance_to_footprint(points_m: FloatArray, footprint: Sequence[float]) -> float:
    """The least distance from (N, 2) points to a rectangle x0, y0, x1, y1; 0 inside."""
    x0, y0, x1, y1 = footprint
    outside_x = np.maximum(np.maximum(x0 - points_m[:, 0], points_m[:, 0] - x1), 0.0)
    outside_y = np.maximum(np.maximum(y0 - points_m[:, 1], points_m[:, 1] - y1), 0.0)
    return float(np.hypot(outside_x, outside_y).min())
