"""Figs. 7 and 8 of Xu 2024: a frame before and after denoising, and its fused depth image."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fusion_core.exporting.figures import (
    add_legend_below,
    continuous_deg,
    depth_shades,
    far_limit_m,
    label_azimuth,
    middle_of_view_rad,
    png_figure,
    show_color,
    show_depth,
    show_holes,
    start_at_zero,
)
from fusion_core.exporting.palette import BURR, CONFLICT, DEPTH, GOOD, LIDAR
from fusion_core.model.classes import NoiseClass, RepairSource, is_repaired
from fusion_core.model.conventions import (
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BAND_ROWS = 7
"""Rows shown above and below the curve in the enlarged band."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairedCurve:
    """The beams in view with their pixels, raw and repaired: arrays over the B beams.

    ``row``, ``column``: -1 where a beam has no pixel. ``lidar_m``: ranges, ``depth_m``: depths
    along the optical axis, ``depth_as_range_m``: as horizontal ranges. ``camera_range_m``: the
    range at which the beam meets what the camera sees. NaN where missing.
    Classes are codes of NoiseClass (-1 without a pixel), sources of RepairSource.
    """

    azimuth_rad: FloatArray
    row: IntArray
    column: IntArray
    lidar_m: FloatArray
    lidar_repaired_m: FloatArray
    lidar_class: IntArray
    lidar_source: IntArray
    depth_m: FloatArray
    depth_repaired_m: FloatArray
    depth_class: IntArray
    depth_source: IntArray
    depth_as_range_m: FloatArray
    camera_range_m: FloatArray

    @property
    def azimuth_deg(self) -> FloatArray:
        """(B,) without a jump inside the view."""
        return continuous_deg(self.azimuth_rad, middle_of_view_rad(self.azimuth_rad))

    @property
    def depth_changed(self) -> BoolArray:
        """(B,) whether the pixel was repaired."""
        return is_repaired(self.depth_source)


def fused_depth_m(depth_m: Float32Array, curve: RepairedCurve) -> Float32Array:
    """(H, W) image with the repaired pixels of the curve."""
    fused = depth_m.copy()
    changed = curve.depth_changed
    fused[curve.row[changed], curve.column[changed]] = curve.depth_repaired_m[changed]
    return fused


def write_repair(path: Path, heading: str, depth_m: Float32Array, curve: RepairedCurve) -> None:
    """Fig. 7: depth image, the band around the curve enlarged, and the LiDAR curve, before and
    after."""
    far_m = far_limit_m(depth_m)
    with png_figure(path, heading, height_in=4.6) as figure:
        grid = figure.subplots(3, 2, height_ratios=(1.3, 0.75, 1.2))
        for i, (when, image_m) in enumerate(
            (("before", depth_m), ("after", fused_depth_m(depth_m, curve)))
        ):
            show_depth(grid[0, i], image_m, far_m=far_m)
            grid[0, i].set_title(f"({'ab'[i]}) {when}, holes in blue")
            _show_curve_in_image(grid[0, i], curve, after=i == 1)
            _show_band(grid[1, i], image_m, curve, far_m, after=i == 1)
            _show_lidar(grid[2, i], curve, after=i == 1)
            grid[1, i].sharex(grid[2, i])
        grid[2, 1].set_ylim(grid[2, 0].get_ylim())
        add_legend_below(
            figure,
            grid.ravel(),
            columns=2,
            caption="Framed: the longest stretch of each noise type of Xu 2024 §2.3.2. A: hole on\n"
            "both sensors. B: hole on this sensor alone. C: burr. Hatched: beams without a pixel.",
        )


def _show_curve_in_image(axes: "Axes", curve: RepairedCurve, *, after: bool) -> None:
    inside = curve.row >= 0
    axes.plot(
        curve.column[inside],
        curve.row[inside],
        ".",
        color=LIDAR,
        ms=1.4,
        label="pixel on the LiDAR's curve",
    )
    if after:
        _mark_sources(axes, curve.column, curve.row, curve.depth_source, "LiDAR", LIDAR)


def _mark_sources(
    axes: "Axes",
    x: FloatArray | IntArray,
    y: FloatArray | IntArray,
    source: IntArray,
    other: str,
    color: str,
) -> None:
    for code, label, face in (
        (RepairSource.OTHER_SENSOR, f"repaired from the {other}", color),
        (RepairSource.NEIGHBOURS, "repaired from neighbours", GOOD),
    ):
        mine = source == code
        if mine.any():
            axes.plot(
                x[mine],
                y[mine],
                "o",
                color=face,
                ms=1.6,
                mec="black",
                mew=0.1,
                label=label,
                zorder=4,
            )


