"""The trajectory on the map with its loop closures, and the effective number of particles."""

from pathlib import Path

import numpy as np

from fusion_core.exporting.figures import png_figure
from fusion_core.exporting.palette import BURR, DEPTH, LIDAR, UNKNOWN
from fusion_core.model.conventions import NS_PER_S, BoolArray, FloatArray, IntArray
from fusion_core.model.grids import OccupancyGrid

_SIDE_PX = 900
_SMALLEST_PX = 420
_LEGEND_PX = 110


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
    low, high = _bounds_m(grid, poses_map_scan)
    size_m = np.maximum(high - low, 1.0)
    shape = size_m / size_m.max()
    width_px, height_px = (max(_SMALLEST_PX, round(_SIDE_PX * fraction)) for fraction in shape)
    with png_figure(path, heading, width_px=width_px, height_px=height_px + _LEGEND_PX) as figure:
        axes = figure.subplots()
        axes.set_facecolor(UNKNOWN)
        axes.set_aspect("equal")
        axes.set_xlabel("x in the map frame (m)")
        axes.set_ylabel("y in the map frame (m)")
        if grid is not None:
            axes.imshow(
                _downsampled_probability(grid),
                cmap="gray_r",
                vmin=0.0,
                vmax=1.0,
                origin="lower",
                extent=(low[0], high[0], low[1], high[1]),
            )
        x, y = poses_map_scan[:, 0], poses_map_scan[:, 1]
        for i, (x0, y0, x1, y1) in enumerate(loops_m):
            label = f"loop closures: {len(loops_m)}" if i == 0 else None
            axes.plot([x0, x1], [y0, y1], "-", color=LIDAR, lw=0.8, label=label)
        axes.plot(x, y, "-", color=DEPTH, lw=1.0, label="trajectory of the LiDAR")
        if not trusted.all():
            axes.plot(
                np.where(trusted, np.nan, x),
                np.where(trusted, np.nan, y),
                "o",
                color=BURR,
                ms=3.0,
                label=f"not trusted: {int((~trusted).sum())} scans",
            )
        axes.set_xlim(low[0], low[0] + size_m[0])
        axes.set_ylim(low[1], low[1] + size_m[1])
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
    with png_figure(path, heading, width_px=1000, height_px=420) as figure:
        axes = figure.subplots()
        axes.plot(since_s, effective, "-", color=DEPTH, lw=0.9, label="effective particles")
        count = int(resampled.sum())
        if count:
            axes.plot(
                since_s[resampled],
                effective[resampled],
                "|",
                color=BURR,
                ms=9.0,
                label=f"resampled: {count} times",
            )
        axes.axhline(particles, color="black", lw=0.6, ls=":", label=f"particles: {particles}")
        axes.set_ylim(0.0, 1.06 * particles)
        axes.set_xlabel("time since the first scan (s)")
        axes.set_ylabel("effective number of particles")
        figure.legend(loc="outside lower center", ncols=3, frameon=False)


def _downsampled_probability(grid: OccupancyGrid) -> FloatArray:
    """(rows, columns) probability at about the picture's resolution, each cell the maximum of those
    that it covers, so that thin walls stay."""
    stride = -(-max(grid.log_odds.shape) // (2 * _SIDE_PX))
    log_odds = grid.log_odds
    for axis in (0, 1):
        starts = np.arange(0, log_odds.shape[axis], stride)
        log_odds = np.fmax.reduceat(log_odds, starts, axis=axis)
    probability: FloatArray = 1.0 / (1.0 + np.exp(-log_odds))
    return probability


def _bounds_m(
    grid: OccupancyGrid | None, poses_map_scan: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(2,) and (2,): the map's corners, or those of the trajectory where there is no map."""
    if grid is None:
        positions_m = poses_map_scan[:, :2]
        return positions_m.min(axis=0) - 1.0, positions_m.max(axis=0) + 1.0
    rows, columns = grid.log_odds.shape
    low = np.array(grid.origin_m)
    return low, low + grid.resolution_m * np.array([columns, rows])
