"""What all browsers share: opened once, aligned once, and closed when nobody looks at it."""

import random
import shutil
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from app.state import library as library_module
from app.state.library import Library
from app.state.opened import Opened
from app.state.view import View
from fusion_core.model.errors import MissingStream, RecordingError
from fusion_core.model.recording import Recording
from fusion_core.workflows.presets import PRESETS
from tests.hostile.names import NO_UTF8, SHOWN

ENOUGH_S = 60.0
UNSEEN = library_module._MOST_UNSEEN
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


def open_of(every: list[Opened]) -> list[bool]:
    """Which of these can still be read from."""
    return [is_open(opened.session.recording) for opened in every]


# Names


def test_names_that_are_no_utf8_are_listed_and_opened(small_scene: Path, tmp_path: Path) -> None:
    path = tmp_path / NO_UTF8
    shutil.copyfile(small_scene, path)
    for shared in (Library([path], []), Library([], [tmp_path])):
        (name,) = shared.names()
        assert name == SHOWN
        assert shared.open(View(recording=name)).session.recording.path == path
        with pytest.raises(RecordingError):
            shared.path(f"{SHOWN}x")
        shared.close()


# Shared


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

    def endless(_: object, progress: Callable[..., None], *_more: object) -> None:
        try:
            while True:
                began.set()
                progress(0, None, "aligning")
        finally:
            stopped.set()

    monkeypatch.setattr("app.state.opened.align_session", endless)
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


# Closed when nobody looks at it


def test_of_what_nobody_looks_at_the_last_few_stay_open(
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


def test_what_somebody_looks_at_stays_until_they_leave(library: Library, views: list[View]) -> None:
    seen = library.open(views[0], seen_by="ann")
    assert library.open(views[0], seen_by="ben") is seen
    for view in views[1:]:
        library.open(view)
    library.leave("ben")
    assert open_of([seen]) == [True]
    assert library.open(views[0]) is seen
    for view in views[1:]:
        library.open(view)
    library.leave("ann")
    assert open_of([seen]) == [False]
    library.leave("nobody")


def test_who_opens_another_looks_at_that_one(library: Library, views: list[View]) -> None:
    every = [library.open(view, seen_by="ann") for view in views]
    older = len(views) - 1 - UNSEEN
    assert open_of(every) == [False] * older + [True] * (UNSEEN + 1)


def test_who_cannot_open_another_stays_where_they_are(library: Library, views: list[View]) -> None:
    seen = library.open(views[0], seen_by="ann")
    with pytest.raises(MissingStream):
        library.open(views[0].changed(lidar_topic="/none"), seen_by="ann")
    for view in views[1:]:
        library.open(view)
    assert open_of([seen]) == [True]


def test_a_file_stays_open_as_long_as_one_of_its_choices(
    library: Library, views: list[View]
) -> None:
    first = library.open(views[0])
    second = library.open(views[0].changed(virtual_row=60), seen_by="ann")
    for view in views[1:]:
        library.open(view)
    assert first.session.recording is second.session.recording
    assert open_of([second]) == [True]
    assert library.open(views[0]) is not first
    library.leave("ann")
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

    monkeypatch.setattr("app.state.opened.align_session", endless)
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
    """Stands for ``open_session``: lets nobody through a recording's gate before it is opened."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        self.reached, self.go_on = threading.Event(), threading.Event()
        self.calls = 0
        self._name = name
        self._open = library_module.open_session
        monkeypatch.setattr(library_module, "open_session", self)

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


def test_two_who_ask_at_once_get_one(
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


def test_many_who_come_and_go_find_open_what_they_look_at(
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
                opened = library.open(view, seen_by=seed)
                if not is_open(opened.session.recording):
                    problems.append(f"{view.recording} is closed")
                if opened.session.virtual_row != view.virtual_row:
                    problems.append(f"{view.recording} is another")
                if chosen.random() < 0.2:
                    library.leave(seed)
            except Exception as error:  # noqa: BLE001  # told by the test
                problems.append(repr(error))
        library.leave(seed)

    threads = [threading.Thread(target=come_and_go, args=(seed,)) for seed in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(ENOUGH_S)
    assert problems == []
    assert 0 < sum(is_open(recording) for recording in sources.opened) <= UNSEEN
    library.close()
    assert not any(is_open(recording) for recording in sources.opened)
