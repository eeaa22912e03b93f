"""Paint on the surfaces of a world: a picture for each of its rectangles, or none.

A pixel of a camera takes the light of a patch of the surface, not of a point. So each picture is
kept at half, a quarter, … of its resolution, too, and a pixel reads the one whose texels are about
as large as its patch, as graphics cards do (Williams 1983). The patch of a slanted surface is
longer than wide; the size taken is the geometric mean of the two, between a blur and an alias.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray, IntArray, read_only
from fusion_core.simulation.panels import TRIANGLES_PER_PANEL, Panel, points_by_panel, read_image
from fusion_core.simulation.solids import Mesh
from fusion_core.simulation.textures import Texture

# A picture is not halved below this, the shorter side.
_LEAST_TEXELS = 8


@dataclass(frozen=True, slots=True)
class Paint:
    """The panels of a mesh. ``panel_of``: (T,) the panel of each triangle, -1 where it is plain."""

    panels: tuple[Panel, ...]
    panel_of: IntArray

    def __post_init__(self) -> None:
        read_only(self.panel_of)


def paint_mesh(mesh: Mesh, textures: Sequence[Texture | None]) -> Paint:
    """The paint of a mesh that consists of rectangles of two triangles each, as ``quad`` makes
    them; ``textures`` has one for each rectangle, or None where it stays plain."""
    corners_m = mesh.corners_m.reshape(-1, TRIANGLES_PER_PANEL, 3, 3)
    if len(textures) != len(corners_m):
        raise ValueError(f"{len(corners_m)} rectangles, {len(textures)} textures")
    panels: list[Panel] = []
    panel_of = np.full(len(corners_m), -1, dtype=np.int64)
    for number, (texture, (first, second)) in enumerate(zip(textures, corners_m, strict=True)):
        if texture is not None:
            panel_of[number] = len(panels)
            corner = first[0]
            panels.append(Panel(corner.copy(), first[1] - corner, second[2] - corner, texture))
    return Paint(tuple(panels), np.repeat(panel_of, TRIANGLES_PER_PANEL))


class PaintReader:
    """What is painted where rays end."""

    def __init__(self, paint: Paint) -> None:
        self._panels = paint.panels
        # Rays that hit nothing have triangle -1.
        self._panel_of = np.concatenate([paint.panel_of, [-1]])
        # Panels may share a texture.
        stacks = {id(panel.texture): _halved(panel.texture.rgb) for panel in paint.panels}
        self._levels = [stacks[id(panel.texture)] for panel in paint.panels]

    def rgb(
        self, triangles: IntArray, points_m: FloatArray, footprint_m: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """(K, 3) colours from 0 to 255 of the K painted among N points, and (K,) which those are.

        ``triangles``: (N,) of the mesh; later ones (people, a mirror) are plain. ``points_m``:
        (N, 3). ``footprint_m``: (N,) the size of the patch that a pixel sees there.
        """
        known = len(self._panel_of) - 1
        panel_of = self._panel_of[np.where(triangles < known, triangles, -1)]
        painted: IntArray = np.flatnonzero(panel_of >= 0).astype(np.int64)
        points_m, footprint_m = points_m[painted], footprint_m[painted]
        rgb = np.zeros((painted.size, 3))
        for index, chosen in points_by_panel(panel_of[painted]):
            panel, levels = self._panels[index], self._levels[index]
            along_a, along_b = panel.fractions(points_m[chosen])
            level = np.log2(np.maximum(footprint_m[chosen] / panel.texel_m, 1.0))
            level = np.minimum(level, len(levels) - 1.0)
            for number in range(int(level.min()), min(int(level.max()) + 2, len(levels))):
                share = 1.0 - np.abs(level - number)
                own = np.flatnonzero(share > 0.0)
                if not own.size:
                    continue
                colors = read_image(levels[number], along_a[own], along_b[own])
                rgb[chosen[own]] += share[own, None] * colors
        return rgb, painted


def _halved(image: ByteArray) -> list[ByteArray]:
    """The image, and as often as it goes half of the one before."""
    stack = [image]
    while min(stack[-1].shape[:2]) >= 2 * _LEAST_TEXELS:
        height, width = stack[-1].shape[:2]
        half = cv2.resize(
            stack[-1], (round(width / 2), round(height / 2)), interpolation=cv2.INTER_AREA
        )
        stack.append(half.astype(np.uint8))
    return stack
