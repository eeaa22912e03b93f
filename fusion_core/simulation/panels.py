"""Painted rectangles: where they stand, and what is painted where rays end on them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, IntArray, read_only
from fusion_core.simulation.solids import Material, Mesh, quad
from fusion_core.simulation.textures import Texture

TRIANGLES_PER_PANEL = 2


@dataclass(frozen=True, slots=True)
class Panel:
    """A painted rectangle: a corner and, from it, two edges (3,) at right angles."""

    corner_m: FloatArray
    edge_a_m: FloatArray
    edge_b_m: FloatArray
    texture: Texture

    def __post_init__(self) -> None:
        for array in (self.corner_m, self.edge_a_m, self.edge_b_m):
            read_only(array)

    @property
    def texel_m(self) -> float:
        """The width of a texel along the first edge."""
        return float(np.linalg.norm(self.edge_a_m) / self.texture.infrared.shape[1])

    def fractions(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N,) each: how far along its two edges points (N, 3) on it lie, 0 to 1."""
        from_corner = points_m - self.corner_m
        along_a: FloatArray = from_corner @ self.edge_a_m / (self.edge_a_m @ self.edge_a_m)
        along_b: FloatArray = from_corner @ self.edge_b_m / (self.edge_b_m @ self.edge_b_m)
        return along_a, along_b

    def mesh(self) -> Mesh:
        """Its two triangles."""
        corner_m, edge_a_m, edge_b_m = (
            [float(value) for value in array]
            for array in (self.corner_m, self.edge_a_m, self.edge_b_m)
        )
        return quad(corner_m, edge_a_m, edge_b_m, Material.WALL)


def read_paint(
    panels: Sequence[Panel],
    images: Sequence[ByteArray | Float32Array],
    panel_of: IntArray,
    points_m: FloatArray,
) -> FloatArray:
    """(N, C) values of the panels' images at surface points (N, 3), bilinear; 0 on no panel.

    ``images``: one for each panel, of any resolution. ``panel_of``: (N,), -1 on no panel.
    """
    channels = 1 if images[0].ndim == 2 else images[0].shape[2]
    result = np.zeros((len(points_m), channels))
    for index, chosen in points_by_panel(panel_of):
        along_a, along_b = panels[index].fractions(points_m[chosen])
        result[chosen] = read_image(images[index], along_a, along_b)
    return result


def points_by_panel(panel_of: IntArray) -> Iterator[tuple[int, IntArray]]:
    """Each panel that is met, and the numbers of its points; ``panel_of``: (N,), -1 is none."""
    order: IntArray = np.argsort(panel_of, kind="stable")
    starts = np.flatnonzero(np.diff(panel_of[order], prepend=-1))
    for start, end in pairwise([*starts.tolist(), len(order)]):
        chosen = order[start:end]
        yield int(panel_of[chosen[0]]), chosen


def read_image(
    image: ByteArray | Float32Array, along_a: FloatArray, along_b: FloatArray
) -> FloatArray:
    """(N, C) values at fractions of a panel's two edges, bilinear; its borders are repeated."""
    height, width = image.shape[:2]
    column, row = along_a * width - 0.5, (1.0 - along_b) * height - 0.5
    # cv2.remap takes maps of less than 2^15 a side.
    side = 1 << 14
    parts = [
        cv2.remap(
            image,
            column[i : i + side].astype(np.float32).reshape(-1, 1),
            row[i : i + side].astype(np.float32).reshape(-1, 1),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        ).reshape(-1, 1 if image.ndim == 2 else image.shape[2])
        for i in range(0, len(column), side)
    ]
    return np.concatenate(parts).astype(np.float64)
