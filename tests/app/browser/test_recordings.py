"""Recordings that are not as they should be: cut off, or named to do harm."""

from pathlib import Path

from playwright.sync_api import expect

from fusion_core.workflows.info import info
from scanloom.state.view import PANELS, View
from tests.app.browser.person import Person, peak_of


def test_a_recording_cut_in_the_middle_warns_and_works(person: Person, damaged: Path) -> None:
    whole = len(person.frame_view.open_recording.frames)
    person.choose("Recording", damaged.name)
    expect(person.text("Warning:")).to_be_visible()
    expect(person.text(info(damaged)["warnings"][0])).to_be_visible()
    person.wait_until(lambda: person.frame_view.view.recording == damaged.name)
    person.wait_until(lambda: person.frame_view.fused is not None)
    left = len(person.frame_view.open_recording.frames)
    assert whole // 3 < left < whole
    person.key("End")
    expect(person.text(f"frame {left - 1} of {left}")).to_be_visible()
    person.key("Home")
    person.press("Match")
    person.wait_for_peak(peak_of(person.frame_view, View(recording=damaged.name)))


def test_a_hostile_name_is_text(person: Person, hostile: Path) -> None:
    header = person.page.get_by_text(hostile.name, exact=True).locator("visible=true")
    expect(header).to_have_count(0)
    person.choose("Recording", hostile.name)
    expect(header).to_have_count(1)
    assert person.page.get_by_label("Recording", exact=True).input_value() == hostile.name
    person.wait_until(lambda: person.frame_view.view.recording == hostile.name)
    for number, panel in enumerate(PANELS):
        person.key(f"Alt+{number + 1}")
        person.wait_for_panel(panel)
    assert person.page.evaluate("window.taken") is None
    assert person.page.locator("img[src='x'], img[src='b']").count() == 0
    assert person.page.locator("strong", has_text="bold").count() == 0
