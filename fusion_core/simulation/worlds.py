"""Worlds to record in: rooms with doors, glass, furniture and people, each made from a seed.

The floor of a world spans 0…size in x and y. Every world is closed: outside its windows and doors
lies a yard with walls and a roof. A pane of glass is an obstacle: the true range of a ray that hits
it is that of the pane, whatever the sensor sees behind it.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.model.world_outline import MeasuredAngle, MeasuredLine, ObstacleOutline
from fusion_core.simulation import furniture
from fusion_core.simulation.floor_plan import FloorPlan
from fusion_core.simulation.obstacle_outlines import obstacle_outlines, outer_wall_edges
from fusion_core.simulation.paint import Paint
from fusion_core.simulation.random_streams import RandomStream, make_generator
from fusion_core.simulation.solids import (
    Material,
    Mesh,
    Opening,
    box,
    column,
    join_meshes,
    quad,
    wall,
)
from fusion_core.simulation.sunlight import Sunlight

CEILING_M = 2.6
_NO_OPENINGS: tuple[tuple[Opening, ...], ...] = ((), (), (), ())
_YARD_M = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Walker:
    """A person who walks back and forth between two points."""

    start_m: tuple[float, float]
    end_m: tuple[float, float]
    speed_m_s: float = 0.8

    def mesh_at(self, time_s: float) -> Mesh:
        """Two swinging legs, a body and a head, as they stand at an instant."""
        start, end = np.array(self.start_m), np.array(self.end_m)
        length = float(np.linalg.norm(end - start))
        travelled = (self.speed_m_s * time_s) % (2.0 * length)
        place = start + (end - start) * (1.0 - abs(travelled / length - 1.0))
        yaw = float(np.arctan2(end[1] - start[1], end[0] - start[0]))
        forward = np.array([np.cos(yaw), np.sin(yaw)])
        left = np.array([-forward[1], forward[0]])
        stride = 0.25 * np.sin(2.0 * np.pi * self.speed_m_s * time_s / 1.3)

        def part(offset: FloatArray, radii: tuple[float, float], z: tuple[float, float]) -> Mesh:
            x, y = place + offset
            return column((float(x), float(y)), radii, z, yaw, Material.CLOTHES)

        return join_meshes(
            [
                part(0.1 * left + stride * forward, (0.07, 0.07), (0.0, 0.85)),
                part(-0.1 * left - stride * forward, (0.07, 0.07), (0.0, 0.85)),
                part(np.zeros(2), (0.13, 0.21), (0.8, 1.45)),
                part(np.zeros(2), (0.1, 0.09), (1.45, 1.75)),
            ]
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class World:
    """A static place, the people who move in it, and a route that collides with neither.

    ``blocks_m``: (B, 4) footprints x0, y0, x1, y1 of the furniture and inner walls.
    ``route_m``: (W, 2) waypoints of a closed curve on which a robot touches nothing.
    ``obstacles``: the outlines of all that the robot could run into; ``lines`` and ``angles`` are
    to be measured in a map of it. ``fine_texture``: surfaces have a finer pattern too. ``paint``:
    what is painted on the mesh instead of the pattern, or None.
    ``openings``: those of each outer wall, from the one along y = 0 on, anticlockwise.
    ``sunlight``: the sun that shines through its windows, or None.
    """

    size_m: tuple[float, float]
    mesh: Mesh
    blocks_m: FloatArray
    route_m: FloatArray
    walkers: tuple[Walker, ...] = ()
    obstacles: tuple[ObstacleOutline, ...] = ()
    lines: tuple[MeasuredLine, ...] = ()
    angles: tuple[MeasuredAngle, ...] = ()
    fine_texture: bool = False
    openings: tuple[tuple[Opening, ...], ...] = _NO_OPENINGS
    sunlight: Sunlight | None = None
    paint: Paint | None = None

    def __post_init__(self) -> None:
        read_only(self.blocks_m)
        read_only(self.route_m)


def furnished_room(seed: int) -> World:
    """A living room: glass door, window, light and dark cabinets, low boxes, tables."""
    return _living_room(seed, with_person=False)


def room_with_person(seed: int) -> World:
    """The same kind of room, with a person who walks along one of its walls."""
    return _living_room(seed, with_person=True)


def open_corridor(seed: int) -> World:
    """A corridor of 14 m with open doorways, a glass door at one end and a few lockers."""
    rng = make_generator(seed, RandomStream.WORLD)
    size = (14.0, 2.4)
    route = np.array([[2.5, 1.2], [3.5, 0.95], [7.0, 0.95], [10.5, 0.95], [11.5, 1.2]])
    route = np.concatenate([route, np.array([[10.5, 1.45], [7.0, 1.45], [3.5, 1.45]])])
    doors = np.sort(rng.uniform(1.0, 6.0, 2)) + np.array([0.0, 6.0])
    openings = (
        tuple(Opening(float(s), float(s) + 0.9, 0.0, 2.05) for s in doors),
        (Opening(0.6, 1.8, 0.05, 2.1, glazed=True),),
        (Opening(float(rng.uniform(4.0, 8.0)), 9.0, 0.0, 2.05),),
        (),
    )
    plan = FloorPlan(rng, size, route, clearance_m=0.32)
    plan.keep_open(openings)
    for material in (Material.WOOD, Material.DARK, Material.WOOD, Material.DARK):
        plan.place_against_wall((0.6, 1.2), (0.22, 0.3), furniture.cabinet((0.9, 1.9), material))
    return build_world(plan, openings)


def bedroom(seed: int) -> World:
    """A small cluttered bedroom: bed, dark wardrobe, desk, chairs, boxes on the floor."""
    rng = make_generator(seed, RandomStream.WORLD)
    size = (4.8, 4.4)
    route = _oval((3.1, 2.2), (0.4, 0.85))
    openings = ((), (), (Opening(0.6, 2.0, 0.9, 2.1, glazed=True),), ())
    plan = FloorPlan(rng, size, route, clearance_m=0.35)
    plan.place((0.0, 1.4, 2.0, 2.9), furniture.cabinet((0.48, 0.55), Material.FABRIC))
    plan.place((0.0, 0.95, 0.4, 1.35), furniture.low_box)
    plan.place((0.0, 2.95, 0.4, 3.35), furniture.low_box)
    plan.place_against_wall((1.4, 1.8), (0.5, 0.6), furniture.cabinet((2.0, 2.2), Material.DARK))
    plan.place_against_wall((1.0, 1.2), (0.5, 0.6), furniture.table)
    plan.place_against_wall((0.7, 0.9), (0.35, 0.45), furniture.cabinet((0.8, 1.2), Material.WOOD))
    for _ in range(3):
        plan.place_freely((0.4, 0.45), (0.4, 0.45), furniture.chair)
    for _ in range(5):
        plan.place_freely((0.25, 0.4), (0.25, 0.4), furniture.low_box)
    return build_world(plan, openings)


def two_rooms(seed: int) -> World:
    """Two rooms with an open door between them, which the route passes both ways."""
    rng = make_generator(seed, RandomStream.WORLD)
    size = (8.4, 4.8)
    route = np.array([[1.6, 2.4], [2.4, 1.85], [4.2, 2.22], [6.0, 1.85], [6.8, 2.4]])
    route = np.concatenate([route, np.array([[6.0, 2.95], [4.2, 2.58], [2.4, 2.95]])])
    openings = (
        (Opening(5.4, 6.9, 0.05, 2.1, glazed=True),),
        (),
        (Opening(1.0, 2.4, 0.9, 2.1, glazed=True),),
        (),
    )
    plan = FloorPlan(rng, size, route, clearance_m=0.35)
    plan.keep_open(openings)
    for y0, y1 in ((0.0, 1.7), (3.1, 4.8)):
        plan.place((4.15, y0, 4.25, y1), furniture.inner_wall)
    plan.add_mesh(box((4.15, 1.7, 2.05), (4.25, 3.1, CEILING_M), Material.WALL))
    _furnish(plan)
    return build_world(plan, openings)


def _living_room(seed: int, *, with_person: bool) -> World:
    rng = make_generator(seed, RandomStream.WORLD)
    size = (float(rng.uniform(6.2, 7.4)), float(rng.uniform(5.2, 6.0)))
    center = (size[0] / 2.0, size[1] / 2.0)
    route = _oval(center, (size[0] / 2.0 - 1.9, size[1] / 2.0 - 1.75))
    door = float(rng.uniform(1.0, size[0] - 2.6))
    window = float(rng.uniform(1.0, size[1] - 2.6))
    openings = (
        (Opening(door, door + 1.6, 0.05, 2.1, glazed=True),),
        (Opening(window, window + 1.4, 0.9, 2.1, glazed=True),),
        (),
        (),
    )
    plan = FloorPlan(rng, size, route, clearance_m=0.4)
    plan.keep_open(openings)
    walkers: tuple[Walker, ...] = ()
    if with_person:
        y = size[1] - 0.55
        plan.keep_free((0.6, y - 0.5, size[0] - 0.6, y + 0.5))
        walkers = (Walker(start_m=(1.0, y), end_m=(size[0] - 1.0, y)),)
    _furnish(plan)
    return build_world(plan, openings, walkers)


def _furnish(plan: FloorPlan) -> None:
    plan.place_freely((0.9, 1.1), (0.6, 0.7), furniture.table)
    plan.place_freely((0.35, 0.45), (0.35, 0.45), furniture.low_box)
    plan.place_freely((0.35, 0.45), (0.35, 0.45), furniture.low_box)
    plan.place_against_wall((1.2, 1.6), (0.4, 0.5), furniture.cabinet((0.7, 1.0), Material.DARK))
    plan.place_against_wall((1.6, 2.0), (0.75, 0.9), furniture.sofa)
    plan.place_against_wall((0.8, 1.2), (0.35, 0.45), furniture.cabinet((1.6, 2.1), Material.WOOD))
    plan.place_against_wall((0.9, 1.1), (0.55, 0.65), furniture.table)
    plan.place_against_wall((0.6, 0.9), (0.35, 0.45), furniture.cabinet((1.0, 1.4), Material.DARK))
    plan.place_against_wall((0.6, 1.2), (0.4, 0.6), furniture.cabinet((0.5, 0.8), Material.WOOD))
    plan.place_freely((0.4, 0.45), (0.4, 0.45), furniture.chair)


def build_world(
    plan: FloorPlan,
    openings: tuple[tuple[Opening, ...], ...] = _NO_OPENINGS,
    walkers: tuple[Walker, ...] = (),
    *,
    lines: tuple[MeasuredLine, ...] = (),
    angles: tuple[MeasuredAngle, ...] = (),
    fine_texture: bool = False,
) -> World:
    """The world of a plan, with its shell and the outlines of its obstacles."""
    obstacles = obstacle_outlines(
        outer_wall_edges(plan.size_m, openings, CEILING_M), plan.objects, plan.size_m
    )
    # The yard is an obstacle only where an open door leads to it.
    if any(not opening.glazed for side in openings for opening in side):
        fence_m = np.array([*_yard(plan.size_m), _yard(plan.size_m)[0]])
        fence = ObstacleOutline(
            name="yard", z_min_m=0.0, z_max_m=CEILING_M, outline_m=fence_m, seen_by={}
        )
        obstacles = (*obstacles, fence)
    return World(
        size_m=plan.size_m,
        mesh=join_meshes([_shell(plan.size_m, openings), *plan.meshes]),
        blocks_m=np.array(plan.footprints, dtype=np.float64).reshape(-1, 4),
        route_m=plan.route_m,
        walkers=walkers,
        obstacles=obstacles,
        lines=lines,
        angles=angles,
        fine_texture=fine_texture,
        openings=openings,
    )


def _yard(size_m: tuple[float, float]) -> list[tuple[float, float]]:
    low, high_x, high_y = -_YARD_M, size_m[0] + _YARD_M, size_m[1] + _YARD_M
    return [(low, low), (high_x, low), (high_x, high_y), (low, high_y)]


def _shell(size_m: tuple[float, float], openings: tuple[tuple[Opening, ...], ...]) -> Mesh:
    """Floor, ceiling, the four walls (from the one along y = 0, anticlockwise), and the yard."""
    width, depth = size_m
    corners = [(0.0, 0.0), (width, 0.0), (width, depth), (0.0, depth)]
    yard = _yard(size_m)
    low, (high_x, high_y) = -_YARD_M, yard[2]
    walls = [
        wall(corners[side], corners[(side + 1) % 4], CEILING_M, openings[side]) for side in range(4)
    ]
    fences = [wall(yard[side], yard[(side + 1) % 4], CEILING_M) for side in range(4)]
    floor = quad((low, low, 0.0), (high_x - low, 0, 0), (0, high_y - low, 0), Material.FLOOR)
    ceiling = quad(
        (low, low, CEILING_M), (high_x - low, 0, 0), (0, high_y - low, 0), Material.CEILING
    )
    return join_meshes([floor, ceiling, *walls, *fences])


def _oval(center_m: tuple[float, float], radii_m: tuple[float, float]) -> FloatArray:
    angle = np.arange(8) * (np.pi / 4.0)
    return np.stack(
        [center_m[0] + radii_m[0] * np.cos(angle), center_m[1] + radii_m[1] * np.sin(angle)],
        axis=1,
    )