def _show_band(
    axes: "Axes", depth_m: Float32Array, curve: RepairedCurve, far_m: float, *, after: bool
) -> None:
    """The rows around the curve, straightened: one column of the band for each beam."""
    from matplotlib.colors import Normalize

    azimuth_deg = curve.azimuth_deg
    if azimuth_deg.size < 2:
        axes.set_axis_off()
        return
    band_m, outside = rectify_band_m(depth_m, curve)
    shades = depth_shades()(Normalize(0.0, far_m)(np.ma.masked_invalid(band_m)))
    shades[outside, 3] = 0.0
    axes.patch.set(hatch="////", edgecolor="0.75")
    axes.imshow(
        shades,
        aspect="auto",
        extent=(
            azimuth_deg.max(),
            azimuth_deg.min(),
            _BAND_ROWS + 0.5,
            -_BAND_ROWS - 0.5,
        ),
    )
    for edge in (-0.5, 0.5):
        axes.axhline(edge, color=LIDAR, lw=0.4)
    if after:
        on_curve = np.zeros(azimuth_deg.size)
        _mark_sources(axes, azimuth_deg, on_curve, curve.depth_source, "LiDAR", LIDAR)
    else:
        _label_noise(axes, curve, curve.depth_class, curve.lidar_class, (-5.8, -3.2, 4.5))
    axes.set_ylabel("rows from\ncurve (px)")
    axes.set_title("band around the curve")
    label_azimuth(axes)


def rectify_band_m(depth_m: Float32Array, curve: RepairedCurve) -> tuple[FloatArray, BoolArray]:
    """Depths of the ``_BAND_ROWS`` k rows above and below the curve: (2 k + 1, 2 B), columns at
    equal angles from left to right, NaN where missing; and the mask of places without a pixel."""
    azimuth_deg = curve.azimuth_deg
    step_deg = float(np.median(np.abs(np.diff(np.sort(azimuth_deg)))))
    shown_deg = np.linspace(azimuth_deg.max(), azimuth_deg.min(), 2 * azimuth_deg.size)
    beam = _nearest(azimuth_deg, shown_deg)
    row, column = curve.row[beam], curve.column[beam]
    rows = row + np.arange(-_BAND_ROWS, _BAND_ROWS + 1)[:, np.newaxis]
    inside = (row >= 0) & (rows >= 0) & (rows < depth_m.shape[0])
    inside &= np.abs(shown_deg - azimuth_deg[beam]) < step_deg
    return np.where(inside, depth_m[np.where(inside, rows, 0), column], np.nan), ~inside


def _nearest(values: FloatArray, wanted: FloatArray) -> IntArray:
    """(M,) index of the value nearest to each ``wanted`` one, the first of two equally near.

    ``values``: (N,) in any order, all different, at least two.
    """
    order: IntArray = np.argsort(values).astype(np.int64)
    place = np.clip(np.searchsorted(values[order], wanted), 1, values.size - 1)
    below, above = order[place - 1], order[place]
    away_below, away_above = np.abs(wanted - values[below]), np.abs(wanted - values[above])
    takes_below = (away_below < away_above) | ((away_below == away_above) & (below < above))
    return np.where(takes_below, below, above)


def _show_lidar(axes: "Axes", curve: RepairedCurve, *, after: bool) -> None:
    azimuth_deg = curve.azimuth_deg
    axes.plot(
        azimuth_deg,
        curve.camera_range_m,
        ".",
        color=DEPTH,
        ms=1.4,
        label="what the camera sees there",
    )
    repaired = is_repaired(curve.lidar_source) & after
    shown_m = curve.lidar_repaired_m if after else curve.lidar_m
    for noise, color, marker, size, label in (
        (NoiseClass.GOOD, LIDAR, ".", 2.6, "good beam"),
        (NoiseClass.BURR, BURR, "X", 2.4, "burr"),
        (NoiseClass.CONFLICT, CONFLICT, "D", 2.0, "conflict: two real surfaces"),
    ):
        mine = ~repaired & (curve.lidar_class == noise)
        if mine.any():
            axes.plot(azimuth_deg[mine], shown_m[mine], marker, color=color, ms=size, label=label)
    show_holes(axes, azimuth_deg, shown_m)
    if after:
        _mark_sources(axes, azimuth_deg, shown_m, curve.lidar_source, "depth image", DEPTH)
    else:
        top_m = float(axes.dataLim.y1)
        heights_m = (1.32 * top_m, 1.20 * top_m, 1.08 * top_m)
        _label_noise(axes, curve, curve.lidar_class, curve.depth_class, heights_m)
    start_at_zero(axes, headroom=0.4)
    axes.set_ylabel("range (m)")
    axes.set_title(f"LiDAR curve {'after' if after else 'before'} denoising")
    label_azimuth(axes)


