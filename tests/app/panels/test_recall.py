"""The recall curve on a real server: computed when asked, and once for all epsilons."""

import shutil
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser

from fusion_core.model.errors import ScanLoomError
from fusion_core.workflows.evaluate.evaluate import EPSILON_OVER_E
from fusion_core.workflows.fuse.epsilon import measure_epsilon
from fusion_core.workflows.fuse.recall import RecallCurve
from scanloom.client_session import ClientSession
from scanloom.panels import recall as recall_module
from scanloom.panels.register import RegisterPanel
from scanloom.state.library import Library
from scanloom.state.view import View
from tests.app.viser_client import ViserClient, Widget, connect
from tests.patience import ENOUGH_S

FOLDER = "Recall over ε, by ground truth"


class Bench:
    """A server whose browsers have a session with the Register panel alone."""

    def __init__(self, library: Library, first: View) -> None:
        self.library = library
        self.first = first
        self.server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        self.server.on_client_connect(self._welcome)
        self.furnished = threading.Event()
        self.client: ViserClient = connect(f"http://127.0.0.1:{self.server.get_port()}")
        assert self.furnished.wait(ENOUGH_S)
        self.until(
            lambda: (
                self.session.frame_view is not None and self.session.frame_view.fused is not None
            )
        )
        self.until(lambda: self.is_offered)

    def _welcome(self, client: viser.ClientHandle) -> None:
        self.session = ClientSession(client, self.library, self.first)
        self.panel = RegisterPanel(client.gui, self.session)
        self.session.panels = [self.panel]
        self.session.refresh()
        self.furnished.set()

    def close(self) -> None:
        self.panel.close()
        self.session.close()
        self.client.close()
        self.server.stop()

    def until(self, condition: Callable[[], bool]) -> None:
        self.client.wait_until(condition)
        assert self.session.wait(ENOUGH_S)

    def change(self, **values: object) -> None:
        self.session.change(**values)
        assert self.session.wait(ENOUGH_S)

    def epsilon(self, value: float, unit: str = "E") -> None:
        self.session.change_setting("noise", "epsilon_unit", unit)
        self.session.change_setting("noise", "epsilon", value)
        assert self.session.wait(ENOUGH_S)

    def within(self, kind: str) -> Widget:
        """The one widget of a kind in the curve's folder."""
        (widget,) = (
            w
            for w in self.client.widgets.values()
            if w.type == kind and FOLDER in self.client.around(w)
        )
        return widget

    def sees(self, kind: str) -> bool:
        return bool(self.within(kind).props["visible"])

    @property
    def is_offered(self) -> bool:
        return bool(self.client.find(FOLDER).props["visible"])

    @property
    def words(self) -> str:
        return str(self.within("GuiMarkdownMessage").props["_markdown"])

    @property
    def button(self) -> Widget:
        return self.within("GuiButtonMessage")

    def press(self) -> None:
        self.client.update(self.button.uuid, {"value": True})

    def said(self) -> str:
        return str(self.within("GuiHtmlMessage").props["content"])


@pytest.fixture(scope="module")
def library(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Library]:
    """The first recording has its truth beside it, the second has none."""
    alone = tmp_path_factory.mktemp("alone") / "alone.mcap"
    shutil.copyfile(small_scene, alone)
    library = Library([small_scene, alone], [])
    yield library
    library.close()


@pytest.fixture
def bench(library: Library) -> Iterator[Bench]:
    """A new browser before the first recording, which is aligned once and has no curve yet."""
    first = View(recording=next(iter(library.named())), panel="Register")
    # Seen by somebody all the time, it stays open.
    library.open(first, viewer="the tests").recalls.clear()
    bench = Bench(library, first)
    yield bench
    bench.close()


def a_curve(**values: Any) -> RecallCurve:
    rising = np.arange(EPSILON_OVER_E.size, dtype=np.int64)
    given = {
        "factors": EPSILON_OVER_E.copy(),
        "good_kept": rising * 10,
        "noise_found": rising[::-1].copy(),
        "good_pairs": 290,
        "noise_pairs": 29,
    }
    return RecallCurve(**given | values)


