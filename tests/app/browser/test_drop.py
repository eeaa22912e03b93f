"""A file that the mouse drags out of another program and lets go over the page."""

from pathlib import Path

import pytest
from playwright.sync_api import Locator, expect

from scanloom.state.view import View
from tests.app.browser.person import Person

GIGABYTE = 1_000_000_000
# Over the scene, where no field takes files by itself.
PLACE = {"x": 450, "y": 120}


class Drag:
    """What the browser is told of a drag by the system."""

    def __init__(self, person: Person, *paths: Path) -> None:
        files = [str(path) for path in paths]
        self._data = {"items": [], "files": files, "dragOperationsMask": 1}
        self._person = person
        self._browser = person.page.context.new_cdp_session(person.page)
        self._tell("dragEnter")

    def rest(self) -> None:
        """Rest on the page, until it takes the drag for its own: the system goes on telling."""

        def is_taken() -> bool:
            self._tell("dragOver")
            return is_marked(self._person)

        self._person.wait_until(is_taken)

    def let_go(self) -> None:
        """Drop the files there."""
        self._tell("drop")

    def _tell(self, kind: str) -> None:
        told = {"type": kind, **PLACE, "data": self._data}
        self._browser.send("Input.dispatchDragEvent", told)


@pytest.fixture
def dialog(person: Person) -> Locator:
    """The opening dialog, which is closed."""
    dialog = person.page.get_by_role("dialog")
    expect(dialog).to_have_count(0)
    return dialog


def close(person: Person, dialog: Locator) -> None:
    person.page.keyboard.press("Escape")
    expect(dialog).to_have_count(0)


def is_marked(person: Person) -> bool:
    return bool(person.page.evaluate("document.body.classList.contains('scanloom-drop')"))


def test_a_dropped_recording_is_uploaded_and_opened(
    person: Person, dialog: Locator, small_scene: Path, tmp_path: Path
) -> None:
    path = tmp_path / "dropped.mcap"
    path.write_bytes(small_scene.read_bytes())
    drag = Drag(person, path)
    drag.rest()
    drag.let_go()
    person.wait_until(lambda: person.frame_view.view.recording.startswith("dropped.mcap (upload"))
    assert not is_marked(person)
    expect(person.page.locator(".scanloom-tools")).to_contain_text("dropped.mcap")
    expect(dialog).to_have_count(0)


def test_a_drag_that_leaves_the_page_does_nothing(
    person: Person, dialog: Locator, small_scene: Path
) -> None:
    Drag(person, small_scene).rest()
    # Chromium's protocol tells a page nothing of it: as the window's edge does.
    person.page.evaluate("document.body.dispatchEvent(new DragEvent('dragleave', {bubbles: true}))")
    assert not is_marked(person)
    expect(dialog).to_have_count(0)


def test_what_is_refused_says_why_and_leaves_everything(
    person: Person, dialog: Locator, small_scene: Path, tmp_path: Path
) -> None:
    person.look_at(View(recording=small_scene.name, frame_index=3, panel="Repair"))
    before, address = person.session.view, person.page.url
    notes, huge = tmp_path / "notes.txt", tmp_path / "huge.bag"
    notes.write_text("no recording")
    with huge.open("wb") as file:
        file.truncate(2 * GIGABYTE)
    for paths, words in (
        ([notes], "notes.txt: is no recording: a text file."),
        ([huge], "huge.bag has 2,000 MB; at most 200 MB can be uploaded."),
        ([notes, huge], "Only one file can be uploaded at a time."),
        ([tmp_path], "A folder cannot be uploaded"),
    ):
        drag = Drag(person, *paths)
        drag.rest()
        drag.let_go()
        expect(dialog.get_by_role("status")).to_contain_text(words)
        assert not is_marked(person)
        close(person, dialog)
    assert person.session.view == before
    assert person.frame_view.view == before
    assert person.page.url == address
    # The page still answers.
    person.key("Home")
    person.wait_until(lambda: person.frame_view.view.frame_index == 0)


def test_an_upload_that_cannot_begin_says_so(
    person: Person, dialog: Locator, small_scene: Path
) -> None:
    person.page.evaluate("""() => {
        window.Connected = window.WebSocket;
        window.WebSocket = class { constructor() { setTimeout(() => this.onerror()); } };
    }""")
    drag = Drag(person, small_scene)
    drag.rest()
    drag.let_go()
    expect(dialog.get_by_role("status")).to_contain_text("The upload could not begin")
    person.page.evaluate("() => { window.WebSocket = window.Connected; }")
    close(person, dialog)


def test_escape_closes_one_dialog_once(person: Person, dialog: Locator) -> None:
    person.key("o")
    expect(dialog).to_be_visible()
    person.page.evaluate("""() => {
        window.presses = [];
        const count = (event) => window.presses.push(event.target.closest("[data-press]"));
        document.addEventListener("click", count, true);
    }""")
    person.page.keyboard.press("Escape")
    expect(dialog).to_have_count(0)
    # A dialog that opens right after it would be closed by a second press.
    assert person.page.evaluate("window.presses.length") == 1
