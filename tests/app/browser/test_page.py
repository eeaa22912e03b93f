"""What is always in sight: the scene, the streams, the frames and what differs from the preset."""

from pathlib import Path

from playwright.sync_api import expect

from fusion_core.workflows.info import info
from tests.app.browser.person import Person, colourful


def test_the_page_shows_the_scene_and_the_panel(person: Person, small_scene: Path) -> None:
    expect(person.text(small_scene.name)).to_be_visible()
    expect(person.text("settings of the preset default")).to_be_visible()
    canvas = person.page.locator("canvas[data-engine]").bounding_box()
    assert canvas is not None
    assert canvas["width"] > 400
    # Rows, pairs and image_planes are drawn over a white ground.
    person.wait_until(lambda: 0.01 < coloured_fraction(person, canvas["width"]) < 0.9)


def coloured_fraction(person: Person, width_px: float) -> float:
    """How much of the scene is neither ground nor grid."""
    return float(colourful(person.screen()[:, : int(width_px / 2)]).mean())


def test_the_streams_are_listed_with_their_counts(person: Person, small_scene: Path) -> None:
    # The plot below has a table of its own.
    table = person.page.locator("table:visible", has_text="stream")
    listed = [row.split("\t") for row in table.locator("tr").all_inner_texts()]
    found = {name: (role, int(count), rate) for name, role, count, rate in listed[1:]}
    expected = {
        topic["name"]: (
            topic["role"].replace("_", " "),
            topic["count"],
            "–" if topic["rate_hz"] is None else f"{topic['rate_hz']:.1f}",
        )
        for topic in info(small_scene)["topics"]
    }
    assert found == expected
    assert found["/scan"][:2] == ("lidar", 20)


def test_the_keys_go_through_the_frames(person: Person) -> None:
    times_ns = person.frame_view.open_recording.frames.times_ns
    count = len(times_ns)
    for key, number in (
        ("PageDown", 1),
        ("PageDown", 2),
        ("PageUp", 1),
        ("End", count - 1),
        ("PageDown", 0),
        ("PageUp", count - 1),
        ("Home", 0),
    ):
        person.key(key)
        time_s = (times_ns[number] - times_ns[0]) / 1e9
        expect(person.text(f"{time_s:.3f} s · frame {number} of {count}")).to_be_visible()
        expect(person.thumb("Frame")).to_have_attribute("aria-valuenow", str(number))
        assert person.session.view.frame_index == number


def test_a_preset_changes_the_line_of_differences_and_undo_brings_it_back(person: Person) -> None:
    person.session.change_setting("noise", "epsilon", 2.5)
    expect(person.text("differs: noise.epsilon = 2.5")).to_be_visible()
    person.choose("Preset", "published")
    expect(person.text("settings of the preset published")).to_be_visible()
    person.wait_until(lambda: person.frame_view.view.preset == "published")
    person.press("Undo")
    expect(person.text("differs: noise.epsilon = 2.5")).to_be_visible()
    assert person.page.get_by_label("Preset", exact=True).input_value() == "default"
    person.press("Reset")
    expect(person.text("settings of the preset default")).to_be_visible()
