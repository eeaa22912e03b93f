"""Occupancy grids as images: on axes in metres, and as a texture for the floor of the scene.

In the light theme the colours are those of the exported pictures.
"""

from functools import cache

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray
from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.map.colors import scale_bar_m
from scanloom.plots.axes import Axes
from scanloom.plots.legend import LegendEntry, swatch
from scanloom.plots.text import draw_text
from scanloom.plots.theme import LIGHT, Theme
from scanloom.plots.ticks import number_label

_UNKNOWN_SHADE = 0


def paint_grid(axes: Axes, grid: OccupancyGrid | None) -> None:
    """Fill metric axes with a map; what is beyond it, or where there is none, is unknown.

    A pixel over several cells shows the surest obstacle of them, so that no wall is lost.
    """
    inside = axes.inside
    if grid is None:
        inside[:] = axes.theme.unknown
        return
    padded = np.pad(_shades_of(grid), 1, constant_values=_UNKNOWN_SHADE)
    rows, columns = grid.log_odds.shape
    sizes = (axes.box.height, rows, 1), (axes.box.width, columns, 0)
    shades = padded
    for axis, (pixels, cells, coordinate) in enumerate(sizes):
        low_m = (axes.x_limits, axes.y_limits)[coordinate][0]
        edges_m = low_m + np.arange(pixels + 1) / axes.px_per_unit[coordinate]
        cell = np.floor((edges_m - grid.origin_m[coordinate]) / grid.resolution_m + 1e-6)
        starts = np.clip(cell + 1, 0, cells + 1).astype(np.int64)
        # A pixel within a cell has an empty range, for which reduceat gives that cell.
        shades = np.maximum.reduceat(shades, starts, axis=axis)
        shades = shades[:-1] if axis == 0 else shades[:, :-1]
    inside[:] = _colors_of_shades(axes.theme)[np.flipud(shades)]


def grid_texture(grid: OccupancyGrid, theme: Theme = LIGHT) -> ByteArray:
    """(rows, columns, 3) uint8: a pixel for each cell, the first row at the greatest y."""
    return np.flipud(_colors_of_shades(theme)[_shades_of(grid)]).copy()


def grid_legend(theme: Theme = LIGHT) -> list[LegendEntry]:
    """What the colours of a map mean."""
    known = (theme.obstacle, "obstacle"), (theme.free, "free"), (theme.unknown, "unknown")
    return [LegendEntry(swatch(color), label) for color, label in known]


def grid_step_m(axes: Axes) -> float:
    """A round length, at most a third of the width of metric axes."""
    return scale_bar_m(axes.box.width / axes.px_per_unit[0])


def draw_scale_bar(axes: Axes, y_px: int) -> None:
    """A bar of that length with its metres, from the left of the box, its middle at ``y_px``."""
    bar_m = grid_step_m(axes)
    left = axes.box.left
    right = left + round(bar_m * axes.px_per_unit[0])
    cv2.rectangle(axes.rgb, (left, y_px - 2), (right - 1, y_px + 2), axes.theme.ink, -1)
    draw_text(axes.rgb, f"{number_label(bar_m)} m", (right + 8, y_px), color=axes.theme.ink)


def draw_metric_grid(axes: Axes, step_m: float) -> None:
    """A line at each multiple of a length."""
    axes.draw_grid(_multiples(axes.x_limits, step_m), _multiples(axes.y_limits, step_m))


def _multiples(limits: tuple[float, float], step_m: float) -> list[float]:
    first, last = np.ceil(limits[0] / step_m), np.floor(limits[1] / step_m)
    return [float(step_m * count) for count in np.arange(first, last + 1)]


def _shades_of(grid: OccupancyGrid) -> ByteArray:
    """(rows, columns) uint8: the greater, the surer an obstacle; least where nothing is known."""
    shade = 1.0 + np.round(254.0 * np.where(grid.known, grid.probability, 0.0))
    return np.where(grid.known, shade, _UNKNOWN_SHADE).astype(np.uint8)


@cache
def _colors_of_shades(theme: Theme) -> ByteArray:
    """(256, 3) uint8 by shade: unknown, and then from surely free to surely an obstacle."""
    free, obstacle = np.array(theme.free, dtype=np.float64), np.array(theme.obstacle)
    known = free + (obstacle - free) * np.arange(255)[:, np.newaxis] / 254.0
    return np.vstack([np.array([theme.unknown]), np.round(known)]).astype(np.uint8)
