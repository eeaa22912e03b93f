"""Recordings that are not as they should be: cut off, or without a sensor."""

from pathlib import Path

from playwright.sync_api import expect

from fusion_core.workflows.info import info
from scanloom.state.view import View
from tests.app.browser.person import Person, peak_of


def test_a_recording_cut_in_the_middle_warns_and_works(person: Person, damaged: Path) -> None:
    whole = len(person.frame_view.open_recording.frames)
    person.open_recording(damaged.name)
    expect(person.text("Warning:")).to_be_visible()
    expect(person.text(info(damaged)["warnings"][0])).to_be_visible()
    person.wait_until(lambda: person.frame_view.view.recording == damaged.name)
    person.wait_until(lambda: person.frame_view.fused is not None)
    left = len(person.frame_view.open_recording.frames)
    assert whole // 3 < left < whole
    person.key("End")
    expect(person.text(f"Frame {left} of {left}")).to_be_visible()
    person.key("Home")
    person.open_step("Match")
    person.wait_for_peak(peak_of(person.frame_view, View(recording=damaged.name)))


def test_a_lidar_alone_is_shown_and_steps_without_a_camera_are_grey(
    person: Person, lidar_alone: Path
) -> None:
    reason = "The recording has no depth camera: there is nothing to match the LiDAR with"
    person.session.change(**dict(View(recording=lidar_alone.name)))
    expect(person.text("20 scans of a LiDAR in 2 s; no depth camera")).to_be_visible()
    steps = person.page.get_by_label("Steps")
    grey = steps.locator("button[aria-disabled=true]")
    expect(grey).to_have_count(5)
    expect(grey.first).to_have_attribute("title", f"{reason}. (Alt + 2)")
    legend = person.page.get_by_role("group", name="Legend")
    expect(legend.get_by_role("button", name="LiDAR curve")).to_be_visible()
    expect(legend.get_by_role("button", name="Depth surface")).to_have_count(0)
    # It is grey, and opens all the same.
    steps.get_by_role("button", name="Repair").click(force=True)
    expect(person.page.get_by_role("heading", name=reason)).to_be_visible()
    person.open_step("Map")
    expect(person.button("Run")).to_be_enabled()
