"""The Match panel: a slider dragged, and an offset picked on the heatmap in the scene."""

import cv2
import numpy as np
from playwright.sync_api import expect

from tests.app.browser.person import Person, colourful, match_of, peak_of


def test_the_sampling_slider_changes_heatmap_and_peak(person: Person) -> None:
    person.press("Match")
    expect(person.text("Peak u =")).to_be_visible()
    frame_view = person.frame_view
    first = peak_of(frame_view, person.session.view)
    assert person.peak() == first
    before = person.picture()
    step_deg = person.drag("Sampling step (°)", 60.0)
    assert step_deg > 1.0
    person.wait_until(lambda: person.frame_view.view.settings.sampling.step_deg == step_deg)
    second = peak_of(frame_view, person.frame_view.view)
    assert second != first
    person.wait_for_peak(second)
    person.wait_for_another_picture(before)
    # A slow drag may be several changes.
    while person.session.view.preset_overrides():
        person.press("Undo")
        person.page.wait_for_timeout(100)
    person.wait_for_peak(first)
    person.wait_until(lambda: np.array_equal(person.picture(), before))


def test_a_click_on_the_heatmap_picks_the_offset_under_it(person: Person) -> None:
    person.press("Match")
    expect(person.text("Peak u =")).to_be_visible()
    picture = person.picture()
    field = match_of(person.frame_view, person.session.view).search.fields["euclidean"]
    canvas = person.page.locator("canvas[data-engine]").bounding_box()
    assert canvas is not None
    person.press("Heatmap")
    # The image plane faces the camera and fills the screen's height but for a tenth.
    picture_per_screen_px = 1.1 * picture.shape[1] / canvas["height"]
    x = canvas["x"] + canvas["width"] / 2
    y = canvas["y"] + canvas["height"] / 2
    around = np.s_[round(y / 2) - 20 : round(y / 2) + 60, round(x / 2) - 60 : round(x / 2) + 60]
    person.wait_until(lambda: bool(colourful(person.screen()[around]).mean() > 0.5))
    rows, columns = field.scores.shape
    for right_px, down_px in ((30.0, 20.0), (-90.0, 60.0)):
        person.page.mouse.click(x + right_px, y + down_px)
        left, top, width, height = box_of_field(picture)
        x_px = (picture.shape[1] - 1) / 2 + right_px * picture_per_screen_px
        y_px = (picture.shape[0] - 1) / 2 + down_px * picture_per_screen_px
        u = field.u_first + (x_px - left + 0.5) * columns / width - 0.5
        v = (y_px - top + 0.5) * rows / height - 0.5
        person.wait_for_number("u (samples)", u, within=1.0)
        person.wait_for_number("v (row)", v, within=1.0)
        # The mark of what was picked takes a line below the next picture.
        picture = person.wait_for_another_picture(picture)
    expect(person.text("Picked by hand: u =")).to_be_visible()
    assert person.session.view.picked_offset is not None
    person.press("Clear")
    u, v = peak_of(person.frame_view, person.session.view)
    person.wait_for_number("u (samples)", u, within=0.01)
    # Rows are shown whole.
    person.wait_for_number("v (row)", v, within=0.51)


def box_of_field(picture: np.ndarray) -> tuple[int, int, int, int]:
    """(left, top, width, height) of the field in a heatmap: its largest coloured part."""
    mask = cv2.morphologyEx(
        colourful(picture).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8)
    )
    _, _, boxes, _ = cv2.connectedComponentsWithStats(mask)
    left, top, width, height, _ = max(boxes[1:], key=lambda box: int(box[cv2.CC_STAT_AREA]))
    return int(left), int(top), int(width), int(height)
