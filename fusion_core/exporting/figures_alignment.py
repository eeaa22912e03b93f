"""Figs. 3 and 4 of Xu 2024: the pair aligned in time, and the scores over (u, v)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    leave_margin,
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
# What the axis of yaw takes between a field and its title: ticks, numbers and its name.
_YAW_AXIS_PT = 18.0
# Of the width: numbers of the outermost scales reach some pixels beyond where the layout puts them.
_FIELD_MARGIN = 0.01


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
    images: Any = ["depth"] if frame.color is None else ["color", "depth"]
    with png_figure(path, heading, height_in=3.4) as figure:
        axes = figure.subplot_mosaic([images, ["scan"] * len(images)])
        letters = iter("abc")
        if frame.color is not None:
            assert frame.color_after_ms is not None, "a colour image has a stamp"
            show_color(axes["color"], frame.color)
            delay = describe_delay(frame.color_after_ms, "the depth image")
            axes["color"].set_title(f"({next(letters)}) colour image\n{delay}")
        show_depth(axes["depth"], frame.depth_m, far_m=far_limit_m(frame.depth_m))
        axes["depth"].set_title(
            f"({next(letters)}) depth image, holes in blue\n"
            f"{format_stamp(frame.depth_stamp_ns)}{clock}"
        )
        _show_scan(axes["scan"], frame.scan, frame.beams_in_view)
        add_legend_below(figure, [axes["scan"]], columns=2)
        axes["scan"].set_title(
            f"({next(letters)}) LiDAR curve, {format_stamp(frame.scan.stamp_ns)}{clock}; "
            f"depth image {describe_delay(frame.gap_ns / NS_PER_MS, 'the scan')}"
        )


def _show_scan(axes: "Axes", scan: LaserScan, beams_in_view: IntArray) -> None:
    azimuth_deg = np.rad2deg(scan.angles_rad)
    outside = np.setdiff1d(np.arange(azimuth_deg.size), beams_in_view)
    for beams, color, label in (
        (outside, "0.6", "beam outside the camera's view"),
        (beams_in_view, LIDAR, "beam in the camera's view"),
    ):
        axes.plot(azimuth_deg[beams], scan.ranges_m[beams], ".", color=color, ms=2.6, label=label)
    show_holes(axes, azimuth_deg, scan.ranges_m)
    label_azimuth(axes)
    axes.set_ylabel("LiDAR range (m)")
    start_at_zero(axes)


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldPanel:
    """Scores over (u, v), their peaks, and the scales of the axes.

    ``scores``: (H, U), NaN where there is none, columns from offset ``u_first``. ``peak`` and
    ``runner_up``: (u, v) or None. The camera's yaw on the LiDAR is ``yaw_at_zero_deg`` for u = 0
    and decreases by ``step_deg`` per sample; ``mount_u`` is where it is the mount's.
    ``middle_row``: the row at elevation 0; ``focal_px``: the vertical focal length.
    """

    scores: FloatArray
    u_first: int
    peak: tuple[float, float] | None
    runner_up: tuple[float, float] | None
    peak_score: float
    yaw_at_zero_deg: float
    step_deg: float
    mount_u: float
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
    with png_figure(path, heading, height_in=5.2) as figure:
        leave_margin(figure, _FIELD_MARGIN)
        parts = figure.subfigures(2, 1, height_ratios=(2.0, 1.0), squeeze=False)
        above, below = parts[:, 0]
        fields = above.subplots(2, len(columns), squeeze=False)
        curves = below.subplots(1, len(columns), squeeze=False)[0]
        for i, column in enumerate(columns):
            last = i == len(columns) - 1
            _show_field(fields[0, i], column.frame, f"{column.name},\nthis frame", last)
            mean = f"{column.name},\nmean of {mean_of}"
            _show_field(fields[1, i], column.recording, mean, last)
            _show_curves(curves[i], column)
        add_legend_below(
            below,
            curves,
            columns=2,
            caption="✕ score at the peak (u, v), ○ runner-up; dotted: u of the mount's yaw.\n"
            "u: LiDAR sample on the leftmost sample of depth row v; yaw: left of the LiDAR.\n"
            "Grey: no score (not searched, or too few samples valid on both sides).",
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
    add_color_bar(axes, image, "", left=1.31 if last else 1.03)
    # White around black stands out on every shade.
    for color, width, style in (("white", 1.2, "-"), ("black", 0.6, ":")):
        axes.axvline(panel.mount_u, color=color, lw=width, ls=style)
    for color, more, width in (("white", 0.6, 1.6), ("black", 0.0, 0.7)):
        for place, marker, size in ((panel.runner_up, "o", 3.5), (panel.peak, "X", 4.0)):
            if place is not None:
                axes.plot(
                    *place, marker, ms=size + more, mfc="none", mec=color, mew=width, clip_on=False
                )
    axes.set_xlim(panel.u_first - 0.5, panel.u_first + offsets - 0.5)
    found = ""
    if panel.peak is not None:
        found = f"\n✕ {panel.peak_score:.3f} ({panel.peak[0]:.1f}, {panel.peak[1]:.0f})"
    if panel.runner_up is not None:
        found += f"   ○ ({panel.runner_up[0]:.0f}, {panel.runner_up[1]:.0f})"
    axes.set_title(title + found, pad=_YAW_AXIS_PT)
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

    elevations = axes.secondary_yaxis("right", functions=(elevation_deg, row))
    elevations.set_ylabel("elevation (°)", labelpad=0.0)


def _show_curves(axes: "Axes", column: MetricColumn) -> None:
    if column.curves is None or column.frame is None or column.frame.peak is None:
        _show_message(axes, f"{column.name}:\nno peak in this frame")
        return
    samples = np.arange(column.curves.lidar_m.size)
    for values_m, color, label in (
        (column.curves.lidar_m, LIDAR, "LiDAR curve"),
        (column.curves.depth_m, DEPTH, "depth row"),
    ):
        axes.plot(samples, values_m, ".-", color=color, ms=2.8, lw=0.5, label=label)
    u, v = column.frame.peak
    axes.set_title(f"{column.name}:\ncurves compared at u {u:.0f}, v {v:.0f}")
    axes.set_xlabel(f"sample of the row ({column.frame.step_deg:.2f}° each)")
    axes.set_ylabel("range (m)")
    start_at_zero(axes)


def _show_message(axes: "Axes", message: str) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, message, ha="center", va="center", transform=axes.transAxes)
