"""A client session without a browser: the view, its results, and what is reported."""

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
from fusion_core.workflows.fuse.cached_chain import FrameChoice
from fusion_core.workflows.fuse.frame_match import FrameMatch
from fusion_core.workflows.fuse.settings import PRESETS
from scanloom.client_session import STORED_VIEW, ClientSession
from scanloom.frame_view import FrameView, compute_frame_view
from scanloom.page_parts import Panel
from scanloom.resources import sample_path
from scanloom.state import open_recording as open_recording_module
from scanloom.state.library import Library
from scanloom.state.open_recording import OpenRecording
from scanloom.state.view import View, view_of_link
from tests.patience import ENOUGH_S


class FakeClient:
    """A client as far as a session needs one: it keeps notifications and stored items."""

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


class Recorder(Panel):
    """A panel that keeps what it was shown, and fails where it is asked to."""

    def __init__(self) -> None:
        self.frame_view: list[FrameView] = []
        self.failure: Exception | None = None
        self._changed = threading.Condition()

    def show(self, frame_view: FrameView) -> None:
        if self.failure is not None:
            raise self.failure
        with self._changed:
            self.frame_view.append(frame_view)
            self._changed.notify_all()

    def until(self, condition: Callable[[FrameView], bool]) -> FrameView:
        """Wait until what was shown last fits: an alignment ends when it will."""
        with self._changed:
            assert self._changed.wait_for(
                lambda: bool(self.frame_view) and condition(self.frame_view[-1]), ENOUGH_S
            )
            return self.frame_view[-1]


def aligned(library: Library, view: View) -> OpenRecording:
    """The recording of a view, once its alignment has ended."""
    open_recording = library.open(view)
    ended = threading.Event()

    def hear() -> None:
        if open_recording.chain is not None or open_recording.failure is not None:
            ended.set()

    open_recording.align(hear)
    hear()
    assert ended.wait(ENOUGH_S)
    open_recording.remove_listener(hear)
    return open_recording


@pytest.fixture(scope="module")
def library(small_scene: Path) -> Iterator[Library]:
    shared = Library([small_scene], [])
    yield shared
    shared.close()


@pytest.fixture(scope="module")
def view(library: Library, small_scene: Path) -> View:
    first = View(recording=small_scene.name)
    # Seen by somebody all the time, it stays open.
    library.open(first, viewer="the tests")
    aligned(library, first)
    return first


@pytest.fixture
def client() -> FakeClient:
    return FakeClient()


@pytest.fixture
def panel() -> Recorder:
    return Recorder()


@pytest.fixture
def session(
    library: Library, view: View, client: FakeClient, panel: Recorder
) -> Iterator[ClientSession]:
    """A session that shows its first view."""
    made = ClientSession(client, library, view)  # type: ignore[arg-type]  # as far as it is needed
    made.panels = [panel]
    made.refresh()
    assert made.wait(ENOUGH_S)
    yield made
    made.close()


def shown_by(session: ClientSession) -> FrameView:
    """What the session shows of its latest view."""
    assert session.wait(ENOUGH_S)
    assert session.frame_view is not None
    return session.frame_view


def frames_of(session: ClientSession) -> int:
    return len(shown_by(session).open_recording.frames)


# The session


def test_a_session_shows_its_first_view_and_has_the_browser_keep_it(
    session: ClientSession, view: View, client: FakeClient, panel: Recorder
) -> None:
    assert [frame_view.view for frame_view in panel.frame_view] == [view]
    assert panel.frame_view[0].fused is not None
    assert view_of_link(client.stored[STORED_VIEW]) == view
    assert client.notes == []


def test_nothing_is_shown_before_all_panels_are_there(
    library: Library, view: View, client: FakeClient, panel: Recorder
) -> None:
    """A page takes clicks before it is built whole."""
    session = ClientSession(client, library, view)  # type: ignore[arg-type]  # as far as it is needed
    with session.building():
        session.change(panel="Review")
        assert not session.wait(1.0)
        session.panels = [panel]
    shown_by(session)
    assert panel.frame_view[-1].view.panel == "Review"
    session.close()


