"""Two runs of one recording side by side on one scale, and how far apart their ways are."""

from collections.abc import Sequence
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
from fusion_core.workflows.map.colors import difference_colors, scale_bar_m
from scanloom.plots import sheet as paper
from scanloom.plots.lettering import INK, shortened, write
from scanloom.plots.map_canvas import Canvas, canvas_for
from scanloom.plots.map_raster import TITLE_PX, draw_scale_bar, layout
from scanloom.plots.palette import Color
from scanloom.plots.sheet import LINE_PX, MARGIN_PX, LegendEntry
from scanloom.plots.slam_progress import LATTICE, bounds, lay_map, map_legend

# Height of the ways alone.
_WAYS_PX = 190
_COLORS: tuple[Color, ...] = difference_colors(2)[2:4]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WayOnMap:
    """``stamps_ns``: (N,) rising; ``poses``: (N, 3) x, y, yaw in the frame of ``grid``, which is
    None where there is no map."""

    title: str
    stamps_ns: IntArray
    poses: FloatArray
    grid: OccupancyGrid | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Apart:
    """How far two ways are apart once the second is laid on the first by their first common pose.

    ``times_s``: (K,) since the first common stamp; ``away_m``: (K,). ``second_in_first``: (3,) x,
    y, yaw of the second map's frame in the first's.
    """

    times_s: FloatArray
    away_m: FloatArray
    second_in_first: FloatArray

    def __post_init__(self) -> None:
        read_only(self.times_s)
        read_only(self.away_m)
        read_only(self.second_in_first)


def apart(first: WayOnMap, second: WayOnMap) -> Apart | None:
    """At the stamps of the first way, the second interpolated where it has others; None where the
    two have no time in common."""
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
    frame = np.array([*(here[0, :2] - _turned(there[:1, :2], turn)[0]), turn])
    moved = moved_points(there[:, :2], frame)
    return Apart(
        times_s=(times_ns - times_ns[0]) / NS_PER_S,
        away_m=np.hypot(*(here[:, :2] - moved).T),
        second_in_first=frame,
    )


def moved_points(points_m: FloatArray, frame: FloatArray) -> FloatArray:
    """(N, 2) points of a frame, whose (3,) x, y, yaw is given, in the other frame."""
    moved: FloatArray = _turned(points_m[:, :2], float(frame[2])) + frame[:2]
    return moved


def moved_grid(grid: OccupancyGrid, frame: FloatArray) -> OccupancyGrid:
    """A map laid into another frame: each new cell, of half the side so that no thin wall is lost,
    has the value of the old one at its middle."""
    rows, columns = grid.log_odds.shape
    low = np.array(grid.origin_m)
    corners = low + grid.resolution_m * np.array(
        [[0, 0], [columns, 0], [0, rows], [columns, rows]], dtype=np.float64
    )
    reached = moved_points(corners, frame)
    new_low = reached.min(axis=0)
    side_m = 0.5 * grid.resolution_m
    width, height = np.ceil(np.ptp(reached, axis=0) / side_m - 1e-6).astype(int)
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


def runs_picture(
    first: WayOnMap, second: WayOnMap, *, second_in_first: FloatArray, width_px: int, height_px: int
) -> ByteArray:
    """Both maps with their ways on one scale, in the first map's frame, and the ways alone,
    enlarged.

    Returns (h, width_px, 3) uint8 with h at most ``height_px``.
    """
    grids = [
        first.grid,
        None if second.grid is None else moved_grid(second.grid, second_in_first),
    ]
    ways = [first.poses[:, :2], moved_points(second.poses, second_in_first)]
    lows, highs = zip(
        *(bounds(grid, way) for grid, way in zip(grids, ways, strict=True)), strict=True
    )
    low_m, high_m = np.min(lows, axis=0), np.max(highs, axis=0)
    entries: Sequence[LegendEntry] = [
        LegendEntry(paper.stroke(_COLORS[0]), "way of A"),
        LegendEntry(paper.stroke(_COLORS[1]), "way of B, laid on A by its first pose"),
        *(map_legend() if any(grid is not None for grid in grids) else ()),
    ]
    legend = paper.legend_lines(entries, width_px - 2 * MARGIN_PX)
    # Both scale bars, the ways alone with their title, the legend.
    under = (2 + len(legend)) * LINE_PX + TITLE_PX + _WAYS_PX + 2 * MARGIN_PX
    boxes, px_per_m = layout(
        2, high_m - low_m, width_px - 2 * MARGIN_PX, height_px - under - MARGIN_PX, columns=2
    )
    line = boxes[0].bottom + MARGIN_PX
    top = line + LINE_PX + TITLE_PX
    sheet = paper.blank_sheet(width_px, boxes[0].bottom + under + MARGIN_PX // 2)
    for place, (box, run, grid) in enumerate(zip(boxes, (first, second), grids, strict=True)):
        canvas = Canvas(sheet=sheet, box=box, low_m=low_m, px_per_m=px_per_m)
        lay_map(canvas, grid)
        canvas.way(ways[place], _COLORS[place], 1)
        canvas.ring(ways[place][0], INK)
        box.frame(sheet)
        words = shortened(f"{'AB'[place]}  {run.title}", box.width, size_px=paper.TITLE_PX)
        write(sheet, words, box.left, box.top - 12, size_px=paper.TITLE_PX)
    draw_scale_bar(sheet, boxes[0], px_per_m, line + LINE_PX // 2)
    box = paper.room(MARGIN_PX, top, width_px - MARGIN_PX, top + _WAYS_PX)
    canvas = canvas_for(sheet, box, *bounds(None, *ways))
    canvas.lattice(scale_bar_m(box.width / canvas.px_per_m), LATTICE)
    for way, color in zip(ways, _COLORS, strict=True):
        canvas.way(way, color, 1)
    canvas.ring(ways[0][0], INK)
    box.frame(sheet)
    write(sheet, "A and B, ways alone", box.left, box.top - 12, size_px=paper.TITLE_PX)
    draw_scale_bar(sheet, box, canvas.px_per_m, box.bottom + MARGIN_PX + LINE_PX // 2)
    paper.draw_legend(sheet, legend, MARGIN_PX, box.bottom + MARGIN_PX + LINE_PX)
    return sheet


def _turned(points_m: FloatArray, angle_rad: float) -> FloatArray:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turned: FloatArray = points_m @ np.array([[cos, sin], [-sin, cos]])
    return turned
