"""A run of SLAM from above and to scale: while it works, and on its map once it is done.

The colours are those of the exported pictures.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.slam_view import SlamView
from fusion_core.workflows.map.colors import FREE, UNKNOWN, scale_bar_m
from scanloom.plots import sheet as paper
from scanloom.plots.lettering import INK, shortened, write
from scanloom.plots.map_canvas import Canvas, canvas_for
from scanloom.plots.map_raster import TITLE_PX, draw_scale_bar, drawn, layout, raster_of_grid
from scanloom.plots.palette import Color, color_map, color_of
from scanloom.plots.sheet import LINE_PX, MARGIN_PX, LegendEntry

WAY: Color = color_of("depth")
LOOP: Color = color_of("lidar")
UNTRUSTED: Color = color_of("burr")
_OCCUPIED: Color = (0, 0, 0)
LATTICE: Color = (236, 239, 242)
_CLOSE_UP_PX = 156
# Weights are coloured up to so many times that of equal particles.
_HEAVIEST = 3.0
_SMALLEST_M = 2.0
_CLOSE_UP_LEAST_M = 0.1
Window = tuple[FloatArray, FloatArray]
"""(2,) least and (2,) greatest x, y that a picture shows."""


def window_around(view: SlamView, before: Window | None = None) -> Window | None:
    """What a picture of a run shows: that of the picture before as long as it holds everything,
    so that the picture does not swim, and some room to grow in where it does not.

    None where nothing is placed.
    """
    points_m = np.concatenate([view.poses_map_scan[:, :2], view.particles[:, :2]])
    if len(points_m) == 0:
        return None
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    if before is not None and (before[0] <= low).all() and (high <= before[1]).all():
        return before
    if before is not None:
        # After loops are closed the whole way may have moved.
        low, high = np.minimum(low, before[0]), np.maximum(high, before[1])
    margin = 0.15 * float((high - low).max()) + 0.5 * _SMALLEST_M
    return low - margin, high + margin


def live_picture(view: SlamView, window: Window, *, width_px: int, height_px: int) -> ByteArray:
    """The way so far, the particles with a close-up, and the loop closures.

    Returns (height_px, width_px, 3) uint8. Raises ValueError for too small a picture.
    """
    sheet = paper.blank_sheet(width_px, height_px)
    count = len(view.particles)
    legend = paper.legend_lines(_live_legend(view), width_px - 2 * MARGIN_PX)
    under = (1 + len(legend)) * LINE_PX + MARGIN_PX + (_CLOSE_UP_PX + TITLE_PX if count else 0)
    top = MARGIN_PX + TITLE_PX
    box = paper.room(MARGIN_PX, top, width_px - MARGIN_PX, height_px - under - MARGIN_PX)
    canvas = canvas_for(sheet, box, *window)
    canvas.lattice(scale_bar_m(box.width / canvas.px_per_m), LATTICE)
    poses = view.poses_map_scan
    canvas.way(poses, WAY)
    canvas.links(view.loops_m, LOOP)
    if len(poses):
        canvas.ring(poses[0], INK)
        canvas.arrow(poses[-1], INK)
    if count:
        order = np.argsort(view.weights, kind="stable")
        canvas.dots(view.particles[order], _weight_colors(view.weights[order]), 2)
    box.frame(sheet)
    steps_m = np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()
    title = f"{view.stage.capitalize()}: {len(poses)} scans placed, {steps_m:.1f} m of way"
    words = shortened(title, box.width, size_px=paper.TITLE_PX)
    write(sheet, words, box.left, box.top - 12, size_px=paper.TITLE_PX)
    line = box.bottom + MARGIN_PX
    draw_scale_bar(sheet, box, canvas.px_per_m, line + LINE_PX // 2)
    paper.draw_legend(sheet, legend, MARGIN_PX, line + LINE_PX)
    if count:
        _close_up(sheet, view, line + (1 + len(legend)) * LINE_PX + TITLE_PX)
    return sheet


def run_picture(
    title: str,
    grid: OccupancyGrid | None,
    poses_map_scan: FloatArray,
    trusted: BoolArray,
    loops_m: FloatArray,
    *,
    width_px: int,
    height_px: int,
) -> ByteArray:
    """A finished run: the way over its map, loop closures, and what cannot be trusted.

    ``grid``: None where there is no map. ``poses_map_scan``: (N, 3), ``trusted``: (N,),
    ``loops_m``: (L, 4). Returns (h, width_px, 3) uint8 with h at most ``height_px``.
    """
    low_m, high_m = bounds(grid, poses_map_scan)
    entries = [
        LegendEntry(paper.stroke(WAY), "way of the LiDAR"),
        LegendEntry(_begin, "begin"),
        LegendEntry(_end, "end"),
    ]
    if len(loops_m):
        entries.append(LegendEntry(_link, f"loop closures: {len(loops_m)}"))
    if not trusted.all():
        entries.append(LegendEntry(paper.stroke(UNTRUSTED, 3), "untrusted"))
    if grid is not None:
        entries += map_legend()
    legend = paper.legend_lines(entries, width_px - 2 * MARGIN_PX)
    under = (1 + len(legend)) * LINE_PX + MARGIN_PX
    (box,), px_per_m = layout(
        1, high_m - low_m, width_px - 2 * MARGIN_PX, height_px - under - MARGIN_PX
    )
    sheet = paper.blank_sheet(width_px, box.bottom + under + MARGIN_PX // 2)
    canvas = Canvas(sheet=sheet, box=box, low_m=low_m, px_per_m=px_per_m)
    lay_map(canvas, grid)
    canvas.links(loops_m, LOOP)
    canvas.way(poses_map_scan, WAY)
    canvas.stretches(poses_map_scan, ~trusted, UNTRUSTED)
    canvas.ring(poses_map_scan[0], INK)
    canvas.arrow(poses_map_scan[-1], INK)
    box.frame(sheet)
    words = shortened(title, width_px - 2 * MARGIN_PX, size_px=paper.TITLE_PX)
    write(sheet, words, box.left, box.top - 12, size_px=paper.TITLE_PX)
    draw_scale_bar(sheet, box, px_per_m, box.bottom + MARGIN_PX + LINE_PX // 2)
    paper.draw_legend(sheet, legend, MARGIN_PX, box.bottom + MARGIN_PX + LINE_PX)
    return sheet


def bounds(grid: OccupancyGrid | None, *ways: FloatArray) -> Window:
    """All that is known of a map and of (N, >= 2) ways, with a little room around."""
    corners = [way[:, :2] for way in ways]
    if grid is not None and grid.known.any():
        rows, columns = np.nonzero(grid.known)
        cells = np.column_stack([columns, rows])
        ends = np.array([cells.min(axis=0), cells.max(axis=0) + 1])
        corners.append(np.array(grid.origin_m) + grid.resolution_m * ends)
    points_m = np.concatenate(corners)
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    margin = 0.02 * float((high - low).max())
    # A robot that stood still is a point.
    lacking = np.maximum(0.5 * (_SMALLEST_M - (high - low)), 0.0)
    return low - margin - lacking, high + margin + lacking


def lay_map(canvas: Canvas, grid: OccupancyGrid | None) -> None:
    """A map as the ground of a picture; without one, what is unknown."""
    part = canvas.box.view(canvas.sheet)
    if grid is None:
        part[:] = UNKNOWN
        return
    raster = raster_of_grid(grid)
    part[:] = drawn(raster, canvas.low_m, canvas.px_per_m, canvas.box)


def map_legend() -> list[LegendEntry]:
    """What the ground's colours mean."""
    known = ((_OCCUPIED, "obstacle"), (FREE, "free"), (UNKNOWN, "unknown"))
    return [LegendEntry(paper.swatch(color), words) for color, words in known]


