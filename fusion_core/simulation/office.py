"""A medium-sized office, after the experiment of Fu 2024, section 4.2.2, and two rooms alike.

The paper shows the office in a photograph and gives no measures: all of them are ours. What it
says is that a LiDAR misses the small obstacles on the floor. Here those are 5 to 30 cm high, below
the LiDAR's plane at 0.40 m. Desks leave the floor under them free; what a robot could run into are
their legs, drawers and the screens between them. The same for every seed, so that maps can be
compared.
"""

from dataclasses import replace
from functools import cache

import numpy as np

from fusion_core.model.world_outline import MeasuredAngle, MeasuredLine
from fusion_core.simulation import textures
from fusion_core.simulation.floor_plan import FloorPlan
from fusion_core.simulation.furniture import Footprint
from fusion_core.simulation.office_furniture import desk, office_chair, solid_box
from fusion_core.simulation.paint import paint_mesh
from fusion_core.simulation.painted_things import (
    LARGE_TEXEL_M,
    Faces,
    paint_objects,
    paint_wall,
    quad_edges,
    texels,
)
from fusion_core.simulation.paths import round_corners
from fusion_core.simulation.random_streams import RandomStream, make_generator
from fusion_core.simulation.solids import Material, Opening, SolidObject, join_meshes
from fusion_core.simulation.textures import Texture
from fusion_core.simulation.worlds import World, build_world

SIZE_M = (8.4, 6.6)
# The seed of what is painted: the office is the same in each recording.
_PAINT_SEED = 19

FACES: dict[str, Faces] = {
    "desk": (textures.wood, textures.wood),
    "drawers": (textures.wood, None),
    "screen": (textures.picture, None),
    "shelf": (textures.books, None),
    "cupboard": (textures.wood, None),
    "printer": (None, None),
    "chair": (textures.cloth, textures.cloth),
    "bin": (None, None),
    "stack of cartons": (textures.poster, textures.poster),
    "carton": (textures.poster, textures.poster),
    "parcel": (textures.poster, textures.poster),
    "toolbox": (textures.picture, None),
    "step": (textures.wood, textures.wood),
    "pile of books": (textures.books, textures.poster),
    "bag": (textures.cloth, textures.cloth),
    "paper": (None, textures.poster),
    "cable duct": (None, None),
}

# Footprint and height of what stands on the floor below the LiDAR's plane: against a wall, or
# where the route leads round it.
_LOW: tuple[tuple[str, Footprint, float, Material], ...] = (
    ("cable duct", (2.55, 0.0, 2.63, 0.5), 0.05, Material.WALL),
    ("paper", (4.72, 3.1, 4.94, 3.41), 0.1, Material.WALL),
    ("pile of books", (0.0, 2.2, 0.22, 2.5), 0.14, Material.WOOD),
    ("parcel", (5.3, 6.2, 5.85, 6.6), 0.18, Material.WOOD),
    ("toolbox", (8.1, 4.5, 8.4, 5.0), 0.22, Material.FABRIC),
    ("step", (5.75, 0.0, 6.15, 0.35), 0.25, Material.WOOD),
    ("bag", (2.6, 6.3, 3.05, 6.6), 0.28, Material.FABRIC),
    ("carton", (2.2, 4.62, 2.55, 4.9), 0.3, Material.WOOD),
)


