"""Fig. 9 of Xu 2024: the map of the LiDAR alone beside the fused one."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fusion_core.exporting.figures import add_color_bar, png_figure
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
}
_SHADES = 32


def write_maps(
    path: Path,
    heading: str,
    grids: Mapping[str, OccupancyGrid],
    difference: MapDifference | None,
) -> None:
    """Fig. 9: maps by name ("lidar", "fused", ...), and where two of them differ."""
    from matplotlib.patches import Patch

    shown = [name for name in _NAMES if name in grids]
    panels = len(shown) + (difference is not None)
    columns = 2 if panels > 1 else 1
    rows = -(-panels // columns)
    with png_figure(path, heading, width_px=700 * columns, height_px=600 * rows) as figure:
        every = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
        for axes in every[panels:]:
            axes.set_axis_off()
        for axes in every[:panels]:
            axes.set_facecolor(UNKNOWN)
            axes.set_aspect("equal")
            axes.set_xlabel("x in the map frame (m)")
            axes.set_ylabel("y in the map frame (m)")
            axes.tick_params(labelbottom=True, labelleft=True)
        for letter, axes, name in zip("abc", every, shown, strict=False):
            _show_map(axes, grids[name])
            axes.set_title(f"({letter}) {_NAMES[name]}, {_SOURCES[name]}")
        handles = [Patch(facecolor=UNKNOWN, label="unknown")]
        if difference is not None:
            handles += _show_difference(every[panels - 1], difference)
            first, second = (_NAMES[name] for name in difference.names)
            every[panels - 1].set_title(
                f"({'abcd'[panels - 1]}) obstacles of {first} and {second}, "
                "differences drawn enlarged"
            )
        figure.legend(
            handles=handles, loc="outside lower center", ncols=len(handles), frameon=False
        )


_SOURCES = {
    "lidar": "raw scans",
    "repaired": "repaired scans",
    "merged": "scans and what the camera met",
    "fused": "repaired scans",
    "camera": "what the camera met",
}


def _show_map(axes: "Axes", grid: OccupancyGrid) -> None:
    import matplotlib as mpl

    shades = mpl.colormaps["gray_r"].resampled(_SHADES)
    image = axes.imshow(
        grid.probability,
        cmap=shades.with_extremes(bad=UNKNOWN),
        vmin=0.0,
        vmax=1.0,
        origin="lower",
        extent=_extent(grid.origin_m, grid.resolution_m, grid.log_odds.shape),
    )
    add_color_bar(axes, image, "probability of an obstacle")


def _show_difference(axes: "Axes", difference: MapDifference) -> "list[Patch]":
    """Draw the difference; returns the legend of its colours."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    extent = _extent(difference.origin_m, difference.resolution_m, difference.states.shape)
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
            ms=3.5,
        )
        name = _NAMES[difference.names[mask - 1]]
        handles.append(Patch(facecolor=color, label=f"only in the {name}: {rows.size} cells"))
    return handles


def _extent(
    origin_m: tuple[float, float], resolution_m: float, shape: tuple[int, ...]
) -> tuple[float, float, float, float]:
    x_m, y_m = origin_m
    return x_m, x_m + shape[1] * resolution_m, y_m, y_m + shape[0] * resolution_m
