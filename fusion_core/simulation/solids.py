"""Solid shapes as triangles with materials: what worlds are made of.

The functions below build a ``Mesh`` from a few measures. The world frame has x and y in the floor
and z up, in metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray, read_only


class Material(IntEnum):
    """What a surface is made of; the sensor models treat DARK, GLASS and MIRROR specially."""

    WALL = 0
    FLOOR = 1
    CEILING = 2
    WOOD = 3
    FABRIC = 4
    DARK = 5
    GLASS = 6
    CLOTHES = 7
    MIRROR = 8


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles. ``corners_m``: (T, 3, 3), corner by corner; ``materials``: (T,) uint8."""

    corners_m: FloatArray
    materials: ByteArray

    def __post_init__(self) -> None:
        if self.corners_m.shape != (self.materials.size, 3, 3):
            raise ValueError(f"corners_m must be (T, 3, 3), got {self.corners_m.shape}")
        read_only(self.corners_m)
        read_only(self.materials)


@dataclass(frozen=True, slots=True)
class Opening:
    """A hole in a wall: from ``start_m`` to ``end_m`` along it, between two heights.

    A glazed opening is closed by a pane of glass in the wall's plane.
    """

    start_m: float
    end_m: float
    bottom_m: float
    top_m: float
    glazed: bool = False


@dataclass(frozen=True, slots=True)
class Prism:
    """An upright convex prism: its (K, 2) corners on the floor, anticlockwise, and its z range."""

    corners_m: FloatArray
    heights_m: tuple[float, float]

    def __post_init__(self) -> None:
        read_only(self.corners_m)


@dataclass(frozen=True, slots=True)
class SolidObject:
    """A named object: its surface, and the convex prisms that it consists of."""

    name: str
    mesh: Mesh
    prisms: tuple[Prism, ...]

    def renamed(self, name: str) -> "SolidObject":
        """The same object under another name."""
        return SolidObject(name, self.mesh, self.prisms)

    def moved(self, x_m: float, y_m: float) -> "SolidObject":
        """The same object elsewhere on the floor."""
        step = np.array([x_m, y_m])
        surface = self.mesh.corners_m.copy()
        surface[..., :2] += step
        prisms = tuple(Prism(prism.corners_m + step, prism.heights_m) for prism in self.prisms)
        return SolidObject(self.name, Mesh(surface, self.mesh.materials), prisms)

    def rotated(self, yaw_rad: float) -> "SolidObject":
        """The same object, rotated anticlockwise about the middle of its footprint's bounds."""
        corners = np.concatenate([prism.corners_m for prism in self.prisms])
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        c, s = np.cos(yaw_rad), np.sin(yaw_rad)
        rotation = np.array([[c, -s], [s, c]])

        def turn(points_m: FloatArray) -> FloatArray:
            turned: FloatArray = (points_m - middle) @ rotation.T + middle
            return turned

        surface = self.mesh.corners_m.copy()
        surface[..., :2] = turn(surface[..., :2])
        prisms = tuple(Prism(turn(prism.corners_m), prism.heights_m) for prism in self.prisms)
        return SolidObject(self.name, Mesh(surface, self.mesh.materials), prisms)


BoxSpec = tuple[Sequence[float], Sequence[float], Material]
"""Lowest corner, highest corner and material of a box along the axes."""


def make_object(name: str, blocks: Sequence[BoxSpec]) -> SolidObject:
    """An object made of axis-aligned boxes."""
    prisms = tuple(
        Prism(rectangle((lower[0], lower[1], upper[0], upper[1])), (lower[2], upper[2]))
        for lower, upper, _ in blocks
    )
    return SolidObject(name, join_meshes([box(*block) for block in blocks]), prisms)


def rectangle(footprint: tuple[float, float, float, float]) -> FloatArray:
    """(4, 2) corners of x0, y0, x1, y1, anticlockwise."""
    x0, y0, x1, y1 = footprint
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], dtype=np.float64)


def join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """All triangles of several meshes, in order."""
    return Mesh(
        np.concatenate([mesh.corners_m for mesh in meshes]),
        np.concatenate([mesh.materials for mesh in meshes]),
    )


