"""What all browsers share: opened once, aligned once, and closed when it has no viewer."""

import os
import random
import shutil
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from fusion_core.model.errors import MissingStream, RecordingError
from fusion_core.model.recording import Recording
from fusion_core.workflows.fuse.settings import PRESETS
from scanloom.resources import sample_path
from scanloom.state import library as library_module
from scanloom.state.file_stamp import FileStamp
from scanloom.state.library import Library
from scanloom.state.open_recording import OpenRecording
from scanloom.state.view import View
from tests.hostile.names import NO_UTF8, SHOWN
from tests.patience import ENOUGH_S

UNSEEN = library_module._MAX_UNVIEWED
LIDAR = "/scan"


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory, small_scene: Path) -> list[Path]:
    """More recordings than are kept."""
    folder = tmp_path_factory.mktemp("rooms")
    paths = [folder / f"{number}.mcap" for number in range(UNSEEN + 3)]
    for path in paths:
        shutil.copyfile(small_scene, path)
    return paths


@pytest.fixture
def views(rooms: list[Path]) -> list[View]:
    return [View(recording=path.name) for path in rooms]


@pytest.fixture
def library(rooms: list[Path]) -> Iterator[Library]:
    shared = Library(rooms, [])
    yield shared
    shared.close()


@pytest.fixture
def view(views: list[View]) -> View:
    return views[0]


def is_open(recording: Recording) -> bool:
    try:
        recording.read(LIDAR, 0)
    except RecordingError as error:
        if "is closed" not in error.problem:
            raise
        return False
    return True


def open_of(every: list[OpenRecording]) -> list[bool]:
    """Which of these can still be read from."""
    return [is_open(opened.fuse_session.recording) for opened in every]


# Names


def test_names_that_are_no_utf8_are_shown_and_opened(small_scene: Path, tmp_path: Path) -> None:
    path = tmp_path / NO_UTF8
    shutil.copyfile(small_scene, path)
    given = Library([path], [])
    assert list(given.named()) == [SHOWN]
    for shared in (given, Library([], [tmp_path])):
        assert shared.open(View(recording=SHOWN)).fuse_session.recording.path == path
        with pytest.raises(RecordingError):
            shared.path(f"{SHOWN}x")
        shared.close()


# Shared


def test_people_share_a_recording_and_its_alignment(library: Library, view: View) -> None:
    opened = library.open(view)
    elsewhere = view.changed(frame_index=5, panel="Map").with_setting("noise", "epsilon", 2.0)
    assert library.open(elsewhere) is opened
    other = library.open(view.changed(virtual_row=60))
    assert other is not opened
    assert other.fuse_session.recording is opened.fuse_session.recording
    published = view.changed(settings=PRESETS["published"])
    assert library.open(published) is opened
    assert library.open(published.changed(alignment_settings=PRESETS["published"])) is not opened


def test_all_viewers_are_notified_of_an_alignment_until_they_leave(small_scene: Path) -> None:
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
        opened.remove_listener(leave)

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

    def endless(_: object, progress: Callable[..., None], *_more: object) -> None:
        try:
            while True:
                began.set()
                progress(0, None, "aligning")
        finally:
            stopped.set()

    monkeypatch.setattr("scanloom.state.open_recording.align_recording", endless)
    library = Library([small_scene], [])
    library.open(View(recording=small_scene.name)).align(lambda: None)
    assert began.wait(ENOUGH_S)
    library.close()
    assert stopped.is_set()


@pytest.fixture
def shelves(tmp_path: Path, small_scene: Path) -> Library:
    """A library with one root, and files beside it that may not be opened."""
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
    assert list(shelves.named()) == [small_scene.name]
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
        ".hidden.mcap",
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
    assert list(library.named()) == [str(path) for path in paths]
    assert [library.path(name) for name in library.named()] == paths


def test_a_topic_that_is_not_there_is_refused(library: Library, view: View) -> None:
    with pytest.raises(MissingStream, match="no topic '/none'"):
        library.open(view.changed(depth_topics=("/none",)))


