"""Occupancy grids of one place side by side on one scale, and where they differ (Xu 2024, Fig. 9).

The colours are those of the exported pictures.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from app.scene import sheet as paper
from app.scene.lettering import INK, shortened, write
from app.scene.palette import Color
from app.scene.sheet import LINE_PX, MARGIN_PX, Box, LegendEntry
from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.grids import MapDifference, OccupancyGrid
from fusion_core.workflows.map_colors import FREE, UNKNOWN, difference_colors, scale_bar_m

_TITLE_PX = LINE_PX + 8
_BETWEEN_PX = 12
_OCCUPIED: Color = (0, 0, 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Raster:
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


def map_pictures(
    grids: Mapping[str, OccupancyGrid],
    difference: MapDifference | None = None,
    *,
    width_px: int,
    height_px: int,
) -> ByteArray:
    """Maps by title, and their difference after them, all of the same window of the map frame.

    Returns (h, width_px, 3) uint8 with h at most ``height_px``. Raises ValueError for no map, or
    too small a picture.
    """
    panels = {title: _raster_of_grid(grid) for title, grid in grids.items()}
    if difference is not None:
        panels["difference, drawn larger"] = _raster_of_difference(difference)
    if not panels:
        raise ValueError("there is no map to draw")
    corners = np.array([raster.corners_m for raster in panels.values()])
    low_m, high_m = corners[:, :2].min(axis=0), corners[:, 2:].max(axis=0)
    legend = paper.legend_lines(_legend(grids, difference), width_px - 2 * MARGIN_PX)
    under = (1 + len(legend)) * LINE_PX + MARGIN_PX
    boxes, px_per_m = _layout(
        len(panels), high_m - low_m, width_px - 2 * MARGIN_PX, height_px - under - MARGIN_PX
    )
    bottom = max(box.bottom for box in boxes)
    sheet = paper.blank_sheet(width_px, bottom + under + MARGIN_PX // 2)
    for box, (title, raster) in zip(boxes, panels.items(), strict=True):
        box.view(sheet)[:] = _drawn(raster, low_m, px_per_m, box)
        box.frame(sheet)
        words = shortened(title, box.width, size_px=paper.TITLE_PX)
        write(sheet, words, box.left, box.top - 12, size_px=paper.TITLE_PX)
    _draw_scale_bar(sheet, boxes[0], px_per_m, bottom + MARGIN_PX + LINE_PX // 2)
    paper.draw_legend(sheet, legend, MARGIN_PX, bottom + MARGIN_PX + LINE_PX)
    return sheet


def map_texture(grid: OccupancyGrid) -> ByteArray:
    """(rows, columns, 3) uint8: a pixel for each cell, the first row at the greatest y."""
    raster = _raster_of_grid(grid)
    return np.flipud(raster.colors[raster.ranks]).copy()


def _raster_of_grid(grid: OccupancyGrid) -> _Raster:
    """The surer an obstacle, the darker and the more it counts."""
    shade = 1.0 + np.round(254.0 * np.where(grid.known, grid.probability, 0.0))
    grey = np.round(255.0 * (1.0 - np.arange(255) / 254.0)).astype(np.uint8)
    return _Raster(
        ranks=np.where(grid.known, shade, 0.0).astype(np.uint8),
        colors=np.vstack([np.array([UNKNOWN], dtype=np.uint8), np.repeat(grey[:, None], 3, 1)]),
        resolution_m=grid.resolution_m,
        origin_m=grid.origin_m,
    )


def _raster_of_difference(difference: MapDifference) -> _Raster:
    """An obstacle that fewer maps have counts more."""
    colors = np.array(difference_colors(len(difference.names)), dtype=np.uint8)
    masks = range(1, 2 ** len(difference.names))
    obstacles = sorted(masks, key=lambda mask: -mask.bit_count())
    states = [
        MapDifference.UNKNOWN,
        MapDifference.FREE,
        *(MapDifference.FREE + mask for mask in obstacles),
    ]
    rank_of_state = np.argsort(states).astype(np.uint8)
    return _Raster(
        ranks=rank_of_state[difference.states],
        colors=colors[states],
        resolution_m=difference.resolution_m,
        origin_m=difference.origin_m,
        # Beyond what all maps share.
        larger_from=MapDifference.FREE + 2,
    )


def _layout(
    count: int, size_m: FloatArray, width_px: int, height_px: int
) -> tuple[list[Box], float]:
    """The arrangement of boxes of equal size that draws the largest, and its pixels a metre."""
    best = 0.0, 1
    for columns in range(1, count + 1):
        rows = -(-count // columns)
        wide = (width_px - (columns - 1) * _BETWEEN_PX) / columns
        high = (height_px - rows * _TITLE_PX) / rows
        best = max(best, (min(wide / size_m[0], high / size_m[1]), columns))
    px_per_m, columns = best
    width, height = int(px_per_m * size_m[0]), int(px_per_m * size_m[1])
    first = paper.room(
        MARGIN_PX, MARGIN_PX + _TITLE_PX, MARGIN_PX + width, MARGIN_PX + _TITLE_PX + height
    )
    return [
        Box(
            first.left + place % columns * (width + _BETWEEN_PX),
            first.top + place // columns * (height + _TITLE_PX),
            width,
            height,
        )
        for place in range(count)
    ], px_per_m


def _drawn(raster: _Raster, low_m: FloatArray, px_per_m: float, box: Box) -> ByteArray:
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


def _draw_scale_bar(sheet: ByteArray, box: Box, px_per_m: float, y_px: int) -> None:
    bar_m = scale_bar_m(box.width / px_per_m)
    right = box.left + round(bar_m * px_per_m)
    cv2.rectangle(sheet, (box.left, y_px - 2), (right - 1, y_px + 2), INK, -1)
    write(sheet, f"{paper.number(bar_m)} m", right + 8, y_px)


def _legend(
    grids: Mapping[str, OccupancyGrid], difference: MapDifference | None
) -> Sequence[LegendEntry]:
    entries = []
    if grids:
        entries = [
            LegendEntry(paper.swatch(color), words)
            for color, words in ((_OCCUPIED, "obstacle"), (FREE, "free"), (UNKNOWN, "unknown"))
        ]
    if difference is not None:
        colors = difference_colors(len(difference.names))
        present = np.unique(difference.states)
        entries += [
            LegendEntry(paper.swatch(colors[state]), f"obstacle: {words}")
            for state, words in difference.legend.items()
            if state in present and (state > MapDifference.FREE or not grids)
        ]
    return entries
