"""Figures of two grids fused cell by cell (Fu 2024 §3.2), and of how they lie on each other."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fusion_core.exporting.figures import COLUMN_IN, png_figure
from fusion_core.exporting.map_axes import (
    Extent,
    grid_extent,
    map_height_in,
    prepare_map_axes,
    seen_extent,
    show_grid,
)
from fusion_core.exporting.palette import BURR, DEPTH, FUSED, LIDAR, UNKNOWN
from fusion_core.model.conventions import BoolArray
from fusion_core.model.grid_fusion import CellState, GridFusion, cell_states
from fusion_core.model.grids import OccupancyGrid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_AROUND_IN, _TITLE_IN, _LABELS_IN = 0.85, 0.2, 0.35
_HEIGHT_MAX_IN = 4.0
# Of the two grids that are laid on each other.
_FIRST, _SECOND = LIDAR, DEPTH


def write_fusion_figure(path: Path, heading: str, fusion: GridFusion) -> None:
    """The state by Table 3, the probability by (10), and which cells differ between them."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    extent = seen_extent(fusion.layers.values())
    whole = grid_extent(
        fusion.table.origin_m, fusion.table.resolution_m, fusion.table.log_odds.shape
    )
    wide = COLUMN_IN - _LABELS_IN
    small_in, wide_in = (map_height_in(extent, wide / n, _HEIGHT_MAX_IN) for n in (2, 1))
    height_in = _AROUND_IN + small_in + wide_in + 2 * _TITLE_IN
    states = cell_states(fusion.table.log_odds)
    with png_figure(path, heading, height_in=height_in) as figure:
        panels = figure.subplot_mosaic(
            [["table", "bayes"], ["differ", "differ"]], height_ratios=[small_in, wide_in]
        )
        prepare_map_axes(panels["table"], extent, ticks=False)
        panels["table"].imshow(
            states,
            cmap=ListedColormap([UNKNOWN, "white", "black"]),
            vmin=-0.5,
            vmax=2.5,
            origin="lower",
            extent=whole,
        )
        panels["table"].set_title("(a) state by Table 3")
        prepare_map_axes(panels["bayes"], extent, ticks=False)
        show_grid(panels["bayes"], fusion.bayes)
        panels["bayes"].set_title("(b) probability by (10)")
        axes = panels["differ"]
        prepare_map_axes(axes, extent, ticks=True)
        common = np.where(states == CellState.OCCUPIED, 2, np.minimum(states, 1))
        axes.imshow(
            common,
            cmap=ListedColormap([UNKNOWN, "white", FUSED]),
            vmin=-0.5,
            vmax=2.5,
            origin="lower",
            extent=whole,
        )
        differ = fusion.rules_differ
        _mark_cells(axes, whole, fusion.table.resolution_m, differ, BURR)
        axes.set_title("(c) where they differ (enlarged)")
        handles = [
            Patch(facecolor=UNKNOWN, label="unknown"),
            Patch(facecolor="white", edgecolor="0.6", linewidth=0.3, label="empty"),
            Patch(facecolor=FUSED, label="occupied by Table 3"),
            Patch(facecolor=BURR, label=f"not by (10): {int(differ.sum())} cells"),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)


def write_misalignment_figure(
    path: Path,
    heading: str,
    grids: Mapping[str, OccupancyGrid],
    moved: Mapping[str, OccupancyGrid],
    shift: str,
) -> None:
    """Occupied cells of the second of two grids over those of the first: as drawn, and moved by
    the estimated misalignment, which ``shift`` says in words."""
    from matplotlib.patches import Patch

    (first, base), (second, other) = grids.items()
    extent = seen_extent(grids.values())
    panel_in = map_height_in(extent, COLUMN_IN - _LABELS_IN, _HEIGHT_MAX_IN)
    height_in = _AROUND_IN + 2 * panel_in + 3 * _TITLE_IN
    with png_figure(path, heading, height_in=height_in) as figure:
        for axes, top, title in zip(
            figure.subplots(2, 1),
            (other, moved[second]),
            ("(a) as drawn", f"(b) moved by the estimate:\n{shift}"),
            strict=True,
        ):
            prepare_map_axes(axes, extent, ticks=True)
            for grid, color, alpha in ((base, _FIRST, 1.0), (top, _SECOND, 0.7)):
                _fill_cells(axes, grid, color, alpha)
            axes.set_title(title)
        handles = [
            Patch(facecolor=_FIRST, label=f"occupied: {first}"),
            Patch(facecolor=_SECOND, alpha=0.7, label=f"occupied: {second}"),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)


def _fill_cells(axes: "Axes", grid: OccupancyGrid, color: str, alpha: float) -> None:
    from matplotlib.colors import ListedColormap

    occupied = np.ma.masked_equal(grid.log_odds > 0.0, False)
    axes.imshow(
        occupied,
        cmap=ListedColormap([color]),
        alpha=alpha,
        origin="lower",
        extent=grid_extent(grid.origin_m, grid.resolution_m, grid.log_odds.shape),
    )


def _mark_cells(
    axes: "Axes", extent: Extent, resolution_m: float, cells: BoolArray, color: str
) -> None:
    rows, columns = np.nonzero(cells)
    axes.plot(
        extent[0] + (columns + 0.5) * resolution_m,
        extent[2] + (rows + 0.5) * resolution_m,
        "s",
        color=color,
        ms=1.6,
    )
