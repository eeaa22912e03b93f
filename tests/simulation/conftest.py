"""An empty room in which every distance has a closed form."""

from collections.abc import Sequence

import numpy as np
import pytest

from fusion_core.simulation.solids import Material, Mesh, join_meshes, quad, wall
from fusion_core.simulation.worlds import World

WIDTH, DEPTH, HEIGHT = 6.0, 4.0, 2.5


class StandingPath:
    """A robot that stays where it is put."""

    def __init__(self, x: float, y: float, yaw: float) -> None:
        self._pose = np.array([x, y, yaw])

    def pose(self, time_s: float) -> np.ndarray:
        return self._pose.copy()


class PlainRoom:
    """Makes a closed room of WIDTH x DEPTH x HEIGHT, with whatever else is put into it."""

    size_m = (WIDTH, DEPTH)

    def __call__(self, extra: Sequence[Mesh] = ()) -> World:
        corners = [(0.0, 0.0), (WIDTH, 0.0), (WIDTH, DEPTH), (0.0, DEPTH)]
        walls = [wall(corners[i], corners[(i + 1) % 4], HEIGHT) for i in range(4)]
        along_x, along_y = (WIDTH, 0, 0), (0, DEPTH, 0)
        floor = quad((0, 0, 0), along_x, along_y, Material.FLOOR)
        ceiling = quad((0, 0, HEIGHT), along_x, along_y, Material.CEILING)
        return World(
            size_m=self.size_m,
            mesh=join_meshes([floor, ceiling, *walls, *extra]),
            blocks_m=np.zeros((0, 4)),
            route_m=np.array([[2.0, 2.0], [4.0, 2.0], [3.0, 2.5]]),
        )

    def range_m(self, x: float, y: float, azimuth: np.ndarray) -> np.ndarray:
        """Distance to the walls along the floor, in closed form."""
        with np.errstate(divide="ignore"):
            to_x = np.where(np.cos(azimuth) > 0, WIDTH - x, -x) / np.cos(azimuth)
            to_y = np.where(np.sin(azimuth) > 0, DEPTH - y, -y) / np.sin(azimuth)
        return np.minimum(to_x, to_y)


@pytest.fixture(scope="session")
def plain_room() -> PlainRoom:
    return PlainRoom()


@pytest.fixture(scope="session")
def standing() -> type[StandingPath]:
    return StandingPath
