"""Where furniture may stand: inside the room, apart from each other, off the robot's route."""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.simulation.furniture import Footprint, ObjectMaker
from fusion_core.simulation.paths import closed_curve
from fusion_core.simulation.solids import Mesh, Opening, SolidObject

_MAX_ATTEMPTS = 60
_GAP_M = 0.08


class FloorPlan:
    """Places the furniture of a room.

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
        self.footprints: list[Footprint] = []
        self.meshes: list[Mesh] = []
        self.objects: list[SolidObject] = []
        self._rng = rng
        self._curve = closed_curve(route_m)
        self._clearance_m = clearance_m
        self._kept_free: list[Footprint] = []

    def place(self, footprint: Footprint, make: ObjectMaker) -> None:
        """Place a new object exactly here."""
        self.add(make(footprint, self._rng), footprint)

    def add(self, solid: SolidObject, footprint: Footprint) -> None:
        """Add an existing object; ``footprint`` bounds it."""
        self.footprints.append(footprint)
        self.meshes.append(solid.mesh)
        self.objects.append(solid)

    def add_mesh(self, mesh: Mesh) -> None:
        """Add a solid that does not stand on the floor, such as a lintel."""
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

    def place_against_wall(
        self,
        widths_m: tuple[float, float],
        depths_m: tuple[float, float],
        make: ObjectMaker,
        room: Footprint | None = None,
    ) -> None:
        """Place an object with its back to a wall where there is space; leave it out where not.

        ``room``: whose walls; those of the whole world where None.
        """
        low_x, low_y, far_x, far_y = (0.0, 0.0, *self.size_m) if room is None else room
        for _ in range(_MAX_ATTEMPTS):
            width, depth = self._rng.uniform(*widths_m), self._rng.uniform(*depths_m)
            side = int(self._rng.integers(4))
            start, end = ((low_x, far_x), (low_y, far_y))[side % 2]
            if width >= end - start:
                continue
            s0 = start + float(self._rng.uniform(0.0, end - start - width))
            s1 = s0 + width
            footprint = [
                (s0, low_y, s1, low_y + depth),
                (far_x - depth, s0, far_x, s1),
                (s0, far_y - depth, s1, far_y),
                (low_x, s0, low_x + depth, s1),
            ][side]
            if self._fits(footprint):
                self.place(footprint, make)
                return

    def place_freely(
        self,
        widths_m: tuple[float, float],
        depths_m: tuple[float, float],
        make: ObjectMaker,
        room: Footprint | None = None,
    ) -> None:
        """Place an object anywhere in a room where there is space; leave it out where not."""
        low_x, low_y, far_x, far_y = (0.0, 0.0, *self.size_m) if room is None else room
        for _ in range(_MAX_ATTEMPTS):
            width, depth = self._rng.uniform(*widths_m), self._rng.uniform(*depths_m)
            x0 = float(self._rng.uniform(low_x + 0.3, far_x - 0.3 - width))
            y0 = float(self._rng.uniform(low_y + 0.3, far_y - 0.3 - depth))
            footprint = (x0, y0, x0 + width, y0 + depth)
            if self._fits(footprint):
                self.place(footprint, make)
                return

    def _fits(self, footprint: Footprint) -> bool:
        x0, y0, x1, y1 = footprint
        for other in [*self.footprints, *self._kept_free]:
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
