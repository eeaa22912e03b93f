"""A view outlives its page: by a reload, by a link, and beside what others do."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect

from fusion_core.workflows.fuse.settings import PRESETS
from scanloom.server.workbench import Workbench
from scanloom.state.view import View
from tests.app.browser.person import Person, peak_of


def assert_shows(person: Person, view: View) -> None:
    """The page shows frame, settings and panel of a view whose panel is Match."""
    assert person.session.view == view
    count = len(person.frame_view.open_recording.frames)
    expect(person.text(f"Frame {view.frame_index + 1} of {count}")).to_be_visible()
    expect(person.text(f"sampling.step_deg = {view.settings.sampling.step_deg}")).to_be_visible()
    person.wait_for_peak(peak_of(person.frame_view, view))


def changed(view: View) -> View:
    """Another frame, another panel, another setting."""
    return view.with_setting("sampling", "step_deg", 1.75).changed(frame_index=11, panel="Match")


def test_a_reload_brings_everything_back(person: Person, workbench: Workbench) -> None:
    view = changed(person.session.view)
    person.look_at(view)
    before = person.session
    person.reload(workbench)
    assert person.session is not before
    assert_shows(person, view)
    legend = person.page.get_by_label("Legend")
    expect(legend.get_by_role("button", name="LiDAR curve")).to_be_visible()


@pytest.fixture(scope="module")
def friend(arrive: Callable[..., Person], small_scene: Path) -> Iterator[Person]:
    """A person who followed a link, in a browser that had never seen the workbench."""
    friend = arrive(f"/go?view={changed(View(recording=small_scene.name)).to_link()}")
    yield friend
    friend.page.context.close()


def test_a_link_brings_everything_into_another_browser(
    person: Person, friend: Person, workbench: Workbench
) -> None:
    view = changed(person.session.view)
    assert_shows(friend, view)
    assert friend.page.url.endswith("/")
    person.look_at(view)
    person.page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    # Browsers let only the page in front copy.
    person.page.bring_to_front()
    kept = person.page.locator("[data-view-link]")
    expect(kept).to_have_attribute("data-view-link", f"/go?view={view.to_link()}")
    person.page.get_by_label("Copy a link").click()
    link = f"{workbench.address}/go?view={view.to_link()}"
    # Reading at the same time would keep the page from writing.
    expect(person.text("Copied")).to_be_visible()
    assert person.page.evaluate("navigator.clipboard.readText()") == link


@pytest.mark.slow
def test_what_one_does_changes_nothing_for_another(person: Person, friend: Person) -> None:
    first = person.session.view.changed(panel="Match")
    person.look_at(first)
    friend.look_at(first)
    friend.unfold("Settings and view")
    friend.choose("Preset", "published")
    person.choose("Measured by", "cosine")
    friend.key("End")
    last = len(friend.frame_view.open_recording.frames) - 1
    expect(friend.text("Settings: published")).to_be_visible()
    expect(friend.text(f"Frame {last + 1} of {last + 1}")).to_be_visible()
    expect(person.text("search.metric = cosine")).to_be_visible()
    expect(person.text(f"Frame 1 of {last + 1}")).to_be_visible()
    assert person.session.view == first.with_setting("search", "metric", "cosine")
    published = PRESETS["published"]
    assert friend.session.view == first.changed(
        preset="published", settings=published, alignment_settings=published, frame_index=last
    )
    friend.wait_until(
        lambda: (
            friend.frame_view.view == friend.session.view and friend.frame_view.match is not None
        )
    )
    for someone in (person, friend):
        someone.wait_for_peak(peak_of(someone.frame_view, someone.session.view))
