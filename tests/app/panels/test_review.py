"""The review on a real server: answers, what they change, and what is said where they cannot be
written."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fusion_core.model.classes import NoiseClass
from fusion_core.model.errors import ExportError
from fusion_core.model.labels import NO_LABEL, CaptureLabels, Label
from fusion_core.workflows.labels.open_store import LabelStore, open_labels
from scanloom.client_session import ClientSession
from scanloom.panels.review import ReviewPanel
from scanloom.server.workbench import ServeOptions, Workbench
from scanloom.state.frame_runs import SENSORS
from tests.app.viser_client import ViserClient, connect
from tests.patience import ENOUGH_S

pytestmark = pytest.mark.slow


class Visit:
    """A browser at the review, once all frames are counted."""

    def __init__(self, workbench: Workbench, client: ViserClient) -> None:
        self.client = client
        client.find("page events")
        client.wait_until(lambda: bool(workbench.sessions))
        self.session: ClientSession = workbench.sessions[-1]
        self.panel = next(p for p in self.session.panels if isinstance(p, ReviewPanel))
        self.desk = self.panel._desk
        self.session.change(panel="Review", frame_index=0, selected_beam=None)
        client.wait_until(lambda: self.panel._survey is not None)

    def begin(self, name: str) -> None:
        self.client.set_value("Your name", name)
        self.client.click("Begin the review")
        self.client.wait_until(lambda: self.desk.layer == name)
        self.until(lambda: self.panel._survey is not None and self.panel._survey.is_complete)
        self.session.refresh()
        self.until(lambda: self.desk.state().counted[0] > 10 and self.session.wait(ENOUGH_S))

    def until(self, condition: object) -> None:
        self.client.wait_until(condition)  # type: ignore[arg-type]  # a function

    def key(self, label: str) -> None:
        self.client.trigger(label)

    def html(self, sign: str) -> str:
        return next(
            (
                str(widget.props["content"])
                for widget in list(self.client.widgets.values())
                if sign in str(widget.props.get("content"))
            ),
            "",
        )

    def told(self) -> str:
        """What the next notification says."""
        note = self.client.wait_for(lambda one: one.type == "NotificationShowMessage")
        props = note.message["props"]
        return f"{props['title']} {props['body']}"


@pytest.fixture(scope="module")
def workbench(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workbench]:
    out = tmp_path_factory.mktemp("out")
    options = ServeOptions(
        recordings=[small_scene], port=0, output_root=out, label_address=str(out / "labels.sqlite")
    )
    with Workbench(options) as serving:
        yield serving


@pytest.fixture
def visit(workbench: Workbench) -> Iterator[Visit]:
    with connect(workbench.address) as client:
        yield Visit(workbench, client)


@pytest.fixture
def store(small_scene: Path, workbench: Workbench) -> Iterator[LabelStore]:
    address = workbench._options.label_address
    with open_labels(small_scene, address, create=True) as opened:
        yield opened


def labelled(store: LabelStore, layer: str) -> list[CaptureLabels]:
    return list(store.labelled(layer))


def test_yes_and_no_judge_the_automatic_class(visit: Visit, store: LabelStore) -> None:
    visit.begin("kurt")
    visit.key("Next frame (J; in the review: run)")
    visit.until(lambda: visit.desk.state().number is not None)
    state = visit.desk.state()
    assert state.table is not None
    assert state.number is not None
    runs, run = state.table.runs(state.number)
    visit.key("Review: yes, right")
    visit.until(lambda: bool(labelled(store, "kurt")))
    (labels,) = labelled(store, "kurt")
    assert labels.capture == runs.capture(run)
    assert set(labels.label.tolist()) == {int(runs.noise_class[run])}
    assert set(labels.column.tolist()) == set(runs.column[runs.samples(run)].tolist())
    # What is not noise is good.
    visit.key("Next conflict (in the review: no)")
    visit.until(lambda: store.counts("kurt")[Label.GOOD] > 0)
    (action, _) = store.actions("kurt")
    assert (action.annotator, action.source) == ("kurt", "human")
    assert action.settings_sha256 == visit.session.view.settings_sha256


def test_what_is_good_may_be_wrong_in_several_ways(visit: Visit, store: LabelStore) -> None:
    visit.begin("lena")
    review = visit.session.view.review.model_copy(update={"classes": frozenset({NoiseClass.GOOD})})
    visit.session.change(review=review)
    visit.session.wait(ENOUGH_S)
    visit.key("Next frame (J; in the review: run)")
    visit.until(lambda: visit.desk.state().number is not None)
    visit.client.drain()
    visit.key("Next conflict (in the review: no)")
    assert "Say what it is instead" in visit.told()
    assert labelled(store, "lena") == []


def test_a_split_run_is_answered_in_halves(visit: Visit, store: LabelStore) -> None:
    visit.begin("mara")
    table = visit.desk.state().table
    assert table is not None
    sizes = np.array([table.runs(n)[0].start[table.run[n] + 1] for n in range(len(table))])
    sizes -= np.array([table.runs(n)[0].start[table.run[n]] for n in range(len(table))])
    is_noise = table.noise_class != NoiseClass.GOOD
    number = int(np.flatnonzero(is_noise & (sizes >= 4))[0])
    runs, run = table.runs(number)
    whole = runs.samples(run)
    sensor = SENSORS[runs.sensor[run]]
    visit.session.change(review=visit.session.view.review.model_copy(update={"sensor": sensor}))
    visit.session.change(
        frame_index=int(table.frame[number]), selected_beam=int(runs.beam[whole.start])
    )
    visit.until(lambda: visit.desk.state().part == whole)
    visit.key("Review: split the run")
    visit.until(lambda: visit.desk.state().part.stop < whole.stop)
    cut = visit.desk.state().part.stop
    visit.key("Review: burr")
    visit.until(lambda: visit.desk.state().part == slice(cut, whole.stop))
    visit.key("Review: good")
    visit.until(lambda: store.counts("mara")[Label.GOOD] == whole.stop - cut)
    assert store.counts("mara")[Label.BURR] == cut - whole.start


def test_all_open_runs_of_a_queue_are_one_action(visit: Visit, store: LabelStore) -> None:
    visit.begin("nina")
    classes = frozenset({NoiseClass.CONFLICT, NoiseClass.BURR})
    visit.session.change(
        review=visit.session.view.review.model_copy(update={"classes": classes, "sensor": "lidar"})
    )
    visit.session.wait(ENOUGH_S)
    count = len(visit.desk.open_numbers())
    assert count > 1
    visit.client.click("Label all open runs of the queue …")
    visit.client.click(f"Label {count} runs")
    visit.until(lambda: visit.desk.open_numbers() == [])
    assert sum(1 for _ in store.actions("nina")) == 1
    counts = store.counts("nina")
    assert counts[Label.BURR] > 0
    assert counts[Label.GOOD] == counts[Label.HOLE] == 0


def test_the_same_place_in_neighbouring_frames_is_labelled_along(
    visit: Visit, store: LabelStore
) -> None:
    visit.begin("olga")
    table = visit.desk.state().table
    assert table is not None
    found = [
        n
        for n in range(len(table))
        if table.frame[n] == 10 and table.noise_class[n] == NoiseClass.HOLE and table.sensor[n] == 0
    ]
    runs, run = table.runs(found[len(found) // 2])
    visit.session.change(review=visit.session.view.review.model_copy(update={"sensor": "lidar"}))
    visit.session.change(frame_index=10, selected_beam=int(runs.beam[runs.samples(run)][0]))
    visit.until(lambda: visit.desk.state().number == found[len(found) // 2])
    visit.session.wait(ENOUGH_S)
    visit.key("Review: label run and neighbours")
    visit.until(lambda: bool(labelled(store, "olga")))
    (action,) = store.actions("olga")
    assert len(action.captures) > 1
    assert store.counts("olga")[Label.HOLE] == action.samples
    visit.session.undo()
    assert labelled(store, "olga") == []


def test_the_repair_follows_a_layer(visit: Visit, store: LabelStore) -> None:
    visit.begin("petra")
    fused = visit.session.frame_view and visit.session.frame_view.fused
    assert fused is not None
    at = int(np.flatnonzero(fused.classes.lidar_class == NoiseClass.GOOD)[5])
    beam = int(fused.match.correspondence.beam[at])
    visit.desk.mark_beams([beam], is_added=False)
    visit.desk.answer(Label.HOLE)
    visit.session.change(panel="Repair", label_layer="petra")
    visit.session.wait(ENOUGH_S)
    overruled = visit.session.frame_view and visit.session.frame_view.fused
    assert overruled is not None
    assert overruled.classes.lidar_class[at] == NoiseClass.HOLE
    assert overruled.repair.lidar_range_m[at] != fused.match.correspondence.lidar_range_m[at]
    visit.session.change(selected_beam=beam)
    visit.session.wait(ENOUGH_S)
    visit.until(lambda: "a person" in visit.html("<b>Beam.</b>"))
    # In the review the automatic class is asked about.
    visit.session.change(panel="Review")
    visit.session.wait(ENOUGH_S)
    asked = visit.session.frame_view and visit.session.frame_view.fused
    assert asked is not None
    assert asked.classes.lidar_class[at] == NoiseClass.GOOD


def test_an_answer_that_cannot_be_written_is_told_and_changes_nothing(
    visit: Visit, store: LabelStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    visit.begin("ruth")
    visit.key("Next frame (J; in the review: run)")
    visit.until(lambda: visit.desk.state().number is not None)
    number = visit.desk.state().number

    def full(*_: object) -> None:
        raise ExportError("cannot be written: no space left on device.", file="labels.sqlite")

    visit.client.drain()
    with monkeypatch.context() as patched:
        patched.setattr(LabelStore, "label", full)
        visit.key("Review: burr")
        assert "no space left" in visit.told()
    assert labelled(store, "ruth") == []
    # The run is asked about still.
    assert visit.desk.state().number == number
    visit.key("Review: burr")
    visit.until(lambda: store.counts("ruth")[Label.BURR] > 0)


def test_a_store_that_is_none_is_refused_in_one_line(small_scene: Path, tmp_path: Path) -> None:
    address = tmp_path / "other.sqlite"
    with sqlite3.connect(address) as other:
        other.execute("create table mine (a)")
    before = address.read_bytes()
    options = ServeOptions(
        recordings=[small_scene], port=0, output_root=tmp_path, label_address=str(address)
    )
    with Workbench(options) as workbench, connect(workbench.address) as client:
        visit = Visit(workbench, client)
        client.set_value("Your name", "sara")
        client.drain()
        client.click("Begin the review")
        assert "is not a label store of ScanLoom" in visit.told()
        assert visit.desk.labels is None
    assert address.read_bytes() == before


def test_no_label_takes_a_label_away(visit: Visit, store: LabelStore) -> None:
    visit.begin("tina")
    visit.desk.mark_beams([3, 4, 5], is_added=False)
    visit.desk.answer(Label.GOOD)
    visit.desk.mark_beams([4], is_added=False)
    visit.desk.answer("clear")
    (labels,) = labelled(store, "tina")
    assert labels.column.tolist() == [3, 5]
    (_, action) = store.actions("tina")
    (change,) = store.changes_of(action.id)
    assert change.after.label.tolist() == [NO_LABEL]
