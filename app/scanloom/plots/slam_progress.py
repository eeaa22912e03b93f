"""A run of SLAM from above and to scale while it works: trajectory, particles, loop closures."""

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.slam_view import SlamView
from scanloom.plots.axes import (
    ABOVE_PX,
    FRACTION_BITS,
    Axes,
    draw_dot,
    draw_ring,
    fit_axes,
)
from scanloom.plots.canvas import LINE_PX, MARGIN_PX, blank_canvas, box_between
from scanloom.plots.color_scale import COLOR_BAR_PX, ColorScale
from scanloom.plots.grid_image import draw_metric_grid, draw_scale_bar, grid_step_m
from scanloom.plots.legend import Legend, LegendEntry, line_symbol, padded
from scanloom.plots.palette import Color, color_map, color_of
from scanloom.plots.text import draw_text
from scanloom.plots.theme import LIGHT, Theme
from scanloom.plots.ticks import number_label

TRAJECTORY: Color = color_of("depth")
LOOP_CLOSURE: Color = color_of("lidar")

_CLOSE_UP_PX = 156
# Weights are coloured up to so many times that of equal particles.
_HEAVIEST = 3.0
_SMALLEST_M = 2.0
_CLOSE_UP_LEAST_M = 0.1
# Of the triangle at a pose: its tip and its two other corners.
_ARROW_PX = np.array([[12.0], [9.0], [9.0]])
_ARROW_RAD = np.array([0.0, 2.4, -2.4])

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
        # After loops are closed the whole trajectory may have moved.
        low, high = np.minimum(low, before[0]), np.maximum(high, before[1])
    margin = 0.15 * float((high - low).max()) + 0.5 * _SMALLEST_M
    return low - margin, high + margin