def quad(
    corner_m: Sequence[float],
    edge_a_m: Sequence[float],
    edge_b_m: Sequence[float],
    material: Material,
) -> Mesh:
    """The parallelogram that two edges span from a corner."""
    start, a, b = np.array(corner_m), np.array(edge_a_m), np.array(edge_b_m)
    corners = np.array([[start, start + a, start + a + b], [start, start + a + b, start + b]])
    return Mesh(corners.astype(np.float64), np.full(2, material, dtype=np.uint8))


def box(lower_m: Sequence[float], upper_m: Sequence[float], material: Material) -> Mesh:
    """A box along the axes between its lowest and its highest corner."""
    x0, y0, z0 = lower_m
    x1, y1, z1 = upper_m
    along_x, along_y, along_z = (x1 - x0, 0, 0), (0, y1 - y0, 0), (0, 0, z1 - z0)
    return join_meshes(
        [
            quad((x0, y0, z0), along_x, along_y, material),
            quad((x0, y0, z1), along_x, along_y, material),
            quad((x0, y0, z0), along_x, along_z, material),
            quad((x0, y1, z0), along_x, along_z, material),
            quad((x0, y0, z0), along_y, along_z, material),
            quad((x1, y0, z0), along_y, along_z, material),
        ]
    )


def column(
    center_m: tuple[float, float],
    radii_m: tuple[float, float],
    heights_m: tuple[float, float],
    yaw_rad: float,
    material: Material,
) -> Mesh:
    """An upright elliptic column of ten sides, open below, closed above."""
    sides = 10
    angle = np.arange(sides + 1) * (2.0 * np.pi / sides)
    along, across = radii_m[0] * np.cos(angle), radii_m[1] * np.sin(angle)
    x = center_m[0] + along * np.cos(yaw_rad) - across * np.sin(yaw_rad)
    y = center_m[1] + along * np.sin(yaw_rad) + across * np.cos(yaw_rad)
    bottom = np.stack([x, y, np.full_like(x, heights_m[0])], axis=1)
    top = np.stack([x, y, np.full_like(x, heights_m[1])], axis=1)
    middle = np.broadcast_to(np.array([*center_m, heights_m[1]]), (sides, 3))
    corners = np.concatenate(
        [
            np.stack([bottom[:-1], bottom[1:], top[1:]], axis=1),
            np.stack([bottom[:-1], top[1:], top[:-1]], axis=1),
            np.stack([top[:-1], top[1:], middle], axis=1),
        ]
    )
    return Mesh(corners, np.full(len(corners), material, dtype=np.uint8))


def wall(
    start_m: tuple[float, float],
    end_m: tuple[float, float],
    height_m: float,
    openings: Sequence[Opening] = (),
) -> Mesh:
    """A wall without thickness from one point of the floor to another, with openings in order."""
    start, end = np.array(start_m, dtype=np.float64), np.array(end_m, dtype=np.float64)
    length = float(np.linalg.norm(end - start))
    direction = (end - start) / length

    def panel(s0: float, s1: float, z0: float, z1: float, material: Material) -> list[Mesh]:
        if s1 - s0 <= 0.0 or z1 - z0 <= 0.0:
            return []
        corner, along = start + direction * s0, direction * (s1 - s0)
        return [
            quad((corner[0], corner[1], z0), (along[0], along[1], 0), (0, 0, z1 - z0), material)
        ]

    panels: list[Mesh] = []
    done = 0.0
    for opening in openings:
        s0, s1 = opening.start_m, opening.end_m
        panels += panel(done, s0, 0.0, height_m, Material.WALL)
        panels += panel(s0, s1, 0.0, opening.bottom_m, Material.WALL)
        panels += panel(s0, s1, opening.top_m, height_m, Material.WALL)
        if opening.glazed:
            panels += panel(s0, s1, opening.bottom_m, opening.top_m, Material.GLASS)
        done = s1
    return join_meshes([*panels, *panel(done, length, 0.0, height_m, Material.WALL)])
