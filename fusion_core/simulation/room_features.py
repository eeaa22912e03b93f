"""What makes a world harder to measure: a mirror, sunlight, a person walking.

Each is added to a finished world and drawn from its own random stream, so furniture and route stay
what they were.
"""

from dataclasses import replace

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.simulation.floor_plan import distance_to_footprint
from fusion_core.simulation.furniture import Footprint
from fusion_core.simulation.paths import closed_curve
from fusion_core.simulation.random_streams import RandomStream, make_generator
from fusion_core.simulation.solids import Material, join_meshes, quad
from fusion_core.simulation.sunlight import Sunlight
from fusion_core.simulation.worlds import Walker, World

# A wardrobe mirror: low enough for the LiDAR's plane, and its distance from the wall.
_MIRROR_WIDTHS_M, _MIRROR_HEIGHTS_M, _MIRROR_OFF_WALL_M = (0.6, 0.9), (0.1, 1.9), 0.004
# Floor that is free in front of a mirror, and wall between it and an opening.
_MIRROR_CLEAR_M, _FRAME_M = 0.6, 0.1
# The sun's height over the horizon, and how far to the side of a window it may stand.
_SUN_ELEVATIONS_RAD, _SUN_SIDE_RAD = (0.35, 0.7), 0.6
# Where a person may walk: distance to furniture and walls, to the robot's route, and the shortest
# way worth walking.
_PERSON_CLEAR_M, _ROBOT_CLEAR_M, _SHORTEST_WALK_M = 0.35, 0.65, 0.8
_TRIES = 400


def add_features(world: World, seed: int, *, mirror: bool, sunlight: bool, person: bool) -> World:
    """The world with what is asked for, as far as there is space, or a window for the sun."""
    if mirror:
        world = with_mirror(world, make_generator(seed, RandomStream.FEATURES, 0))
    if sunlight:
        world = with_sunlight(world, make_generator(seed, RandomStream.FEATURES, 1))
    if person:
        world = with_person(world, make_generator(seed, RandomStream.FEATURES, 2))
    return world


def with_mirror(world: World, rng: np.random.Generator) -> World:
    """The world with a mirror on a free part of an outer wall, where there is one."""
    sides = _sides(world.size_m)
    for _ in range(_TRIES):
        side = int(rng.integers(4))
        start, along, inwards = sides[side]
        length_m = float(np.linalg.norm(along))
        direction = along / length_m
        width_m = float(rng.uniform(*_MIRROR_WIDTHS_M))
        s0 = float(rng.uniform(_FRAME_M, length_m - width_m - _FRAME_M))
        s1 = s0 + width_m
        if any(
            s0 < opening.end_m + _FRAME_M and s1 > opening.start_m - _FRAME_M
            for opening in world.openings[side]
        ):
            continue
        corner = start + s0 * direction
        far = start + s1 * direction + _MIRROR_CLEAR_M * inwards
        low, high = np.minimum(corner, far), np.maximum(corner, far)
        before = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
        if any(_overlap(before, block) for block in world.blocks_m):
            continue
        x, y = corner + _MIRROR_OFF_WALL_M * inwards
        bottom, top = _MIRROR_HEIGHTS_M
        edge = width_m * direction
        pane = quad((x, y, bottom), (edge[0], edge[1], 0), (0, 0, top - bottom), Material.MIRROR)
        return replace(world, mesh=join_meshes([world.mesh, pane]))
    return world


def with_sunlight(world: World, rng: np.random.Generator) -> World:
    """The world with the sun before one of its windows; it shines into all that face it."""
    windows: list[FloatArray] = []
    inwards_of: list[FloatArray] = []
    for (start, along, inwards), openings in zip(_sides(world.size_m), world.openings, strict=True):
        direction = along / np.linalg.norm(along)
        for opening in openings:
            if opening.glazed:
                corner = np.array([*(start + opening.start_m * direction), opening.bottom_m])
                edge = np.array([*((opening.end_m - opening.start_m) * direction), 0.0])
                up = np.array([0.0, 0.0, opening.top_m - opening.bottom_m])
                windows.append(np.stack([corner, edge, up]))
                inwards_of.append(inwards)
    if not windows:
        return world
    chosen = inwards_of[int(rng.integers(len(windows)))]
    side_rad = rng.uniform(-_SUN_SIDE_RAD, _SUN_SIDE_RAD)
    azimuth = np.arctan2(chosen[1], chosen[0]) + side_rad
    elevation = rng.uniform(*_SUN_ELEVATIONS_RAD)
    flat = np.array([np.cos(azimuth), np.sin(azimuth)])
    direction = np.array([*(np.cos(elevation) * flat), -np.sin(elevation)])
    facing = [window for window, into in zip(windows, inwards_of, strict=True) if flat @ into > 0.0]
    return replace(
        world,
        sunlight=Sunlight(direction=direction, windows_m=np.stack(facing), size_m=world.size_m),
    )


def with_person(world: World, rng: np.random.Generator) -> World:
    """The world with one more person, on the longest free way of some hundred drawn ones.

    The way touches neither furniture nor the robot's route. None is added where there is no space.
    """
    route_m = closed_curve(world.route_m)
    low, high = np.array([0.5, 0.5]), np.array(world.size_m) - 0.5
    best_m, best = _SHORTEST_WALK_M, None
    for _ in range(_TRIES):
        start, end = rng.uniform(low, high), rng.uniform(low, high)
        length_m = float(np.linalg.norm(end - start))
        if length_m <= best_m:
            continue
        way = start + np.linspace(0.0, 1.0, int(length_m / 0.05) + 2)[:, None] * (end - start)
        if _is_free(way, world, route_m):
            best_m, best = length_m, (start, end)
    if best is None:
        return world
    (x0, y0), (x1, y1) = best
    walker = Walker(start_m=(float(x0), float(y0)), end_m=(float(x1), float(y1)))
    return replace(world, walkers=(*world.walkers, walker))


def _is_free(way_m: FloatArray, world: World, route_m: FloatArray) -> bool:
    """Whether a person can walk along points (P, 2)."""
    apart_m = np.linalg.norm(way_m[:, None] - route_m[None, ::5], axis=2)
    if float(apart_m.min()) < _ROBOT_CLEAR_M:
        return False
    return all(distance_to_footprint(way_m, block) >= _PERSON_CLEAR_M for block in world.blocks_m)


def _sides(size_m: tuple[float, float]) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Start, the vector along, and the unit vector inwards of each outer wall."""
    width, depth = size_m
    corners = np.array([(0.0, 0.0), (width, 0.0), (width, depth), (0.0, depth)])
    vectors = np.roll(corners, -1, axis=0) - corners
    inwards = np.array([(0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (1.0, 0.0)])
    return list(zip(corners, vectors, inwards, strict=True))


def _overlap(one: Footprint, block: FloatArray) -> bool:
    x0, y0, x1, y1 = block
    apart: BoolArray | bool = one[0] > x1 or one[2] < x0 or one[1] > y1 or one[3] < y0
    return not apart
