"""One person's desk without a browser: the view, what is computed for it, and what is told."""

import os
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fusion_core.model.errors import AlignmentFailed, RecordingError
from fusion_core.workflows.fuse.frame import FrameMatch
from fusion_core.workflows.fuse.live import FrameChoice
from fusion_core.workflows.fuse.presets import PRESETS
from scanloom.client_session import STORED_VIEW, Desk
from scanloom.frame_view import Shown, shown_of
from scanloom.resources import sample_path
from scanloom.state.library import Library
from scanloom.state.opened import Opened
from scanloom.state.view import View, view_of_link

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
        self._changed = threading.Condition()

    def show(self, shown: Shown) -> None:
        if self.failure is not None:
            raise self.failure
        with self._changed:
            self.shown.append(shown)
            self._changed.notify_all()

    def until(self, condition: Callable[[Shown], bool]) -> Shown:
        """Wait until what was shown last fits: an alignment ends when it will."""
        with self._changed:
            assert self._changed.wait_for(
                lambda: bool(self.shown) and condition(self.shown[-1]), ENOUGH_S
            )
            return self.shown[-1]


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
    # Seen by somebody all the time, it stays open.
    library.open(first, seen_by="the tests")
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


def test_a_failure_is_told_once_until_it_is_over(desk: Desk, client: Told, panel: Recorder) -> None:
    # No scan lies so near that it would not be too far.
    desk.set("time", "max_gap_ms", 0.001)
    desk.align_again()
    failure = panel.until(lambda shown: shown.failure is not None).failure
    assert failure is not None
    for _ in range(3):
        desk.refresh()
        assert desk.wait(ENOUGH_S)
    assert [title for title, _ in client.notes] == [failure.problem]
    desk.undo()
    panel.until(lambda shown: shown.fused is not None)


def test_a_panel_that_fails_is_told_and_the_desk_goes_on(
    desk: Desk, client: Told, panel: Recorder
) -> None:
    panel.failure = ZeroDivisionError("by zero")
    desk.change(number=3)
    assert desk.wait(ENOUGH_S)
    ((title, body),) = client.notes
    assert title == "Something failed: ZeroDivisionError: by zero."
    assert "another frame" in body
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


def test_a_desk_looks_at_what_it_shows_until_it_is_closed(
    view: View, small_scene: Path, client: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = Library([small_scene], [])
    seen: list[object] = []
    monkeypatch.setattr(library, "leave", seen.append)
    own = library.open
    monkeypatch.setattr(
        library, "open", lambda v, seen_by=None: (seen.append(seen_by), own(v, seen_by))[1]
    )
    other = Desk(client, library, view)  # type: ignore[arg-type]  # as far as it is needed
    other.refresh()
    assert other.wait(ENOUGH_S)
    assert set(seen) == {other}
    seen.clear()
    other.close()
    assert seen == [other]
    library.close()


def test_a_desk_that_is_closed_while_its_recording_opens_looks_at_nothing(
    view: View, small_scene: Path, client: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scanloom.client_session._PARTING_S", 0.0)
    library = Library([small_scene], [])
    opening, go_on, left = threading.Event(), threading.Event(), threading.Event()
    own_open, own_leave = library.open, library.leave

    def slow(asked: View, seen_by: object = None) -> Opened:
        opening.set()
        assert go_on.wait(ENOUGH_S)
        return own_open(asked, seen_by)

    def leave(seen_by: object) -> None:
        own_leave(seen_by)
        if go_on.is_set():
            left.set()

    monkeypatch.setattr(library, "open", slow)
    monkeypatch.setattr(library, "leave", leave)
    desk = Desk(client, library, view)  # type: ignore[arg-type]  # as far as it is needed
    desk.refresh()
    assert opening.wait(ENOUGH_S)
    desk.close()
    go_on.set()
    assert left.wait(ENOUGH_S)
    assert desk.shown is None
    library.close()


@pytest.mark.parametrize(
    ("error", "title", "body"),
    [
        (AlignmentFailed("no peak.", advice="Look elsewhere."), "no peak.", "Look elsewhere."),
        (KeyError("row"), "Something failed: KeyError: 'row'.", "Go to another frame"),
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

    monkeypatch.setattr("scanloom.state.opened.align_session", fail)
    library = Library([small_scene], [])
    opened = library.open(View(recording=small_scene.name))
    desk = Desk(client, library, View(recording=small_scene.name))  # type: ignore[arg-type]  # as far as it is needed
    desk.panels = [panel]
    failed = threading.Event()
    opened.align(lambda: failed.set() if opened.failure is not None else None)
    assert failed.wait(ENOUGH_S)
    desk.refresh()
    shown = shown_by(desk)
    assert (shown.opened, shown.chain) == (opened, None)
    ((said, then),) = client.notes
    assert said == title
    assert then.startswith(body)
    desk.close()
    library.close()


def test_a_recording_that_is_cut_while_it_is_open_is_told_so(
    tmp_path: Path, client: Told, panel: Recorder
) -> None:
    path = tmp_path / "room.mcap"
    # Longer than what is read ahead.
    shutil.copyfile(sample_path(), path)
    library = Library([path], [])
    view = View(recording=path.name)
    # It stays open, and there is nothing to be aligned yet.
    library.open(view, seen_by="the test")
    os.truncate(path, path.stat().st_size // 2)
    desk = Desk(client, library, view)  # type: ignore[arg-type]  # as far as it is needed
    desk.panels = [panel]
    desk.refresh()
    panel.until(lambda shown: shown.failure is not None)
    ((title, advice),) = client.notes
    assert title == "room.mcap: has become shorter since it was opened."
    assert advice == "Reload the page: it is then opened again, as it is now."
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
    for number in (last, last + 1, 2**31 - 1):
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


def test_a_stage_that_fails_on_one_frame_leaves_what_came_before_it(
    desk: Desk, client: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(match: FrameMatch, *_: Any) -> None:
        raise ZeroDivisionError("in the classes")

    with monkeypatch.context() as patched:
        patched.setattr("fusion_core.workflows.fuse.live.judge_frame", fail)
        # No other test has judged it so.
        desk.change(number=5)
        desk.set("noise", "epsilon", 3.21)
        shown = shown_by(desk)
    assert shown.view.number == 5
    assert shown.paired is not None
    assert shown.match is not None
    assert shown.fused is None
    assert shown.color is not None
    title, body = client.notes[-1]
    assert title == "Something failed: ZeroDivisionError: in the classes."
    assert "another frame" in body
    desk.change(number=6)
    assert shown_by(desk).fused is not None
    desk.change(number=5)
    assert shown_by(desk).fused is not None


def test_a_colour_image_that_cannot_be_read_hides_no_frame(
    desk: Desk, client: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = shown_by(desk).opened.frames

    def fail(number: int) -> None:
        raise RecordingError("/color: message 7 is damaged.", advice="Record it again.")

    monkeypatch.setattr(frames, "color", fail)
    desk.change(number=7)
    shown = shown_by(desk)
    assert shown.fused is not None
    assert shown.color is None
    assert client.notes == [("/color: message 7 is damaged.", "Record it again.")]


def test_while_a_recording_is_aligned_its_streams_are_shown(library: Library, view: View) -> None:
    waiting = Opened(library.open(view).session)
    shown = shown_of(view, waiting)
    assert (shown.chain, shown.match, shown.failure) == (None, None, None)
    assert shown.opened is waiting
