"""The folders of the Review panel on a small room, worked by a browser's messages."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import viser

from fusion_core.model.labels import NO_LABEL, CaptureLabels, Label
from fusion_core.workflows.fuse.cached_chain import FrameChoice
from fusion_core.workflows.fuse.captures import frame_captures
from fusion_core.workflows.labels.compare_layers import agreement_of
from fusion_core.workflows.labels.labelled_frames import labelled_frames
from fusion_core.workflows.labels.open_store import Author
from fusion_core.workflows.labels.suggestions import suggest_thresholds
from scanloom.client_session import ClientSession
from scanloom.page.bridge import PageBridge
from scanloom.panels.review import ReviewPanel
from scanloom.panels.review_desk import ReviewDesk
from scanloom.state.library import Library
from scanloom.state.recording_labels import RecordingLabels
from scanloom.state.review_choices import ReviewChoices
from scanloom.state.view import View
from tests.app.viser_client import ViserClient, connect
from tests.patience import ENOUGH_S, comes_true

# All frames are aligned and counted first.
pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Bench:
    """A browser at a session with nothing but this panel, whose frames are all counted."""

    session: ClientSession
    panel: ReviewPanel
    browser: ViserClient
    labels: RecordingLabels

    @property
    def desk(self) -> ReviewDesk:
        return self.panel._desk

    def until(self, condition: Callable[[], bool]) -> None:
        """Wait for what a message of the browser brings about, and until that is shown."""
        assert comes_true(condition)
        assert self.session.wait(ENOUGH_S)

    def choose(self, **choices: object) -> None:
        review = ReviewChoices.model_validate(choices)
        self.session.change(review=review)
        assert self.session.wait(ENOUGH_S)

    def begin(self, name: str) -> None:
        """Begin as a person does, and go to the first run."""
        self.browser.set_value("Your name", name)
        self.browser.set_value("Layer", "")
        self.browser.click("Begin the review")
        self.until(lambda: self.desk.layer == name and self.desk.labels is not None)
        self.until(self.is_counted)
        self.desk.go(1)
        self.until(lambda: self.desk.state().number is not None)

    def is_counted(self) -> bool:
        counted, frames = self.desk.state().counted
        return 0 < frames == counted

    def run(self) -> CaptureLabels:
        """The samples that are asked about, as labels of the automatic class."""
        state = self.desk.state()
        assert state.table is not None
        assert state.number is not None
        runs, run = state.table.runs(state.number)
        return runs.labels(run, int(runs.noise_class[run]), state.part)

    def shown(self) -> str:
        """All that the browser shows as HTML."""
        widgets = list(self.browser.widgets.values())
        return "".join(
            str(w.props.get("content", "")) for w in widgets if w.props.get("visible", True)
        )


@pytest.fixture(scope="module")
def module_bench(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    address = str(tmp_path_factory.mktemp("labels") / "labels.sqlite")
    library = Library([small_scene], [], label_address=address)
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    built: list[tuple[ClientSession, ReviewPanel]] = []

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        view = View(recording=small_scene.name, panel="Review")
        session = ClientSession(client, library, view)
        panel = ReviewPanel(client, PageBridge(client.gui), session)
        session.panels = [panel]
        session.refresh()
        built.append((session, panel))

    with connect(f"http://127.0.0.1:{server.get_port()}") as browser:
        browser.find("Begin the review")
        labels = library.labels(library.path(small_scene.name))
        labels.open()
        yield Bench(*built[0], browser, labels)
        built[0][0].close()
    server.stop()
    library.close()


@pytest.fixture
def bench(module_bench: Bench) -> Iterator[Bench]:
    """The bench, with no review."""
    module_bench.choose()
    yield module_bench
    module_bench.desk.end()
    module_bench.session.refresh()
    assert module_bench.session.wait(ENOUGH_S)


def test_known_answers_are_told_at_the_end_alone(bench: Bench) -> None:
    bench.begin("anna")
    first = bench.run()
    codes = [label for label in Label if label not in (int(first.label[0]), Label.UNSURE)]
    wrong, right = codes[0], int(codes[1])
    image = first.as_image()
    image[first.row, first.column] = right
    bench.labels.label("gold", [CaptureLabels.of_image(first.capture, image)], Author("expert"))
    bench.until(lambda: "gold</bdi>: " in bench.shown())
    bench.browser.set_value("Known answers", "gold")
    bench.until(lambda: bench.session.view.review.gold_layer == "gold")
    bench.until(lambda: "gold</bdi>: " not in bench.shown())
    bench.choose(gold_layer="gold", auto_advance=False)
    bench.desk.answer(wrong)
    bench.until(lambda: "Your label: " in bench.shown())
    assert "gold" not in bench.shown()
    # Not even that it disagrees.
    for gold_layer, is_told in (("gold", False), ("", True)):
        bench.choose(gold_layer=gold_layer, order="disagreement", only_open=False)
        assert (bench.desk.state().progress.total > 0) == is_told
    bench.choose(gold_layer="gold")
    bench.labels.label("ben", [first], Author("ben"))
    bench.until(lambda: "ben</bdi>: " in bench.shown())

    samples = first.label.size
    bench.browser.click("End and score")
    bench.until(lambda: "anna" in bench.shown() and "recall" in bench.shown())
    shown = bench.shown()
    assert f"Of {samples} samples that both labelled, 0.00 are right" in shown
    assert "runs with a known answer are labelled" in shown
    assert not bench.desk.is_on
    assert bench.browser.find("Begin the review").props["visible"]
    bench.begin("anna")
    assert "recall" not in bench.shown()


def test_without_known_answers_the_review_does_not_end(bench: Bench) -> None:
    bench.begin("carla")
    assert bench.browser.find("End and score").props["disabled"]
    for name in ("carla", "nobody"):
        bench.choose(gold_layer=name)
        assert bench.desk.gold_layer == ""
        bench.browser.click("End and score")
        assert bench.desk.end_with_known_answers() is None
        assert bench.desk.is_on
    offered = bench.browser.find("Known answers")
    bench.browser.wait_until(lambda: "nobody" in offered.props["options"])
    assert "carla" not in offered.props["options"]


def give(bench: Bench, layer: str, labels: CaptureLabels, codes: list[int]) -> None:
    """Label the first samples of some labels."""
    few = np.arange(labels.row.size) < len(codes)
    own = labels.subset(few)
    given = CaptureLabels.of_samples(
        own.capture, own.row, own.column, np.array(codes, dtype=np.int64)
    )
    bench.labels.label(layer, [given], Author(layer))


def whole_scan(bench: Bench) -> CaptureLabels:
    """All beams of the scan that is asked about."""
    capture = bench.run().capture
    beams = np.arange(capture.columns)
    return CaptureLabels.of_samples(capture, np.zeros_like(beams), beams, Label.GOOD)


def test_a_comment_goes_with_the_next_answer_alone(bench: Bench) -> None:
    bench.begin("ida")
    store = bench.labels._opened
    field = bench.browser.find("Comment")
    bench.browser.set_value("Comment", " a chair's leg ")
    bench.until(lambda: bench.desk.comment.strip() == "a chair's leg")
    assert field.value == " a chair's leg "
    # Nothing is written, so it stays.
    bench.desk.mark_beams([1, 2], is_added=False)
    bench.desk.answer("accept")
    assert bench.desk.comment == field.value
    bench.desk.answer(Label.BURR)
    bench.browser.wait_until(lambda: field.value == "")
    bench.desk.answer(Label.GOOD)
    bench.browser.set_value("Comment", "as before")
    bench.until(lambda: bench.desk.comment == "as before")
    bench.desk.answer_around(Label.HOLE, 2)
    comments = [action.comment for action in store.actions("ida")]
    assert comments == [
        "a chair's leg",
        "",
        "the same place in up to 2 frames before and after: as before",
    ]


def test_layers_are_compared_without_known_answers(bench: Bench) -> None:
    bench.choose(sensor="lidar")
    bench.begin("dora")
    scan = whole_scan(bench)
    for layer, codes in (
        ("dora", [0, 0, 1, 1, 2, 2, 0, 0]),
        ("emil", [0, 0, 1, 1, 2, 0, 0, 0]),
        ("frida", [0, 0, 1, 1, 2, 2, 3]),
        ("gold", [0, 0, 1, 1]),
    ):
        give(bench, layer, scan, codes)
    bench.choose(gold_layer="gold")
    layers = [name for name in bench.labels.layers if name != "gold"]
    bench.browser.click("Compare layers")
    bench.until(lambda: "Krippendorff" in bench.shown())
    shown = bench.shown()
    expected = agreement_of(bench.labels, layers)
    assert f"{expected.coefficients['krippendorff_alpha'].value:.2f}" in shown
    # 7 of 8, and κ by hand: 0.875 agree, (4 * 5 + 2 * 2 + 2 * 1) / 64 by chance.
    pair = shown[shown.index("emil", shown.index("dora</bdi> and")) :]
    assert "8 samples that both decided on" in pair[:200]
    assert re.search(r"agree</th><td[^>]*>0\.88<", pair)
    assert re.search(rf"Cohen's κ</th><td[^>]*>{(7 / 8 - 26 / 64) / (1 - 26 / 64):.2f}<", pair)
    assert "gold" not in shown
    # Other layers make it another table.
    bench.choose()
    bench.until(lambda: "Krippendorff" not in bench.shown())


def test_a_majority_is_counted_then_written_in_one_action(bench: Bench) -> None:
    bench.choose(sensor="lidar", gold_layer="gold")
    bench.begin("agreed")
    scan = whole_scan(bench)
    before = bench.labels.counts("agreed")
    for layer, codes in (
        ("gisela", [3, 3, 3, 2, 2, 1]),
        ("hugo", [3, 3, 3, 2, 1]),
        ("gold", [1, 1, 1, 1, 1, 1]),
    ):
        give(bench, layer, scan, codes)
    # Somebody has decided here.
    give(bench, "agreed", scan, [0])
    assert sum(before.values()) == 0
    own = bench.labels.labels_of
    assert bench.desk.own is not None
    told = bench.desk.own.told(bench.session.view.review)
    others = [own(name, scan.capture).as_image()[0] for name in told]
    votes = np.stack([[(own == code) for own in others] for code in range(4)]).sum(axis=1)
    decided = (votes.sum(axis=0) >= 2) & (2 * votes.max(axis=0) > votes.sum(axis=0))
    decided[0] = False
    count = bench.desk.own.majority(told, 2)
    assert count >= decided.sum() > 1
    bench.browser.click("Adjudicate by majority …")
    bench.browser.click(f"Label {count} samples")
    bench.until(lambda: sum(bench.labels.counts("agreed").values()) == count + 1)
    image = own("agreed", scan.capture).as_image()[0]
    np.testing.assert_array_equal(image[decided], votes.argmax(axis=0)[decided])
    assert (image[1:][~decided[1:]] == NO_LABEL).all()
    assert image[0] == Label.GOOD
    assert "gold" not in bench.shown()
    bench.session.undo()
    bench.until(lambda: sum(bench.labels.counts("agreed").values()) == 1)


def test_a_suggestion_is_shown_and_applied_by_one_press(bench: Bench) -> None:
    bench.begin("jana")
    frame_view = bench.session.frame_view
    assert frame_view is not None
    assert frame_view.chain is not None
    noise = frame_view.view.settings.noise
    # Whoever calls every side of a pair that differs by much a burr, and all else good.
    table = bench.desk.state().table
    assert table is not None
    for frame in range(0, len(table.frames), 3):
        fused = frame_view.chain.fused(FrameChoice(number=frame), frame_view.view.settings)
        captures = frame_captures(fused.match, frame_view.chain.session)
        pairs = fused.match.correspondence
        differs = np.abs(pairs.lidar_range_m - pairs.depth_m) > 0.3
        assert captures.scan is not None
        codes = np.where(differs, Label.BURR, Label.GOOD)
        row = np.zeros_like(captures.beam)
        bench.labels.label(
            "jana",
            [CaptureLabels.of_samples(captures.scan, row, captures.beam, codes)],
            Author("jana"),
        )
    bench.browser.set_value("By the labels of", "jana")
    bench.browser.click("Suggest ε and thresholds")
    bench.until(lambda: "By the labels of <bdi" in bench.shown())
    expected = suggest_thresholds(
        labelled_frames(frame_view.chain, frame_view.view.settings, bench.labels.layer("jana")),
        frame_view.chain.alignment,
        frame_view.view.settings,
    )
    fit = expected[0].fit
    assert fit is not None
    assert fit.value != noise.epsilon
    score = f"{fit.score_of_current:.2f} → {fit.score_of_value:.2f}"
    assert f">{fit.value:.3g} <" in bench.shown()
    assert f"({fit.low:.3g}–{fit.high:.3g})" in bench.shown()
    assert score in bench.shown()
    bench.browser.press("suggestion", "epsilon")
    bench.until(lambda: bench.session.view.settings.noise.epsilon == fit.value)
    bench.browser.wait_until(lambda: "in use" in bench.shown())
    # What no suggestion is called changes nothing.
    before = bench.session.view.settings
    bench.browser.press("suggestion", "epsilon_unit")
    bench.browser.press("suggestion", "max_gap_deg")
    # In another unit it is another setting.
    bench.session.change_setting("noise", "epsilon_unit", "m")
    bench.until(lambda: "By the labels of <bdi" not in bench.shown())
    bench.session.change(settings=frame_view.view.settings)
    assert before.model_copy(update={"noise": noise}) == frame_view.view.settings


def test_labels_of_one_kind_suggest_nothing(bench: Bench) -> None:
    bench.begin("karl")
    bench.desk.mark_beams([1, 2, 3], is_added=False)
    bench.desk.answer(Label.GOOD)
    bench.browser.set_value("By the labels of", "karl")
    bench.browser.click("Suggest ε and thresholds")
    bench.until(lambda: "The labels do not tell" in bench.shown())
    assert "Apply</button>" not in bench.shown()
