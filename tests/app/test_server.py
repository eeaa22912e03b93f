"""A browser and its session: the view it gets, what is reported, and how it ends."""

import base64
import json
import shutil
import threading
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fusion_core.model.errors import RecordingError, SettingsError
from scanloom.client_session import STORED_VIEW, ClientSession
from scanloom.server.pages import LINK_KEY
from scanloom.server.sending import LoopEvent
from scanloom.server.workbench import ServeOptions, Workbench
from scanloom.state.view import View, view_of_link
from tests.app.viser_client import connect
from tests.hostile.names import NO_UTF8, SHOWN
from tests.hostile.visitors import LAST_WIDGET
from tests.patience import ENOUGH_S, comes_true


@pytest.fixture
def view(small_scene: Path) -> View:
    return View(recording=small_scene.name)


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
    kept = view.changed(frame_index=4, panel="Match").with_setting("noise", "epsilon", 2.5)
    storage = {STORED_VIEW: kept.to_link()}
    with connect(workbench.address, storage=storage) as client:
        client.wait_until(lambda: client_shows(client, "Frame", 5))
        assert desk_of(workbench).view == kept


def test_a_browser_is_sent_what_any_thread_queues(workbench: Workbench) -> None:
    with connect(workbench.address) as client:
        client.wait_until(lambda: len(workbench.sessions) == 1)
        connection = workbench.sessions[0]._client._websock_connection
        assert isinstance(connection.get_message_buffer().message_event, LoopEvent)


def test_the_scene_waits_for_no_surroundings_and_casts_no_shadows(workbench: Workbench) -> None:
    with connect(workbench.address) as client:
        # viser's page hides the scene until it has decoded a photograph, unless it is told of none.
        around = client.wait_for(
            lambda received: received.type == "EnvironmentMapMessage", ENOUGH_S
        )
        assert around.message["hdri_data"] is None
        lights = client.wait_for(lambda received: received.type == "EnableLightsMessage", ENOUGH_S)
        assert lights.message["enabled"]
        assert not lights.message["cast_shadow"]


def test_a_link_goes_before_what_was_kept_and_is_followed_once(
    workbench: Workbench, view: View
) -> None:
    linked, kept = view.changed(frame_index=6), view.changed(frame_index=4)
    storage = {STORED_VIEW: kept.to_link(), LINK_KEY: linked.to_link()}
    with connect(workbench.address, storage=storage) as client:
        client.wait_until(lambda: client_shows(client, "Frame", 7))
        client.wait_until(lambda: storage[STORED_VIEW] == linked.to_link())
    assert LINK_KEY not in storage


@pytest.mark.parametrize(
    ("link", "words"),
    [
        ("broken", "the link cannot be followed"),
        (View(recording="../elsewhere").to_link(), "is not among the recordings"),
        (View(recording="a\x00b").to_link(), "is not among the recordings"),
    ],
)
def test_a_link_that_cannot_be_followed_is_reported_and_the_kept_view_is_shown(
    workbench: Workbench, view: View, link: str, words: str
) -> None:
    storage = {STORED_VIEW: view.changed(frame_index=4).to_link(), LINK_KEY: link}
    with connect(workbench.address, storage=storage) as client:
        title, _ = next(notes_of(client))
        assert words in title
        client.wait_until(lambda: client_shows(client, "Frame", 5))


def test_a_widget_that_holds_a_refused_value_is_set_back(workbench: Workbench, view: View) -> None:
    storage = {STORED_VIEW: view.changed(panel="Match").to_link()}
    with connect(workbench.address, storage=storage) as client:
        row = client.find("v (row)", timeout=ENOUGH_S)
        client.wait_until(lambda: row.value > 0.0)
        peak_row = row.value
        client.set_value("v (row)", -3.0)
        client.set_value("Offset", "Use")
        title, _ = next(notes_of(client))
        assert title.startswith("picked_offset.1: ")
        client.wait_until(lambda: row.value == peak_row)


