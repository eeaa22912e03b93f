"""What is always in sight: the scene, the streams, the frames and what differs from the preset."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from playwright.sync_api import Locator, expect

from fusion_core.workflows.info import info
from scanloom.page.layout import page_sizes
from scanloom.server.workbench import Workbench
from scanloom.state.view import View
from tests.app.browser.person import Person, colourful


def test_the_page_shows_the_scene_and_the_panel(person: Person, small_scene: Path) -> None:
    expect(person.text(small_scene.name)).to_be_visible()
    # In so small a window the docks make room once the view is known.
    person.wait_until(lambda: np.diff(scene_sides_px(person)) > 200)
    # Depth, curve and pairs are drawn over a white ground.
    person.wait_until(lambda: 0.005 < coloured_fraction(person, *scene_sides_px(person)) < 0.9)


def test_the_page_has_its_name_and_docks_that_stand_still(person: Person) -> None:
    expect(person.page).to_have_title("ScanLoom")
    # A dock that is eased into place draws the whole scene at each step.
    eased = """let moving = [];
        for (let one = document.querySelector("canvas[data-engine]"); one; one = one.parentElement)
            moving.push(getComputedStyle(one).transitionDuration);
        [...document.querySelectorAll("[data-dock-group]")].forEach(one =>
            moving.push(getComputedStyle(one).transitionDuration));
        moving"""
    durations = person.page.evaluate(eased)
    assert len(durations) > 5
    assert set(durations) == {"0s"}


def test_the_scene_stands_where_it_stays_from_its_first_moment(
    arrive: Callable[..., Person], workbench: Workbench
) -> None:
    person = arrive(viewport={"width": 1600, "height": 900})
    person.page.add_init_script("""window.places = new Set();
        new MutationObserver(() => {
            const box = document.querySelector("canvas[data-engine]")?.getBoundingClientRect();
            if (box?.width) places.add(`${Math.round(box.left)} ${Math.round(box.width)}`);
        }).observe(document, { attributes: true, childList: true, subtree: true });""")
    person.reload(workbench)
    person.wait_until_on_page()
    # From then on people move the docks.
    expect(person.page.locator("style[data-before-docks]")).to_have_count(0)
    assert len(person.page.evaluate("[...places]")) == 1
    person.page.context.close()


def test_the_legend_over_the_scene_switches_a_layer(person: Person) -> None:
    legend = person.page.get_by_role("group", name="Legend", exact=True).last
    curve = legend.get_by_role("button", name="LiDAR curve")
    expect(curve).to_have_attribute("aria-pressed", "true")
    box = legend.bounding_box()
    canvas = person.page.locator("canvas[data-engine]").bounding_box()
    assert box is not None
    assert canvas is not None
    assert canvas["x"] <= box["x"] <= canvas["x"] + canvas["width"]
    curve.press("Enter")
    expect(curve).to_have_attribute("aria-pressed", "false")
    assert person.session.view.hidden_layers == {"curve"}
    curve.press("Enter")
    expect(curve).to_have_attribute("aria-pressed", "true")


def test_a_smaller_window_and_larger_letters_arrange_the_page_anew(
    arrive: Callable[..., Person], small_scene: Path
) -> None:
    person = arrive(viewport={"width": 1600, "height": 900})
    person.look_at(View(recording=small_scene.name, panel="Repair"))
    person.page.set_viewport_size({"width": 1280, "height": 720})
    person.wait_until(lambda: person.session.window_px == (1280, 720))
    person.page.keyboard.press("p")
    canvas = person.page.locator("canvas[data-engine]")
    steps = person.page.get_by_label("Steps").get_by_role("button")
    slider = person.page.get_by_role("slider").locator("visible=true").first.locator("xpath=../..")
    for size in (page_sizes(1280, 720, is_large=True), page_sizes(1280, 720)):
        # viser rounds by a few pixels.
        person.wait_until(
            lambda size=size: abs(width_px(canvas) - size.between_px - 24) < 16  # type: ignore[misc]
        )
        rows = [person.page.get_by_label(name, exact=True) for name in ("Playback", "Speed")]
        person.wait_until(lambda: are_in_a_row(steps.all()))
        person.wait_until(lambda rows=rows: are_in_a_row(rows))  # type: ignore[misc]
        # It could not be dragged if it were shorter.
        person.wait_until(lambda: width_px(slider) > 60)
        person.wait_until(lambda: bottom_px(person.live("profile")) < 720)
        person.page.keyboard.press("p")
    person.page.context.close()


def are_in_a_row(places: list[Locator]) -> bool:
    tops_px = {round(box["y"]) for place in places if (box := place.bounding_box()) is not None}
    return len(tops_px) == 1


def bottom_px(locator: Locator) -> float:
    box = locator.bounding_box()
    assert box is not None
    return float(box["y"] + box["height"])


def width_px(locator: Locator) -> float:
    box = locator.bounding_box()
    assert box is not None
    return float(box["width"])


def scene_sides_px(person: Person) -> tuple[float, float]:
    """Where the scene begins and ends."""
    canvas = person.page.locator("canvas[data-engine]").bounding_box()
    assert canvas is not None
    return canvas["x"], canvas["x"] + canvas["width"]


def coloured_fraction(person: Person, left_px: float, right_px: float) -> float:
    """How much of the scene is neither ground nor grid."""
    # The screen's picture has half of the pixels.
    return float(colourful(person.screen()[:, int(left_px / 2) : int(right_px / 2)]).mean())


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
        expect(person.text(f"Frame {number + 1} of {count} · {time_s:.2f} s")).to_be_visible()
        assert person.session.view.frame_index == number


def test_a_preset_changes_the_line_of_differences_and_undo_brings_it_back(person: Person) -> None:
    person.session.change_setting("noise", "epsilon", 2.5)
    expect(person.text("with noise.epsilon = 2.5")).to_be_visible()
    person.unfold("Settings and view")
    person.choose("Preset", "published")
    expect(person.text("Settings: published")).to_be_visible()
    person.wait_until(lambda: person.frame_view.view.preset == "published")
    person.page.get_by_label("Undo the last change").click()
    expect(person.text("with noise.epsilon = 2.5")).to_be_visible()
    expect(person.page.get_by_label("Preset", exact=True)).to_have_value("default")
    person.press("Reset to this preset")
    expect(person.text("Settings: ")).to_have_count(0)


def test_a_step_that_is_opened_has_its_help(person: Person) -> None:
    person.unfold("About this step")
    expect(person.text("What you see")).to_be_visible()
    person.open_step("Match")
    # Sent together with the step's folder.
    expect(person.text("fits best at row")).to_be_visible()
    person.unfold("About this step")
    expect(person.text("The picture Where do they fit? shows the similarity")).to_be_visible()
