"""Places to map: two rooms with two doors between them, and a whole floor."""

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.world_outline import MeasuredAngle, MeasuredLine
from fusion_core.simulation import furniture
from fusion_core.simulation.floor_plan import FloorPlan
from fusion_core.simulation.furniture import Footprint
from fusion_core.simulation.paths import round_corners
from fusion_core.simulation.random_streams import RandomStream, make_generator
from fusion_core.simulation.solids import Material, Opening, box
from fusion_core.simulation.worlds import CEILING_M, World, build_world

_DOOR_HEIGHT_M = 2.05
_WALL_M = 0.1
_HALF_DOOR_M = 0.6
# Length of wall kept free of furniture in the corners where lines and angles are measured.
_BARE_M = 2.2


def two_room_loop(seed: int) -> World:
    """Two rooms of 6 m x 7 m; the route leads through one door and back through the other."""
    size = (12.0, 7.0)
    doors_y = (1.6, 5.4)
    lane = np.array([(1.6, 1.6), (10.4, 1.6), (10.4, 5.4), (1.6, 5.4)])
    plan = FloorPlan(
        make_generator(seed, RandomStream.WORLD), size, round_corners(lane, 0.8), clearance_m=0.4
    )
    openings = (
        (Opening(8.2, 9.8, 0.05, 2.1, glazed=True),),
        (),
        (Opening(2.0, 3.6, 0.9, 2.1, glazed=True),),
        (),
    )
    plan.keep_open(openings)
    _keep_corners_bare(plan)
    _partition(plan, axis=1, at_m=6.0, span_m=(0.0, size[1]), doors_m=doors_y)
    for room in ((0.0, 0.0, 5.95, 7.0), (6.05, 0.0, 12.0, 7.0)):
        _furnish(plan, room)
    lines, angles = _corner_measures(size)
    return build_world(plan, openings, lines=lines, angles=angles, fine_texture=True)


def whole_floor(seed: int) -> World:
    """A corridor of 18 m with three rooms on either side, of which the route visits each."""
    size = (18.0, 12.4)
    south_y, north_y = 5.0, 7.4
    middles_x = (3.0, 9.0, 15.0)
    plan = FloorPlan(
        make_generator(seed, RandomStream.WORLD), size, _floor_route(middles_x), clearance_m=0.35
    )
    glass = tuple(Opening(x - 0.8, x + 0.8, 0.05, 2.1, glazed=True) for x in (3.0, 15.0))
    openings = (
        glass,
        (Opening(5.6, 6.8, 0.05, 2.1, glazed=True),),
        (Opening(8.0, 10.0, 0.9, 2.1, glazed=True),),
        (),
    )
    plan.keep_open(openings)
    _keep_corners_bare(plan)
    for y in (south_y, north_y):
        _partition(plan, axis=0, at_m=y, span_m=(0.0, size[0]), doors_m=middles_x)
    rooms: list[Footprint] = []
    half = 0.5 * _WALL_M
    for low, high in ((0.0, south_y - half), (north_y + half, size[1])):
        for x in (6.0, 12.0):
            plan.place((x - half, low, x + half, high), furniture.inner_wall)
        for x0, x1 in ((0.0, 6.0 - half), (6.0 + half, 12.0 - half), (12.0 + half, 18.0)):
            rooms.append((x0, low, x1, high))
    for room in rooms:
        _furnish(plan, room)
    for x in (5.4, 11.6):
        plan.place((x, south_y + half, x + 0.9, south_y + half + 0.3), _locker)
    corridor = np.array(
        [[(3.7, south_y + half), (5.3, south_y + half)], [(3.7, 7.35), (8.3, 7.35)]]
    )
    lines, angles = _corner_measures(size)
    lines = (*lines, MeasuredLine(name="line 3", faces_m=corridor))
    return build_world(plan, openings, lines=lines, angles=angles, fine_texture=True)


def _keep_corners_bare(plan: FloorPlan) -> None:
    """Keep furniture away from the walls that ``_corner_measures`` measures."""
    width, depth = plan.size_m
    bare, off = _BARE_M, 0.7
    plan.keep_free((0.0, 0.0, bare, off))
    plan.keep_free((0.0, 0.0, off, bare))
    plan.keep_free((width - bare, 0.0, width, off))
    plan.keep_free((width - off, 0.0, width, bare))
    plan.keep_free((0.0, depth - off, bare, depth))


