"""The time between each depth image and its scan over the recording, as a plot and as text."""

import numpy as np
import viser

from fusion_core.model.conventions import NS_PER_S, FloatArray
from fusion_core.workflows.fuse.pairing_gaps import PairingGaps, PairingStamps
from fusion_core.workflows.fuse.settings import ChainSettings
from scanloom.frame_view import FrameView, clock_offset_ms
from scanloom.page.update_widget import update_widget
from scanloom.plots.line_plot import (
    INK,
    NEUTRAL,
    PlotLabels,
    add_line_plot,
    dots,
    line,
    set_limits,
    set_theme,
    with_vertical_line,
)
from scanloom.plots.palette import color_of
from scanloom.plots.theme import theme_of

# Margin of the plot beyond the largest gap of a pair; set by hand.
_MARGIN_FRACTION = 0.12
# Set by hand: about the resolution of stamps on robots.
_MIN_LIMIT_MS = 0.5


class PairingPlot:
    """The gap of each pair over time, with the current frame marked."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._plot = add_line_plot(
            gui,
            PlotLabels(
                title="Each depth image against its scan",
                x="time since the first frame (s)",
                x_short="time (s)",
                y="image − scan (ms)",
            ),
            (
                dots("depth image", color_of("depth"), 3.0),
                dots("without a scan", INK, 6.0, hollow=True),
                line("half a scan period", NEUTRAL, dashed=True),
                line("and its negative", NEUTRAL, dashed=True),
                line("this frame", INK),
            ),
            y_limits=(-1.0, 1.0),
        )
        self._summary = gui.add_markdown("", visible=False)
        self._of: tuple[PairingStamps | None, float] = None, 0.0
        self._curves: GapCurves | None = None
        self._marked: tuple[GapCurves | None, int] = None, -1

    def show(self, frame_view: FrameView) -> None:
        """Draw the gaps, once the recording's stamps are known."""
        stamps = frame_view.open_recording.pairing
        is_virtual = frame_view.view.virtual_row is not None
        if is_virtual:
            update_widget(self._summary, content="A virtual LiDAR has the stamps of its images.")
        set_theme(self._plot, theme_of(is_dark=frame_view.is_dark))
        update_widget(self._plot, visible=stamps is not None and not is_virtual)
        update_widget(self._summary, visible=stamps is not None)
        if stamps is None or is_virtual:
            return
        offset_ms = (
            0.0 if frame_view.chain is None else clock_offset_ms(frame_view.view, frame_view.chain)
        )
        curves = self._curves_of(stamps, offset_ms, frame_view)
        index = frame_view.view.frame_index
        if self._marked != (curves, index):
            self._marked = curves, index
            self._plot.data = curves.data_at(int(frame_view.open_recording.frames.times_ns[index]))
            set_limits(self._plot, -curves.limit_ms, curves.limit_ms)

    def _curves_of(
        self, stamps: PairingStamps, offset_ms: float, frame_view: FrameView
    ) -> "GapCurves":
        if self._curves is not None and self._of == (stamps, offset_ms):
            return self._curves
        self._of = stamps, offset_ms
        settings = frame_view.open_recording.fuse_session.settings
        gaps = stamps.gaps(offset_ms, settings.time)
        first_ns = int(frame_view.open_recording.frames.times_ns[0])
        self._curves = curves = GapCurves(gaps, first_ns)
        update_widget(self._summary, content=_summary_text(gaps, offset_ms, settings))
        return curves


class GapCurves:
    """The plot's series. All pairs are within ``limit_ms``; what lies beyond is at the edge."""

    def __init__(self, gaps: PairingGaps, first_ns: int) -> None:
        order = np.argsort(gaps.time_ns, kind="stable")
        gap_ms, paired = gaps.gap_ms[order], gaps.is_paired[order]
        known_ms = np.abs(gap_ms[paired if paired.any() else np.isfinite(gap_ms)])
        farthest_ms = float(known_ms.max()) if known_ms.size else 0.0
        self.limit_ms = max((1.0 + _MARGIN_FRACTION) * farthest_ms, _MIN_LIMIT_MS)
        # An image without any scan is drawn at the edge.
        inside_ms = np.clip(np.nan_to_num(gap_ms, nan=np.inf), -self.limit_ms, self.limit_ms)
        half_ms = np.full(gap_ms.size, 0.5 * gaps.scan_period_ms)
        half_ms[half_ms > self.limit_ms] = np.nan
        self._first_ns = first_ns
        self._time_s: FloatArray = (gaps.time_ns[order] - first_ns) / NS_PER_S
        self._series = (
            np.where(paired, gap_ms, np.nan),
            np.where(paired, np.nan, inside_ms),
            half_ms,
            -half_ms,
        )

    def data_at(self, time_ns: int) -> tuple[FloatArray, ...]:
        """The plot's data with the frame of that time marked."""
        return with_vertical_line(
            self._time_s,
            self._series,
            (time_ns - self._first_ns) / NS_PER_S,
            (-self.limit_ms, self.limit_ms),
            interpolate=False,
        )


def _summary_text(gaps: PairingGaps, offset_ms: float, settings: ChainSettings) -> str:
    without = int((~gaps.is_paired).sum())
    known_ms = gaps.gap_ms[gaps.is_paired]
    lines = []
    if known_ms.size:
        lines.append(
            f"Pairs lie **{np.abs(known_ms).max():.1f} ms** apart at most, "
            f"{np.median(known_ms):.1f} ms in the median.".replace("-", "−")
        )
    if without:
        missing = f"within {settings.time.max_gap_ms:g} ms"
        if settings.time.pair_by == "rates":
            missing = "of their number"
        lines.append(
            f"**{without}** of {gaps.is_paired.size} depth images have no scan {missing} and are "
            "not fused."
        )
    if settings.time.pair_by == "interpolated":
        lines.append("u, v and the mount come from scans interpolated at the images' instants.")
    elif settings.time.pair_by == "rates":
        lines.append("Pairs are counted by the two rates; their stamps are not used.")
    if offset_ms:
        lines.append(f"The clock offset of {offset_ms:.1f} ms is taken out.".replace("-", "−"))
    return "  \n".join(lines)
