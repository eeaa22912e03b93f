"""The recall curve of Fig. 6 with the current epsilon, for recordings with ground truth."""

import threading
from collections.abc import Callable, Hashable
from pathlib import Path

import numpy as np
import viser

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.progress import Progress
from fusion_core.workflows.fuse.epsilon import measure_epsilon
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.recall import PAPER_BAND, RecallCurve, recall_of, truth_beside
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView, as_failure, clock_offset_ms, failure_summary
from scanloom.jobs.long_job import LongJob
from scanloom.page.markup import paragraph
from scanloom.page.update_widget import update_widget
from scanloom.plots.line_plot import (
    INK,
    PlotLabels,
    add_line_plot,
    area,
    line,
    set_theme,
    with_vertical_line,
)
from scanloom.plots.palette import Color, color_of
from scanloom.plots.theme import theme_of
from scanloom.state.open_recording import OpenRecording

_BAND_COLOR: Color = (225, 229, 233)
_COMPUTE, _CANCEL = "Compute", "Cancel"
# Set by hand: continuous playback must not stop this computation altogether.
_MAX_IDLE_WAIT_S = 0.5
_CANCEL_TIMEOUT_S = 10.0


class RecallPanel:
    """Computes the curve on request in a background thread; it is cached with the recording."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._session = session
        self._lock = threading.RLock()
        self._job: LongJob | None = None
        self._closed = False
        self._begin: Callable[[], None] = lambda: None
        # The displayed recording, and its ground truth.
        self._open_recording: OpenRecording | None = None
        self._truth: Path | None = None
        # The plotted curve, and the marked epsilon.
        self._plotted: tuple[RecallCurve | None, float] = None, 0.0
        self._folder = gui.add_folder("Recall over ε, by ground truth", visible=False)
        with self._folder:
            self._plot = add_line_plot(
                gui,
                PlotLabels(
                    title="Recall over the threshold",
                    x="threshold ε in multiples of the frame's E",
                    x_short="ε / E",
                    y="recall",
                ),
                (
                    area("E to √2 E", _BAND_COLOR),
                    line("ξ: good pairs kept", color_of("good")),
                    line("η: noise pairs found", color_of("burr")),
                    line("ε of this frame", INK),
                ),
            )
            self._summary = gui.add_markdown("", visible=False)
            self._button = gui.add_button(
                _COMPUTE, hint="Compares every frame with the ground truth, as in Fig. 6 of Xu 2024"
            )
            self._progress_text = gui.add_html("", visible=False)
            self._progress = gui.add_progress_bar(0.0, visible=False)
        self._button.on_click(lambda _: self._press())

    def show(self, frame_view: FrameView) -> None:
        """Draw the curve of the view's settings if it is cached; else offer to compute it."""
        self._find_truth(frame_view.open_recording)
        chain, truth, fused = frame_view.chain, self._truth, frame_view.fused
        update_widget(self._folder, visible=chain is not None and truth is not None)
        if chain is None or truth is None:
            return
        settings, offset_ms = frame_view.view.settings, clock_offset_ms(frame_view.view, chain)
        key = settings.read_by("match"), offset_ms, frame_view.view.hand_pose
        curve = frame_view.open_recording.recalls.get(key)

        def work(progress: Progress) -> RecallCurve:
            return recall_of(chain, settings, truth, offset_ms, self._yielding(progress))

        with self._lock:
            self._begin = lambda: self._start(work, frame_view.open_recording, key)
            update_widget(self._button, visible=curve is None or self._job is not None)
        set_theme(self._plot, theme_of(is_dark=frame_view.is_dark))
        update_widget(self._plot, visible=curve is not None)
        update_widget(self._summary, visible=curve is not None)
        if curve is not None:
            self._show_curve(curve, fused)

    def close(self) -> None:
        """Cancel the computation: the browser has disconnected."""
        with self._lock:
            self._closed = True
            job = self._job
        if job is not None:
            job.cancel()
            job.wait(_CANCEL_TIMEOUT_S)

    def _find_truth(self, open_recording: OpenRecording) -> None:
        if self._open_recording is open_recording:
            return
        with self._lock:
            self._open_recording = open_recording
            if self._job is not None:
                self._job.cancel()
            update_widget(self._progress_text, visible=False)
        self._truth = truth_beside(open_recording.recording.path)

    def _press(self) -> None:
        with self._lock:
            if self._job is not None:
                self._job.cancel()
            else:
                self._begin()

    def _start(
        self, work: Callable[[Progress], RecallCurve], open_recording: OpenRecording, key: Hashable
    ) -> None:
        if self._closed:
            return

        def done(curve: RecallCurve) -> None:
            open_recording.recalls[key] = curve
            self._end("")

        update_widget(self._button, label=_CANCEL)
        update_widget(self._progress_text, content=paragraph("Starting …"), visible=True)
        update_widget(self._progress, value=0.0, visible=True)
        self._job = LongJob(
            "recall",
            work,
            on_progress=self._advance,
            on_done=done,
            on_failed=self._fail,
            on_cancelled=lambda: self._end(""),
        )

    def _yielding(self, progress: Progress) -> Progress:
        """``progress`` that also waits for the session's worker, so that dragging stays smooth."""

        def report(done: int, total: int | None, what: str) -> None:
            progress(done, total, what)
            self._session.wait(_MAX_IDLE_WAIT_S)

        return report

    def _advance(self, done: int, total: int | None, what: str) -> None:
        percent = round(100.0 * done / total) if total else 0
        update_widget(self._progress, value=float(percent))
        update_widget(self._progress_text, content=paragraph(f"{what.capitalize()}, {percent} %"))

    def _fail(self, error: Exception) -> None:
        failure = as_failure(
            error
            if self._open_recording is None
            else self._open_recording.explain_read_error(error)
        )
        self._end(f"There is no curve. {failure_summary(failure)} {failure.advice}")

    def _end(self, message: str) -> None:
        """End the job, in its thread, and have the session display the result."""
        with self._lock:
            self._job = None
            update_widget(self._button, label=_COMPUTE)
            update_widget(self._progress, visible=False)
            update_widget(self._progress_text, content=paragraph(message), visible=bool(message))
            closed = self._closed
        if not closed:
            self._session.refresh()

    def _show_curve(self, curve: RecallCurve, fused: FusedFrame | None) -> None:
        measured = None if fused is None else measure_epsilon(fused)
        factor = (
            float("nan")
            if measured is None or not measured.E_m > 0.0
            else measured.median_m / measured.E_m
        )
        marked = factor if _is_in_plot(curve, factor) else float("nan")
        before, at = self._plotted
        if before is not curve or not np.array_equal(at, marked, equal_nan=True):
            self._plotted = curve, marked
            self._plot.data = _data(curve, marked)
        update_widget(self._summary, content=_summary_text(curve, factor))


