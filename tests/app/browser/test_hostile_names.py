"""A recording whose name, topics and frame ids would do harm where they are not taken for text."""

import shlex
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest
from playwright.sync_api import expect

from scanloom.panels.pictures import DepthImagePanel, SimilarityPanel
from scanloom.panels.profile import ProfilePanel
from scanloom.state.view import PANELS, View, view_of_link
from tests.app.browser.person import Person
from tests.hostile.topics import MARKUP, hostile_topic

# Also what is there for a moment alone.
WATCH = """() => {
    window.made = [];
    const harmful = "img[src='x'], img[src='a'], img[onerror], script:not([src])";
    window.watching = new MutationObserver(changes => {
        for (const { addedNodes } of changes) for (const added of addedNodes) {
            if (!(added instanceof Element)) continue;
            if (added.matches(harmful)) window.made.push(added.outerHTML);
            for (const it of added.querySelectorAll(harmful)) window.made.push(it.outerHTML);
        }
    });
    window.watching.observe(document, { childList: true, subtree: true });
}"""
FOUND = """() => {
    window.watching.disconnect();
    const bold = [...document.querySelectorAll("strong")].map(it => it.textContent);
    return [window.taken ?? null, window.made, bold.filter(text => text === "bold").length];
}"""


@pytest.fixture
def reader(person: Person, hostile: Path) -> Iterator[Person]:
    """A person who has opened the recording, and to whom nothing happens."""
    person.page.evaluate(WATCH)
    person.look_at(View(recording=hostile.name))
    yield person
    assert person.page.evaluate(FOUND) == [None, [], 0]


def test_the_streams_are_listed_as_text(reader: Person) -> None:
    topic = hostile_topic("/scan")
    listed = reader.page.locator("table:visible", has_text="stream")
    for name in ("/scan", "/camera/depth/camera_info"):
        own = hostile_topic(name)
        cell = listed.locator("bdi", has_text=name[-10:])
        expect(cell).to_have_attribute("title", own[:600])
        shown = cell.inner_text()
        # It is cut in the middle, so that the others are seen too.
        before, _, after = shown.partition("…")
        assert own.startswith(before)
        assert own.endswith(after)
        assert len(MARKUP) // 3 < len(shown) <= 90
    expect(reader.text("It can be fused:")).to_contain_text(MARKUP)
    reader.unfold("Streams to use")
    reader.page.get_by_role("combobox", name="LiDAR", exact=True).click()
    expect(reader.page.get_by_role("option", name=topic, exact=True)).to_be_visible()
    reader.page.keyboard.press("Escape")


def test_every_step_and_what_the_pointer_reads_out(reader: Person, hostile: Path) -> None:
    expect(reader.page.locator(".scanloom-tools bdi")).to_have_text(hostile.name)
    readout = reader.page.locator(".scanloom-readout")
    for panel in PANELS:
        reader.look_at(reader.session.view.changed(panel=panel))
        expect(reader.page.locator(f"[aria-current=step][data-value='{panel}']")).to_be_visible()
        expect(reader.page.locator(".scanloom-verdict h2")).not_to_be_empty()
    for picture, kind in (
        ("depth", DepthImagePanel),
        ("similarity", SimilarityPanel),
        ("profile", ProfilePanel),
    ):
        box = reader.panel(kind)._drawn.axes.box
        middle_px = box.left + box.width // 2, box.top + box.height // 2
        reader.page.mouse.move(*reader.place_on(picture, *middle_px))
        expect(readout).to_contain_text(" ")
        reader.page.mouse.move(450.0, 100.0)
        expect(readout).to_be_hidden()
    reader.page.mouse.move(*reader.place_on("time", 120, 30))
    expect(readout).to_contain_text("frame ")
    legend = reader.page.get_by_role("group", name="Legend", exact=True).last
    for pressed in ("false", "true"):
        legend.get_by_role("button").first.click()
        expect(legend.get_by_role("button").first).to_have_attribute("aria-pressed", pressed)


def test_the_dialog_the_link_and_the_command(reader: Person, hostile: Path) -> None:
    reader.key("o")
    row = reader.page.locator(".scanloom-files bdi").get_by_text(hostile.name, exact=True)
    expect(row).to_be_visible()
    reader.page.keyboard.press("Escape")
    expect(reader.page.get_by_role("dialog")).to_have_count(0)
    depth = hostile_topic("/camera/depth/image_raw")
    chosen = {"lidar_topic": hostile_topic("/scan"), "depth_topics": (depth,)}
    reader.look_at(reader.session.view.changed(panel="Map", **chosen))
    reader.unfold("On the command line")
    command = reader.page.locator("textarea").locator("visible=true").first
    # As the shell takes it apart, the topics are the recording's.
    assert {f"--lidar={chosen['lidar_topic']}", f"--depth={depth}"} <= set(
        shlex.split(command.input_value())
    )
    link = reader.page.locator("[data-view-link]").get_attribute("data-view-link")
    assert link is not None
    (written,) = parse_qs(urlsplit(link).query)["view"]
    assert view_of_link(written) == reader.session.view
