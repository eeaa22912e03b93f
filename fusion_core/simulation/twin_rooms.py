"""Two rooms alike in shape, furniture and paint, side by side on a corridor.

What a camera or a LiDAR sees in the one it sees in the other, so that only the way between them
tells which is which: a test of loop closing. The corridor's own paint does not repeat. The same for
every seed.
"""

from functools import cache

import numpy as np

from fusion_core.simulation import textures
from fusion_core.simulation.obstacle_outlines import obstacle_outlines, outer_wall_edges
from fusion_core.simulation.office import FACES
from fusion_core.simulation.office_furniture import desk, office_chair, solid_box
from fusion_core.simulation.paint import paint_mesh
from fusion_core.simulation.painted_things import LARGE_TEXEL_M, paint_objects, paint_wall, texels
from fusion_core.simulation.paths import round_corners
from fusion_core.simulation.random_streams import RandomStream, make_generator
from fusion_core.simulation.solids import (
    Material,
    Mesh,
    Prism,
    SolidObject,
    join_meshes,
    quad,
    rectangle,
)
from fusion_core.simulation.textures import Texture
from fusion_core.simulation.worlds import CEILING_M, World

ROOM_M = (4.8, 4.2)
CORRIDOR_M = 1.8
_WALL_M = 0.1
SHIFT_M = ROOM_M[0] + _WALL_M
"""How far east of the first room the second one lies."""

_DOOR_M, _DOOR_TOP_M = (1.8, 3.0), 2.05
_PAINT_SEED = 20

# A rectangle of the world and what is painted on it.
_Surface = tuple[Mesh, Texture | None]
_Point = tuple[float, float]


def twin_rooms(seed: int) -> World:
    """The rooms and their corridor, the same for every seed."""
    return _twin_rooms()


@cache
def _twin_rooms() -> World:
    rng = make_generator(_PAINT_SEED, RandomStream.TEXTURES)
    size = (2.0 * ROOM_M[0] + _WALL_M, CORRIDOR_M + _WALL_M + ROOM_M[1])
    south_y = CORRIDOR_M + _WALL_M
    shell = _room_shell(rng)
    own = _furniture()
    paint = paint_objects(own, FACES, rng)
    meshes: list[Mesh] = []
    found: list[Texture | None] = []
    objects: list[SolidObject] = []
    for x in (0.0, SHIFT_M):
        moved = [solid.moved(x, south_y) for solid in own]
        objects += moved
        meshes += [_moved(mesh, x, south_y) for mesh, _ in shell]
        meshes += [solid.mesh for solid in moved]
        found += [texture for _, texture in shell] + paint
    corridor = _corridor(size, rng)
    locker = solid_box("cupboard", (4.3, CORRIDOR_M - 0.3, 5.2, CORRIDOR_M), 1.7, Material.WOOD)
    corridor_paint = paint_objects([locker], FACES, rng)
    meshes += [mesh for mesh, _ in corridor] + [locker.mesh]
    found += [texture for _, texture in corridor] + corridor_paint
    objects += [locker, *_inner_walls(size)]
    mesh = join_meshes(meshes)
    return World(
        size_m=size,
        mesh=mesh,
        blocks_m=np.array([_bounds(solid) for solid in objects]),
        route_m=round_corners(_route(south_y), 0.4),
        obstacles=obstacle_outlines(
            outer_wall_edges(size, ((), (), (), ()), CEILING_M), objects, size
        ),
        paint=paint_mesh(mesh, found),
    )


def _furniture() -> list[SolidObject]:
    """What stands in each room, in the frame of its south-western corner."""
    parts: list[SolidObject] = []
    for x, y in ((1.7, 1.45), (1.7, 2.16)):
        parts += desk((x, y, x + 1.4, y + 0.69), (x + 0.06, y + 0.1))
    return [
        *parts,
        solid_box("screen", (1.7, 2.14, 3.1, 2.16), 1.2, Material.FABRIC),
        solid_box("shelf", (0.6, 3.85, 1.8, 4.2), 1.8, Material.WOOD),
        solid_box("shelf", (0.0, 1.6, 0.35, 2.8), 1.8, Material.WOOD),
        solid_box("cupboard", (2.9, 3.8, 4.1, 4.2), 0.8, Material.WOOD),
        solid_box("stack of cartons", (4.35, 1.7, 4.8, 2.2), 0.7, Material.WOOD),
        solid_box("printer", (4.3, 0.0, 4.8, 0.45), 1.0, Material.DARK),
        solid_box("carton", (0.3, 0.0, 0.7, 0.35), 0.28, Material.WOOD),
        solid_box("bag", (4.5, 3.1, 4.8, 3.5), 0.2, Material.FABRIC),
        office_chair((2.5, 2.55), 0.4),
    ]