def _close_up(sheet: ByteArray, view: SlamView, top: int) -> None:
    """The particles alone, enlarged, with their weights' scale."""
    box = paper.room(MARGIN_PX, top, MARGIN_PX + _CLOSE_UP_PX, top + _CLOSE_UP_PX - MARGIN_PX)
    centre = np.average(view.particles[:, :2], axis=0, weights=view.weights)
    reach_m = float(np.abs(view.particles[:, :2] - centre).max())
    half_m = _round_up(max(1.3 * reach_m, _CLOSE_UP_LEAST_M))
    canvas = canvas_for(sheet, box, centre - half_m, centre + half_m)
    bar_m = scale_bar_m(box.width / canvas.px_per_m)
    canvas.lattice(bar_m, LATTICE)
    order = np.argsort(view.weights, kind="stable")
    particles, colors = view.particles[order], _weight_colors(view.weights[order])
    canvas.headings(particles, colors, 11.0)
    canvas.dots(particles, colors, 3)
    box.frame(sheet)
    write(sheet, "Particles, close up", box.left, box.top - 12, size_px=paper.TITLE_PX)
    count = len(view.particles)
    equal = view.weights * count
    paper.color_bar(
        sheet,
        box,
        (0.0, _HEAVIEST),
        color_map("viridis"),
        words="weight × P",
        beyond=(False, bool((equal > _HEAVIEST).any())),
    )
    known = view.effective[np.isfinite(view.effective)]
    spread_m = float(
        np.sqrt(
            np.average(((view.particles[:, :2] - centre) ** 2).sum(axis=1), weights=view.weights)
        )
    )
    lines = [
        f"P = {count} particles",
        f"N_eff = {known[-1]:.1f}" if known.size else "N_eff: none weighed yet",
        f"spread {100.0 * spread_m:.1f} cm",
        f"lines every {paper.number(bar_m)} m",
    ]
    left = box.right + paper.COLOR_BAR_PX + 16
    for place, words in enumerate(lines):
        write(sheet, words, left, box.top + 10 + place * LINE_PX)