def _data(curve: RecallCurve, marked: float) -> tuple[FloatArray, ...]:
    """x, the paper's band, both recalls, and a line at the threshold ``marked``, unless NaN."""
    first, last = PAPER_BAND
    factors = np.sort(np.concatenate([curve.factors, [first, first, last, last]]))
    band = np.zeros(factors.size)
    # Its edges occur twice, so that they are vertical.
    band[np.searchsorted(factors, first) + 1 : np.searchsorted(factors, last, "right") - 1] = 1.0
    recalls = [
        np.interp(factors, curve.factors, _fractions(counts, whole))
        for counts, whole in (
            (curve.good_kept, curve.good_pairs),
            (curve.noise_found, curve.noise_pairs),
        )
    ]
    is_marked = bool(np.isfinite(marked))
    return with_vertical_line(
        factors,
        (band, *recalls),
        marked if is_marked else float(factors[0]),
        (0.0, 1.0) if is_marked else (np.nan, np.nan),
        interpolate=True,
    )


def _is_in_plot(curve: RecallCurve, factor: float) -> bool:
    return bool(curve.factors[0] <= factor <= curve.factors[-1])


def _fractions(counts: IntArray, whole: int) -> FloatArray:
    """Counts as fractions of ``whole``, NaN if it is 0."""
    return counts / whole if whole else np.full(counts.shape, np.nan)


def _summary_text(curve: RecallCurve, factor: float) -> str:
    counts = f"{curve.good_pairs} good and {curve.noise_pairs} noise pairs by ground truth."
    if not np.isfinite(factor):
        return f"{counts} This frame has no E, so its ε is not marked."
    there = f"This frame's ε is **{factor:.2f} E**"
    if not _is_in_plot(curve, factor):
        return f"{counts} {there}, outside the plot."
    parts = []
    for verb, found, whole, what in (
        ("keeps", curve.good_kept, curve.good_pairs, "good"),
        ("finds", curve.noise_found, curve.noise_pairs, "noise"),
    ):
        if whole:
            percent = 100.0 * np.interp(factor, curve.factors, _fractions(found, whole))
            parts.append(f"{verb} **{percent:.1f} %** of the {what} pairs")
    alone = f" ε alone {' and '.join(parts)}; the classes look at neighbours, too."
    return f"{counts} {there}.{alone if parts else ''}"
