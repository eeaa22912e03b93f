"""The experimental site of Li 2022, section 4.1: 5.6 m x 3.18 m with objects A, B, C and D.

The paper gives the site's size, the height of A's bar (0.42 m) and of the robot (0.55 m), and
which sensor sees which object. The other measures are ours: LiDAR at 0.30 m, legs of 5 cm, B's
bar at 0.62 m (the robot fits under it), C 0.40 m high (both sensors see it), D 0.20 m (the camera
alone). Further objects of other shapes stand for the paper's "office".
"""

import numpy as np

from fusion_core.model.world_outline import MeasuredAngle, MeasuredLine
from fusion_core.simulation.floor_plan import FloorPlan
from fusion_core.simulation.furniture import Footprint
from fusion_core.simulation.paths import round_corners
from fusion_core.simulation.random_streams import RandomStream, make_generator
from fusion_core.simulation.solids import BoxSpec, Material, Prism, SolidObject, column, make_object
from fusion_core.simulation.worlds import World, build_world

SIZE_M = (5.6, 3.18)
_LEG_M = 0.05
_BOARD_HEIGHT_M = 0.6


def arena(seed: int) -> World:
    """The site, the same for every seed, so that maps can be compared."""
    width, depth = SIZE_M
    lane = np.array([(0.85, 0.85), (4.75, 0.85), (4.75, 2.33), (0.85, 2.33)])
    route = round_corners(lane, 0.5)
    plan = FloorPlan(make_generator(seed, RandomStream.WORLD), SIZE_M, route, clearance_m=0.3)
    a = (1.45, 1.5, 2.25, 1.55)
    c = (1.0, 2.83, 1.4, 3.18)
    board = (3.4, 2.75, 3.44, 3.18)
    plan.add(_bar("A", a, bar_m=(0.42, 0.47)), a)
    b = (2.6, 0.38, 2.65, 1.32)
    gate = _bar("B", b, bar_m=(0.62, 0.67))
    plan.meshes.append(gate.mesh)
    plan.objects.append(gate)
    plan.add(_box("C", c, 0.4, Material.WOOD), c)
    _put(plan, _box("D", (3.0, 1.42, 3.45, 1.72), 0.2, Material.FABRIC))
    _put(plan, _box("tall box", (3.85, 1.42, 4.15, 1.72), 0.9, Material.WOOD).rotated(np.pi / 6))
    _put(plan, _box("step", (1.25, 0.0, 1.95, 0.3), 0.12, Material.FABRIC))
    _put(plan, _box("books", (2.4, 1.62, 2.7, 1.82), 0.1, Material.CLOTHES).rotated(0.26))
    _put(plan, _box("case", (0.0, 1.4, 0.28, 1.75), 0.5, Material.DARK))
    _put(plan, _box("board", board, _BOARD_HEIGHT_M, Material.WOOD))
    _put(plan, _box("low crate", (4.0, 0.0, 4.5, 0.28), 0.24, Material.WOOD))
    _put(plan, _round("bin", (5.25, 0.4), 0.15, 0.35))
    _put(plan, _stool("stool", (4.95, 2.62, 5.25, 2.92)))
    _put(plan, _box("flat parcel", (1.95, 2.85, 2.55, 3.1), 0.16, Material.CLOTHES))
    lines = (
        _line("line 1", ((2.2, 0.0), (3.9, 0.0)), ((3.6, depth), (4.8, depth))),
        _line("line 2", ((0.0, 0.2), (0.0, 1.3)), ((width, 0.8), (width, 2.6))),
        _line("line 3", (c[:2], (c[2], c[1])), ((0.1, 0.0), (1.2, 0.0))),
    )
    angles = (
        _angle("angle a", ((0.0, 0.0), (1.2, 0.0)), ((0.0, 0.0), (0.0, 1.3))),
        _angle("angle b", ((width, depth), (3.6, depth)), ((width, depth), (width, 0.8))),
    )
    return build_world(plan, lines=lines, angles=angles, fine_texture=True)


def _put(plan: FloorPlan, thing: SolidObject) -> None:
    corners = np.concatenate([prism.corners_m for prism in thing.prisms])
    (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
    plan.add(thing, (float(x0), float(y0), float(x1), float(y1)))


def _box(name: str, footprint: Footprint, height_m: float, material: Material) -> SolidObject:
    x0, y0, x1, y1 = footprint
    return make_object(name, [((x0, y0, 0.0), (x1, y1, height_m), material)])


def _bar(name: str, footprint: Footprint, *, bar_m: tuple[float, float]) -> SolidObject:
    """A bar between two legs, at the ends of the longer side."""
    x0, y0, x1, y1 = footprint
    low, high = bar_m
    second = (x1 - _LEG_M, y0) if x1 - x0 > y1 - y0 else (x0, y1 - _LEG_M)
    blocks: list[BoxSpec] = [
        ((x, y, 0.0), (x + _LEG_M, y + _LEG_M, low), Material.WOOD) for x, y in ((x0, y0), second)
    ]
    return make_object(name, [*blocks, ((x0, y0, low), (x1, y1, high), Material.WOOD)])


def _round(
    name: str, center_m: tuple[float, float], radius_m: float, height_m: float
) -> SolidObject:
    radii, heights = (radius_m, radius_m), (0.0, height_m)
    mesh = column(center_m, radii, heights, 0.0, Material.FABRIC)
    # The column's side is a polygon of ten corners.
    angle = np.arange(10) * (2.0 * np.pi / 10)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius_m + np.array(center_m)
    return SolidObject(name, mesh, (Prism(ring, heights),))


def _stool(name: str, footprint: Footprint) -> SolidObject:
    """A seat at 0.42-0.45 m on four legs."""
    x0, y0, x1, y1 = footprint
    legs: list[BoxSpec] = [
        ((x, y, 0.0), (x + 0.03, y + 0.03, 0.42), Material.WOOD)
        for x in (x0, x1 - 0.03)
        for y in (y0, y1 - 0.03)
    ]
    return make_object(name, [*legs, ((x0, y0, 0.42), (x1, y1, 0.45), Material.WOOD)])


_Segment = tuple[tuple[float, float], tuple[float, float]]


def _line(name: str, first: _Segment, second: _Segment) -> MeasuredLine:
    return MeasuredLine(name=name, faces_m=np.array([first, second], dtype=np.float64))


def _angle(name: str, first: _Segment, second: _Segment) -> MeasuredAngle:
    return MeasuredAngle(name=name, arms_m=np.array([first, second], dtype=np.float64))
