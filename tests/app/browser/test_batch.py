"""A batch in a browser: its report, and its list in the workbench."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from fusion_core.workflows.batch.report import write_report
from scanloom.server.workbench import ServeOptions, Workbench
from tests.app.browser.conftest import CARD_OF_NO_NAME, FEW_FRAMES, SCREEN
from tests.app.browser.person import at_session
from tests.patience import ENOUGH_S
from tests.workflows.batch.made_outcomes import DAY_NS, MONDAY_NS, failed, fleet, frame, fused

HOSTILE = "<img src=x onerror=alert(1)><script>alert(2)</script>"


@pytest.fixture(scope="module")
def shelf(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A batch, night, and two of its recordings, in data."""
    root = tmp_path_factory.mktemp("shelf")
    folder, recordings = root / "night", root / "data"
    recordings.mkdir()
    frames = [frame(0, MONDAY_NS + 20 * DAY_NS, lidar_hole=12, depth_hole=12, lidar_burr=3)]
    bumped = fused(folder, "bumped", frames, yaw_rad=0.2)
    outcomes = [*fleet(folder), bumped, failed(HOSTILE, error=HOSTILE)]
    write_report(folder, outcomes, recordings=recordings)
    for name in ("bumped.mcap", "run_04.mcap"):
        (recordings / name).write_bytes(small_scene.read_bytes())
    return root


@pytest.fixture
def report(browser: Browser, shelf: Path) -> Iterator[Page]:
    """The report, opened from its file by a browser without a network."""
    context = browser.new_context(offline=True)
    page = context.new_page()
    messages: list[str] = []
    page.on("console", lambda message: messages.append(message.text))
    page.on("pageerror", lambda error: messages.append(str(error)))
    page.on("dialog", lambda dialog: (messages.append(dialog.message), dialog.dismiss()))
    page.goto((shelf / "night" / "report.html").as_uri())
    yield page
    context.close()
    # A test may try what the policy of the page forbids.
    assert [message for message in messages if "Content Security Policy" not in message] == []


def shown_names(page: Page) -> list[str]:
    return page.locator("tbody tr:visible th").all_inner_texts()


def test_the_report_is_sorted_and_filtered_without_a_network(report: Page) -> None:
    names = shown_names(report)
    assert len(names) == 14
    report.get_by_role("button", name="yaw, deg").click()
    ascending = shown_names(report)
    assert sorted(ascending) == sorted(names)
    # What failed has no yaw, and comes last both ways.
    assert ascending[-2:] == ["bumped", HOSTILE]
    report.get_by_role("button", name="yaw, deg").click()
    descending = shown_names(report)
    assert descending == [*reversed(ascending[:-1]), HOSTILE]
    report.get_by_label("Show").select_option("mount moved")
    assert shown_names(report) == ["bumped"]
    expect(report.locator("#count")).to_have_text("1 of 14")
    report.get_by_label("Show").select_option("=failed")
    assert shown_names(report) == [HOSTILE]
    report.get_by_label("Show").select_option("")
    report.get_by_label("Find").fill("RUN_1")
    assert sorted(shown_names(report)) == ["run_10", "run_11"]


def test_the_policy_of_the_report_stops_a_script_that_slips_in(report: Page) -> None:
    report.evaluate("document.body.insertAdjacentHTML('beforeend', '<p id=late></p>')")
    blocked = report.evaluate(
        """() => new Promise(resolve => {
            document.addEventListener('securitypolicyviolation', e => resolve(e.violatedDirective));
            const late = document.createElement('button');
            late.setAttribute('onclick', 'document.title = 1');
            document.getElementById('late').append(late);
            late.click();
        })"""
    )
    assert blocked.startswith("script-src")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_report_fits_the_screen_in_both_colours(
    browser: Browser, shelf: Path, scheme: str
) -> None:
    context = browser.new_context(color_scheme=scheme, viewport={"width": 390, "height": 800})
    page = context.new_page()
    page.goto((shelf / "night" / "report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    background = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert background == {"light": "rgb(255, 255, 255)", "dark": "rgb(27, 29, 31)"}[scheme]
    context.close()


def test_a_batch_is_listed_sorted_and_gone_through(
    browser: Browser, shelf: Path, small_scene: Path, tmp_path: Path
) -> None:
    options = ServeOptions(recordings=[small_scene], roots=[shelf], port=0, output_root=tmp_path)
    context = browser.new_context(viewport=SCREEN, device_scale_factor=0.5)
    context.set_default_timeout(ENOUGH_S * 1000)
    context.add_init_script(FEW_FRAMES)
    context.add_init_script(CARD_OF_NO_NAME)
    with Workbench(options) as workbench:
        page = context.new_page()
        page.goto(workbench.address)
        person = at_session(page, workbench, [])
        person.key("o")
        dialog = page.get_by_role("dialog")
        dialog.get_by_role("button", name=shelf.name).click()
        dialog.get_by_role("button", name="night").click()
        names = page.locator(".scanloom-batch tbody th")
        expect(names).to_have_count(14)
        expect(names.filter(has_text=HOSTILE)).to_have_count(1)
        yaw = page.locator(".scanloom-batch thead button", has_text="yaw")
        yaw.click()
        expect(page.locator(".scanloom-batch [aria-sort=ascending]")).to_contain_text("yaw")
        yaw.click()
        expect(names.first).to_have_text("◆ bumped")
        dialog.get_by_role("textbox").fill("run_0")
        expect(names).to_have_count(10)
        dialog.get_by_role("textbox").fill("")
        expect(names).to_have_count(14)
        names.first.get_by_role("button").click()
        person.wait_until(lambda: person.frame_view.view.recording == "data/bumped.mcap")
        walk = page.locator(".scanloom-walk")
        expect(walk).to_contain_text("night 1 of 14")
        page.keyboard.press("Shift+PageDown")
        person.wait_until(lambda: person.frame_view.view.recording == "data/run_04.mcap")
        walk.get_by_role("button", name="Previous").click()
        person.wait_until(lambda: person.frame_view.view.recording == "data/bumped.mcap")
        context.close()