def _corner_measures(
    size_m: tuple[float, float],
) -> tuple[tuple[MeasuredLine, ...], tuple[MeasuredAngle, ...]]:
    """Length and width of a rectangle, and its two angles in the south."""
    width, depth = size_m
    south = np.array([(0.0, 0.0), (_BARE_M, 0.0)])
    west = south[:, ::-1].copy()
    east = west + np.array([width, 0.0])
    lines = (
        MeasuredLine(name="line 1", faces_m=np.stack([west, east])),
        MeasuredLine(name="line 2", faces_m=np.stack([south, south + np.array([0.0, depth])])),
    )
    south_east = np.array([(width, 0.0), (width - _BARE_M, 0.0)])
    angles = (
        MeasuredAngle(name="angle a", arms_m=np.stack([south, west])),
        MeasuredAngle(name="angle b", arms_m=np.stack([south_east, east])),
    )
    return lines, angles


def _floor_route(middles_x: tuple[float, ...]) -> FloatArray:
    """East along the corridor through the southern rooms, back through the northern ones.

    Each room is driven round clockwise, in and out through the same door, on its right side.
    """

    def visit(x: float, lane_y: float, near_y: float, far_y: float) -> FloatArray:
        # The eastward part has its rooms in the south; rotated by 180° it is the westward part.
        side = 0.2
        return np.array(
            [
                (x - side, lane_y),
                (x - side, near_y),
                (x - 1.7, near_y),
                (x - 1.7, far_y),
                (x + 1.7, far_y),
                (x + 1.7, near_y),
                (x + side, near_y),
                (x + side, lane_y),
            ]
        )

    east = np.concatenate([visit(x, 5.75, 3.7, 1.3) for x in middles_x])
    turn = np.array([(16.9, 5.75), (16.9, 6.65)])
    middle = np.array([9.0, 6.2])
    west = np.concatenate([east, turn])
    return round_corners(np.concatenate([west, 2.0 * middle - west]), 0.35)


def _partition(
    plan: FloorPlan,
    *,
    axis: int,
    at_m: float,
    span_m: tuple[float, float],
    doors_m: tuple[float, ...],
) -> None:
    """A wall with doors, along x (axis 0) or y (axis 1)."""
    low, high = at_m - 0.5 * _WALL_M, at_m + 0.5 * _WALL_M
    stops = [span_m[0]]
    for door in doors_m:
        stops += [door - _HALF_DOOR_M, door + _HALF_DOOR_M]
        s0, s1 = stops[-2:]
        x0, y0, x1, y1 = (s0, low, s1, high) if axis == 0 else (low, s0, high, s1)
        plan.add_mesh(box((x0, y0, _DOOR_HEIGHT_M), (x1, y1, CEILING_M), Material.WALL))
    stops.append(span_m[1])
    for s0, s1 in zip(stops[::2], stops[1::2], strict=True):
        plan.place((s0, low, s1, high) if axis == 0 else (low, s0, high, s1), furniture.inner_wall)


def _furnish(plan: FloorPlan, room: Footprint) -> None:
    """The furniture of a room, as far as there is space."""
    dark = furniture.cabinet((0.7, 1.2), Material.DARK)
    light = furniture.cabinet((0.5, 1.8), Material.WOOD)
    plan.place_freely((0.9, 1.1), (0.6, 0.7), furniture.table, room)
    plan.place_against_wall((1.2, 1.6), (0.4, 0.5), dark, room)
    plan.place_against_wall((1.4, 1.8), (0.7, 0.8), furniture.sofa, room)
    plan.place_against_wall((0.6, 1.0), (0.35, 0.45), light, room)
    plan.place_against_wall((0.5, 0.8), (0.3, 0.4), light, room)
    plan.place_freely((0.35, 0.45), (0.35, 0.45), furniture.low_box, room)
    plan.place_freely((0.4, 0.45), (0.4, 0.45), furniture.chair, room)


_locker = furniture.cabinet((1.7, 1.9), Material.DARK)