def _label_noise(
    axes: "Axes", curve: RepairedCurve, own: IntArray, other: IntArray, heights: tuple[float, ...]
) -> None:
    """Label the longest run of each noise type with A, B or C, each at its height."""
    hole = own == NoiseClass.HOLE
    types = {
        "A": hole & (other == NoiseClass.HOLE),
        "B": hole & (other >= 0) & (other != NoiseClass.HOLE),
        "C": own == NoiseClass.BURR,
    }
    azimuth_deg = curve.azimuth_deg
    for (letter, mask), y in zip(types.items(), heights, strict=True):
        run = longest_run(mask)
        if run.size == 0:
            continue
        run_deg = azimuth_deg[run]
        axes.axvspan(
            run_deg.min() - 0.2,
            run_deg.max() + 0.2,
            facecolor="none",
            edgecolor="black",
            ls="--",
            lw=0.5,
        )
        axes.text(
            float(run_deg.mean()),
            y,
            letter,
            ha="center",
            va="center",
            weight="bold",
            size=5.5,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "linewidth": 0.3},
        )


def longest_run(mask: BoolArray) -> IntArray:
    """Positions of the longest run in ``mask``, the first of equal ones."""
    chosen = np.flatnonzero(mask)
    runs = np.split(chosen, np.flatnonzero(np.diff(chosen) != 1) + 1)
    return max(runs, key=len)


def write_fused_depth(
    path: Path,
    heading: str,
    *,
    color: ByteArray | None,
    depth_m: Float32Array,
    curve: RepairedCurve,
) -> None:
    """Fig. 8: colour and depth image, LiDAR and depth curve, and the fused depth image."""
    far_m = far_limit_m(depth_m)
    fused_m = fused_depth_m(depth_m, curve)
    with png_figure(path, heading, height_in=3.3) as figure:
        axes = _four_panels(figure, color)
        letters = iter("abcd")
        if color is not None:
            show_color(axes["color"], color)
            axes["color"].set_title(f"({next(letters)}) colour image")
        show_depth(axes["depth"], depth_m, far_m=far_m)
        axes["depth"].set_title(f"({next(letters)}) depth image, holes in blue")
        _show_both_curves(axes["curves"], curve)
        axes["curves"].set_title(f"({next(letters)}) LiDAR and depth curve, raw")
        show_depth(axes["fused"], fused_m, far_m=far_m)
        changed = curve.depth_changed
        axes["fused"].scatter(
            curve.column[changed],
            curve.row[changed],
            c=curve.depth_repaired_m[changed],
            cmap=depth_shades(),
            vmin=0.0,
            vmax=far_m,
            marker="s",
            s=2.5,
            edgecolor=LIDAR,
            linewidth=0.25,
        )
        axes["fused"].set_title(
            f"({next(letters)}) fused: {changed.sum()} repaired pixels,\nenlarged, edged in orange"
        )


def _four_panels(figure: "Figure", color: ByteArray | None) -> "dict[str, Axes]":
    if color is None:
        return figure.subplot_mosaic([["depth", "fused"], ["curves", "curves"]])
    return figure.subplot_mosaic([["color", "depth"], ["curves", "fused"]])


def _show_both_curves(axes: "Axes", curve: RepairedCurve) -> None:
    azimuth_deg = curve.azimuth_deg
    axes.plot(azimuth_deg, curve.lidar_m, ".", color=LIDAR, ms=3.0, label="LiDAR")
    axes.plot(azimuth_deg, curve.depth_as_range_m, ".", color=DEPTH, ms=2.0, label="depth")
    axes.set_ylabel("horizontal range (m)")
    start_at_zero(axes)
    label_azimuth(axes)
    axes.grid(visible=True)
    axes.legend(loc="lower right", markerscale=2.0)