def test_frames_are_shown_as_recorded_until_the_recording_is_aligned(
    small_scene: Path, view: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A person steps through them meanwhile, and a report of progress changes the bar alone."""
    goes_on, is_counting = threading.Event(), threading.Event()

    def align_later(fuse_session: Any, progress: Any, stamps: Any) -> Any:
        progress(1, 2, "searching")
        is_counting.set()
        assert goes_on.wait(ENOUGH_S)
        progress(2, 2, "searching")
        return align_recording(fuse_session, progress, stamps)

    align_recording = open_recording_module.align_recording
    monkeypatch.setattr(open_recording_module, "align_recording", align_later)
    own = Library([small_scene], [])
    panel = Recorder()
    session = ClientSession(FakeClient(), own, view)  # type: ignore[arg-type]  # as far as it is needed
    session.panels = [panel]
    session.refresh()
    for number in (0, 3, 1):
        session.change(frame_index=number)
        shown = panel.until(
            lambda frame_view, number=number: frame_view.view.frame_index == number  # type: ignore[misc]  # bound now
        )
        assert shown.chain is None
        assert shown.raw is not None
        assert shown.raw.stamp_ns == shown.open_recording.frames.image(number).stamp_ns
    assert is_counting.wait(ENOUGH_S)
    assert session.wait(ENOUGH_S)
    shows = len(panel.frame_view)
    session._hear_of_alignment()
    assert session.wait(ENOUGH_S)
    assert len(panel.frame_view) == shows
    # Asked to, it shows all again: a widget may hold a refused value.
    session.refresh()
    assert session.wait(ENOUGH_S)
    assert len(panel.frame_view) == shows + 1
    goes_on.set()
    aligned_view = panel.until(lambda frame_view: frame_view.chain is not None)
    assert aligned_view.raw is None
    assert aligned_view.view.frame_index == 1
    session.close()
    own.close()


def test_the_alignment_waits_for_the_browser_to_draw(small_scene: Path, view: View) -> None:
    started: list[Callable[[], None]] = []
    own = Library([small_scene], [])
    panel = Recorder()
    session = ClientSession(FakeClient(), own, view, after_drawing=started.append)  # type: ignore[arg-type]  # as far as it is needed
    session.panels = [panel]
    session.refresh()
    assert session.wait(ENOUGH_S)
    session.change(frame_index=2)
    shown = shown_by(session)
    assert shown.raw is not None
    assert len(started) == 1
    # What another browser has aligned in the meantime is shown as well.
    assert aligned(own, view) is shown.open_recording
    started[0]()
    panel.until(lambda frame_view: frame_view.chain is not None)
    session.close()
    own.close()


def test_of_many_changes_the_last_is_shown_and_kept(
    session: ClientSession, client: FakeClient, panel: Recorder
) -> None:
    for tenths in range(1, 41):
        session.change_setting("noise", "epsilon", tenths / 10)
    frame_view = shown_by(session)
    assert frame_view.view.settings.noise.epsilon == 4.0
    assert panel.frame_view[-1] is frame_view
    assert view_of_link(client.stored[STORED_VIEW]) == session.view == frame_view.view
    assert [s.view.settings.noise.epsilon for s in panel.frame_view[1:]] == sorted(
        {s.view.settings.noise.epsilon for s in panel.frame_view[1:]}
    )


def test_epsilon_decides_what_is_shown(session: ClientSession) -> None:
    found = []
    for epsilon in (0.5, 10.0):
        session.change_setting("noise", "epsilon", epsilon)
        fused = shown_by(session).fused
        assert fused is not None
        found.append(np.count_nonzero(fused.classes.lidar_class))
    assert found[0] > found[1]


def test_a_refused_value_is_reported_each_time_and_the_view_stays(
    session: ClientSession, view: View, client: FakeClient, panel: Recorder
) -> None:
    for count in (1, 2):
        before = len(panel.frame_view)
        session.change_setting("noise", "epsilon", -1.0)
        assert session.view == view
        assert len(client.notes) == count
        # The widget that holds the refused value is set back.
        shown_by(session)
        assert len(panel.frame_view) > before
    title, body = client.notes[0]
    assert title.startswith("noise.epsilon: ")
    assert body == "The value before is kept."
    session.undo()
    assert session.view == view


def test_one_history_of_settings_frames_and_steps(session: ClientSession, view: View) -> None:
    session.change_setting("noise", "epsilon", 2.0)
    session.change(frame_index=7)
    session.change(panel="Repair")
    # Pointing and showing are no changes.
    session.change(selected_beam=12, playback_speed=2.0)
    session.change_setting("noise", "support_sigma", 3.0)
    after = session.view
    pointed = view.changed(selected_beam=12, playback_speed=2.0)
    was = [
        pointed.with_setting("noise", "epsilon", 2.0).changed(frame_index=7, panel="Repair"),
        pointed.with_setting("noise", "epsilon", 2.0).changed(frame_index=7),
        pointed.with_setting("noise", "epsilon", 2.0),
        pointed,
    ]
    for expected in was:
        session.undo()
        assert session.view == expected
    session.undo()
    assert session.view == pointed
    for expected in [*was[-2::-1], after, after]:
        session.redo()
        assert session.view == expected


def test_frames_that_pass_are_undone_at_once(session: ClientSession, view: View) -> None:
    for _ in range(3):
        session.step(1)
    session.change(frame_index=9)
    session.step(1)
    for expected in (9, 3, 0):
        session.undo()
        assert session.view == view.changed(frame_index=expected)


def test_one_drag_of_a_slider_is_undone_at_once(session: ClientSession, view: View) -> None:
    for epsilon in (2.0, 2.5, 3.0):
        session.change_setting("noise", "epsilon", epsilon)
    session.undo()
    assert session.view == view


def test_undo_of_a_preset_brings_its_alignment_back_too(session: ClientSession, view: View) -> None:
    own = shown_by(session).open_recording
    session.apply_preset("published")
    assert session.view.settings == session.view.alignment_settings == PRESETS["published"]
    assert shown_by(session).open_recording is not own
    session.undo()
    assert session.view == view
    assert shown_by(session).open_recording is own
    session.redo()
    assert session.view.alignment_settings == PRESETS["published"]


def test_another_alignment_is_undone_before_the_setting_that_asked_for_it(
    session: ClientSession, view: View
) -> None:
    session.change_setting("search", "min_overlap", 0.6)
    session.align_again()
    assert not session.view.needs_alignment()
    session.undo()
    assert session.view == view.with_setting("search", "min_overlap", 0.6)
    session.undo()
    assert session.view == view


def test_a_place_picked_by_hand_is_that_of_its_frame_unless_locked(session: ClientSession) -> None:
    session.change(picked_offset=(80.0, 40.0))
    session.change(panel="Match")
    assert session.view.picked_offset == (80.0, 40.0)
    session.step(1)
    assert session.view.picked_offset is None
    session.change(picked_offset=(80.0, 40.0), lock_picked_offset=True)
    session.step(1)
    assert session.view.picked_offset == (80.0, 40.0)


@pytest.mark.parametrize(
    ("loop", "start", "by", "end"),
    [(True, 0, -1, -1), (True, -1, 1, 0), (False, 0, -1, 0), (False, -1, 1, -1), (True, 3, 2, 5)],
)
def test_a_step_comes_in_again_from_the_other_end_or_stops(
    session: ClientSession, loop: bool, start: int, by: int, end: int
) -> None:
    count = frames_of(session)
    session.change(loop_playback=loop, frame_index=start % count)
    session.step(by)
    assert session.view.frame_index == end % count


def test_a_failure_is_reported_once_until_it_is_over(
    session: ClientSession, client: FakeClient, panel: Recorder
) -> None:
    # No scan lies so near that it would not be too far.
    session.change_setting("time", "max_gap_ms", 0.001)
    session.align_again()
    failure = panel.until(lambda frame_view: frame_view.failure is not None).failure
    assert failure is not None
    for _ in range(3):
        session.refresh()
        assert session.wait(ENOUGH_S)
    assert [title for title, _ in client.notes] == [failure.problem]
    session.undo()
    panel.until(lambda frame_view: frame_view.fused is not None)


def test_a_panel_that_fails_is_reported_and_the_session_goes_on(
    session: ClientSession, client: FakeClient, panel: Recorder
) -> None:
    panel.failure = ZeroDivisionError("by zero")
    session.change(frame_index=3)
    assert session.wait(ENOUGH_S)
    ((title, body),) = client.notes
    assert title == "Something failed: ZeroDivisionError: by zero."
    assert "another frame" in body
    panel.failure = None
    session.change(frame_index=4)
    assert shown_by(session).view.frame_index == panel.frame_view[-1].view.frame_index == 4


def test_a_recording_that_is_none_is_reported_and_the_session_goes_on(
    session: ClientSession, client: FakeClient
) -> None:
    session.change(lidar_topic="/none")
    assert session.wait(ENOUGH_S)
    assert "'/none'" in client.notes[0][0]
    session.change(lidar_topic=None, frame_index=2)
    assert shown_by(session).view.frame_index == 2


def test_a_closed_session_shows_nothing_any_more(session: ClientSession, panel: Recorder) -> None:
    before = len(panel.frame_view)
    session.close()
    session.change(frame_index=5)
    assert session.wait(ENOUGH_S)
    assert len(panel.frame_view) == before


def test_a_session_looks_at_what_it_shows_until_it_is_closed(
    view: View, small_scene: Path, client: FakeClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = Library([small_scene], [])
    seen: list[object] = []
    monkeypatch.setattr(library, "release", seen.append)
    own = library.open
    monkeypatch.setattr(
        library, "open", lambda v, viewer=None: (seen.append(viewer), own(v, viewer))[1]
    )
    other = ClientSession(client, library, view)  # type: ignore[arg-type]  # as far as it is needed
    other.refresh()
    assert other.wait(ENOUGH_S)
    assert set(seen) == {other}
    seen.clear()
    other.close()
    assert seen == [other]
    library.close()


def test_a_session_that_is_closed_while_its_recording_opens_looks_at_nothing(
    view: View, small_scene: Path, client: FakeClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scanloom.client_session._CLOSE_TIMEOUT_S", 0.0)
    library = Library([small_scene], [])
    opening, go_on, left = threading.Event(), threading.Event(), threading.Event()
    own_open, own_leave = library.open, library.release

    def slow(asked: View, viewer: object = None) -> OpenRecording:
        opening.set()
        assert go_on.wait(ENOUGH_S)
        return own_open(asked, viewer)

    def release(viewer: object) -> None:
        own_leave(viewer)
        if go_on.is_set():
            left.set()

    monkeypatch.setattr(library, "open", slow)
    monkeypatch.setattr(library, "release", release)
    session = ClientSession(client, library, view)  # type: ignore[arg-type]  # as far as it is needed
    session.refresh()
    assert opening.wait(ENOUGH_S)
    session.close()
    go_on.set()
    assert left.wait(ENOUGH_S)
    assert session.frame_view is None
    library.close()


@pytest.mark.parametrize(
    ("error", "title", "body"),
    [
        (AlignmentFailed("no peak.", advice="Look elsewhere."), "no peak.", "Look elsewhere."),
        (KeyError("row"), "Something failed: KeyError: 'row'.", "Go to another frame"),
    ],
)
def test_an_alignment_that_fails_is_reported_and_the_streams_are_shown(
    small_scene: Path,
    client: FakeClient,
    panel: Recorder,
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
    title: str,
    body: str,
) -> None:
    def fail(*_: Any) -> None:
        raise error

    monkeypatch.setattr("scanloom.state.open_recording.align_recording", fail)
    library = Library([small_scene], [])
    open_recording = library.open(View(recording=small_scene.name))
    session = ClientSession(client, library, View(recording=small_scene.name))  # type: ignore[arg-type]  # as far as it is needed
    session.panels = [panel]
    failed = threading.Event()
    open_recording.align(lambda: failed.set() if open_recording.failure is not None else None)
    assert failed.wait(ENOUGH_S)
    session.refresh()
    frame_view = shown_by(session)
    assert (frame_view.open_recording, frame_view.chain) == (open_recording, None)
    ((said, then),) = client.notes
    assert said == title
    assert then.startswith(body)
    session.close()
    library.close()


def test_a_recording_that_is_cut_while_it_is_open_is_reported(
    tmp_path: Path, client: FakeClient, panel: Recorder
) -> None:
    path = tmp_path / "room.mcap"
    # Longer than what is read ahead.
    shutil.copyfile(sample_path(), path)
    library = Library([path], [])
    view = View(recording=path.name)
    # It stays open, and there is nothing to be aligned yet.
    library.open(view, viewer="the test")
    os.truncate(path, path.stat().st_size // 2)
    session = ClientSession(client, library, view)  # type: ignore[arg-type]  # as far as it is needed
    session.panels = [panel]
    session.refresh()
    panel.until(lambda frame_view: frame_view.failure is not None)
    ((title, advice),) = client.notes
    assert title == "room.mcap: has become shorter since it was opened."
    assert advice == "Reload the page: it is then opened again, as it is now."
    session.close()
    library.close()


# What is shown


def test_what_is_shown_is_what_the_chain_computes(library: Library, view: View) -> None:
    open_recording = library.open(view)
    assert open_recording.chain is not None
    frame_view = compute_frame_view(view.changed(frame_index=9), open_recording)
    choice = FrameChoice(number=9)
    assert frame_view.match is open_recording.chain.match(choice, view.settings)
    assert frame_view.fused is open_recording.chain.fused(choice, view.settings)
    assert frame_view.color is not None
    assert frame_view.failure is None


def test_a_frame_beyond_the_last_is_the_last(library: Library, view: View) -> None:
    open_recording = library.open(view)
    last = len(open_recording.frames) - 1
    for number in (last, last + 1, 2**31 - 1):
        frame_view = compute_frame_view(view.changed(frame_index=number), open_recording)
        assert frame_view.view.frame_index == last
        assert frame_view.paired is not None
        assert frame_view.paired.image.stamp_ns == open_recording.frames.image(last).stamp_ns


def test_the_clock_offset_is_the_mounts_and_only_where_asked_for(
    library: Library, view: View
) -> None:
    open_recording = library.open(view)
    chain = open_recording.chain
    assert chain is not None
    late = OpenRecording(open_recording.opened)
    late.chain = type(chain)(
        open_recording.fuse_session,
        open_recording.frames,
        replace(chain.alignment, mount=replace(chain.alignment.mount, clock_offset_ms=30.0)),
    )
    gaps_ns = []
    for applied in (False, True):
        paired = compute_frame_view(
            view.changed(frame_index=9, apply_clock_offset=applied), late
        ).paired
        assert paired is not None
        assert paired.window is not None
        gaps_ns.append((paired.gap_ns, paired.window.scan.stamp_ns))
    assert sum(gaps_ns[0]) - sum(gaps_ns[1]) == 30_000_000


@pytest.mark.parametrize("preset", ["default", "published"])
def test_a_picked_row_that_the_image_lacks_is_a_failure_as_text(
    library: Library, view: View, preset: str
) -> None:
    open_recording = library.open(view)
    asked = view.changed(preset=preset, settings=PRESETS[preset])  # type: ignore[index]  # one of the two
    rows = open_recording.frames.image(0).depth_m.shape[0]
    inside = compute_frame_view(asked.changed(picked_offset=(80.0, rows - 1.0)), open_recording)
    assert inside.match is not None
    assert set(inside.match.correspondence.row.tolist()) == {rows - 1}
    outside = compute_frame_view(asked.changed(picked_offset=(80.0, float(rows))), open_recording)
    assert outside.match is None
    assert outside.paired is not None
    assert isinstance(outside.failure, AlignmentFailed)
    assert f"v = {rows}" in outside.failure.problem


def test_a_stage_that_fails_on_one_frame_leaves_what_came_before_it(
    session: ClientSession, client: FakeClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(match: FrameMatch, *_: Any) -> None:
        raise ZeroDivisionError("in the classes")

    with monkeypatch.context() as patched:
        patched.setattr("fusion_core.workflows.fuse.cached_chain.classify_and_repair", fail)
        # With settings of no other test, so that nothing is cached.
        session.change(frame_index=5)
        session.change_setting("noise", "epsilon", 3.21)
        frame_view = shown_by(session)
    assert frame_view.view.frame_index == 5
    assert frame_view.paired is not None
    assert frame_view.match is not None
    assert frame_view.fused is None
    assert frame_view.color is not None
    title, body = client.notes[-1]
    assert title == "Something failed: ZeroDivisionError: in the classes."
    assert "another frame" in body
    session.change(frame_index=6)
    assert shown_by(session).fused is not None
    session.change(frame_index=5)
    assert shown_by(session).fused is not None


def test_a_colour_image_that_cannot_be_read_hides_no_frame(
    session: ClientSession, client: FakeClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = shown_by(session).open_recording.frames

    def fail(number: int) -> None:
        raise RecordingError("/color: message 7 is damaged.", advice="Record it again.")

    monkeypatch.setattr(frames, "color", fail)
    session.change(frame_index=7)
    frame_view = shown_by(session)
    assert frame_view.fused is not None
    assert frame_view.color is None
    assert client.notes == [("/color: message 7 is damaged.", "Record it again.")]


def test_while_a_recording_is_aligned_its_streams_are_shown(library: Library, view: View) -> None:
    waiting = OpenRecording(library.open(view).opened)
    frame_view = compute_frame_view(view, waiting)
    assert (frame_view.chain, frame_view.match, frame_view.failure) == (None, None, None)
    assert frame_view.open_recording is waiting