# Closed when nobody looks at it


def test_the_last_few_recordings_without_viewers_stay_open(
    library: Library, views: list[View]
) -> None:
    every = [library.open(view) for view in views]
    older = len(views) - UNSEEN
    assert open_of(every) == [False] * older + [True] * UNSEEN
    for view, opened in zip(views[older:], every[older:], strict=True):
        assert library.open(view) is opened
    # Asked for again, it is opened again.
    again = library.open(views[0])
    assert again is not every[0]
    assert open_of([again]) == [True]


def test_what_is_asked_for_again_is_kept_longer(library: Library, views: list[View]) -> None:
    every = [library.open(view) for view in views[:UNSEEN]]
    library.open(views[0])
    library.open(views[UNSEEN])
    assert open_of(every) == [True, False, *[True] * (UNSEEN - 2)]


def test_a_recording_stays_open_while_it_has_viewers(library: Library, views: list[View]) -> None:
    seen = library.open(views[0], viewer="ann")
    assert library.open(views[0], viewer="ben") is seen
    for view in views[1:]:
        library.open(view)
    library.release("ben")
    assert open_of([seen]) == [True]
    assert library.open(views[0]) is seen
    for view in views[1:]:
        library.open(view)
    library.release("ann")
    assert open_of([seen]) == [False]
    library.release("nobody")


def test_a_viewer_who_opens_another_recording_leaves_the_first(
    library: Library, views: list[View]
) -> None:
    every = [library.open(view, viewer="ann") for view in views]
    older = len(views) - 1 - UNSEEN
    assert open_of(every) == [False] * older + [True] * (UNSEEN + 1)


def test_a_viewer_who_cannot_open_another_keeps_the_first(
    library: Library, views: list[View]
) -> None:
    seen = library.open(views[0], viewer="ann")
    with pytest.raises(MissingStream):
        library.open(views[0].changed(lidar_topic="/none"), viewer="ann")
    for view in views[1:]:
        library.open(view)
    assert open_of([seen]) == [True]


def test_a_file_stays_open_as_long_as_one_of_its_choices(
    library: Library, views: list[View]
) -> None:
    first = library.open(views[0])
    second = library.open(views[0].changed(virtual_row=60), viewer="ann")
    for view in views[1:]:
        library.open(view)
    assert first.fuse_session.recording is second.fuse_session.recording
    assert open_of([second]) == [True]
    assert library.open(views[0]) is not first
    library.release("ann")
    for view in views[1:]:
        library.open(view)
    assert open_of([second]) == [False]


def test_what_is_closed_stops_to_be_aligned(
    library: Library, views: list[View], monkeypatch: pytest.MonkeyPatch
) -> None:
    began, stopped = threading.Event(), threading.Event()

    def endless(_: object, progress: Callable[..., None], *_more: object) -> None:
        try:
            while True:
                began.set()
                progress(0, None, "aligning")
        finally:
            stopped.set()

    monkeypatch.setattr("scanloom.state.open_recording.align_recording", endless)
    library.open(views[0]).align(lambda: None)
    assert began.wait(ENOUGH_S)
    for view in views[1 : UNSEEN + 1]:
        library.open(view)
    assert stopped.wait(ENOUGH_S)


class Sources:
    """Keeps every recording that is opened."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.opened: list[Recording] = []
        self._open = library_module.open_source
        monkeypatch.setattr(library_module, "open_source", self)

    def __call__(self, *args: Any) -> Recording:
        recording = self._open(*args)
        self.opened.append(recording)
        return recording


def test_a_recording_that_cannot_be_used_is_closed(
    library: Library, view: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources = Sources(monkeypatch)
    with pytest.raises(MissingStream):
        library.open(view.changed(lidar_topic="/none"))
    assert [is_open(recording) for recording in sources.opened] == [False]


# Several at a time


class Gate:
    """Replaces ``open_recorded_streams``: lets nobody through a recording's gate before it is
    opened."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        self.reached, self.go_on = threading.Event(), threading.Event()
        self.calls = 0
        self._name = name
        self._open = library_module.open_recorded_streams
        monkeypatch.setattr(library_module, "open_recorded_streams", self)

    def __call__(self, recording: Recording, *args: Any) -> Any:
        if recording.path.name == self._name:
            self.calls += 1
            self.reached.set()
            assert self.go_on.wait(ENOUGH_S)
        return self._open(recording, *args)