@cache
def _office() -> World:
    width, depth = SIZE_M
    # Up the middle, round the desks in the west, up the middle again, round those in the east.
    west, middle, east, south, north = 1.2, 4.2, 7.2, 1.25, 5.35
    lane = [(middle, south), (middle, north), (west, north), (west, south)]
    lane += [(middle, south), (middle, north), (east, north), (east, south)]
    plan = FloorPlan(
        # Nothing is placed by chance.
        make_generator(0, RandomStream.WORLD),
        SIZE_M,
        round_corners(np.array(lane), 0.7),
        clearance_m=0.3,
    )
    # Two blocks of four desks, two and two face to face, with a screen between them.
    for x in (2.05, 4.95):
        for y in (2.0, 3.3):
            for side, desk_x in enumerate((x, x + 0.71)):
                drawers = (desk_x + 0.05, y + 0.05 + 0.8 * side)
                for part in desk((desk_x, y, desk_x + 0.69, y + 1.3), drawers):
                    _put(plan, part)
        _put(plan, solid_box("screen", (x + 0.69, 2.0, x + 0.71, 4.6), 1.2, Material.FABRIC))
    _put(plan, office_chair((1.85, 3.0), 0.3))
    _put(plan, office_chair((6.55, 2.5), 0.9))
    # Along the walls.
    _put(plan, solid_box("shelf", (2.9, 0.0, 4.1, 0.35), 1.8, Material.WOOD))
    _put(plan, solid_box("shelf", (4.1, 0.0, 5.3, 0.35), 1.8, Material.WOOD))
    _put(plan, solid_box("printer", (7.85, 0.0, 8.4, 0.6), 1.0, Material.DARK))
    _put(plan, solid_box("cupboard", (7.95, 2.4, 8.4, 3.6), 1.1, Material.WOOD))
    _put(plan, solid_box("stack of cartons", (7.9, 6.2, 8.4, 6.6), 0.75, Material.WOOD))
    _put(plan, solid_box("cupboard", (6.1, 6.2, 7.3, 6.6), 0.8, Material.WOOD))
    _put(plan, solid_box("bin", (0.0, 1.5, 0.3, 1.8), 0.5, Material.DARK))
    _put(plan, solid_box("shelf", (0.0, 3.0, 0.35, 4.2), 1.8, Material.WOOD))
    _put(plan, solid_box("stack of cartons", (0.0, 6.1, 0.5, 6.6), 0.6, Material.WOOD))
    for name, footprint, height_m, material in _LOW:
        _put(plan, solid_box(name, footprint, height_m, material))
    openings = ((), (), (Opening(3.6, 6.6, 0.9, 2.1, glazed=True),), ())
    lines = (
        _line("line 1", ((0.0, 0.2), (0.0, 1.4)), ((width, 0.8), (width, 2.3))),
        _line("line 2", ((0.3, 0.0), (2.4, 0.0)), ((0.7, depth), (2.5, depth))),
    )
    angles = (
        _angle("angle a", ((0.0, 0.0), (2.4, 0.0)), ((0.0, 0.0), (0.0, 1.4))),
        _angle("angle b", ((0.0, depth), (2.5, depth)), ((0.0, depth), (0.0, 4.3))),
    )
    world = build_world(plan, openings, lines=lines, angles=angles)
    return _painted(world, plan.objects)


def office(seed: int) -> World:
    """The office, the same for every seed."""
    return _office()


def _painted(world: World, objects: list[SolidObject]) -> World:
    """The world with its floor, walls and objects painted. The shell comes first in its mesh."""
    rng = make_generator(_PAINT_SEED, RandomStream.TEXTURES)
    found: list[Texture | None] = []
    own = join_meshes([solid.mesh for solid in objects])
    shell = len(world.mesh.materials) - len(own.materials)
    middle = np.array([*world.size_m, 0.0]) / 2.0
    for (corner, a, b), material in zip(
        quad_edges(world.mesh)[: shell // 2], world.mesh.materials[:shell:2], strict=True
    ):
        inside = np.all((corner[:2] >= -1e-9) & (corner[:2] <= np.array(world.size_m) + 1e-9))
        if material == Material.FLOOR:
            found.append(textures.paint(textures.carpet, texels(a, b, LARGE_TEXEL_M), rng))
        elif material == Material.WALL and inside and corner[2] == 0.0:
            length, height = float(np.linalg.norm(a)), float(np.linalg.norm(b))
            texture = paint_wall(length, height, _boards(length, height, rng), rng)
            inwards = middle - corner - 0.5 * (a + b)
            seen_right = np.cross(a, b) @ inwards > 0.0
            found.append(texture if seen_right else textures.mirrored(texture))
        else:
            found.append(None)
    found += paint_objects(objects, FACES, rng)
    return replace(world, paint=paint_mesh(world.mesh, found))


def _boards(
    length_m: float, height_m: float, rng: np.random.Generator
) -> list[tuple[float, float, float, float]]:
    """A board on every second stretch of some two metres of wall; the others stay plain."""
    boards = []
    along_m = float(rng.uniform(0.3, 0.9))
    while along_m + 1.0 < length_m:
        width_m = float(rng.uniform(0.6, 0.9))
        bottom_m = float(rng.uniform(0.15, 0.3))
        boards.append((along_m, bottom_m, width_m, min(0.9, height_m - bottom_m - 0.1)))
        along_m += float(rng.uniform(1.7, 2.4))
    return boards


def _put(plan: FloorPlan, thing: SolidObject) -> None:
    corners = np.concatenate([prism.corners_m for prism in thing.prisms])
    (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
    plan.add(thing, (float(x0), float(y0), float(x1), float(y1)))


_Segment = tuple[tuple[float, float], tuple[float, float]]


def _line(name: str, first: _Segment, second: _Segment) -> MeasuredLine:
    return MeasuredLine(name=name, faces_m=np.array([first, second], dtype=np.float64))


def _angle(name: str, first: _Segment, second: _Segment) -> MeasuredAngle:
    return MeasuredAngle(name=name, arms_m=np.array([first, second], dtype=np.float64))
