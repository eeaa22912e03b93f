"""The opening dialog: choosing, uploading, and what cannot be opened."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Locator, expect

from tests.app.browser.person import Person

GIGABYTE = 1_000_000_000


@pytest.fixture
def dialog(person: Person) -> Iterator[Locator]:
    """The open dialog."""
    # Notifications of viser's may lie over it, and it is sent anew with the recording's name.
    person.page.evaluate("document.querySelector('[data-press=open]').click()")
    dialog = person.page.get_by_role("dialog")
    expect(dialog.get_by_text("Upload a file…")).to_be_visible()
    yield dialog
    person.page.keyboard.press("Escape")
    expect(dialog).to_have_count(0)


def upload(person: Person, path: Path) -> None:
    person.page.locator("[data-upload-file]").set_input_files(path)


def test_a_recording_is_chosen_by_keyboard_alone(person: Person, damaged: Path) -> None:
    person.key("o")
    row = person.page.locator(".scanloom-files button", has_text=damaged.name)
    expect(row).to_contain_text("LiDAR, depth, colour")
    row.focus()
    person.page.keyboard.press("Enter")
    person.wait_until(lambda: person.frame_view.view.recording == damaged.name)
    expect(person.page.get_by_role("dialog")).to_have_count(0)


def test_what_cannot_be_opened_leaves_everything_and_says_why(
    person: Person, dialog: Locator, small_scene: Path, tmp_path: Path
) -> None:
    before = person.session.view
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(small_scene.read_bytes()[:2_000])
    upload(person, broken)
    failed = dialog.get_by_role("status").get_by_text("broken.mcap: is cut short or damaged")
    expect(failed).to_be_visible()
    assert person.session.view == before
    assert person.frame_view.view == before
    notes = tmp_path / "notes.txt"
    notes.write_text("no recording")
    upload(person, notes)
    expect(dialog.get_by_text("notes.txt: is no recording: a text file.")).to_be_visible()
    dialog.get_by_role("button", name="Dismiss").click()
    expect(dialog.get_by_role("status")).to_have_count(0)
    assert person.session.view == before


def test_an_upload_of_two_gigabytes_is_refused_at_once(
    person: Person, dialog: Locator, tmp_path: Path
) -> None:
    huge = tmp_path / "huge.bag"
    with huge.open("wb") as file:
        file.truncate(2 * GIGABYTE)
    upload(person, huge)
    words = "huge.bag has 2,000 MB; at most 200 MB can be uploaded."
    expect(dialog.get_by_text(words)).to_be_visible()
    # The page still answers.
    dialog.get_by_role("button", name="Dismiss").click()
    expect(dialog.get_by_text(words)).to_have_count(0)


def test_an_upload_is_taken_and_opened(
    person: Person, dialog: Locator, small_scene: Path, tmp_path: Path
) -> None:
    name = "<img src=x onerror='window.taken = 3'>.mcap"
    path = tmp_path / name
    path.write_bytes(small_scene.read_bytes())
    upload(person, path)
    person.wait_until(lambda: person.frame_view.view.recording.startswith(name))
    expect(dialog).to_have_count(0)
    expect(person.page.locator(".scanloom-tools")).to_contain_text(name)
    assert person.page.evaluate("window.taken") is None
