"""The weights of fused odometry over time, and the difference of each source from the result."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from fusion_core.exporting.figures import add_legend_below, png_figure
from fusion_core.exporting.palette import BURR, DEPTH, GOOD, LIDAR
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SOURCE_COLORS: Mapping[str, str] = {"wheel": GOOD, "laser": LIDAR, "visual": DEPTH}
# No more columns than the figure has pixels.
_COLUMNS_MAX = 1200


class OdometryWeights(Protocol):
    """The part of each of S sources in N - 1 fused steps.

    ``stamps_ns``: (N,). ``translation``, ``rotation``: (N - 1, S) weights, ``residual_m``,
    ``residual_rad``: (N - 1, S) difference from the fused step, NaN where there is none.
    ``rejected``: (N - 1, S) steps that are outliers.
    """

    @property
    def sources(self) -> Sequence[str]: ...
    @property
    def stamps_ns(self) -> IntArray: ...
    @property
    def translation(self) -> FloatArray: ...
    @property
    def rotation(self) -> FloatArray: ...
    @property
    def rejected(self) -> BoolArray: ...
    @property
    def residual_m(self) -> FloatArray: ...
    @property
    def residual_rad(self) -> FloatArray: ...


def write_odometry_weights(path: Path, heading: str, weights: OdometryWeights) -> None:
    """Weight of each source in each step, and its difference from the fused step.

    Crosses mark rejected steps. Raises ExportError where the file cannot be written.
    """
    stamps_ns, sources = weights.stamps_ns, weights.sources
    seconds = (stamps_ns - stamps_ns[0]) / 1e9
    with png_figure(path, heading, height_in=4.4) as figure:
        panels = figure.subplots(4, 1, sharex=True)
        for axes, values, title in (
            (panels[0], weights.translation, "weight of the translation"),
            (panels[1], weights.rotation, "weight of the rotation"),
        ):
            _plot_stacked(axes, seconds, values, sources)
            axes.set_title(title)
            axes.set_ylabel("weight")
            axes.set_ylim(0.0, 1.0)
        for axes, residual, unit in (
            (panels[2], 1e3 * weights.residual_m, "mm"),
            (panels[3], np.rad2deg(weights.residual_rad), "°"),
        ):
            for source, name in enumerate(sources):
                axes.plot(
                    seconds[1:],
                    residual[:, source],
                    "-",
                    lw=0.5,
                    color=SOURCE_COLORS.get(name, "0.4"),
                )
            axes.set_ylabel(f"difference ({unit})")
            axes.set_yscale("symlog", linthresh=_threshold(residual))
            axes.set_ylim(bottom=0.0)
            axes.yaxis.set_major_formatter("{x:g}")
            axes.grid(visible=True)
        panels[2].set_title("difference of each source's step from the fused one; x: rejected")
        for source, _ in enumerate(sources):
            out = weights.rejected[:, source]
            panels[2].plot(
                seconds[1:][out],
                1e3 * weights.residual_m[out, source],
                "x",
                color=BURR,
                ms=2,
                mew=0.5,
                label="rejected step",
            )
        panels[-1].set_xlabel("time since the first scan (s)")
        panels[-1].set_xlim(0.0, float(max(seconds[-1], 1e-9)))
        add_legend_below(figure, panels, columns=len(sources) + 1)


def _plot_stacked(
    axes: "Axes", seconds: FloatArray, weights: FloatArray, sources: Sequence[str]
) -> None:
    """Stacked areas of (N - 1, S) weights; of long recordings the mean over each column of the
    figure."""
    pieces = np.array_split(np.arange(len(weights)), max(1, min(len(weights), _COLUMNS_MAX)))
    pieces = [piece for piece in pieces if piece.size]
    if not pieces:
        return
    edges = np.array([seconds[piece[0]] for piece in pieces] + [seconds[-1]])
    means = np.stack([weights[piece].mean(axis=0) for piece in pieces])
    below = np.zeros(len(means) + 1)
    for source, name in enumerate(sources):
        above = below + np.append(means[:, source], means[-1, source])
        axes.fill_between(
            edges,
            below,
            above,
            step="post",
            lw=0.0,
            color=SOURCE_COLORS.get(name, "0.4"),
            label=name,
        )
        below = above


def _threshold(residual: FloatArray) -> float:
    """Where the scale changes from linear to logarithmic: the median residual."""
    known = residual[np.isfinite(residual) & (residual > 0.0)]
    return float(np.median(known)) if known.size else 1.0
