"""The trajectory on the map with its loop closures, and the effective number of particles."""

from pathlib import Path

import numpy as np

from fusion_core.exporting.figures import COLUMN_IN, png_figure
from fusion_core.exporting.map_axes import map_height_in, prepare_map_axes, seen_extent, show_grid
from fusion_core.exporting.palette import BURR, DEPTH, LIDAR
from fusion_core.model.conventions import NS_PER_S, BoolArray, FloatArray, IntArray
from fusion_core.model.grids import OccupancyGrid

# Room for heading and legend, in inches, and the highest that a narrow map becomes.
_AROUND_IN, _HEIGHT_MAX_IN = 0.75, 4.5


def write_trajectory_figure(
    path: Path,
    heading: str,
    grid: OccupancyGrid | None,
    poses_map_scan: FloatArray,
    trusted: BoolArray,
    loops_m: FloatArray,
) -> None:
    """A trajectory on its map.

    ``grid``: None where there is no map. ``poses_map_scan``: (N, 3), N >= 1. ``trusted``: (N,).
    ``loops_m``: (L, 4) x, y of both ends of each loop closure. Raises ExportError.
    """
    extent = seen_extent([] if grid is None else [grid], poses_map_scan[:, :2])
    map_in = map_height_in(extent, COLUMN_IN, _HEIGHT_MAX_IN)
    with png_figure(path, heading, height_in=_AROUND_IN + map_in) as figure:
        axes = figure.subplots()
        prepare_map_axes(axes, extent, ticks=True)
        if grid is not None:
            show_grid(axes, grid)
        x, y = poses_map_scan[:, 0], poses_map_scan[:, 1]
        for i, (x0, y0, x1, y1) in enumerate(loops_m):
            label = f"loop closures: {len(loops_m)}" if i == 0 else None
            axes.plot([x0, x1], [y0, y1], "-", color=LIDAR, lw=0.6, label=label)
        axes.plot(x, y, "-", color=DEPTH, lw=0.8, label="trajectory of the LiDAR")
        if not trusted.all():
            axes.plot(
                np.where(trusted, np.nan, x),
                np.where(trusted, np.nan, y),
                "o",
                color=BURR,
                ms=1.5,
                label=f"not trusted: {int((~trusted).sum())} scans",
            )
        figure.legend(loc="outside lower center", ncols=3, frameon=False)


def write_effective_particles(
    path: Path,
    heading: str,
    stamps_ns: IntArray,
    effective: FloatArray,
    resampled: BoolArray,
    particles: int,
) -> None:
    """N_eff (Grisetti 2007, eq. 20) over K scans by which the particles were weighted.

    ``stamps_ns``, ``effective``, ``resampled``: (K,), K >= 1. Raises ExportError.
    """
    since_s = (stamps_ns - stamps_ns[0]) / NS_PER_S
    with png_figure(path, heading, height_in=1.9) as figure:
        axes = figure.subplots()
        axes.plot(since_s, effective, "-", color=DEPTH, lw=0.6, label="effective particles")
        count = int(resampled.sum())
        if count:
            axes.plot(
                since_s[resampled],
                effective[resampled],
                "|",
                color=BURR,
                ms=4.0,
                mew=0.6,
                label=f"resampled: {count} times",
            )
        axes.axhline(particles, color="black", lw=0.6, ls=":", label=f"particles: {particles}")
        axes.set_ylim(0.0, 1.06 * particles)
        axes.set_xlabel("time since the first scan (s)")
        axes.set_ylabel("effective number of particles")
        figure.legend(loc="outside lower center", ncols=3, frameon=False)
