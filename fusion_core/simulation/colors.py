"""The colours that a camera sees: a base per material, a pattern fixed to the surface, light."""

import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray
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
}
_TABLE: FloatArray = np.array([_BASE[material] for material in Material], dtype=np.float64)
_LIGHT: FloatArray = np.array([0.4, 0.25, 0.88])
_CELL_M = 0.12
_CONTRAST = 0.35


def shade(points_m: FloatArray, hits: Hits) -> ByteArray:
    """(N, 3) uint8 RGB of the surface points (N, 3) that were met.

    The pattern gives features to follow from image to image: random greys, one for each cell of
    a lattice of 12 cm.
    """
    # Just inside the surface: a wall may lie on the border of two cells.
    cells = np.floor((points_m - 0.002 * hits.normals) / _CELL_M).astype(np.int64)
    # Teschner et al. 2003: a hash of lattice cells.
    mixed = (cells[:, 0] * 73856093) ^ (cells[:, 1] * 19349663) ^ (cells[:, 2] * 83492791)
    grey = ((mixed * 2654435761) % 65536) / 65536.0
    lit = 0.6 + 0.4 * np.abs(hits.normals @ _LIGHT)
    brightness = lit * (1.0 - _CONTRAST * grey)
    rgb = _TABLE[hits.materials] * brightness[:, None]
    return np.rint(np.clip(rgb, 0.0, 255.0)).astype(np.uint8)
