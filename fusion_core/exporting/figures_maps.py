"""Fig. 9 of Xu 2024: the map of the LiDAR alone beside the fused one."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from fusion_core.exporting.palette import BURR, FUSED, LIDAR, UNKNOWN
from fusion_core.model.grids import MapDifference, OccupancyGrid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import Patch

_NAMES = {
    "lidar": "LiDAR map",
    "repaired": "repaired map",
    "merged": "merged map",
    "fused": "fused map",
    "camera": "camera map",
    "reference": "reference",
}
_SOURCES = {
    "lidar": "raw scans",
    "repaired": "repaired scans",
    "merged": "scans and camera",
    "fused": "repaired scans",
    "camera": "its depth alone",
    "reference": "true ranges",
}
# Room for heading and legend, and for the title of a row of maps, in inches.
_AROUND_IN, _TITLE_IN = 0.85, 0.2
# Room for the labels of a map's axes.
_LABELS_IN = 0.35
# A map that is higher than wide fills no more than this.
_HEIGHT_MAX_IN = 4.0


def write_maps(
    path: Path,
    heading: str,
    grids: Mapping[str, OccupancyGrid],
    difference: MapDifference | None,
    sources: Mapping[str, str] = _SOURCES,
) -> None:
    """Fig. 9: maps by name ("lidar", "fused", ...) side by side, and below them, as wide as the
    figure, where two of them differ. ``sources``: what maps were drawn of, where that is not what
    it is in ``fuse``."""
    from matplotlib.patches import Patch

    shown = [name for name in _NAMES if name in grids]
    extent = _extent_of(grids, difference)
    columns = 1 if len(shown) < 2 else 2
    places = [*shown, *[f"empty {i}" for i in range(-len(shown) % columns)]]
    rows: list[Any] = [places[i : i + columns] for i in range(0, len(places), columns)]
    wide = COLUMN_IN - _LABELS_IN
    small_in, wide_in = (
        map_height_in(extent, wide / count, _HEIGHT_MAX_IN) for count in (columns, 1)
    )
    heights_in = [small_in] * len(rows)
    if difference is not None:
        rows.append(["difference"] * columns)
        heights_in.append(wide_in)
    height_in = _AROUND_IN + sum(heights_in) + _TITLE_IN * len(rows)
    with png_figure(path, heading, height_in=height_in) as figure:
        panels = figure.subplot_mosaic(rows, height_ratios=heights_in)
        for letter, name in zip("abcd", shown, strict=False):
            prepare_map_axes(panels[name], extent, ticks=columns == 1)
            show_grid(panels[name], grids[name])
            panels[name].set_title(
                f"({letter}) {_NAMES[name]}: {sources.get(name, _SOURCES[name])}"
            )
        handles = [
            Patch(facecolor=UNKNOWN, label="unknown"),
            Patch(facecolor="white", edgecolor="0.6", linewidth=0.3, label="free"),
        ]
        if difference is None:
            handles.append(Patch(facecolor="black", label="occupied"))
        else:
            axes = panels["difference"]
            prepare_map_axes(axes, extent, ticks=True)
            handles += _show_difference(axes, difference)
            first, second = (_name_of(name) for name in difference.names)
            axes.set_title(
                f"({'abcde'[len(shown)]}) obstacles of {first} and {second}, differences enlarged"
            )
        empty = places[len(shown) :]
        if empty:
            panels[empty[0]].set_axis_off()
            panels[empty[0]].legend(handles=handles, loc="center", frameon=False)
        else:
            figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)


def _name_of(name: str) -> str:
    return _NAMES.get(name, f"{name} map")


def _extent_of(grids: Mapping[str, OccupancyGrid], difference: MapDifference | None) -> Extent:
    if grids or difference is None:
        return seen_extent(grids.values())
    return grid_extent(difference.origin_m, difference.resolution_m, difference.states.shape)


def _show_difference(axes: "Axes", difference: MapDifference) -> "list[Patch]":
    """Draw the difference; returns the legend of its colours."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    extent = grid_extent(difference.origin_m, difference.resolution_m, difference.states.shape)
    free, both = MapDifference.FREE, MapDifference.FREE + 3
    common = np.select([difference.states == both, difference.states >= free], [2, 1], 0)
    axes.imshow(
        common,
        cmap=ListedColormap([UNKNOWN, "white", FUSED]),
        vmin=-0.5,
        vmax=2.5,
        origin="lower",
        extent=extent,
    )
    handles = [Patch(facecolor=FUSED, label=f"obstacle in both: {(common == 2).sum()} cells")]
    for mask, color in ((1, LIDAR), (2, BURR)):
        rows, columns = np.nonzero(difference.states == free + mask)
        axes.plot(
            extent[0] + (columns + 0.5) * difference.resolution_m,
            extent[2] + (rows + 0.5) * difference.resolution_m,
            "s",
            color=color,
            ms=2.2,
        )
        name = _name_of(difference.names[mask - 1])
        handles.append(Patch(facecolor=color, label=f"only in the {name}: {rows.size} cells"))
    return handles
