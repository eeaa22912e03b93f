"""The time between each depth image and its scan, as a picture and in words."""

import numpy as np
import viser

from fusion_core.model.conventions import NS_PER_MS, NS_PER_S, ByteArray, FloatArray, IntArray
from fusion_core.workflows.fuse.pairing_gaps import PairingGaps, PairingStamps
from scanloom.frame_view import FrameView, clock_offset_ms
from scanloom.panels.widgets.controls import update_widget
from scanloom.plots.gaps_picture import GapsPicture, gaps_picture
from scanloom.plots.png import show_picture

_WIDTH_PX, _HEIGHT_PX = 480, 280


class PairingPlot:
    """Drawn anew for other stamps or another clock offset; another frame only moves its mark."""

    def __init__(self, gui: viser.GuiApi) -> None:
        blank = np.full((_HEIGHT_PX, _WIDTH_PX, 3), 255, dtype=np.uint8)
        self._picture = gui.add_image(blank, format="png", visible=False)
        self._words = gui.add_markdown("", visible=False)
        self._of: tuple[PairingStamps | None, float] = None, 0.0
        self._gaps: PairingGaps | None = None
        self._drawn: GapsPicture | None = None
        self._marked: tuple[GapsPicture | None, int] = None, -1

    def show(self, frame_view: FrameView) -> None:
        """Nothing before the first pass over the recording has ended."""
        stamps = frame_view.open_recording.pairing
        is_virtual = frame_view.open_recording.fuse_session.virtual_row is not None
        if is_virtual:
            update_widget(self._words, content="A virtual LiDAR has the stamps of its images.")
        update_widget(self._picture, visible=stamps is not None and not is_virtual)
        update_widget(self._words, visible=stamps is not None)
        if stamps is None or is_virtual:
            return
        offset_ms = (
            0.0 if frame_view.chain is None else clock_offset_ms(frame_view.view, frame_view.chain)
        )
        drawn, gaps = self._draw(stamps, offset_ms, frame_view)
        number = frame_view.view.frame_index
        if self._marked != (drawn, number):
            self._marked = drawn, number
            show_picture(self._picture, _marked(drawn, gaps, frame_view))

    def _draw(
        self, stamps: PairingStamps, offset_ms: float, frame_view: FrameView
    ) -> tuple[GapsPicture, PairingGaps]:
        if self._drawn is not None and self._gaps is not None and self._of == (stamps, offset_ms):
            return self._drawn, self._gaps
        self._of = stamps, offset_ms
        max_gap_ms = frame_view.open_recording.fuse_session.settings.time.max_gap_ms
        self._gaps = gaps = stamps.gaps(offset_ms, max_gap_ms)
        self._drawn = gaps_picture(
            _since_first_s(gaps.time_ns, frame_view),
            gaps.gap_ms,
            gaps.paired,
            period_ms=gaps.scan_period_ms,
            max_gap_ms=max_gap_ms,
            width_px=_WIDTH_PX,
            height_px=_HEIGHT_PX,
        )
        update_widget(self._words, content=_words(gaps, offset_ms, max_gap_ms))
        return self._drawn, gaps


def _marked(drawn: GapsPicture, gaps: PairingGaps, frame_view: FrameView) -> ByteArray:
    time_ns = int(frame_view.open_recording.frames.times_ns[frame_view.view.frame_index])
    gap_ms: float | None = None
    if frame_view.paired is not None and frame_view.paired.window is not None:
        gap_ms = frame_view.paired.gap_ns / NS_PER_MS
    else:
        known_ms = gaps.gap_ms[(gaps.time_ns == time_ns) & np.isfinite(gaps.gap_ms)]
        gap_ms = float(known_ms[0]) if known_ms.size else None
    return drawn.with_present(float(_since_first_s(np.array([time_ns]), frame_view)[0]), gap_ms)


def _since_first_s(time_ns: IntArray, frame_view: FrameView) -> FloatArray:
    since_s: FloatArray = (time_ns - frame_view.open_recording.frames.times_ns[0]) / NS_PER_S
    return since_s


def _words(gaps: PairingGaps, offset_ms: float, max_gap_ms: float) -> str:
    without = int((~gaps.paired).sum())
    known_ms = gaps.gap_ms[gaps.paired]
    lines = []
    if known_ms.size:
        lines.append(
            f"Pairs lie **{np.abs(known_ms).max():.1f} ms** apart at most, "
            f"{np.median(known_ms):.1f} ms in the median.".replace("-", "−")
        )
    if without:
        lines.append(
            f"**{without}** of {gaps.paired.size} depth images have no scan within "
            f"{max_gap_ms:g} ms and are not fused."
        )
    if offset_ms:
        lines.append(f"The clock offset of {offset_ms:.1f} ms is taken out.".replace("-", "−"))
    return "  \n".join(lines)