def opening(library: Library, view: View, into: list[Any]) -> threading.Thread:
    """Open in a thread of its own; what came of it goes into the list."""

    def work() -> None:
        try:
            into.append(library.open(view))
        except Exception as error:  # noqa: BLE001  # told by the test
            into.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    return thread


def test_two_simultaneous_requests_open_one_recording(
    library: Library, views: list[View], monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch, views[0].recording)
    found: list[Any] = []
    threads = [opening(library, views[0], found) for _ in range(3)]
    assert gate.reached.wait(ENOUGH_S)
    # Others need not wait until it is open.
    assert open_of([library.open(views[1])]) == [True]
    gate.go_on.set()
    for thread in threads:
        thread.join(ENOUGH_S)
    assert gate.calls == 1
    assert len(found) == 3
    assert found[0] is found[1] is found[2]


def test_a_file_that_is_being_opened_is_not_closed_by_others(
    library: Library, views: list[View], monkeypatch: pytest.MonkeyPatch
) -> None:
    library.open(views[0])
    gate = Gate(monkeypatch, views[0].recording)
    found: list[Any] = []
    thread = opening(library, views[0].changed(virtual_row=60), found)
    assert gate.reached.wait(ENOUGH_S)
    for view in views[1:]:
        library.open(view)
    gate.go_on.set()
    thread.join(ENOUGH_S)
    assert open_of(found) == [True]