def _weight_colors(weights: FloatArray) -> ByteArray:
    """(P, 3) by how many times the weight of equal particles each has."""
    share = np.clip(weights * len(weights) / _HEAVIEST, 0.0, 1.0)
    return color_map("viridis")[np.rint(255.0 * share).astype(np.intp)]


def _round_up(length_m: float) -> float:
    """To 1, 2 or 5 times a power of ten, so that a scale stays for a while."""
    power = 10.0 ** np.floor(np.log10(length_m))
    return float(next(step * power for step in (1.0, 2.0, 5.0, 10.0) if length_m <= step * power))


def _live_legend(view: SlamView) -> Sequence[LegendEntry]:
    entries = [
        LegendEntry(paper.stroke(WAY), "way of the LiDAR"),
        LegendEntry(_begin, "begin"),
        LegendEntry(_end, "now"),
    ]
    if len(view.particles):
        entries.append(LegendEntry(_particle, "particle"))
    # Always there: a legend that grows would move the picture.
    entries.append(LegendEntry(_link, paper.steady(f"loop closures: {len(view.loops_m)}", 19)))
    return entries


def _link(part: ByteArray) -> None:
    middle = LINE_PX // 2
    cv2.line(part, (3, middle), (16, middle), LOOP, 1, cv2.LINE_AA)
    for x in (3, 16):
        cv2.circle(part, (x, middle), 2, LOOP, cv2.FILLED, cv2.LINE_AA)


def _begin(part: ByteArray) -> None:
    cv2.circle(part, (10, LINE_PX // 2), 5, INK, 1, cv2.LINE_AA)


def _end(part: ByteArray) -> None:
    middle = LINE_PX // 2
    cv2.fillPoly(
        part, [np.array([(4, middle - 5), (4, middle + 5), (17, middle)])], INK, cv2.LINE_AA
    )


def _particle(part: ByteArray) -> None:
    colors = color_map("viridis")
    for x, shade in ((4, 0), (10, 128), (16, 255)):
        color = tuple(colors[shade].tolist())
        cv2.circle(part, (x, LINE_PX // 2), 2, color, cv2.FILLED, cv2.LINE_AA)