class Computed:
    """Replaces ``recall_of``: counts its calls and may be held."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.begun, self.go_on = threading.Event(), threading.Event()
        self.failure: Exception | None = None
        self.curve = a_curve()
        monkeypatch.setattr(recall_module, "recall_of", self)

    def __call__(self, *args: Any) -> RecallCurve:
        self.calls.append(args)
        progress = args[-1]
        progress(3, 12, "comparing with the truth")
        self.begun.set()
        assert self.go_on.wait(ENOUGH_S)
        progress(4, 12, "comparing with the truth")
        if self.failure is not None:
            raise self.failure
        return self.curve


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> Computed:
    return Computed(monkeypatch)


def test_a_press_draws_the_curve_with_this_frames_epsilon(bench: Bench) -> None:
    assert bench.is_offered
    assert not bench.sees("GuiUplotMessage")
    # Of the first frames E is mostly that of surfaces which one sensor alone sees.
    bench.change(frame_index=20)
    bench.press()
    bench.until(lambda: bench.sees("GuiUplotMessage"))
    assert not bench.sees("GuiButtonMessage")
    assert not bench.sees("GuiProgressBarMessage")
    assert bench.session.frame_view is not None
    fused = bench.session.frame_view.fused
    assert fused is not None
    said = measure_epsilon(fused)
    assert f"**{said.median_m / said.E_m:.2f} E**" in bench.words
    (curve,) = bench.session.frame_view.open_recording.recalls.values()
    assert curve.good_pairs > 100
    at = said.median_m / said.E_m
    factors, _, xi, eta, here = bench.panel._recall._plot.data
    np.testing.assert_allclose(
        np.interp(curve.factors, factors, xi), curve.good_kept / curve.good_pairs
    )
    np.testing.assert_allclose(
        np.interp(curve.factors, factors, eta), curve.noise_found / curve.noise_pairs
    )
    assert factors[np.isfinite(here)].tolist() == [at, at]
    assert here[np.isfinite(here)].tolist() == [0.0, 1.0]


def test_the_plot_has_the_papers_band_and_no_curve_of_no_pairs(
    bench: Bench, computed: Computed
) -> None:
    computed.curve = a_curve(noise_pairs=0)
    computed.go_on.set()
    bench.press()
    bench.until(lambda: bench.sees("GuiUplotMessage"))
    factors, band, xi, eta, _ = bench.panel._recall._plot.data
    assert (np.diff(factors) >= 0.0).all()
    assert np.isfinite(xi).all()
    assert np.isnan(eta).all()
    first, last = factors[band == 1.0][[0, -1]]
    assert (first, last) == pytest.approx((1.0, np.sqrt(2.0)))
    assert (band[(factors > first) & (factors < last)] == 1.0).all()
    assert (band[(factors < first) | (factors > last)] == 0.0).all()
    # Upright edges: both ends stand twice.
    assert {0.0, 1.0} == set(band[factors == first]) == set(band[factors == last])


def test_epsilon_moves_the_mark_and_computes_nothing(bench: Bench, computed: Computed) -> None:
    computed.go_on.set()
    bench.press()
    bench.until(lambda: bench.sees("GuiUplotMessage"))
    plots = []
    for epsilon in (2.0, 4.0):
        bench.epsilon(epsilon)
        bench.until(lambda: f"**{epsilon:.2f} E**" in bench.words)  # noqa: B023  # called at once
        # The factors rise by 0.2 and the fractions by 1/29.
        percent = 100.0 * (epsilon - 0.2) / 0.2 / 29.0
        assert f"keeps **{percent:.1f} %**" in bench.words
        assert f"finds **{100.0 - percent:.1f} %**" in bench.words
        plots.append(bench.panel._recall._plot.data)
    for (factors, *_, here), epsilon in zip(plots, (2.0, 4.0), strict=True):
        assert factors[np.isfinite(here)] == pytest.approx([epsilon, epsilon])
    bench.change(selected_beam=3)
    assert bench.panel._recall._plot.data is plots[1]
    assert len(computed.calls) == 1
    bench.epsilon(0.1)
    bench.until(lambda: "outside the plot" in bench.words)
    assert np.isnan(bench.panel._recall._plot.data[-1]).all()


def test_the_curve_is_kept_for_its_settings(bench: Bench, computed: Computed) -> None:
    computed.go_on.set()
    bench.press()
    bench.until(lambda: bench.sees("GuiUplotMessage"))
    bench.session.change_setting("registration", "model", "affine")
    bench.until(lambda: bench.sees("GuiButtonMessage") and not bench.sees("GuiUplotMessage"))
    bench.press()
    bench.until(lambda: bench.sees("GuiUplotMessage"))
    assert [args[1].registration.model for args in computed.calls] == ["rigid", "affine"]
    for model in ("rigid", "affine"):
        bench.session.change_setting("registration", "model", model)
        assert bench.session.wait(ENOUGH_S)
        bench.until(lambda: bench.sees("GuiUplotMessage") and not bench.sees("GuiButtonMessage"))
    assert len(computed.calls) == 2


def test_without_a_truth_nothing_is_shown(bench: Bench) -> None:
    bench.change(recording="alone.mcap", frame_index=0)
    bench.until(lambda: not bench.is_offered)
    bench.change(recording=bench.first.recording)
    bench.until(lambda: bench.is_offered)


def test_progress_is_shown_and_the_button_cancels(bench: Bench, computed: Computed) -> None:
    bench.press()
    bench.until(lambda: "Comparing with the truth, 25 %" in bench.said())
    assert bench.within("GuiProgressBarMessage").value == 25.0
    assert bench.button.label == "Cancel"
    job = bench.panel._recall._job
    assert job is not None
    bench.press()
    assert job._stop.wait(ENOUGH_S)
    computed.go_on.set()
    bench.until(lambda: bench.button.label == "Compute")
    assert not bench.sees("GuiProgressBarMessage")
    assert not bench.sees("GuiUplotMessage")


def test_another_recording_cancels_what_is_computed(bench: Bench, computed: Computed) -> None:
    bench.press()
    assert computed.begun.wait(ENOUGH_S)
    assert bench.session.frame_view is not None
    open_recording = bench.session.frame_view.open_recording
    bench.change(recording="alone.mcap")
    computed.go_on.set()
    bench.until(lambda: bench.panel._recall._job is None)
    assert open_recording.recalls == {}


@pytest.mark.parametrize(
    ("failure", "words"),
    [
        (ScanLoomError("does not know the mount.", advice="Measure it."), "the mount. Measure it."),
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
    ],
)
def test_a_failure_is_reported_and_can_be_tried_again(
    bench: Bench, computed: Computed, failure: Exception, words: str
) -> None:
    computed.failure = failure
    computed.go_on.set()
    bench.press()
    bench.until(lambda: words in bench.said())
    assert bench.button.label == "Compute"
    computed.failure = None
    bench.press()
    bench.until(lambda: bench.sees("GuiUplotMessage"))
    assert not bench.sees("GuiHtmlMessage")


def test_missing_kinds_of_pairs_are_not_mentioned(bench: Bench, computed: Computed) -> None:
    computed.curve = a_curve(noise_pairs=0)
    computed.go_on.set()
    bench.press()
    bench.until(lambda: bench.sees("GuiUplotMessage"))
    bench.epsilon(2.0)
    bench.until(lambda: "keeps **" in bench.words)
    assert "finds" not in bench.words


def test_what_is_computed_waits_for_the_session(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the session is computing, the job makes no step."""
    steps: list[float] = []
    busy = threading.Event()

    def recall_of(*args: Any) -> RecallCurve:
        busy.set()
        for done in range(3):
            args[-1](done, 3, "comparing")
            steps.append(time.monotonic())
        return a_curve()

    ended: list[float] = []

    class Slow:
        """A panel that takes its time once the job has begun."""

        def show(self, _: object) -> None:
            if busy.is_set() and not ended:
                time.sleep(0.3)
                ended.append(time.monotonic())

        def close(self) -> None:
            """It holds nothing."""

    monkeypatch.setattr(recall_module, "recall_of", recall_of)
    monkeypatch.setattr(recall_module, "_MAX_IDLE_WAIT_S", ENOUGH_S)
    bench.session.panels.append(Slow())  # type: ignore[arg-type]  # a panel as far as a session needs one
    busy.set()
    bench.session.refresh()
    bench.press()
    bench.until(lambda: bench.sees("GuiUplotMessage"))
    assert len(steps) == 3
    assert steps[0] >= ended[0]


def test_a_browser_that_leaves_ends_what_it_asked_for(bench: Bench, computed: Computed) -> None:
    bench.press()
    assert computed.begun.wait(ENOUGH_S)
    closing = threading.Thread(target=bench.panel.close)
    closing.start()
    computed.go_on.set()
    closing.join(ENOUGH_S)
    assert bench.panel._recall._job is None
    bench.press()
    assert len(computed.calls) == 1