def test_what_is_opened_while_the_library_closes_is_closed(
    library: Library, view: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources = Sources(monkeypatch)
    gate = Gate(monkeypatch, view.recording)
    found: list[Any] = []
    thread = opening(library, view, found)
    assert gate.reached.wait(ENOUGH_S)
    library.close()
    gate.go_on.set()
    thread.join(ENOUGH_S)
    assert isinstance(found[0], RecordingError)
    assert [is_open(recording) for recording in sources.opened] == [False]


def test_recordings_of_many_viewers_stay_open(
    library: Library, views: list[View], monkeypatch: pytest.MonkeyPatch
) -> None:
    sources = Sources(monkeypatch)
    every = [view.changed(virtual_row=row) for view in views for row in (None, 50, 60)]
    problems: list[str] = []

    def come_and_go(seed: int) -> None:
        chosen = random.Random(seed)
        for _ in range(60):
            view = chosen.choice(every)
            try:
                opened = library.open(view, viewer=seed)
                if not is_open(opened.fuse_session.recording):
                    problems.append(f"{view.recording} is closed")
                if opened.fuse_session.virtual_row != view.virtual_row:
                    problems.append(f"{view.recording} is another")
                if chosen.random() < 0.2:
                    library.release(seed)
            except Exception as error:  # noqa: BLE001  # told by the test
                problems.append(repr(error))
        library.release(seed)

    threads = [threading.Thread(target=come_and_go, args=(seed,)) for seed in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(ENOUGH_S)
    assert problems == []
    assert 0 < sum(is_open(recording) for recording in sources.opened) <= UNSEEN
    library.close()
    assert not any(is_open(recording) for recording in sources.opened)


# An alignment lives as long as somebody wants it


class Endless:
    """Replaces ``align_session``: aligns until it is stopped. Counts those at work."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.changed = threading.Condition()
        self.at_work: list[Any] = []
        self.ended: list[Any] = []
        monkeypatch.setattr("scanloom.state.open_recording.align_recording", self)

    def __call__(self, session: Any, progress: Callable[..., None], *_: object) -> None:
        with self.changed:
            self.at_work.append(session)
            self.changed.notify_all()
        pause = threading.Event()
        try:
            while True:
                progress(0, None, "aligning")
                pause.wait(0.01)
        finally:
            with self.changed:
                self.at_work.remove(session)
                self.ended.append(session)
                self.changed.notify_all()

    def until(self, condition: Callable[[], bool]) -> None:
        with self.changed:
            assert self.changed.wait_for(condition, ENOUGH_S)


def test_an_alignment_ends_with_the_last_who_waits_for_it(
    library: Library, view: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless = Endless(monkeypatch)
    for person in ("ann", "ben"):
        library.open(view, viewer=person).align(lambda: None)
    opened = library.open(view)
    endless.until(lambda: len(endless.at_work) == 1)
    library.release("ann")
    assert library.open(view) is opened
    assert endless.ended == []
    library.release("ben")
    endless.until(lambda: endless.ended == [opened.fuse_session])
    # Who comes now has it aligned again.
    again = library.open(view, viewer="ann")
    assert again is not opened
    again.align(lambda: None)
    endless.until(lambda: len(endless.at_work) == 1)


def test_who_goes_on_to_another_view_ends_the_alignment_of_the_one_before(
    library: Library, view: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless = Endless(monkeypatch)
    first = library.open(view, viewer="ann")
    first.align(lambda: None)
    endless.until(lambda: len(endless.at_work) == 1)
    library.open(view.changed(virtual_row=60), viewer="ann")
    endless.until(lambda: endless.ended == [first.fuse_session])


def test_of_many_alignments_two_are_at_work_and_the_rest_wait(
    library: Library, view: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless = Endless(monkeypatch)
    waits = threading.Semaphore(0)
    every = []
    for row in range(50, 56):
        opened = library.open(view.changed(virtual_row=row), viewer=row)
        every.append(opened)
        opened.align(
            lambda one=opened: (  # type: ignore[misc]  # this one, not the last
                waits.release() if one.progress.what == "waiting for other alignments" else None
            )
        )
    for _ in range(4):
        assert waits.acquire(timeout=ENOUGH_S)
    assert set(map(id, endless.at_work)) == {id(one.fuse_session) for one in every[:2]}
    library.release(50)
    endless.until(lambda: any(session is every[2].fuse_session for session in endless.at_work))
    assert len(endless.at_work) == 2
    # One that waits goes without ever having begun.
    library.release(53)
    library.release(51)
    endless.until(lambda: any(session is every[4].fuse_session for session in endless.at_work))
    assert all(session is not every[3].fuse_session for session in endless.ended)


# Below a root


@pytest.fixture
def odd_root(tmp_path: Path) -> Path:
    """A root of recordings and of what is none."""
    root = tmp_path / "root"
    (root / ".hidden" / "deep").mkdir(parents=True)
    (root / "inner" / ".cache").mkdir(parents=True)
    for name in ("a.mcap", ".b.mcap", ".hidden/c.mcap", "inner/d.mcap", "inner/.cache/e.mcap"):
        (root / name).write_bytes(b"")
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "f.mcap").write_bytes(b"")
    (root / "to a").symlink_to(root / "a.mcap")
    (root / "to inner").symlink_to(root / "inner")
    (root / "to hidden").symlink_to(root / ".hidden")
    (root / "to c").symlink_to(root / ".hidden" / "c.mcap")
    (root / "to outside").symlink_to(tmp_path / "outside")
    (root / "to nothing").symlink_to(root / "none")
    (root / "loop").symlink_to(root / "loop")
    os.mkfifo(root / "pipe")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(root / "server"))
    return root


def test_what_leads_out_is_hidden_or_no_file_is_refused(odd_root: Path, small_scene: Path) -> None:
    library = Library([small_scene], [odd_root])
    for name in [path.name for path in odd_root.iterdir()]:
        if name in {"a.mcap", "inner", "to a", "to inner"}:
            assert library.path(name) == (odd_root / name).resolve()
        else:
            with pytest.raises(RecordingError, match="not among the recordings"):
                library.path(name)


@pytest.mark.parametrize(
    ("name", "leads_to"),
    [
        ("inner/d.mcap", "inner/d.mcap"),
        ("to inner/d.mcap", "inner/d.mcap"),
        (".hidden/c.mcap", None),
        ("inner/.cache/e.mcap", None),
        ("inner/../.hidden/c.mcap", None),
        ("to hidden/c.mcap", None),
        ("to outside/f.mcap", None),
        ("to inner/.cache/e.mcap", None),
    ],
)
def test_a_link_is_checked_by_where_it_leads(
    odd_root: Path, small_scene: Path, name: str, leads_to: str | None
) -> None:
    library = Library([small_scene], [odd_root])
    if leads_to is not None:
        assert library.path(name) == odd_root / leads_to
        return
    with pytest.raises(RecordingError, match="not among the recordings"):
        library.open(View(recording=name))


def test_a_root_takes_its_recordings_along(odd_root: Path, small_scene: Path) -> None:
    library = Library([small_scene], [odd_root])
    assert library.path("a.mcap").is_file()
    shutil.rmtree(odd_root)
    with pytest.raises(RecordingError, match="not among the recordings"):
        library.path("a.mcap")
    assert library.path(small_scene.name) == small_scene


def test_a_root_that_is_no_folder_is_refused(small_scene: Path, tmp_path: Path) -> None:
    for root in (small_scene, tmp_path / "none"):
        with pytest.raises(RecordingError, match="is no folder"):
            Library([small_scene], [root])


# Changed while it is open


def test_a_recording_that_is_cut_while_it_is_open_says_so_and_is_opened_again(
    tmp_path: Path,
) -> None:
    path = tmp_path / "room.mcap"
    # Longer than what is read ahead.
    shutil.copyfile(sample_path(), path)
    library = Library([path], [])
    view = View(recording=path.name)
    opened = library.open(view, viewer="ann")
    whole = path.read_bytes()
    os.truncate(path, len(whole) // 2)
    with pytest.raises(Exception) as failed:  # noqa: PT011, PT012  # as the reader has it
        for number in range(len(opened.frames)):
            opened.frames.pair(number)
    failure = opened.explain_read_error(failed.value)
    assert isinstance(failure, RecordingError)
    assert failure.problem == "has become shorter since it was opened."
    assert failure.file == str(path)
    assert "Reload the page" in failure.advice
    # Who looks at it keeps what can still be read; who comes next has it as it is then.
    path.write_bytes(whole)
    assert library.open(view, viewer="ann") is opened
    library.release("ann")
    again = library.open(view, viewer="ann")
    assert again is not opened
    assert len(again.frames) == len(opened.frames)
    assert again.frames.pair(len(again.frames) - 1)
    library.close()
    assert not is_open(opened.fuse_session.recording)


def test_an_error_of_a_recording_that_did_not_change_stays_as_it_is(
    library: Library, view: View
) -> None:
    opened = library.open(view)
    for error in (IndexError("5"), RecordingError("message 7 is damaged.")):
        assert opened.explain_read_error(error) is error
    assert library.open(view) is opened


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda folder: (folder / "a").unlink(), "is gone"),
        (lambda folder: shutil.rmtree(folder), "is gone"),
        (lambda folder: os.truncate(folder / "a", 2), "has become shorter"),
        (lambda folder: (folder / "a").write_bytes(b"longer"), "has changed"),
        (lambda folder: os.utime(folder / "a", ns=(1, 1)), "has changed"),
        (lambda folder: (folder / "c").write_bytes(b""), "has changed"),
        (lambda folder: None, None),
    ],
)
def test_what_became_of_a_folder(
    tmp_path: Path, change: Callable[[Path], object], words: str | None
) -> None:
    folder = tmp_path / "recording"
    folder.mkdir()
    for name in ("a", "b"):
        (folder / name).write_bytes(b"1234")
    stamp = FileStamp.of(folder)
    change(folder)
    said = stamp.change()
    assert said is None if words is None else said is not None and said.startswith(words)
