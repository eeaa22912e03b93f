"""Ranges over azimuth: what the LiDAR measured beside what the camera saw along its curve."""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import ByteArray, FloatArray, IntArray
from fusion_core.model.labels import NO_LABEL, Label
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_match import FrameMatch
from scanloom.plots.axes import FRACTION_BITS, Axes
from scanloom.plots.canvas import WHITE, blank_canvas, box_between
from scanloom.plots.class_marks import class_symbol, draw_class_marks, spread_out
from scanloom.plots.dock_layout import draw_close_axes
from scanloom.plots.label_overlay import label_color
from scanloom.plots.legend import Legend, LegendEntry, line_symbol
from scanloom.plots.palette import color_of
from scanloom.plots.theme import LIGHT, Theme
from scanloom.plots.ticks import whole_ticks_between
from scanloom.state.review_overlay import ReviewOverlay

_MARGIN_PX, _LEFT_PX, _X_LINE_PX = 4, 32, 17
# The lane of the classes' marks, at the bottom of the box.
_LANE_PX = 17
# The strip of a person's labels, at the top of the box.
_LABEL_STRIP_PX = 7
_MARK_SPACING_PX = 9
_METRE_STEP_PX = 20
# The camera's line shows on both sides of the LiDAR's where they agree.
_CAMERA_PX, _LIDAR_PX = 4, 2
_DOT_PX, _REPAIRED_PX = 1.5, 3.5
# Neighbours farther apart than this, and than this share of their range, are different surfaces.
_JUMP_M, _JUMP_FRACTION = 0.15, 0.06
# Single far returns do not set the scale: it ends at most this much above nearly all ranges.
_NEARLY_ALL, _BEYOND_FRACTION = 0.95, 1.5
# As they lie on each other.
_NOISE = (NoiseClass.CONFLICT, NoiseClass.HOLE, NoiseClass.BURR)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RangeProfile:
    """``rgb``: (H, W, 3) uint8. ``axes``: azimuth in degrees, falling to the right, and metres.

    (B,) arrays from left to right: ``beam``, index in the scan; ``azimuth_deg``; ``range_m``: where
    the beam's point is drawn, NaN where it has no value at all.
    """

    rgb: ByteArray
    axes: Axes
    beam: IntArray
    azimuth_deg: FloatArray
    range_m: FloatArray

    def beam_at(self, x_px: float, y_px: float) -> int | None:
        """The beam nearest in azimuth to a point of the picture, None outside of the axes."""
        place = self.axes.to_data(x_px, y_px)
        if place is None or not self.beam.size:
            return None
        return int(self.beam[np.argmin(np.abs(self.azimuth_deg - place[0]))])

    def place_of(self, beam: int) -> tuple[float, float] | None:
        """x, y in the picture of a beam's point, in the lane of the marks where it has no range;
        None for a beam that is not shown."""
        found = np.flatnonzero(self.beam == beam)
        if not found.size:
            return None
        range_m, box = float(self.range_m[found[0]]), self.axes.box
        x, y = self.axes.to_pixel(float(self.azimuth_deg[found[0]]), range_m)
        if not np.isfinite(range_m):
            y = box.bottom - 0.5 * _LANE_PX
        return x, float(np.clip(y, box.top, box.bottom - 1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Curves:
    """(B,) arrays, NaN where missing: ``repaired_m`` only of beams that were repaired;
    ``noise_class``: -1 where the frame has none."""

    beam: IntArray
    azimuth_deg: FloatArray
    lidar_m: FloatArray
    camera_m: FloatArray
    repaired_m: FloatArray
    noise_class: IntArray

    def from_left(self) -> "_Curves":
        """In the order of the picture."""
        order = np.argsort(-self.azimuth_deg, kind="stable")
        return _Curves(
            beam=self.beam[order],
            azimuth_deg=self.azimuth_deg[order],
            lidar_m=self.lidar_m[order],
            camera_m=self.camera_m[order],
            repaired_m=self.repaired_m[order],
            noise_class=self.noise_class[order],
        )


def range_profile(
    frame: FusedFrame | FrameMatch,
    *,
    width_px: int,
    height_px: int,
    beam: int | None = None,
    review: ReviewOverlay | None = None,
    theme: Theme = LIGHT,
) -> RangeProfile:
    """Draw the beams within the camera's view: the LiDAR's ranges, the camera's depth as range
    along its curve, repaired ranges, and the classes of beams that are not good.

    ``frame``: with classes and repairs where it is fused. ``beam``: the selected one, an index in
    the scan. ``review``: labels, as colours above the beams, and marked beams. Raises ValueError
    where the picture is too small.
    """
    match = frame.match if isinstance(frame, FusedFrame) else frame
    pairs = match.correspondence
    repaired_m, noise_class = np.full(pairs.beam.size, np.nan), np.full(pairs.beam.size, -1)
    if isinstance(frame, FusedFrame):
        noise_class = frame.classes.lidar_class
        changed = frame.repair.lidar_range_m != pairs.lidar_range_m
        repaired_m[changed] = frame.repair.lidar_range_m[changed]
    curves = _Curves(
        beam=pairs.beam,
        azimuth_deg=_degrees(pairs.azimuth_rad),
        lidar_m=pairs.lidar_range_m,
        camera_m=pairs.depth_as_range_m,
        repaired_m=repaired_m,
        noise_class=noise_class,
    )
    return _draw(curves, (width_px, height_px), beam, theme, review)


def scan_profile(
    scan: LaserScan,
    *,
    width_px: int,
    height_px: int,
    beam: int | None = None,
    theme: Theme = LIGHT,
) -> RangeProfile:
    """Draw all beams of a scan by itself, while nothing is known of a camera.

    ``beam``: the selected one. Raises ValueError where the picture is too small.
    """
    nothing = np.full(scan.ranges_m.size, np.nan)
    curves = _Curves(
        beam=np.arange(scan.ranges_m.size),
        azimuth_deg=_degrees(scan.angles_rad),
        lidar_m=scan.ranges_m,
        camera_m=nothing,
        repaired_m=nothing,
        noise_class=np.full(scan.ranges_m.size, -1),
    )
    return _draw(curves, (width_px, height_px), beam, theme)


def _draw(
    curves: _Curves,
    size_px: tuple[int, int],
    selected: int | None,
    theme: Theme,
    review: ReviewOverlay | None = None,
) -> RangeProfile:
    curves = curves.from_left()
    width_px, height_px = size_px
    legend = Legend.of(_legend(curves), width_px - 2 * _MARGIN_PX)
    top = _MARGIN_PX + legend.height_px + _MARGIN_PX
    box = box_between(_LEFT_PX, top, width_px - _MARGIN_PX - 1, height_px - _X_LINE_PX)
    low_m, high_m = _limits_m(curves)
    lane_m = _LANE_PX * (high_m - low_m) / max(box.height - _LANE_PX, 1)
    rgb = blank_canvas(width_px, height_px, theme)
    axes = Axes(
        rgb=rgb,
        box=box,
        x_limits=_limits_deg(curves.azimuth_deg),
        y_limits=(low_m - lane_m, high_m),
        theme=theme,
    )
    ticks_m = whole_ticks_between(low_m, high_m, max(2, box.height // _METRE_STEP_PX))
    axes.draw_grid(axes.x_ticks(whole=True), ticks_m)
    axes.inside[-_LANE_PX] = theme.edge
    draw_close_axes(axes, "azimuth (°), left +", "m", y_ticks=ticks_m)
    if review is not None:
        _draw_review(axes, curves, review)
    if selected is not None:
        _draw_selected(axes, curves, selected)
    _draw_curve(axes, curves.azimuth_deg, curves.camera_m, "depth", _CAMERA_PX)
    _draw_curve(axes, curves.azimuth_deg, curves.lidar_m, "lidar", _LIDAR_PX)
    _draw_repaired(axes, curves)
    _draw_classes(axes, curves)
    legend.draw(rgb, _MARGIN_PX, _MARGIN_PX, theme)
    known_m = np.where(np.isfinite(curves.repaired_m), curves.repaired_m, curves.camera_m)
    return RangeProfile(
        rgb=rgb,
        axes=axes,
        beam=curves.beam,
        azimuth_deg=curves.azimuth_deg,
        range_m=np.where(np.isfinite(curves.lidar_m), curves.lidar_m, known_m),
    )


def _degrees(azimuth_rad: FloatArray) -> FloatArray:
    """Continuous azimuths in degrees, their middle within half a turn of 0."""
    degrees: FloatArray = np.rad2deg(azimuth_rad)
    return degrees - 360.0 * np.round(degrees.mean() / 360.0) if degrees.size else degrees


def _limits_deg(azimuth_deg: FloatArray) -> tuple[float, float]:
    """From the left to the right, with half a beam at both ends."""
    if not azimuth_deg.size:
        return 1.0, -1.0
    first, last = float(azimuth_deg[0]), float(azimuth_deg[-1])
    half = 0.5 * (first - last) / (azimuth_deg.size - 1) if azimuth_deg.size > 1 else 1.0
    return first + max(half, 1e-3), last - max(half, 1e-3)


def _limits_m(curves: _Curves) -> tuple[float, float]:
    """Whole metres, so that they seldom change from frame to frame."""
    values = np.concatenate([curves.lidar_m, curves.camera_m, curves.repaired_m])
    values = values[np.isfinite(values)]
    if not values.size:
        return 0.0, 1.0
    most = _BEYOND_FRACTION * float(np.quantile(values, _NEARLY_ALL))
    low = float(np.floor(values.min()))
    return low, max(float(np.ceil(min(values.max(), most))), low + 1.0)


def _draw_curve(
    axes: Axes, azimuth_deg: FloatArray, range_m: FloatArray, sensor: str, width_px: int
) -> None:
    """A line through neighbours on one surface, and dots, so that single values are seen too."""
    color = color_of("lidar" if sensor == "lidar" else "depth")
    exists = np.flatnonzero(np.isfinite(range_m))
    if not exists.size:
        return
    # What is beyond the scale is at its edge.
    points = np.column_stack([azimuth_deg, np.minimum(range_m, axes.y_limits[1])])[exists]
    steps_m, known_m = np.abs(np.diff(range_m[exists])), range_m[exists][1:]
    ends = (np.diff(exists) > 1) | (steps_m > np.maximum(_JUMP_M, _JUMP_FRACTION * known_m))
    fixed = axes.to_fixed(points)
    # The first point twice: a line of one point would not be drawn.
    lines = [np.vstack([part[:1], part]) for part in np.split(fixed, np.flatnonzero(ends) + 1)]
    cv2.polylines(axes.inside, lines, False, color, width_px, cv2.LINE_AA, FRACTION_BITS)
    if sensor == "lidar" and len(points) * 3 < axes.box.width:
        axes.draw_dots(points, color, _DOT_PX)


def _draw_repaired(axes: Axes, curves: _Curves) -> None:
    chosen = np.isfinite(curves.repaired_m)
    points = np.column_stack([curves.azimuth_deg, curves.repaired_m])[chosen]
    axes.draw_dots(points, axes.theme.ink, _REPAIRED_PX + 0.5)
    axes.draw_dots(points, color_of("lidar"), _REPAIRED_PX - 0.5)
    axes.draw_dots(points, WHITE, _REPAIRED_PX - 2.0)


def _draw_classes(axes: Axes, curves: _Curves) -> None:
    """The marks of beams that are not good, in the lane at the bottom."""
    box = axes.box
    x = np.rint([axes.to_pixel(azimuth, 0.0)[0] for azimuth in curves.azimuth_deg]) - box.left
    places = np.column_stack([x, np.full(x.size, box.height - _LANE_PX // 2 - 1)]).astype(np.int64)
    for noise in _NOISE:
        chosen = places[curves.noise_class == noise]
        chosen = chosen[spread_out(chosen, _MARK_SPACING_PX)]
        draw_class_marks(axes.inside, chosen, noise)


def _draw_review(axes: Axes, curves: _Curves, review: ReviewOverlay) -> None:
    """The labels in a strip at the top, and a grey ground below what is marked."""
    half_deg = 0.5 * abs(axes.x_limits[0] - axes.x_limits[1]) / max(curves.beam.size, 1)
    for beam, azimuth_deg in zip(curves.beam, curves.azimuth_deg, strict=True):
        left = round(axes.to_pixel(azimuth_deg + half_deg, 0.0)[0]) - axes.box.left
        right = round(axes.to_pixel(azimuth_deg - half_deg, 0.0)[0]) - axes.box.left
        columns = slice(max(left, 0), max(right, left + 1, 1))
        if review.selected_beams[beam]:
            axes.inside[:, columns] = axes.theme.edge
        if review.beam_labels[beam] != NO_LABEL:
            color = label_color(Label(review.beam_labels[beam]))
            axes.inside[:_LABEL_STRIP_PX, columns] = color


def _draw_selected(axes: Axes, curves: _Curves, beam: int) -> None:
    """A line through the selected beam."""
    for place in np.flatnonzero(curves.beam == beam):
        x = round(axes.to_pixel(float(curves.azimuth_deg[place]), 0.0)[0]) - axes.box.left
        axes.inside[:, max(x, 0) : x + 1] = axes.theme.ink


def _legend(curves: _Curves) -> list[LegendEntry]:
    entries = [LegendEntry(line_symbol(color_of("lidar")), "LiDAR")]
    if np.isfinite(curves.camera_m).any():
        entries.append(LegendEntry(line_symbol(color_of("depth"), _CAMERA_PX), "depth camera"))
    if (curves.noise_class >= 0).any():
        entries.append(LegendEntry(_repaired_symbol, "repaired"))
        entries += [LegendEntry(class_symbol(one), one.name.lower()) for one in sorted(_NOISE)]
    return entries


def _repaired_symbol(part: ByteArray, theme: Theme) -> None:
    middle = part.shape[1] // 2, part.shape[0] // 2
    for color, radius_px in ((theme.ink, 4), (color_of("lidar"), 3)):
        cv2.circle(part, middle, radius_px, color, cv2.FILLED, cv2.LINE_AA)
    cv2.circle(part, middle, 1, WHITE, cv2.FILLED, cv2.LINE_AA)
