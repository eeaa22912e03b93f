"""Figs. 3 and 4 of Xu 2024: the pair aligned in time, and the scores over (u, v)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fusion_core.exporting.figures import (
    NO_VALUE_COLOR,
    add_color_bar,
    add_legend_below,
    describe_delay,
    far_limit_m,
    format_stamp,
    label_azimuth,
    png_figure,
    show_color,
    show_depth,
    show_holes,
    start_at_zero,
)
from fusion_core.exporting.palette import DEPTH, LIDAR
from fusion_core.model.conventions import (
    NS_PER_MS,
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
)
from fusion_core.model.sensors import LaserScan

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SCORE_SHADES = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class SynchronizedFrame:
    """A depth image with the scan and the colour image nearest in time.

    ``color``: (H, W, 3) or None, its stamp ``color_after_ms`` after the depth image's.
    ``depth_m``: (H, W). ``gap_ns``: depth stamp - scan stamp. ``beams_in_view``: indices of the
    beams that meet the image. ``has_nominal_stamps``: whether stamps are made from frame numbers.
    """

    color: ByteArray | None
    color_after_ms: float | None
    depth_m: Float32Array
    depth_stamp_ns: int
    scan: LaserScan
    gap_ns: int
    beams_in_view: IntArray
    has_nominal_stamps: bool


def write_aligned(path: Path, heading: str, frame: SynchronizedFrame) -> None:
    """Fig. 3: colour image, depth image and LiDAR curve nearest in time."""
    clock = " (from the frame number)" if frame.has_nominal_stamps else ""
    panels = 2 if frame.color is None else 3
    with png_figure(path, heading, width_px=530 * panels, height_px=490) as figure:
        axes = figure.subplots(1, panels, squeeze=False)[0]
        letters = iter("abc")
        if frame.color is not None:
            assert frame.color_after_ms is not None, "a colour image has a stamp"
            show_color(axes[0], frame.color)
            delay = describe_delay(frame.color_after_ms, "the depth image")
            axes[0].set_title(f"({next(letters)}) colour image\n{delay}")
        show_depth(axes[-2], frame.depth_m, far_m=far_limit_m(frame.depth_m))
        axes[-2].set_title(
            f"({next(letters)}) depth image, holes in blue\n"
            f"stamp {format_stamp(frame.depth_stamp_ns)}{clock}"
        )
        _show_scan(axes[-1], frame.scan, frame.beams_in_view)
        axes[-1].set_title(
            f"({next(letters)}) LiDAR curve, stamp {format_stamp(frame.scan.stamp_ns)}{clock}\n"
            f"depth image {describe_delay(frame.gap_ns / NS_PER_MS, 'the scan')}"
        )


def _show_scan(axes: "Axes", scan: LaserScan, beams_in_view: IntArray) -> None:
    azimuth_deg = np.rad2deg(scan.angles_rad)
    outside = np.setdiff1d(np.arange(azimuth_deg.size), beams_in_view)
    for beams, color, label in (
        (outside, "0.6", "beam outside the camera's view"),
        (beams_in_view, LIDAR, "beam in the camera's view"),
    ):
        axes.plot(azimuth_deg[beams], scan.ranges_m[beams], ".", color=color, ms=4, label=label)
    show_holes(axes, azimuth_deg, scan.ranges_m)
    label_azimuth(axes)
    axes.set_ylabel("LiDAR range (m)")
    start_at_zero(axes, headroom=0.35)
    axes.legend(loc="upper right")


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldPanel:
    """Scores over (u, v), their peaks, and the scales of the axes.

    ``scores``: (H, U), NaN where there is none, columns from offset ``u_first``. ``peak`` and
    ``runner_up``: (u, v) or None. The camera's yaw on the LiDAR is ``yaw_at_zero_deg`` for u = 0
    and decreases by ``step_deg`` per sample. ``middle_row``: the row at elevation 0; ``focal_px``:
    the vertical focal length.
    """

    scores: FloatArray
    u_first: int
    peak: tuple[float, float] | None
    runner_up: tuple[float, float] | None
    peak_score: float
    yaw_at_zero_deg: float
    step_deg: float
    middle_row: float
    focal_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvePair:
    """The (W,) LiDAR samples and depth samples under a peak, metres, NaN where missing."""

    lidar_m: FloatArray
    depth_m: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricColumn:
    """One score: its name, the field of a frame, the recording's mean field, and the frame's
    curves; None where the recording does not give them."""

    name: str
    frame: FieldPanel | None
    recording: FieldPanel | None
    curves: CurvePair | None


def write_similarity(
    path: Path, heading: str, columns: Sequence[MetricColumn], *, mean_of: str
) -> None:
    """Fig. 4: distributions of the scores, and the two curves at the frame's peaks.

    ``mean_of``: what the recording's mean field is the mean of ("90 frames").
    """
    with png_figure(path, heading, width_px=385 * len(columns), height_px=1150) as figure:
        parts = figure.subfigures(2, 1, height_ratios=(2.1, 1.0), squeeze=False)
        above, below = parts[:, 0]
        fields = above.subplots(2, len(columns), squeeze=False)
        curves = below.subplots(1, len(columns), squeeze=False)[0]
        for i, column in enumerate(columns):
            last = i == len(columns) - 1
            _show_field(fields[0, i], column.frame, f"{column.name}, this frame", last)
            mean = f"{column.name}, mean of {mean_of}"
            _show_field(fields[1, i], column.recording, mean, last)
            _show_curves(curves[i], column)
        add_legend_below(
            below,
            curves,
            columns=2,
            caption="u: LiDAR sample that falls on the leftmost sample of the depth row, counted "
            "from the left. v: depth row, counted from the top.\n"
            "Yaw: how far the camera (its rig) looks to the left of the LiDAR at this u. Grey: no "
            "score (not searched, or too few samples valid on both sides).\n"
            "Curves: the samples that were compared at the peak.",
        )


def _show_field(axes: "Axes", panel: FieldPanel | None, title: str, last: bool) -> None:
    import matplotlib as mpl

    if panel is None or not np.isfinite(panel.scores).any():
        _show_message(axes, f"{title}:\nno score")
        return
    rows, offsets = panel.scores.shape
    shades = mpl.colormaps["viridis"].resampled(_SCORE_SHADES)
    image = axes.imshow(
        panel.scores,
        cmap=shades.with_extremes(bad=NO_VALUE_COLOR),
        aspect="auto",
        extent=(panel.u_first - 0.5, panel.u_first + offsets - 0.5, rows - 0.5, -0.5),
    )
    # The last column has the axis of elevations between the field and its colour bar.
    add_color_bar(axes, image, "score" if last else "", left=1.25 if last else 1.02)
    for place, marker, size in ((panel.runner_up, "o", 7), (panel.peak, "X", 8)):
        if place is not None:
            # White around black stands out on every shade.
            axes.plot(*place, marker, ms=size + 1, mfc="none", mec="white", mew=3.0, clip_on=False)
            axes.plot(*place, marker, ms=size, mfc="none", mec="black", mew=1.2, clip_on=False)
    found = ""
    if panel.peak is not None:
        found = f"\n✕ peak {panel.peak_score:.3f} at u {panel.peak[0]:.1f}, v {panel.peak[1]:.0f}"
    if panel.runner_up is not None:
        found += f"\n○ runner-up at u {panel.runner_up[0]:.0f}, v {panel.runner_up[1]:.0f}"
    axes.set_title(title + found)
    axes.set_xlabel("u (samples)")
    axes.set_ylabel("v (rows)")
    _add_yaw_axis(axes, panel)
    if last:
        _add_elevation_axis(axes, panel)


def _add_yaw_axis(axes: "Axes", panel: FieldPanel) -> None:
    def yaw_deg(u: ArrayLike) -> FloatArray:
        return panel.yaw_at_zero_deg - panel.step_deg * np.asarray(u)

    def offset(deg: ArrayLike) -> FloatArray:
        return (panel.yaw_at_zero_deg - np.asarray(deg)) / panel.step_deg

    axes.secondary_xaxis("top", functions=(yaw_deg, offset)).set_xlabel("yaw (°)")


def _add_elevation_axis(axes: "Axes", panel: FieldPanel) -> None:
    def elevation_deg(v: ArrayLike) -> FloatArray:
        degrees: FloatArray = np.rad2deg(
            np.arctan((panel.middle_row - np.asarray(v)) / panel.focal_px)
        )
        return degrees

    def row(deg: ArrayLike) -> FloatArray:
        rows: FloatArray = panel.middle_row - panel.focal_px * np.tan(np.deg2rad(np.asarray(deg)))
        return rows

    axes.secondary_yaxis("right", functions=(elevation_deg, row)).set_ylabel("elevation (°)")


def _show_curves(axes: "Axes", column: MetricColumn) -> None:
    if column.curves is None or column.frame is None or column.frame.peak is None:
        _show_message(axes, f"{column.name}:\nno peak in this frame")
        return
    samples = np.arange(column.curves.lidar_m.size)
    for values_m, color, label in (
        (column.curves.lidar_m, LIDAR, "LiDAR curve"),
        (column.curves.depth_m, DEPTH, "depth row"),
    ):
        axes.plot(samples, values_m, ".-", color=color, ms=5, lw=0.8, label=label)
    u, v = column.frame.peak
    axes.set_title(f"{column.name}\nthis frame's curves at u {u:.0f}, v {v:.0f}")
    axes.set_xlabel(f"sample of the row ({column.frame.step_deg:.2f}° each)")
    axes.set_ylabel("range (m)")
    start_at_zero(axes)


def _show_message(axes: "Axes", message: str) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, message, ha="center", va="center", transform=axes.transAxes)
