"""One person's desk without a browser: the view, what is computed for it, and what is told."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.desk import STORED_VIEW, Desk
from app.security import LINK_KEY
from app.server import ServeOptions, Workbench
from app.shown import Shown, shown_of
from app.state.history import History
from app.state.library import Library, Opened
from app.state.view import View, view_of_link
from fusion_core.model.errors import AlignmentFailed, MissingStream, RecordingError
from fusion_core.workflows.live import FrameChoice
from fusion_core.workflows.presets import PRESETS
from tests.app.viser_client import connect

ENOUGH_S = 60.0


class Told:
    """A client as far as a desk needs one: it keeps what it is told and what it is to store."""

    client_id = 0

    def __init__(self) -> None:
        self.notes: list[tuple[str, str]] = []
        self.stored: dict[str, str] = {}
        self.local_storage = SimpleNamespace(set_item=self.stored.__setitem__)

    def atomic(self) -> Any:
        return nullcontext()

    def flush(self) -> None:
        """Nothing waits here."""

    def add_notification(self, title: str, body: str, **_: Any) -> None:
        self.notes.append((title, body))


class Recorder:
    """A panel that keeps what it was shown, and fails where it is asked to."""

    def __init__(self) -> None:
        self.shown: list[Shown] = []
        self.failure: Exception | None = None

    def show(self, shown: Shown) -> None:
        if self.failure is not None:
            raise self.failure
        self.shown.append(shown)


def aligned(library: Library, view: View) -> Opened:
    """The recording of a view, once its alignment has ended."""
    opened = library.open(view)
    ended = threading.Event()

    def hear() -> None:
        if opened.chain is not None or opened.failure is not None:
            ended.set()

    opened.align(hear)
    hear()
    assert ended.wait(ENOUGH_S)
    opened.forget(hear)
    return opened


@pytest.fixture(scope="module")
def library(small_scene: Path) -> Iterator[Library]:
    shared = Library([small_scene], [])
    yield shared
    shared.close()


@pytest.fixture(scope="module")
def view(library: Library, small_scene: Path) -> View:
    first = View(recording=small_scene.name)
    aligned(library, first)
    return first


@pytest.fixture
def client() -> Told:
    return Told()


@pytest.fixture
def panel() -> Recorder:
    return Recorder()


@pytest.fixture
def desk(library: Library, view: View, client: Told, panel: Recorder) -> Iterator[Desk]:
    """A desk that shows its first view."""
    made = Desk(client, library, view)  # type: ignore[arg-type]  # as far as it is needed
    made.panels = [panel]
    made.refresh()
    assert made.wait(ENOUGH_S)
    yield made
    made.close()


def shown_by(desk: Desk) -> Shown:
    """What the desk shows of its latest view."""
    assert desk.wait(ENOUGH_S)
    assert desk.shown is not None
    return desk.shown


def frames_of(desk: Desk) -> int:
    return len(shown_by(desk).opened.frames)


# The desk


def test_a_desk_shows_its_first_view_and_has_the_browser_keep_it(
    desk: Desk, view: View, client: Told, panel: Recorder
) -> None:
    assert [shown.view for shown in panel.shown] == [view]
    assert panel.shown[0].fused is not None
    assert view_of_link(client.stored[STORED_VIEW]) == view
    assert client.notes == []


def test_of_many_changes_the_last_is_shown_and_kept(
    desk: Desk, client: Told, panel: Recorder
) -> None:
    for tenths in range(1, 41):
        desk.set("noise", "epsilon", tenths / 10)
    shown = shown_by(desk)
    assert shown.view.settings.noise.epsilon == 4.0
    assert panel.shown[-1] is shown
    assert view_of_link(client.stored[STORED_VIEW]) == desk.view == shown.view
    assert [s.view.settings.noise.epsilon for s in panel.shown[1:]] == sorted(
        {s.view.settings.noise.epsilon for s in panel.shown[1:]}
    )


def test_epsilon_decides_what_is_shown(desk: Desk) -> None:
    found = []
    for epsilon in (0.5, 10.0):
        desk.set("noise", "epsilon", epsilon)
        fused = shown_by(desk).fused
        assert fused is not None
        found.append(np.count_nonzero(fused.classes.lidar_class))
    assert found[0] > found[1]


def test_a_refused_value_is_told_each_time_and_the_view_stays(
    desk: Desk, view: View, client: Told, panel: Recorder
) -> None:
    for count in (1, 2):
        before = len(panel.shown)
        desk.set("noise", "epsilon", -1.0)
        assert desk.view == view
        assert len(client.notes) == count
        # The widget that holds the refused value is set back.
        shown_by(desk)
        assert len(panel.shown) > before
    title, body = client.notes[0]
    assert title.startswith("noise.epsilon: ")
    assert body == "The value before is kept."
    desk.undo()
    assert desk.view == view


def test_undo_takes_settings_back_and_leaves_the_place(desk: Desk, view: View) -> None:
    desk.set("noise", "epsilon", 2.0)
    desk.set("noise", "support_sigma", 3.0)
    desk.change(number=7, panel="Repair")
    desk.undo()
    assert desk.view == view.with_setting("noise", "epsilon", 2.0).changed(number=7, panel="Repair")
    desk.undo()
    desk.undo()
    assert desk.view == view.changed(number=7, panel="Repair")
    desk.redo()
    desk.redo()
    desk.redo()
    assert desk.view.settings.noise.epsilon == 2.0
    assert desk.view.settings.noise.support_sigma == 3.0
    assert desk.view.number == 7


def test_one_drag_of_a_slider_is_undone_at_once(desk: Desk, view: View) -> None:
    for epsilon in (2.0, 2.5, 3.0):
        desk.set("noise", "epsilon", epsilon)
    desk.undo()
    assert desk.view == view


def test_undo_of_a_preset_brings_its_alignment_back_too(desk: Desk, view: View) -> None:
    own = shown_by(desk).opened
    desk.set_preset("published")
    assert desk.view.settings == desk.view.aligned == PRESETS["published"]
    assert shown_by(desk).opened is not own
    desk.undo()
    assert desk.view == view
    assert shown_by(desk).opened is own
    desk.redo()
    assert desk.view.aligned == PRESETS["published"]


def test_another_alignment_is_undone_before_the_setting_that_asked_for_it(
    desk: Desk, view: View
) -> None:
    desk.set("search", "min_overlap", 0.6)
    desk.align_again()
    assert not desk.view.needs_alignment()
    desk.undo()
    assert desk.view == view.with_setting("search", "min_overlap", 0.6)
    desk.undo()
    assert desk.view == view


def test_a_place_picked_by_hand_is_that_of_its_frame_unless_locked(desk: Desk) -> None:
    desk.change_settings(picked=(80.0, 40.0))
    desk.change(panel="Match")
    assert desk.view.picked == (80.0, 40.0)
    desk.step(1)
    assert desk.view.picked is None
    desk.change_settings(picked=(80.0, 40.0), lock_picked=True)
    desk.step(1)
    assert desk.view.picked == (80.0, 40.0)


@pytest.mark.parametrize(
    ("loop", "start", "by", "end"),
    [(True, 0, -1, -1), (True, -1, 1, 0), (False, 0, -1, 0), (False, -1, 1, -1), (True, 3, 2, 5)],
)
def test_a_step_comes_in_again_from_the_other_end_or_stops(
    desk: Desk, loop: bool, start: int, by: int, end: int
) -> None:
    count = frames_of(desk)
    desk.change(loop=loop, number=start % count)
    desk.step(by)
    assert desk.view.number == end % count


def test_a_failure_is_told_once_until_it_is_over(desk: Desk, client: Told) -> None:
    # No scan lies so near that it would not be too far.
    desk.set("time", "max_gap_ms", 0.001)
    desk.align_again()
    shown = shown_by(desk)
    while shown.failure is None:
        assert desk.wait(ENOUGH_S)
        shown = shown_by(desk)
    for _ in range(3):
        desk.refresh()
        assert desk.wait(ENOUGH_S)
    assert len(client.notes) == 1
    assert client.notes[0][0] == shown.failure.problem
    desk.undo()
    assert shown_by(desk).fused is not None


def test_a_panel_that_fails_is_told_and_the_desk_goes_on(
    desk: Desk, client: Told, panel: Recorder
) -> None:
    panel.failure = ZeroDivisionError("by zero")
    desk.change(number=3)
    assert desk.wait(ENOUGH_S)
    assert client.notes == [("Something failed", "ZeroDivisionError: by zero")]
    panel.failure = None
    desk.change(number=4)
    assert shown_by(desk).view.number == panel.shown[-1].view.number == 4


def test_a_recording_that_is_none_is_told_and_the_desk_goes_on(desk: Desk, client: Told) -> None:
    desk.change(lidar_topic="/none")
    assert desk.wait(ENOUGH_S)
    assert "'/none'" in client.notes[0][0]
    desk.change(lidar_topic=None, number=2)
    assert shown_by(desk).view.number == 2


def test_a_closed_desk_shows_nothing_any_more(desk: Desk, panel: Recorder) -> None:
    before = len(panel.shown)
    desk.close()
    desk.change(number=5)
    assert desk.wait(ENOUGH_S)
    assert len(panel.shown) == before


@pytest.mark.parametrize(
    ("error", "title", "body"),
    [
        (AlignmentFailed("no peak.", advice="Look elsewhere."), "no peak.", "Look elsewhere."),
        (KeyError("row"), "Something failed", "KeyError: 'row'"),
    ],
)
def test_an_alignment_that_fails_is_told_and_the_streams_are_shown(
    small_scene: Path,
    client: Told,
    panel: Recorder,
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
    title: str,
    body: str,
) -> None:
    def fail(*_: Any) -> None:
        raise error

    monkeypatch.setattr("app.state.library.align_session", fail)
    library = Library([small_scene], [])
    opened = library.open(View(recording=small_scene.name))
    desk = Desk(client, library, View(recording=small_scene.name))  # type: ignore[arg-type]  # as far as it is needed
    desk.panels = [panel]
    told = threading.Event()
    opened.align(told.set)
    assert told.wait(ENOUGH_S)
    desk.refresh()
    shown = shown_by(desk)
    assert (shown.opened, shown.chain) == (opened, None)
    assert client.notes == [(title, body)]
    desk.close()
    library.close()


# What is shown


def test_what_is_shown_is_what_the_chain_computes(library: Library, view: View) -> None:
    opened = library.open(view)
    assert opened.chain is not None
    shown = shown_of(view.changed(number=9), opened)
    choice = FrameChoice(number=9)
    assert shown.match is opened.chain.matched(choice, view.settings)
    assert shown.fused is opened.chain.judged(choice, view.settings)
    assert shown.color is not None
    assert shown.failure is None


def test_a_frame_beyond_the_last_is_the_last(library: Library, view: View) -> None:
    opened = library.open(view)
    last = len(opened.frames) - 1
    for number in (last, last + 1, 10**30):
        shown = shown_of(view.changed(number=number), opened)
        assert shown.view.number == last
        assert shown.paired is not None
        assert shown.paired.image.stamp_ns == opened.frames.image(last).stamp_ns


def test_the_clock_offset_is_the_mounts_and_only_where_asked_for(
    library: Library, view: View
) -> None:
    opened = library.open(view)
    chain = opened.chain
    assert chain is not None
    late = Opened(opened.session)
    late.chain = type(chain)(
        opened.session,
        opened.frames,
        replace(chain.alignment, mount=replace(chain.alignment.mount, clock_offset_ms=30.0)),
    )
    gaps_ns = []
    for applied in (False, True):
        paired = shown_of(view.changed(number=9, apply_clock_offset=applied), late).paired
        assert paired is not None
        assert paired.window is not None
        gaps_ns.append((paired.gap_ns, paired.window.scan.stamp_ns))
    assert sum(gaps_ns[0]) - sum(gaps_ns[1]) == 30_000_000


@pytest.mark.parametrize("preset", ["default", "published"])
def test_a_picked_row_that_the_image_lacks_is_a_failure_in_words(
    library: Library, view: View, preset: str
) -> None:
    opened = library.open(view)
    asked = view.changed(preset=preset, settings=PRESETS[preset])  # type: ignore[index]  # one of the two
    rows = opened.frames.image(0).depth_m.shape[0]
    inside = shown_of(asked.changed(picked=(80.0, rows - 1.0)), opened)
    assert inside.match is not None
    assert set(inside.match.pairs.row.tolist()) == {rows - 1}
    outside = shown_of(asked.changed(picked=(80.0, float(rows))), opened)
    assert outside.match is None
    assert outside.paired is not None
    assert isinstance(outside.failure, AlignmentFailed)
    assert f"v = {rows}" in outside.failure.problem


def test_while_a_recording_is_aligned_its_streams_are_shown(library: Library, view: View) -> None:
    waiting = Opened(library.open(view).session)
    shown = shown_of(view, waiting)
    assert (shown.chain, shown.match, shown.failure) == (None, None, None)
    assert shown.opened is waiting


# The library


def test_people_share_a_recording_and_its_alignment(library: Library, view: View) -> None:
    opened = library.open(view)
    elsewhere = view.changed(number=5, panel="Map").with_setting("noise", "epsilon", 2.0)
    assert library.open(elsewhere) is opened
    other = library.open(view.changed(virtual_row=60))
    assert other is not opened
    assert other.session.recording is opened.session.recording
    published = view.changed(settings=PRESETS["published"])
    assert library.open(published) is opened
    assert library.open(published.changed(aligned=PRESETS["published"])) is not opened


def test_all_who_wait_for_an_alignment_hear_of_it_until_they_leave(small_scene: Path) -> None:
    library = Library([small_scene], [])
    opened = library.open(View(recording=small_scene.name))
    ended = [threading.Event(), threading.Event()]
    gone: list[int] = []

    def listener(place: int) -> Callable[[], None]:
        def hear() -> None:
            if opened.chain is not None:
                ended[place].set()

        return hear

    def leave() -> None:
        gone.append(1)
        opened.forget(leave)

    opened.align(leave)
    for place in range(2):
        opened.align(listener(place))
    for event in ended:
        assert event.wait(ENOUGH_S)
    assert gone == [1]
    assert opened.progress.done == opened.progress.total or opened.progress.total is None
    library.close()


def test_a_library_that_closes_stops_the_alignment(
    small_scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    began, stopped = threading.Event(), threading.Event()

    def endless(_: object, progress: Callable[..., None]) -> None:
        try:
            while True:
                began.set()
                progress(0, None, "aligning")
        finally:
            stopped.set()

    monkeypatch.setattr("app.state.library.align_session", endless)
    library = Library([small_scene], [])
    library.open(View(recording=small_scene.name)).align(lambda: None)
    assert began.wait(ENOUGH_S)
    library.close()
    assert stopped.is_set()


@pytest.fixture
def shelves(tmp_path: Path, small_scene: Path) -> Library:
    """A library with one root; beside the root lies what is none of its business."""
    root = tmp_path / "root"
    (root / "inner").mkdir(parents=True)
    (tmp_path / "outside.mcap").write_bytes(small_scene.read_bytes())
    for name in ("b.mcap", "a.mcap", "inner/c.mcap", ".hidden.mcap"):
        (root / name).write_bytes(small_scene.read_bytes())
    (root / "leads out").symlink_to(tmp_path / "outside.mcap")
    (root / "loop").symlink_to(root / "loop")
    (tmp_path / "root.mcap").write_bytes(b"")
    return Library([small_scene], [root])


def test_what_may_be_opened_is_named(shelves: Library, small_scene: Path) -> None:
    assert shelves.names()[:4] == [small_scene.name, "a.mcap", "b.mcap", "inner"]
    assert ".hidden.mcap" not in shelves.names()
    for name in (small_scene.name, "a.mcap", "inner/c.mcap"):
        assert shelves.path(name).is_file()
    shelves.close()


@pytest.mark.parametrize(
    "name",
    [
        "",
        ".",
        "..",
        "../outside.mcap",
        "../root.mcap",
        "inner/../../outside.mcap",
        "/etc/passwd",
        "leads out",
        "loop",
        "none.mcap",
        "a\x00b",
        "x" * 4_000,
        "x/" * 2_000,
        "<script>alert(1)</script>",
    ],
)
def test_nothing_else_may_be_opened(shelves: Library, name: str) -> None:
    with pytest.raises(RecordingError, match="not among the recordings") as refused:
        shelves.open(View(recording=name))
    assert str(refused.value).isprintable()


def test_files_of_one_name_are_told_apart(tmp_path: Path, small_scene: Path) -> None:
    paths = [tmp_path / folder / "same.mcap" for folder in ("a", "b")]
    for path in paths:
        path.parent.mkdir()
        path.write_bytes(small_scene.read_bytes())
    library = Library(paths, [])
    assert library.names() == [str(path) for path in paths]
    assert [library.path(name) for name in library.names()] == paths


def test_a_topic_that_is_not_there_is_refused(library: Library, view: View) -> None:
    with pytest.raises(MissingStream, match="no topic '/none'"):
        library.open(view.changed(depth_topics=("/none",)))


# The history

CHANGES = st.lists(st.floats(0.1, 9.0), min_size=1, max_size=12)


def walked(history: History, start: View, epsilons: list[float]) -> list[View]:
    """The views of a walk through these settings; each is at a place of its own."""
    views = [start]
    for number, epsilon in enumerate(epsilons):
        history.add(views[-1])
        views.append(views[-1].with_setting("noise", "epsilon", epsilon).changed(number=number))
    return views


@given(epsilons=CHANGES)
def test_undo_goes_all_the_way_back_and_redo_all_the_way_again(epsilons: list[float]) -> None:
    history = History()
    views = walked(history, View(recording="a"), epsilons)
    at = views[-1]
    for step, then in ((history.undo, views[-2::-1]), (history.redo, views[1:])):
        for expected in then:
            moved = step(at)
            assert moved is not None
            assert moved.settings == expected.settings
            assert moved.number == at.number
            at = moved
        assert step(at) is None


@given(epsilons=CHANGES)
def test_a_change_after_an_undo_leaves_nothing_to_redo(epsilons: list[float]) -> None:
    history = History()
    views = walked(history, View(recording="a"), epsilons)
    undone = history.undo(views[-1])
    assert undone is not None
    history.add(undone)
    assert history.redo(undone) is None


def test_a_drag_is_one_change() -> None:
    history = History()
    views = [View(recording="a")]
    for epsilon, dragged, at_s in (
        (1.1, "noise.epsilon", 10.0),
        (1.2, "noise.epsilon", 10.9),
        (1.3, "noise.epsilon", 11.8),
        (1.4, "noise.epsilon", 20.0),
        (1.5, "noise.other", 20.1),
        (1.6, "", 20.2),
        (1.7, "", 20.3),
    ):
        history.add(views[-1], dragged, at_s)
        views.append(views[-1].with_setting("noise", "epsilon", epsilon))
    undone, view = [], views[-1]
    while (before := history.undo(view)) is not None:
        view = before
        undone.append(view.settings.noise.epsilon)
    assert undone == [1.6, 1.5, 1.4, 1.3, views[0].settings.noise.epsilon]
    # Back in the past, the same setting begins a drag of its own.
    history.add(view, "noise.epsilon", 30.0)
    history.undo(view)
    history.add(view, "noise.epsilon", 30.1)
    assert history.undo(view) is not None


def test_the_history_is_bounded() -> None:
    history = History()
    view = walked(history, View(recording="a"), [1.0 + i / 1000 for i in range(500)])[-1]
    undone = 0
    while (before := history.undo(view)) is not None:
        view, undone = before, undone + 1
    assert undone == 200
    assert view.settings.noise.epsilon == pytest.approx(1.299)


# The desk of a browser, behind the server


@pytest.fixture(scope="module")
def workbench(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workbench]:
    options = ServeOptions(
        recordings=[small_scene], port=0, output_root=tmp_path_factory.mktemp("out")
    )
    with Workbench(options) as serving:
        yield serving


def notes_of(client: Any) -> Iterator[tuple[str, str]]:
    while True:
        message = client.wait_for(
            lambda received: received.type == "NotificationShowMessage", ENOUGH_S
        ).message
        yield message["props"]["title"], message["props"]["body"]


def test_a_browser_gets_the_view_that_it_kept(workbench: Workbench, view: View) -> None:
    kept = view.changed(number=4, panel="Match").with_setting("noise", "epsilon", 2.5)
    storage = {STORED_VIEW: kept.to_link()}
    with connect(workbench.address, storage=storage) as client:
        client.wait_until(lambda: client_shows(client, "Frame", 4), ENOUGH_S)
        assert [desk.view for desk in workbench.desks] == [kept]


def test_a_link_goes_before_what_was_kept_and_is_followed_once(
    workbench: Workbench, view: View
) -> None:
    linked, kept = view.changed(number=6), view.changed(number=4)
    storage = {STORED_VIEW: kept.to_link(), LINK_KEY: linked.to_link()}
    with connect(workbench.address, storage=storage) as client:
        client.wait_until(lambda: client_shows(client, "Frame", 6), ENOUGH_S)
        client.wait_until(lambda: storage[STORED_VIEW] == linked.to_link(), ENOUGH_S)
    assert LINK_KEY not in storage


@pytest.mark.parametrize(
    ("link", "words"),
    [
        ("broken", "the link cannot be followed"),
        (View(recording="../elsewhere").to_link(), "is not among the recordings"),
        (View(recording="a\x00b").to_link(), "is not among the recordings"),
    ],
)
def test_a_link_that_cannot_be_followed_is_told_and_the_kept_view_is_shown(
    workbench: Workbench, view: View, link: str, words: str
) -> None:
    storage = {STORED_VIEW: view.changed(number=4).to_link(), LINK_KEY: link}
    with connect(workbench.address, storage=storage) as client:
        title, _ = next(notes_of(client))
        assert words in title
        client.wait_until(lambda: client_shows(client, "Frame", 4), ENOUGH_S)


def test_a_widget_that_holds_a_refused_value_is_set_back(workbench: Workbench, view: View) -> None:
    storage = {STORED_VIEW: view.changed(panel="Match").to_link()}
    with connect(workbench.address, storage=storage) as client:
        row = client.find("v (row)", timeout=ENOUGH_S)
        client.wait_until(lambda: row.value > 0.0, ENOUGH_S)
        peak_row = row.value
        client.set_value("v (row)", -3.0)
        client.set_value("Offset", "Use")
        title, _ = next(notes_of(client))
        assert title.startswith("picked.1: ")
        client.wait_until(lambda: row.value == peak_row, ENOUGH_S)


@pytest.mark.filterwarnings("ignore:Queued a")
@pytest.mark.parametrize("last_seen", ["Preset", "Frame", "v (row)"])
def test_a_desk_ends_with_its_browser_even_half_furnished(
    workbench: Workbench, last_seen: str
) -> None:
    def threads() -> set[str]:
        return {t.name for t in threading.enumerate() if t.name.startswith(("desk", "play"))}

    def ended() -> bool:
        return not workbench.desks and not threads()

    assert within(ended)
    with connect(workbench.address, storage={}) as client:
        client.find(last_seen, timeout=ENOUGH_S)
        assert threads()
    assert within(ended)


def within(condition: Callable[[], bool]) -> bool:
    """Whether a condition comes true in time."""
    pause = threading.Event()
    deadline_s = time.monotonic() + ENOUGH_S
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        pause.wait(0.05)
    return True


def client_shows(client: Any, label: str, value: Any) -> bool:
    return any(w.label == label and w.value == value for w in client.widgets.values())
