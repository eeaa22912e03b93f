"""Maps on paper: cells as ranked colours, boxes of one scale, and the bar that tells it."""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.map.colors import UNKNOWN, scale_bar_m
from scanloom.plots import sheet as paper
from scanloom.plots.lettering import INK, write
from scanloom.plots.sheet import LINE_PX, MARGIN_PX, Box

TITLE_PX = LINE_PX + 8
"""What a title over a box takes."""
_BETWEEN_PX = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Raster:
    """Cells as the ranks of their colours: where a pixel holds several, the greatest is shown, so
    that no wall is lost. ``ranks``: (rows, columns) uint8, 0 for unknown; ``colors``: (N, 3), by
    rank. Cells of rank ``larger_from`` on are drawn a pixel larger all around."""

    ranks: ByteArray
    colors: ByteArray
    resolution_m: float
    origin_m: tuple[float, float]
    larger_from: int = 256

    @property
    def corners_m(self) -> tuple[float, float, float, float]:
        """Least x and y, greatest x and y."""
        (x, y), (rows, columns) = self.origin_m, self.ranks.shape
        return x, y, x + columns * self.resolution_m, y + rows * self.resolution_m


def raster_of_grid(grid: OccupancyGrid) -> Raster:
    """The surer an obstacle, the darker and the more it counts."""
    shade = 1.0 + np.round(254.0 * np.where(grid.known, grid.probability, 0.0))
    grey = np.round(255.0 * (1.0 - np.arange(255) / 254.0)).astype(np.uint8)
    return Raster(
        ranks=np.where(grid.known, shade, 0.0).astype(np.uint8),
        colors=np.vstack([np.array([UNKNOWN], dtype=np.uint8), np.repeat(grey[:, None], 3, 1)]),
        resolution_m=grid.resolution_m,
        origin_m=grid.origin_m,
    )


def layout(
    count: int, size_m: FloatArray, width_px: int, height_px: int, columns: int | None = None
) -> tuple[list[Box], float]:
    """The arrangement of boxes of equal size that draws the largest, and its pixels a metre.

    ``columns``: how many stand side by side, where that is settled.
    """
    best = 0.0, 1
    for beside in range(1, count + 1) if columns is None else (columns,):
        rows = -(-count // beside)
        wide = (width_px - (beside - 1) * _BETWEEN_PX) / beside
        high = (height_px - rows * TITLE_PX) / rows
        best = max(best, (min(wide / size_m[0], high / size_m[1]), beside))
    px_per_m, beside = best
    width, height = int(px_per_m * size_m[0]), int(px_per_m * size_m[1])
    first = paper.room(
        MARGIN_PX, MARGIN_PX + TITLE_PX, MARGIN_PX + width, MARGIN_PX + TITLE_PX + height
    )
    return [
        Box(
            first.left + place % beside * (width + _BETWEEN_PX),
            first.top + place // beside * (height + TITLE_PX),
            width,
            height,
        )
        for place in range(count)
    ], px_per_m


def drawn(raster: Raster, low_m: FloatArray, px_per_m: float, box: Box) -> ByteArray:
    """(h, w, 3): the box's window of a map, y upwards; beyond the map is unknown."""
    padded = np.pad(raster.ranks, 1)
    starts = []
    for axis, (pixels, cells) in enumerate(
        zip((box.width, box.height), raster.ranks.shape[::-1], strict=True)
    ):
        edges_m = low_m[axis] + np.arange(pixels + 1) / px_per_m
        cell = np.floor((edges_m - raster.origin_m[axis]) / raster.resolution_m + 1e-6)
        starts.append(np.clip(cell + 1, 0, cells + 1).astype(np.int64))
    columns, rows = starts
    # A pixel within a cell has an empty range, for which reduceat gives that cell.
    ranks = np.maximum.reduceat(padded, rows, axis=0)[:-1]
    ranks = np.maximum.reduceat(ranks, columns, axis=1)[:, :-1]
    marked = np.where(ranks >= raster.larger_from, ranks, 0).astype(np.uint8)
    if marked.any():
        ranks = np.maximum(ranks, cv2.dilate(marked, np.ones((3, 3), np.uint8)))
    return raster.colors[np.flipud(ranks)]


def draw_scale_bar(sheet: ByteArray, box: Box, px_per_m: float, y_px: int) -> None:
    """A bar of a round length with its metres, from the box's left, its middle at ``y_px``."""
    bar_m = scale_bar_m(box.width / px_per_m)
    right = box.left + round(bar_m * px_per_m)
    cv2.rectangle(sheet, (box.left, y_px - 2), (right - 1, y_px + 2), INK, -1)
    write(sheet, f"{paper.number(bar_m)} m", right + 8, y_px)
