"""What the figures of maps share: a grid in shades of its probability, cropped to what was seen,
with a scale bar."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from fusion_core.exporting.map_picture import scale_bar_m
from fusion_core.exporting.palette import UNKNOWN
from fusion_core.model.conventions import FloatArray
from fusion_core.model.grids import OccupancyGrid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Few shades keep the files small.
_SHADES = 32
# About as many cells as a figure has pixels: more are merged before they are drawn.
_CELLS_MAX = 1800

Extent = tuple[float, float, float, float]
"""Left, right, bottom, top in the map frame, m."""


def seen_extent(grids: Iterable[OccupancyGrid], positions_m: FloatArray | None = None) -> Extent:
    """What the known cells of all grids and the (N, 2) positions span, with a margin.

    1 m around the origin where there is neither.
    """
    corners = [] if positions_m is None or not len(positions_m) else [positions_m]
    for grid in grids:
        known = np.isfinite(grid.log_odds)
        rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
        if rows.size:
            cells = np.array([[columns[0], rows[0]], [columns[-1] + 1, rows[-1] + 1]])
            corners.append(np.array(grid.origin_m) + grid.resolution_m * cells)
    if not corners:
        return -1.0, 1.0, -1.0, 1.0
    points_m = np.vstack(corners)
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    margin_m = max(0.02 * float((high - low).max()), 0.1)
    left, bottom = low - margin_m
    right, top = high + margin_m
    return float(left), float(right), float(bottom), float(top)


def grid_extent(
    origin_m: tuple[float, float], resolution_m: float, shape: tuple[int, ...]
) -> Extent:
    """The extent of (rows, columns) of cells."""
    x_m, y_m = origin_m
    return x_m, x_m + shape[1] * resolution_m, y_m, y_m + shape[0] * resolution_m


def map_height_in(extent: Extent, width_in: float, height_max_in: float) -> float:
    """The height at which an extent fills a width, no higher than a limit; inches."""
    left, right, bottom, top = extent
    return min(width_in * (top - bottom) / (right - left), height_max_in)


def prepare_map_axes(axes: "Axes", extent: Extent, *, ticks: bool) -> None:
    """Equal axes over an extent, unknown where nothing is drawn, with a scale bar.

    ``ticks``: coordinates in the map frame along the edges.
    """
    left, right, bottom, top = extent
    axes.set_facecolor(UNKNOWN)
    axes.set_aspect("equal")
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    if ticks:
        axes.set_xlabel("x in the map frame (m)")
        axes.set_ylabel("y in the map frame (m)")
    else:
        axes.set_xticks([])
        axes.set_yticks([])
    _add_scale_bar(axes, right - left)


def _add_scale_bar(axes: "Axes", width_m: float) -> None:
    from matplotlib.patheffects import withStroke

    length_m = scale_bar_m(width_m)
    start = 0.03
    end = start + length_m / width_m
    # White around black stands out on free, occupied and unknown cells alike.
    white = [withStroke(linewidth=2.0, foreground="white")]
    axes.plot(
        [start, end],
        [0.03, 0.03],
        "-",
        color="black",
        lw=1.2,
        solid_capstyle="butt",
        transform=axes.transAxes,
        path_effects=white,
        zorder=6,
    )
    axes.text(
        0.5 * (start + end),
        0.045,
        f"{length_m:g} m",
        ha="center",
        va="bottom",
        size=5.5,
        transform=axes.transAxes,
        path_effects=white,
        zorder=6,
    )


def show_grid(axes: "Axes", grid: OccupancyGrid) -> None:
    """The darker a cell, the more probable an obstacle; unknown cells in their colour."""
    import matplotlib as mpl

    probability = _downsampled_probability(grid)
    axes.imshow(
        probability,
        cmap=mpl.colormaps["gray_r"].resampled(_SHADES).with_extremes(bad=UNKNOWN),
        vmin=0.0,
        vmax=1.0,
        origin="lower",
        extent=grid_extent(grid.origin_m, grid.resolution_m, grid.log_odds.shape),
    )


def _downsampled_probability(grid: OccupancyGrid) -> FloatArray:
    """(rows, columns) probability at about the figure's resolution, each cell the maximum of those
    that it covers, so that thin walls stay."""
    stride = -(-max(grid.log_odds.shape) // _CELLS_MAX)
    log_odds = grid.log_odds
    for axis in (0, 1):
        starts = np.arange(0, log_odds.shape[axis], stride)
        log_odds = np.fmax.reduceat(log_odds, starts, axis=axis)
    probability: FloatArray = 1.0 / (1.0 + np.exp(-log_odds))
    return probability
