"""Figs. 5 and 6 of Xu 2024: pairs before and after RANSAC, and the recalls over epsilon."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fusion_core.exporting.figures import add_legend_below, png_figure
from fusion_core.exporting.map_picture import scale_bar_m
from fusion_core.exporting.palette import BURR, DEPTH, GOOD, LIDAR
from fusion_core.model.conventions import BoolArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Curves of a flat wall are parted as if they were as deep as this.
_EXTENT_MIN_M = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class RansacPairs:
    """The pairs of a frame that RANSAC is given, and its result.

    ``lidar_points_m``, ``depth_points_m``: (m, 2), NaN where missing. ``inliers``: (m,), within
    ``threshold_m`` under the model of the best of ``draws``. ``axis_names``: labels of x and z.
    """

    lidar_points_m: FloatArray
    depth_points_m: FloatArray
    inliers: BoolArray
    model: str
    mean_error_m: float
    threshold_m: float
    draws: int
    axis_names: tuple[str, str]


def write_pairs(path: Path, heading: str, pairs: RansacPairs) -> None:
    """Fig. 5: points of both curves, lines between all pairs, and between RANSAC's inliers.

    Where pairs are joined, the depth curve is drawn farther away, since both lie on each other.
    """
    lidar_points_m, depth_points_m = pairs.lidar_points_m, pairs.depth_points_m
    paired = np.isfinite(lidar_points_m).all(axis=1) & np.isfinite(depth_points_m).all(axis=1)
    inlier, outlier = paired & pairs.inliers, paired & ~pairs.inliers
    extent_m = float(np.ptp(lidar_points_m[paired, 1])) if paired.any() else 0.0
    gap_m = scale_bar_m(max(extent_m, _EXTENT_MIN_M))
    drawn_depth_m = depth_points_m + np.array([0.0, gap_m])
    with png_figure(path, heading, height_in=5.2) as figure:
        panels = figure.subplots(3, 1)
        titles = (
            f"(a) {_count(lidar_points_m)} LiDAR points, {_count(depth_points_m)} depth points",
            f"(b) all {paired.sum()} pairs, E = {pairs.mean_error_m:.3f} m; "
            f"depth drawn {gap_m:g} m farther",
            f"(c) {inlier.sum()} inliers: within {pairs.threshold_m:g} m under A ({pairs.model}), "
            f"{pairs.draws} draws",
        )
        for axes, title in zip(panels, titles, strict=True):
            axes.set_title(title)
            axes.set_xlabel(pairs.axis_names[0])
            axes.set_ylabel(pairs.axis_names[1])
            axes.grid(visible=True)
        _show_points(panels[0], lidar_points_m, depth_points_m)
        _show_points(panels[1], lidar_points_m[paired], drawn_depth_m[paired])
        _show_points(panels[2], lidar_points_m[inlier], drawn_depth_m[inlier])
        _connect_pairs(panels[1], lidar_points_m[inlier], drawn_depth_m[inlier], GOOD, "inlier")
        _connect_pairs(panels[1], lidar_points_m[outlier], drawn_depth_m[outlier], BURR, "outlier")
        _connect_pairs(panels[2], lidar_points_m[inlier], drawn_depth_m[inlier], GOOD, "inlier")
        panels[2].set(xlim=panels[1].get_xlim(), ylim=panels[1].get_ylim())
        add_legend_below(figure, panels, columns=4)


def _count(points_m: FloatArray) -> int:
    return int(np.isfinite(points_m).all(axis=1).sum())


def _show_points(axes: "Axes", lidar_m: FloatArray, depth_m: FloatArray) -> None:
    axes.plot(*lidar_m.T, ".", color=LIDAR, ms=3.2, label="LiDAR", zorder=3)
    axes.plot(*depth_m.T, ".", color=DEPTH, ms=2.4, label="depth", zorder=3)


def _connect_pairs(
    axes: "Axes", lidar_m: FloatArray, depth_m: FloatArray, color: str, label: str
) -> None:
    from matplotlib.collections import LineCollection

    lines = np.stack([lidar_m, depth_m], axis=1)
    if len(lines):
        axes.add_collection(
            LineCollection(list(lines), colors=color, linewidths=0.4, label=f"{label} pair")
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RecallCurves:
    """Recalls of good pairs (xi) and noise pairs (eta), None where there are no such pairs.

    ``epsilon_over_E``: (K,) thresholds of the curves. ``band``: the paper's. ``own_...``: the run's
    own threshold (median over its frames, NaN where there is none) and the recalls of its classes,
    which use neighbours too.
    """

    epsilon_over_E: FloatArray
    xi: Sequence[float] | None
    eta: Sequence[float] | None
    band: tuple[float, float]
    own_epsilon_over_E: float
    own_xi: float | None
    own_eta: float | None


def write_recall(path: Path, heading: str, curves: RecallCurves) -> None:
    """Fig. 6: fraction of good pairs kept (xi) and of noise pairs found (eta) over epsilon / E."""
    epsilon_over_E, own_epsilon_over_E = curves.epsilon_over_E, curves.own_epsilon_over_E
    with png_figure(path, heading, height_in=2.7) as figure:
        axes = figure.subplots()
        axes.axvspan(*curves.band, color="0.88", label="band of Xu 2024: E to √2 E")
        if np.isfinite(own_epsilon_over_E):
            axes.axvline(
                own_epsilon_over_E,
                color="black",
                lw=0.7,
                ls="--",
                label=f"this run's median ε = {own_epsilon_over_E:.2f} E",
            )
        for recall, own, color, label in (
            (curves.xi, curves.own_xi, GOOD, "ξ: good pairs kept"),
            (curves.eta, curves.own_eta, BURR, "η: noise pairs found"),
        ):
            if recall is not None:
                axes.plot(
                    epsilon_over_E,
                    recall,
                    ".-",
                    color=color,
                    ms=2.5,
                    lw=0.8,
                    label=f"{label}, by ε alone",
                )
            if own is not None and np.isfinite(own_epsilon_over_E):
                axes.plot(
                    own_epsilon_over_E,
                    own,
                    "*",
                    color=color,
                    ms=6,
                    mec="black",
                    mew=0.4,
                    label=f"{label}, by this run's classes: {own:.3f}",
                )
        axes.set_xlabel("threshold ε in multiples of the frame's mean error E")
        axes.set_ylabel("recall")
        axes.set_xlim(0.0, float(max(epsilon_over_E[-1], np.nan_to_num(own_epsilon_over_E))) + 0.2)
        axes.set_ylim(-0.02, 1.04)
        axes.grid(visible=True)
        add_legend_below(figure, [axes], columns=1)
