"""The Match panel: a slider dragged, and an offset picked on the similarity."""

import re

import numpy as np
from playwright.sync_api import expect

from scanloom.panels.pictures import SimilarityPanel
from tests.app.browser.person import Person, match_of, peak_of

# Of each plot: the least and the greatest x that are seen, and the last of the data.
SHOWN_X = """Object.values(window.__viserTestpoints?.uplots ?? {})
    .map(({chart}) => [chart.scales.x.min, chart.scales.x.max, chart.data[0].at(-1)])
    .filter(shown => shown[2] > 1 && shown[0] !== null)"""


def test_the_sampling_slider_changes_heatmap_and_peak(person: Person) -> None:
    person.open_step("Match")
    person.unfold("Pick by hand")
    expect(person.text("Best fit: u =")).to_be_visible()
    frame_view = person.frame_view
    first = peak_of(frame_view, person.session.view)
    assert person.peak() == first
    before = person.picture("similarity")
    person.unfold("Sampling and masks")
    step_deg = person.drag("Sampling step (°)", 60.0)
    assert step_deg > 1.0
    person.wait_until(lambda: person.frame_view.view.settings.sampling.step_deg == step_deg)
    second = peak_of(frame_view, person.frame_view.view)
    assert second != first
    person.wait_for_peak(second)
    person.wait_for_another_picture("similarity", before)
    # A slow drag may be several changes.
    while person.session.view.preset_overrides():
        person.change_by_key("Control+z")
    person.wait_for_peak(first)
    person.wait_until(lambda: np.array_equal(person.picture("similarity"), before))


def test_a_click_on_the_similarity_picks_the_offset_under_it(person: Person) -> None:
    person.open_step("Match")
    person.unfold("Pick by hand")
    expect(person.text("Best fit: u =")).to_be_visible()
    picture = person.picture("similarity")
    field = match_of(person.frame_view, person.session.view).search.fields["euclidean"]
    rows, columns = field.scores.shape
    for right, down in ((0.6, 0.3), (0.3, 0.8)):
        shown = person.panel(SimilarityPanel)._drawn.axes.box
        left, top, width, height = shown.left, shown.top, shown.width, shown.height
        x_px, y_px = left + right * width, top + down * height
        person.page.mouse.click(*person.place_on("similarity", x_px, y_px))
        u = field.u_first + (x_px - left + 0.5) * columns / width - 0.5
        v = (y_px - top + 0.5) * rows / height - 0.5
        person.wait_for_number("u (samples)", u, within=1.5)
        person.wait_for_number("v (row)", v, within=1.5)
        # The mark of what was picked takes a line below the next picture.
        picture = person.wait_for_another_picture("similarity", picture)
    expect(person.text(re.compile(r"Laid on row \d+ by hand"))).to_be_visible()
    assert person.session.view.picked_offset is not None
    person.press("Clear")
    u, v = peak_of(person.frame_view, person.session.view)
    person.wait_for_number("u (samples)", u, within=0.01)
    # Rows are shown whole.
    person.wait_for_number("v (row)", v, within=0.51)


def test_both_curves_are_seen_whole(person: Person) -> None:
    person.key("Alt+2")
    person.wait_for_panel("Match")
    person.wait_until(lambda: bool(person.page.evaluate(SHOWN_X)))
    # viser draws again when the limits of y have changed, and has lost those of x by then.
    ((least, greatest, last),) = person.page.evaluate(SHOWN_X)
    assert least == 0.0
    assert last <= greatest < 1.5 * last