def _room_shell(rng: np.random.Generator) -> list[_Surface]:
    """Floor and walls of a room, seen from inside, in the frame of its south-western corner."""
    (width, depth), (door_0, door_1) = ROOM_M, _DOOR_M
    up = (0.0, 0.0, CEILING_M)
    floor = _carpet(width, depth, rng)
    lintel_m = CEILING_M - _DOOR_TOP_M
    plain: list[Mesh] = [
        quad((door_1, 0.0, _DOOR_TOP_M), (door_0 - door_1, 0, 0), (0, 0, lintel_m), Material.WALL),
        quad(
            (door_0, -_WALL_M, _DOOR_TOP_M), (door_1 - door_0, 0, 0), (0, _WALL_M, 0), Material.WALL
        ),
        quad((door_0, -_WALL_M, 0.0), (0, _WALL_M, 0), up, Material.WALL),
        quad((door_1, -_WALL_M, 0.0), (0, _WALL_M, 0), up, Material.WALL),
    ]
    return [
        (quad((0, 0, 0), (width, 0, 0), (0, depth, 0), Material.FLOOR), floor),
        _wall((0.0, 0.0), (0.0, depth), [0.5, 3.0], rng),
        _wall((0.0, depth), (width, depth), [1.9], rng),
        _wall((width, depth), (width, 0.0), [1.2, 2.7], rng),
        _wall((width, 0.0), (door_1, 0.0), [0.6], rng),
        _wall((door_0, 0.0), (0.0, 0.0), [0.2], rng),
        *((mesh, None) for mesh in plain),
    ]


def _corridor(size_m: tuple[float, float], rng: np.random.Generator) -> list[_Surface]:
    """Floor and walls of the corridor, and the ceiling over all."""
    width, depth = size_m
    far_y, (door_0, door_1) = CORRIDOR_M, _DOOR_M
    floor_m = far_y + _WALL_M
    carpet = _carpet(width, floor_m, rng)
    lintel = (0.0, 0.0, CEILING_M - _DOOR_TOP_M)
    ceiling = quad((0, 0, CEILING_M), (width, 0, 0), (0, depth, 0), Material.CEILING)
    lintels = [
        quad((x + door_0, far_y, _DOOR_TOP_M), (door_1 - door_0, 0, 0), lintel, Material.WALL)
        for x in (0.0, SHIFT_M)
    ]
    return [
        (quad((0, 0, 0), (width, 0, 0), (0, floor_m, 0), Material.FLOOR), carpet),
        _wall((width, 0.0), (0.0, 0.0), [1.0, 3.4, 7.0], rng),
        _wall((0.0, 0.0), (0.0, far_y), [0.5], rng),
        _wall((width, far_y), (width, 0.0), [0.4], rng),
        _wall((0.0, far_y), (door_0, far_y), [0.5], rng),
        _wall((door_1, far_y), (SHIFT_M + door_0, far_y), [0.3, 2.5], rng),
        _wall((SHIFT_M + door_1, far_y), (width, far_y), [0.4], rng),
        *((mesh, None) for mesh in (ceiling, *lintels)),
    ]


def _carpet(width_m: float, depth_m: float, rng: np.random.Generator) -> Texture:
    shape = texels(np.array([width_m]), np.array([depth_m]), LARGE_TEXEL_M)
    return textures.paint(textures.carpet, shape, rng)


def _wall(start: _Point, end: _Point, boards_m: list[float], rng: np.random.Generator) -> _Surface:
    """A wall that runs from its left to its right end as seen from the room, with boards."""
    along = (end[0] - start[0], end[1] - start[1], 0.0)
    length_m = float(np.hypot(along[0], along[1]))
    boards = [(s, float(rng.uniform(0.15, 0.3)), 0.7, 0.8) for s in boards_m if s < length_m - 0.8]
    texture = paint_wall(length_m, CEILING_M, boards, rng)
    return quad((*start, 0.0), along, (0.0, 0.0, CEILING_M), Material.WALL), texture


def _inner_walls(size_m: tuple[float, float]) -> list[SolidObject]:
    """The outlines of the walls between the rooms and the corridor; their surfaces are painted."""
    stops = [0.0, *_DOOR_M, *(SHIFT_M + s for s in _DOOR_M), size_m[0]]
    north_y = CORRIDOR_M + _WALL_M
    spans = [(x0, CORRIDOR_M, x1, north_y) for x0, x1 in zip(stops[::2], stops[1::2], strict=True)]
    spans.append((ROOM_M[0], north_y, SHIFT_M, size_m[1]))
    nothing = Mesh(np.zeros((0, 3, 3)), np.zeros(0, dtype=np.uint8))
    return [
        SolidObject("inner wall", nothing, (Prism(rectangle(span), (0.0, CEILING_M)),))
        for span in spans
    ]


def _route(south_y: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Round the first room, along the corridor, round the second, and back."""
    middle = 0.5 * sum(_DOOR_M)

    def visit(x: float, in_y: float, out_y: float) -> list[_Point]:
        near_y, far_y = south_y + 0.85, south_y + 3.3
        return [
            (x - 0.2, in_y),
            (x - 0.2, near_y),
            (x - 1.4, near_y),
            (x - 1.4, far_y),
            (x + 1.4, far_y),
            (x + 1.4, near_y),
            (x + 0.2, near_y),
            (x + 0.2, out_y),
        ]

    return np.array([*visit(middle, 0.6, 1.1), *visit(SHIFT_M + middle, 1.1, 0.6)])


def _bounds(solid: SolidObject) -> tuple[float, float, float, float]:
    corners = np.concatenate([prism.corners_m for prism in solid.prisms])
    (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
    return float(x0), float(y0), float(x1), float(y1)


def _moved(mesh: Mesh, x_m: float, y_m: float) -> Mesh:
    return Mesh(mesh.corners_m + np.array([x_m, y_m, 0.0]), mesh.materials)
