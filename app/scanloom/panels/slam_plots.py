"""Plots over the time of a SLAM run: particles, odometry weights, distance of two runs."""

from collections.abc import Mapping

import numpy as np
import viser

from fusion_core.model.conventions import NS_PER_S, FloatArray
from scanloom.jobs.slam_run import SlamRun
from scanloom.page.update_widget import update_widget
from scanloom.plots.line_plot import (
    NEUTRAL,
    PlotLabels,
    add_line_plot,
    dots,
    line,
    set_limits,
    whole_limits,
)
from scanloom.plots.palette import Color, color_of
from scanloom.plots.run_comparison import TrajectoryDifference

_TIME = "time since the first scan (s)"
# The odometries that can be fused, in the colours of the exported figure.
_ODOMETRIES: Mapping[str, Color] = {
    "wheel": color_of("good"),
    "laser": color_of("lidar"),
    "visual": color_of("depth"),
}


def add_effective_plot(gui: viser.GuiApi) -> viser.GuiUplotHandle:
    """The effective number of particles, N_eff (Grisetti 2007, eq. 20)."""
    return add_line_plot(
        gui,
        PlotLabels(title="Effective number of particles", x=_TIME, x_short="time (s)", y="N_eff"),
        (
            line("N_eff", color_of("depth")),
            line("resampled below", NEUTRAL, dashed=True),
        ),
    )


def show_effective(
    plot: viser.GuiUplotHandle,
    times_s: FloatArray,
    effective: FloatArray,
    *,
    particles: int,
    resampling_at: float,
) -> None:
    """(K,) values over (K,) times, NaN where no weights were updated; hidden if empty."""
    known = np.isfinite(effective)
    if known.any():
        plot.data = times_s[known], effective[known], np.full(int(known.sum()), resampling_at)
        set_limits(plot, 0.0, 1.05 * particles)
    update_widget(plot, visible=bool(known.any()))


def show_effective_of(plot: viser.GuiUplotHandle, run: SlamRun, resampling_at: float) -> None:
    """The effective number of particles of a finished run."""
    values = run.files.effective
    times_s = values[:, 0] - run.files.trajectory.stamps_ns[0] / NS_PER_S
    show_effective(
        plot, times_s, values[:, 1], particles=run.choices.particles, resampling_at=resampling_at
    )


def add_weights_plot(gui: viser.GuiApi, part: str) -> viser.GuiUplotHandle:
    """The weight of each odometry in translation or rotation."""
    return add_line_plot(
        gui,
        PlotLabels(
            title=f"Weights of the odometries in the {part}",
            x=_TIME,
            x_short="time (s)",
            y="weight",
        ),
        tuple(dots(name, color, 3.0) for name, color in _ODOMETRIES.items()),
        y_limits=(0.0, 1.05),
    )


def show_weights(
    plot: viser.GuiUplotHandle, run: SlamRun, weights: Mapping[str, FloatArray]
) -> None:
    """(M,) weights by odometry; hidden where none were fused."""
    stamps_s = run.files.weight_stamps_s
    is_fused = bool(weights) and stamps_s.size > 0
    if is_fused:
        unknown = np.full(stamps_s.size, np.nan)
        times_s = stamps_s - run.files.trajectory.stamps_ns[0] / NS_PER_S
        plot.data = times_s, *(weights.get(name, unknown) for name in _ODOMETRIES)
    update_widget(plot, visible=is_fused)


def add_distance_plot(gui: viser.GuiApi) -> viser.GuiUplotHandle:
    """The distance between the trajectories of two runs."""
    return add_line_plot(
        gui,
        PlotLabels(
            title="Distance between A and B",
            x="time since the first common pose (s)",
            x_short="time (s)",
            y="distance (cm)",
        ),
        (line("distance (cm)", NEUTRAL),),
    )


def show_distance(plot: viser.GuiUplotHandle, found: TrajectoryDifference | None) -> None:
    """Hidden where the runs have no time in common."""
    if found is not None:
        distances_cm = 100.0 * found.distances_m
        plot.data = found.times_s, distances_cm
        set_limits(plot, 0.0, whole_limits(distances_cm)[1])
    update_widget(plot, visible=found is not None)
