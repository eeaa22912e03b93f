"""Two runs of one recording side by side on one scale, and how far their trajectories differ."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import (
    NS_PER_S,
    ByteArray,
    FloatArray,
    IntArray,
    read_only,
    wrap_angle,
)
from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.map.colors import difference_colors
from scanloom.plots.axes import ABOVE_PX, fit_axes
from scanloom.plots.canvas import LINE_PX, MARGIN_PX, Box, blank_canvas, box_between
from scanloom.plots.grid_image import (
    draw_metric_grid,
    draw_scale_bar,
    grid_legend,
    grid_step_m,
    paint_grid,
)
from scanloom.plots.legend import Legend, LegendEntry, line_symbol
from scanloom.plots.palette import Color
from scanloom.plots.slam_progress import Window, draw_start
from scanloom.plots.theme import LIGHT, Theme

_OVERLAY_PX = 190
"""Height of the plot of both trajectories."""
_BETWEEN_PX = 12
_SMALLEST_M = 2.0
_COLORS: tuple[Color, ...] = difference_colors(2)[2:4]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunOnMap:
    """``stamps_ns``: (N,) rising; ``poses``: (N, 3) x, y, yaw in the frame of ``grid``, which is
    None where there is no map."""

    title: str
    stamps_ns: IntArray
    poses: FloatArray
    grid: OccupancyGrid | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrajectoryDifference:
    """The distance of two trajectories after aligning the second to the first at their first
    common pose.

    ``times_s``: (K,) since the first common stamp; ``distances_m``: (K,). ``second_in_first``: (3,)
    x, y, yaw of the second map's frame in the first's.
    """

    times_s: FloatArray
    distances_m: FloatArray
    second_in_first: FloatArray

    def __post_init__(self) -> None:
        read_only(self.times_s)
        read_only(self.distances_m)
        read_only(self.second_in_first)


def compare_trajectories(first: RunOnMap, second: RunOnMap) -> TrajectoryDifference | None:
    """At the stamps of the first trajectory, the second interpolated where it has others; None
    where the two have no time in common."""
    stamps_ns = first.stamps_ns
    inside = (stamps_ns >= second.stamps_ns[0]) & (stamps_ns <= second.stamps_ns[-1])
    if not inside.any():
        return None
    here, times_ns = first.poses[inside], stamps_ns[inside]
    # Small numbers: a stamp of today in seconds leaves a float too few digits.
    zero_ns = second.stamps_ns[0]
    known_s = (second.stamps_ns - zero_ns) / NS_PER_S
    asked_s = (times_ns - zero_ns) / NS_PER_S
    yaw = np.unwrap(second.poses[:, 2])
    there = np.column_stack(
        [np.interp(asked_s, known_s, v) for v in (second.poses[:, 0], second.poses[:, 1], yaw)]
    )
    turn = float(wrap_angle(here[0, 2] - there[0, 2]))
    frame = np.array([*(here[0, :2] - _rotate(there[:1, :2], turn)[0]), turn])
    moved = transform_points(there[:, :2], frame)
    return TrajectoryDifference(
        times_s=(times_ns - times_ns[0]) / NS_PER_S,
        distances_m=np.hypot(*(here[:, :2] - moved).T),
        second_in_first=frame,
    )


def transform_points(points_m: FloatArray, frame: FloatArray) -> FloatArray:
    """(N, 2) points of a frame in another; ``frame``: (3,) x, y, yaw of the one in the other."""
    moved: FloatArray = _rotate(points_m[:, :2], float(frame[2])) + frame[:2]
    return moved


def transform_grid(grid: OccupancyGrid, frame: FloatArray) -> OccupancyGrid:
    """A map resampled in another frame: each new cell, of half the side so that no thin wall is
    lost, has the value of the old one at its middle."""
    rows, columns = grid.log_odds.shape
    low = np.array(grid.origin_m)
    corners = low + grid.resolution_m * np.array(
        [[0, 0], [columns, 0], [0, rows], [columns, rows]], dtype=np.float64
    )
    corners_in_frame_m = transform_points(corners, frame)
    new_low = corners_in_frame_m.min(axis=0)
    side_m = 0.5 * grid.resolution_m
    width, height = np.ceil(np.ptp(corners_in_frame_m, axis=0) / side_m - 1e-6).astype(int)
    x = new_low[0] + (np.arange(width) + 0.5) * side_m - frame[0]
    y = new_low[1] + (np.arange(height) + 0.5) * side_m - frame[1]
    cos, sin = np.cos(frame[2]), np.sin(frame[2])
    column = (cos * x[np.newaxis] + sin * y[:, np.newaxis] - low[0]) / grid.resolution_m
    row = (-sin * x[np.newaxis] + cos * y[:, np.newaxis] - low[1]) / grid.resolution_m
    column, row = np.floor(column).astype(np.int64), np.floor(row).astype(np.int64)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    log_odds = np.full((height, width), np.nan)
    log_odds[inside] = grid.log_odds[row[inside], column[inside]]
    return OccupancyGrid(
        resolution_m=side_m,
        origin_m=(float(new_low[0]), float(new_low[1])),
        log_odds=log_odds,
        frame_id=grid.frame_id,
    )


def comparison_picture(
    first: RunOnMap,
    second: RunOnMap,
    *,
    second_in_first: FloatArray,
    width_px: int,
    height_px: int,
    theme: Theme = LIGHT,
) -> ByteArray:
    """Both maps with their trajectories on one scale, in the first map's frame, and the
    trajectories alone, enlarged.

    Returns (h, width_px, 3) uint8 with h at most ``height_px``.
    """
    grids = (
        first.grid,
        None if second.grid is None else transform_grid(second.grid, second_in_first),
    )
    trajectories = first.poses[:, :2], transform_points(second.poses, second_in_first)
    windows = [_window(grid, poses) for grid, poses in zip(grids, trajectories, strict=True)]
    low_m = np.min([low for low, _ in windows], axis=0)
    high_m = np.max([high for _, high in windows], axis=0)
    legend = Legend.of(
        [
            LegendEntry(line_symbol(_COLORS[0]), "trajectory of A"),
            LegendEntry(line_symbol(_COLORS[1]), "trajectory of B, aligned at its first pose"),
            *(grid_legend(theme) if any(grid is not None for grid in grids) else ()),
        ],
        width_px - 2 * MARGIN_PX,
    )
    # Both scale bars, the overlay with its title, the legend.
    below = 2 * (LINE_PX + MARGIN_PX) + ABOVE_PX + _OVERLAY_PX + legend.height_px + MARGIN_PX // 2
    boxes = _two_boxes(high_m - low_m, width_px, height_px - below)
    bar_top = boxes[0].bottom + MARGIN_PX
    rgb = blank_canvas(width_px, boxes[0].bottom + below, theme)
    for number, run in enumerate((first, second)):
        axes = fit_axes(rgb, boxes[number], low_m, high_m, theme=theme)
        paint_grid(axes, grids[number])
        axes.draw_line(trajectories[number], _COLORS[number], 1)
        draw_start(axes, trajectories[number][0])
        axes.draw_frame()
        axes.draw_title(f"{'AB'[number]}  {run.title}")
        draw_scale_bar(axes, bar_top + LINE_PX // 2)
    top = bar_top + LINE_PX + ABOVE_PX
    box = box_between(MARGIN_PX, top, width_px - MARGIN_PX, top + _OVERLAY_PX)
    axes = fit_axes(rgb, box, *_window(None, np.concatenate(trajectories)), theme=theme)
    draw_metric_grid(axes, grid_step_m(axes))
    for trajectory, color in zip(trajectories, _COLORS, strict=True):
        axes.draw_line(trajectory, color, 1)
    draw_start(axes, trajectories[0][0])
    axes.draw_frame()
    axes.draw_title("Trajectories of A and B, enlarged")
    bar_top = box.bottom + MARGIN_PX
    draw_scale_bar(axes, bar_top + LINE_PX // 2)
    legend.draw(rgb, MARGIN_PX, bar_top + LINE_PX, theme)
    return rgb


def _two_boxes(size_m: FloatArray, width_px: int, bottom: int) -> tuple[Box, Box]:
    """The largest two boxes side by side that have the proportions of a window."""
    half_px = (width_px - 2 * MARGIN_PX - _BETWEEN_PX) / 2
    px_per_m = min(half_px / size_m[0], (bottom - ABOVE_PX) / size_m[1])
    width, height = int(px_per_m * size_m[0]), int(px_per_m * size_m[1])
    left = box_between(MARGIN_PX, ABOVE_PX, MARGIN_PX + width, ABOVE_PX + height)
    return left, Box(left.right + _BETWEEN_PX, left.top, left.width, left.height)


def _window(grid: OccupancyGrid | None, points_m: FloatArray) -> Window:
    """All that is known of a map and of (N, 2) points, with a little room around."""
    corners_m = points_m
    if grid is not None and grid.known.any():
        rows, columns = np.nonzero(grid.known)
        cells = np.column_stack([columns, rows])
        ends = np.array([cells.min(axis=0), cells.max(axis=0) + 1])
        ends_m = np.array(grid.origin_m) + grid.resolution_m * ends
        corners_m = np.concatenate([points_m, ends_m])
    low, high = corners_m.min(axis=0), corners_m.max(axis=0)
    margin = 0.02 * float((high - low).max())
    # A robot that did not move is a point.
    lacking = np.maximum(0.5 * (_SMALLEST_M - (high - low)), 0.0)
    return low - margin - lacking, high + margin + lacking


def _rotate(points_m: FloatArray, angle_rad: float) -> FloatArray:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    rotated: FloatArray = points_m @ np.array([[cos, sin], [-sin, cos]])
    return rotated
