"""The furniture of an office."""

from fusion_core.simulation.furniture import Footprint
from fusion_core.simulation.solids import BoxSpec, Material, SolidObject, make_object

_DESK_M, _DRAWERS_M, _LEG_M = 0.74, 0.58, 0.05


def solid_box(name: str, footprint: Footprint, height_m: float, material: Material) -> SolidObject:
    """A closed box on the floor."""
    x0, y0, x1, y1 = footprint
    return make_object(name, [((x0, y0, 0.0), (x1, y1, height_m), material)])


def desk(footprint: Footprint, drawers_m: tuple[float, float]) -> list[SolidObject]:
    """A top on four legs, and under it drawers of 0.55 m x 0.4 m from a corner on."""
    x0, y0, x1, y1 = footprint
    blocks: list[BoxSpec] = [
        ((x, y, 0.0), (x + _LEG_M, y + _LEG_M, _DESK_M - 0.03), Material.WOOD)
        for x in (x0, x1 - _LEG_M)
        for y in (y0, y1 - _LEG_M)
    ]
    top: BoxSpec = ((x0, y0, _DESK_M - 0.03), (x1, y1, _DESK_M), Material.WOOD)
    x, y = drawers_m
    own = (x, y, x + 0.55, y + 0.4)
    return [
        make_object("desk", [*blocks, top]),
        solid_box("drawers", own, _DRAWERS_M, Material.WOOD),
    ]


def office_chair(center_m: tuple[float, float], yaw_rad: float) -> SolidObject:
    """A seat at 0.44 m on a post, whose foot is a cross of 8 cm height under it, and a back."""
    x, y = center_m
    material = Material.FABRIC
    blocks: list[BoxSpec] = [
        ((x - 0.22, y - 0.03, 0.0), (x + 0.22, y + 0.03, 0.08), material),
        ((x - 0.03, y - 0.22, 0.0), (x + 0.03, y + 0.22, 0.08), material),
        ((x - 0.03, y - 0.03, 0.08), (x + 0.03, y + 0.03, 0.44), material),
        ((x - 0.22, y - 0.22, 0.44), (x + 0.22, y + 0.22, 0.5), material),
        ((x - 0.22, y - 0.22, 0.5), (x - 0.17, y + 0.22, 0.95), material),
    ]
    return make_object("chair", blocks).rotated(yaw_rad)
