"""Occupancy grids of one place side by side on one scale, and where they differ (Xu 2024, Fig. 9).

The colours are those of the exported pictures.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from fusion_core.model.conventions import ByteArray
from fusion_core.model.grids import MapDifference, OccupancyGrid
from fusion_core.workflows.map.colors import FREE, UNKNOWN, difference_colors
from scanloom.plots import sheet as paper
from scanloom.plots.lettering import shortened, write
from scanloom.plots.map_raster import Raster, draw_scale_bar, drawn, layout, raster_of_grid
from scanloom.plots.palette import Color
from scanloom.plots.sheet import LINE_PX, MARGIN_PX, LegendEntry

_OCCUPIED: Color = (0, 0, 0)


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
    panels = {title: raster_of_grid(grid) for title, grid in grids.items()}
    if difference is not None:
        panels["difference, drawn larger"] = _raster_of_difference(difference)
    if not panels:
        raise ValueError("there is no map to draw")
    corners = np.array([raster.corners_m for raster in panels.values()])
    low_m, high_m = corners[:, :2].min(axis=0), corners[:, 2:].max(axis=0)
    legend = paper.legend_lines(_legend(grids, difference), width_px - 2 * MARGIN_PX)
    under = (1 + len(legend)) * LINE_PX + MARGIN_PX
    boxes, px_per_m = layout(
        len(panels), high_m - low_m, width_px - 2 * MARGIN_PX, height_px - under - MARGIN_PX
    )
    bottom = max(box.bottom for box in boxes)
    sheet = paper.blank_sheet(width_px, bottom + under + MARGIN_PX // 2)
    for box, (title, raster) in zip(boxes, panels.items(), strict=True):
        box.view(sheet)[:] = drawn(raster, low_m, px_per_m, box)
        box.frame(sheet)
        words = shortened(title, box.width, size_px=paper.TITLE_PX)
        write(sheet, words, box.left, box.top - 12, size_px=paper.TITLE_PX)
    draw_scale_bar(sheet, boxes[0], px_per_m, bottom + MARGIN_PX + LINE_PX // 2)
    paper.draw_legend(sheet, legend, MARGIN_PX, bottom + MARGIN_PX + LINE_PX)
    return sheet


def map_texture(grid: OccupancyGrid) -> ByteArray:
    """(rows, columns, 3) uint8: a pixel for each cell, the first row at the greatest y."""
    raster = raster_of_grid(grid)
    return np.flipud(raster.colors[raster.ranks]).copy()


def _raster_of_difference(difference: MapDifference) -> Raster:
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
    return Raster(
        ranks=rank_of_state[difference.states],
        colors=colors[states],
        resolution_m=difference.resolution_m,
        origin_m=difference.origin_m,
        # Beyond what all maps share.
        larger_from=MapDifference.FREE + 2,
    )


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
