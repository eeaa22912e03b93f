"""Furniture: from a footprint (x0, y0, x1, y1) and a random generator to an object.

Heights are chosen for the three rigs: a LiDAR's plane lies 0.25-0.31 m above the floor, a camera
at 0.92 m or more sees that height only beyond some 1.4 m.
"""

from collections.abc import Callable

import numpy as np

from fusion_core.simulation.solids import BoxSpec, Material, SolidObject, make_object

Footprint = tuple[float, float, float, float]
ObjectMaker = Callable[[Footprint, np.random.Generator], SolidObject]


def cabinet(heights_m: tuple[float, float], material: Material) -> ObjectMaker:
    """A maker of closed boxes with heights between two bounds."""

    def make(footprint: Footprint, rng: np.random.Generator) -> SolidObject:
        x0, y0, x1, y1 = footprint
        height_m = float(rng.uniform(*heights_m))
        return make_object("cabinet", [((x0, y0, 0.0), (x1, y1, height_m), material)])

    return make


def low_box(footprint: Footprint, rng: np.random.Generator) -> SolidObject:
    """A box that reaches just above the LiDAR's plane: close by, only the LiDAR sees it."""
    x0, y0, x1, y1 = footprint
    height_m = float(rng.uniform(0.34, 0.4))
    return make_object("low box", [((x0, y0, 0.0), (x1, y1, height_m), Material.WOOD)])


def table(footprint: Footprint, rng: np.random.Generator) -> SolidObject:
    """A top on four thin legs: the camera meets the top, the LiDAR at most a leg."""
    return make_object(
        "table", _on_legs(footprint, top_m=float(rng.uniform(0.72, 0.78)), leg_m=0.04)
    )


def chair(footprint: Footprint, rng: np.random.Generator) -> SolidObject:
    """A seat on four thin legs with a back on a random side."""
    x0, y0, x1, y1 = footprint
    backs = [(x0, y0, x1, y0 + 0.03), (x0, y1 - 0.03, x1, y1)]
    backs += [(x0, y0, x0 + 0.03, y1), (x1 - 0.03, y0, x1, y1)]
    bx0, by0, bx1, by1 = backs[int(rng.integers(4))]
    back: BoxSpec = ((bx0, by0, 0.45), (bx1, by1, 0.9), Material.WOOD)
    return make_object("chair", [*_on_legs(footprint, top_m=0.45, leg_m=0.03), back])


def sofa(footprint: Footprint, rng: np.random.Generator) -> SolidObject:
    """A seat with a back along one of its longer sides, in fabric."""
    x0, y0, x1, y1 = footprint
    seat: BoxSpec = ((x0, y0, 0.0), (x1, y1, 0.42), Material.FABRIC)
    top = float(rng.uniform(0.75, 0.85))
    if x1 - x0 > y1 - y0:
        back: BoxSpec = ((x0, y0, 0.42), (x1, y0 + 0.2, top), Material.FABRIC)
    else:
        back = ((x0, y0, 0.42), (x0 + 0.2, y1, top), Material.FABRIC)
    return make_object("sofa", [seat, back])


def inner_wall(footprint: Footprint, rng: np.random.Generator) -> SolidObject:
    """A wall with thickness, as high as any room."""
    x0, y0, x1, y1 = footprint
    return make_object("inner wall", [((x0, y0, 0.0), (x1, y1, 2.6), Material.WALL)])


def _on_legs(footprint: Footprint, *, top_m: float, leg_m: float) -> list[BoxSpec]:
    x0, y0, x1, y1 = footprint
    legs: list[BoxSpec] = [
        ((x, y, 0.0), (x + leg_m, y + leg_m, top_m - 0.03), Material.WOOD)
        for x in (x0, x1 - leg_m)
        for y in (y0, y1 - leg_m)
    ]
    return [*legs, ((x0, y0, top_m - 0.03), (x1, y1, top_m), Material.WOOD)]