def test_a_frame_that_cannot_be_read_takes_the_one_before_out_of_sight(
    workbench: Workbench, view: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    storage = {STORED_VIEW: view.changed(frame_index=2).to_link()}
    with connect(workbench.address, storage=storage) as client:

        def pictures_in_sight() -> int:
            return sum(client.shows_picture(name) for name in ("depth", "similarity"))

        client.wait_until(lambda: pictures_in_sight() == 2)
        session = desk_of(workbench)
        assert session.wait(ENOUGH_S)
        assert session.frame_view is not None
        frames = session.frame_view.open_recording.frames

        def fail(*_: Any) -> None:
            raise RecordingError("message 7 is damaged.", advice="Go on.")

        monkeypatch.setattr(frames, "pair", fail)
        # No other test has looked at it.
        session.change(frame_index=13)
        title, body = next(notes_of(client))
        assert (title, body) == ("message 7 is damaged.", "Go on.")
        client.wait_until(lambda: pictures_in_sight() == 0)
        monkeypatch.undo()
        session.change(frame_index=14)
        client.wait_until(lambda: pictures_in_sight() == 2)


@pytest.mark.parametrize("last_seen", ["Preset", "Frame", "v (row)"])
def test_a_session_ends_with_its_browser_even_half_built(
    workbench: Workbench, last_seen: str
) -> None:
    def ended() -> bool:
        return not workbench.sessions and not threads_of_sessions()

    assert comes_true(ended)
    with connect(workbench.address, storage={}) as client:
        client.find(last_seen)
        assert threads_of_sessions()
    assert comes_true(ended)


def test_a_session_whose_page_cannot_be_built_leaves_nothing_behind(
    workbench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert comes_true(lambda: not threads_of_sessions())
    begun = threading.Event()

    def add_no_panels(*_: object) -> None:
        begun.set()
        raise RuntimeError("no panels today")

    monkeypatch.setattr("scanloom.server.workbench.add_panels", add_no_panels)
    with connect(workbench.address, storage={}):
        assert begun.wait(ENOUGH_S)
        assert comes_true(lambda: not threads_of_sessions())


def threads_of_sessions() -> set[str]:
    return {t.name for t in threading.enumerate() if t.name.startswith(("session", "play"))}


def test_a_view_that_cannot_be_opened_gives_way_to_the_one_before(
    workbench: Workbench, view: View
) -> None:
    storage = {STORED_VIEW: view.changed(frame_index=4).to_link()}
    with connect(workbench.address, storage=storage) as client:
        client.wait_until(lambda: any(s.frame_view for s in workbench.sessions))
        session = desk_of(workbench)
        before = session.view
        session.change(recording="none\n.mcap", frame_index=0)
        props = client.wait_for(
            lambda received: received.type == "NotificationShowMessage", ENOUGH_S
        ).message["props"]
        assert "is not among the recordings" in props["title"]
        assert "\n" not in props["title"]
        assert props["auto_close_seconds"] is None
        client.wait_until(lambda: session.view == before)


def test_names_that_are_no_utf8_reach_the_browser(small_scene: Path, tmp_path: Path) -> None:
    recording = tmp_path / NO_UTF8
    shutil.copyfile(small_scene, recording)
    options = ServeOptions(recordings=[recording], port=0, output_root=tmp_path / NO_UTF8 / "out")
    with Workbench(options) as serving, connect(serving.address, storage={}) as client:
        client.wait_until(lambda: client_says(client, SHOWN))
        client.press("step", "Map")
        # The command for the shell, with both names as bytes.
        client.wait_until(lambda: client_says(client, r"r\xff\xfe/out"))


def desk_of(workbench: Workbench) -> ClientSession:
    """The one browser's session; that of the test before may still be going."""
    assert comes_true(lambda: len(workbench.sessions) == 1)
    return workbench.sessions[0]


def client_shows(client: Any, label: str, value: Any) -> bool:
    return any(w.label == label and w.value == value for w in client.widgets.values())


def client_says(client: Any, words: str) -> bool:
    return any(words in str(w.props.get("content", "")) for w in list(client.widgets.values()))


# What is at work ends with its browser


class Endless:
    """Stands for long work that reports its progress, until it is stopped."""

    def __init__(self) -> None:
        self.began, self.ended = threading.Event(), threading.Event()

    def work(self, progress: Callable[..., None]) -> None:
        pause = threading.Event()
        try:
            while True:
                progress(0, None, "working")
                self.began.set()
                pause.wait(0.01)
        finally:
            self.ended.set()


def test_an_alignment_that_a_link_asked_for_ends_with_its_browser(
    workbench: Workbench, view: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless = Endless()
    monkeypatch.setattr(
        "scanloom.state.open_recording.align_recording", lambda *args: endless.work(args[1])
    )
    with connect(
        workbench.address, storage={LINK_KEY: view.changed(virtual_row=61).to_link()}
    ) as client:
        client.find(LAST_WIDGET)
        assert endless.began.wait(ENOUGH_S)
    assert endless.ended.wait(ENOUGH_S)


def test_a_build_ends_with_its_browser_and_leaves_nothing_behind(
    small_scene: Path, view: View, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless = Endless()

    def fuse(recording: Path, output: Path, options: object, progress: Callable[..., None]) -> None:
        output.mkdir(parents=True)
        (output / "half a result").write_text("half")
        endless.work(progress)

    monkeypatch.setattr("scanloom.jobs.build.fuse", fuse)
    root = tmp_path / "out"
    options = ServeOptions(recordings=[small_scene], port=0, output_root=root)
    with Workbench(options) as own:
        storage = {STORED_VIEW: view.changed(panel="Map").to_link()}
        with connect(own.address, storage=storage) as client:
            # By then a press is heard.
            assert comes_true(lambda: len(own.sessions) == 1)
            client.click("Build")
            assert endless.began.wait(ENOUGH_S)
            assert list(root.iterdir())
        assert endless.ended.wait(ENOUGH_S)
        assert comes_true(lambda: not list(root.iterdir()))


# Links of nonsense


NUMBERS = st.integers() | st.integers(2**62, 2**80) | st.floats() | st.just(10**400)


@given(
    name=st.sampled_from(
        ["selected_beam", "frame_index", "draw_index", "row_step", "playback_speed", "virtual_row"]
    ),
    value=NUMBERS,
)
@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_number_a_link_holds_its_page_is_served(
    workbench: Workbench, view: View, name: str, value: float
) -> None:
    values = json.loads(zlib.decompress(base64.urlsafe_b64decode(view.to_link() + "==")))
    text = json.dumps(values | {name: value})
    link = base64.urlsafe_b64encode(zlib.compress(text.encode())).decode().rstrip("=")
    storage = {LINK_KEY: link}
    try:
        view_of_link(link)
        is_refused = False
    except SettingsError:
        is_refused = True
    with connect(workbench.address, storage=storage) as client:
        if is_refused:
            title, _ = next(notes_of(client))
            assert title.startswith(f"the link cannot be followed: {name}")
        client.wait_until(lambda: STORED_VIEW in storage)
        before = storage[STORED_VIEW]
        # It is still there for what comes next.
        client.trigger("Previous frame")
        client.wait_until(lambda: storage[STORED_VIEW] != before)
        assert client.closed_with is None