def slam_progress_picture(
    view: SlamView, window: Window, *, width_px: int, height_px: int, theme: Theme = LIGHT
) -> ByteArray:
    """The trajectory so far, the particles with a close-up, and the loop closures.

    Returns (height_px, width_px, 3) uint8. Raises ValueError for too small a picture.
    """
    rgb = blank_canvas(width_px, height_px, theme)
    has_particles = len(view.particles) > 0
    legend = Legend.of(_legend(view), width_px - 2 * MARGIN_PX)
    below = LINE_PX + legend.height_px + 2 * MARGIN_PX
    below += _CLOSE_UP_PX + ABOVE_PX - MARGIN_PX if has_particles else 0
    box = box_between(MARGIN_PX, ABOVE_PX, width_px - MARGIN_PX, height_px - below)
    axes = fit_axes(rgb, box, *window, theme=theme)
    draw_metric_grid(axes, grid_step_m(axes))
    poses = view.poses_map_scan
    axes.draw_line(poses, TRAJECTORY)
    draw_loop_closures(axes, view.loops_m)
    if len(poses):
        draw_start(axes, poses[0])
        _draw_arrow(axes, poses[-1])
    _draw_particles(axes, view, 2.0)
    axes.draw_frame()
    steps_m = np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()
    axes.draw_title(f"{view.stage.capitalize()}: {len(poses)} scans placed, path {steps_m:.1f} m")
    line = box.bottom + MARGIN_PX
    draw_scale_bar(axes, line + LINE_PX // 2)
    legend.draw(rgb, MARGIN_PX, line + LINE_PX, theme)
    if has_particles:
        _draw_close_up(rgb, view, line + LINE_PX + legend.height_px + ABOVE_PX, theme)
    return rgb


def draw_loop_closures(axes: Axes, loops_m: FloatArray) -> None:
    """(L, 4) lines from x, y to x, y, with a dot at each end."""
    axes.draw_segments(loops_m[:, :2], loops_m[:, 2:], LOOP_CLOSURE)
    axes.draw_dots(loops_m.reshape(-1, 2), LOOP_CLOSURE, 2.0)


def draw_start(axes: Axes, pose: FloatArray) -> None:
    """A small circle where a trajectory begins."""
    (place,) = axes.to_fixed(pose[np.newaxis]).tolist()
    draw_dot(axes.inside, place, axes.theme.background, 5.0)
    draw_ring(axes.inside, place, axes.theme.ink, 5.0)


def _draw_arrow(axes: Axes, pose: FloatArray) -> None:
    """A small triangle that points where the (3,) pose looks."""
    angles = pose[2] + _ARROW_RAD
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    corners = [axes.to_fixed(pose[:2] + directions * _ARROW_PX / axes.px_per_unit[0])]
    inside, theme = axes.inside, axes.theme
    cv2.polylines(inside, corners, True, theme.background, 3, cv2.LINE_AA, FRACTION_BITS)
    cv2.fillPoly(inside, corners, theme.ink, cv2.LINE_AA, FRACTION_BITS)


def _draw_particles(
    axes: Axes, view: SlamView, radius_px: float, *, heading_px: float = 0.0
) -> None:
    """Particles as dots coloured by weight, the heaviest on top; ``heading_px``: length of the
    lines that show where they look."""
    order = np.argsort(view.weights, kind="stable")
    particles = view.particles[order]
    # In multiples of the weight of equal particles.
    weights = np.clip(view.weights[order] * len(order) / _HEAVIEST, 0.0, 1.0)
    colors = color_map("viridis")[np.rint(255.0 * weights).astype(np.intp)].tolist()
    places = axes.to_fixed(particles).tolist()
    if heading_px:
        directions = np.column_stack([np.cos(particles[:, 2]), np.sin(particles[:, 2])])
        tips = axes.to_fixed(particles[:, :2] + directions * heading_px / axes.px_per_unit[0])
        for place, tip, color in zip(places, tips.tolist(), colors, strict=True):
            cv2.line(axes.inside, place, tip, color, 1, cv2.LINE_AA, FRACTION_BITS)
    for place, color in zip(places, colors, strict=True):
        draw_dot(axes.inside, place, color, radius_px)


def _draw_close_up(rgb: ByteArray, view: SlamView, top: int, theme: Theme) -> None:
    """The particles alone, enlarged, with the scale of their weights."""
    right, bottom = MARGIN_PX + _CLOSE_UP_PX, top + _CLOSE_UP_PX - MARGIN_PX
    box = box_between(MARGIN_PX, top, right, bottom)
    centre_m = np.average(view.particles[:, :2], axis=0, weights=view.weights)
    farthest_m = float(np.abs(view.particles[:, :2] - centre_m).max())
    half_m = _round_up(max(1.3 * farthest_m, _CLOSE_UP_LEAST_M))
    axes = fit_axes(rgb, box, centre_m - half_m, centre_m + half_m, theme=theme)
    step_m = grid_step_m(axes)
    draw_metric_grid(axes, step_m)
    _draw_particles(axes, view, 3.0, heading_px=11.0)
    axes.draw_frame()
    axes.draw_title("Particles, close up")
    count = len(view.particles)
    is_beyond = bool((view.weights * count > _HEAVIEST).any())
    scale = ColorScale(colors=color_map("viridis"), limits=(0.0, _HEAVIEST), theme=theme)
    scale.draw_bar(rgb, box, "weight × P", beyond=(False, is_beyond))
    known = view.effective[np.isfinite(view.effective)]
    squared_m2 = ((view.particles[:, :2] - centre_m) ** 2).sum(axis=1)
    spread_m = float(np.sqrt(np.average(squared_m2, weights=view.weights)))
    lines = [
        f"P = {count} particles",
        f"N_eff = {known[-1]:.1f}" if known.size else "N_eff: none weighed yet",
        f"spread {100.0 * spread_m:.1f} cm",
        f"lines every {number_label(step_m)} m",
    ]
    for number, text in enumerate(lines):
        place_px = box.right + COLOR_BAR_PX + 16, box.top + 10 + number * LINE_PX
        draw_text(rgb, text, place_px, color=theme.ink)


def _round_up(length_m: float) -> float:
    """To 1, 2 or 5 times a power of ten, so that a scale stays for a while."""
    power = 10.0 ** np.floor(np.log10(length_m))
    return float(next(step * power for step in (1.0, 2.0, 5.0, 10.0) if length_m <= step * power))


def _legend(view: SlamView) -> list[LegendEntry]:
    entries = [
        LegendEntry(line_symbol(TRAJECTORY), "trajectory of the LiDAR"),
        LegendEntry(_start_symbol, "start"),
        LegendEntry(_arrow_symbol, "now"),
    ]
    if len(view.particles):
        entries.append(LegendEntry(_particle_symbol, "particle"))
    # Always shown: a legend that grows would move the picture.
    label = padded(f"loop closures: {len(view.loops_m)}", 19)
    return [*entries, LegendEntry(_loop_symbol, label)]


_MIDDLE_Y = LINE_PX // 2


def _loop_symbol(part: ByteArray, _theme: Theme) -> None:
    cv2.line(part, (3, _MIDDLE_Y), (16, _MIDDLE_Y), LOOP_CLOSURE, 1, cv2.LINE_AA)
    for x in (3, 16):
        cv2.circle(part, (x, _MIDDLE_Y), 2, LOOP_CLOSURE, cv2.FILLED, cv2.LINE_AA)


def _start_symbol(part: ByteArray, theme: Theme) -> None:
    cv2.circle(part, (10, _MIDDLE_Y), 5, theme.ink, 1, cv2.LINE_AA)


def _arrow_symbol(part: ByteArray, theme: Theme) -> None:
    corners = np.array([(4, _MIDDLE_Y - 5), (4, _MIDDLE_Y + 5), (17, _MIDDLE_Y)])
    cv2.fillPoly(part, [corners], theme.ink, cv2.LINE_AA)


def _particle_symbol(part: ByteArray, _theme: Theme) -> None:
    colors = color_map("viridis")
    for x, shade in ((4, 0), (10, 128), (16, 255)):
        cv2.circle(part, (x, _MIDDLE_Y), 2, colors[shade].tolist(), cv2.FILLED, cv2.LINE_AA)
