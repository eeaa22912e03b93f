"""The colours that a camera sees: a base per material, a pattern or paint on the surface, light."""

import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.simulation.paint import PaintReader
from fusion_core.simulation.ray_casting import Hits
from fusion_core.simulation.solids import Material

_BASE = {
    Material.WALL: (205, 200, 190),
    Material.FLOOR: (120, 95, 70),
    Material.CEILING: (225, 225, 225),
    Material.WOOD: (165, 120, 75),
    Material.FABRIC: (90, 115, 150),
    Material.DARK: (38, 36, 40),
    Material.GLASS: (170, 190, 205),
    Material.CLOTHES: (150, 60, 60),
    Material.MIRROR: (205, 210, 212),
}
_TABLE: FloatArray = np.array([_BASE[material] for material in Material], dtype=np.float64)
_LIGHT: FloatArray = np.array([0.4, 0.25, 0.88])
_CELL_M = 0.12
_FINE_CELL_M = 0.04
_CONTRAST = 0.35
_FINE_CONTRAST = 0.6


def shade(points_m: FloatArray, hits: Hits, *, fine: bool = False) -> ByteArray:
    """(N, 3) uint8 RGB of the surface points (N, 3) that rays hit.

    The pattern gives features to track from image to image: random greys, one for each cell of a
    grid of 12 cm. With ``fine`` half of the contrast comes from a grid of 4 cm, which gives a
    feature detector corners at short range, too.
    """
    # Just inside the surface: a wall may lie on the border of two cells.
    inside_m = points_m - 0.002 * hits.normals
    grey = cell_draw(inside_m, _CELL_M)
    contrast = _CONTRAST
    if fine:
        grey = 0.5 * (grey + cell_draw(inside_m, _FINE_CELL_M))
        contrast = _FINE_CONTRAST
    brightness = _light(hits) * (1.0 - contrast * grey)
    return _rounded(_TABLE[hits.materials] * brightness[:, None])


def shade_painted(
    points_m: FloatArray, hits: Hits, paint: PaintReader, footprint_m: FloatArray
) -> ByteArray:
    """(N, 3) uint8 RGB of surface points (N, 3) of a painted world: its paint, elsewhere plain.

    ``footprint_m``: (N,) the size of the patch that a pixel sees there.
    """
    rgb = _TABLE[hits.materials]
    colors, painted = paint.rgb(hits.triangles, points_m, footprint_m)
    rgb[painted] = colors
    return _rounded(rgb * _light(hits)[:, None])


def _light(hits: Hits) -> FloatArray:
    lit: FloatArray = 0.6 + 0.4 * np.abs(hits.normals @ _LIGHT)
    return lit


def _rounded(rgb: FloatArray) -> ByteArray:
    return np.rint(np.clip(rgb, 0.0, 255.0)).astype(np.uint8)


def cell_draw(points_m: FloatArray, cell_m: float) -> FloatArray:
    """(N,) in [0, 1): a random number of the grid cell that a point lies in, the same each time."""
    cells = np.floor(points_m / cell_m).astype(np.int64)
    # Teschner et al. 2003: a hash of grid cells.
    mixed = (cells[:, 0] * 73856093) ^ (cells[:, 1] * 19349663) ^ (cells[:, 2] * 83492791)
    draw: FloatArray = ((mixed * 2654435761) % 65536) / 65536.0
    return draw
