"""The Repair panel: classes filtered in its pictures."""

import numpy as np
from playwright.sync_api import expect

from fusion_core.model.classes import NoiseClass
from scanloom.plots.canvas import Box
from scanloom.plots.palette import class_color, color_of
from tests.app.browser.expected_frame import NUMBER, expected_frame, repaired_picture
from tests.app.browser.person import Person

# Once holes are hidden, what fills them is seen.
HIDDEN = (NoiseClass.CONFLICT, NoiseClass.BURR, NoiseClass.HOLE)


def test_a_class_that_is_filtered_loses_its_colour_and_the_others_stay(person: Person) -> None:
    person.look_at(
        person.session.view.changed(frame_index=NUMBER, panel="Repair", show_raw_and_repaired=True)
    )
    frame = expected_frame(person.frame_view, person.session.view)
    person.unfold("Classes, before and after")
    expect(person.text("of the holes and burrs")).to_be_visible()
    frame_view = person.figure(1)
    first = repaired_picture(frame, person.session.view, frame_view)
    person.wait_for_figure(first.rgb, 1)
    whole = colors_in(person, first.axes.box)
    assert all(min(pixels) > 0 for pixels in whole.values())
    left = frozenset(NoiseClass)
    for noise in HIDDEN:
        person.page.get_by_label(f"Show {noise.name.lower()}", exact=True).uncheck()
        left -= {noise}
        view = person.session.view.changed(visible_classes=left)
        expected = repaired_picture(frame, view, frame_view)
        person.wait_for_figure(expected.rgb, 1)
        seen = colors_in(person, expected.axes.box)
        # What a dot of a hidden class had covered comes to light.
        assert all(seen[kept][place] >= whole[kept][place] for kept in left for place in (0, 1))
        assert all(seen[gone] == (0, 0) for gone in set(NoiseClass) - left)
    for noise in HIDDEN:
        person.page.get_by_label(f"Show {noise.name.lower()}", exact=True).check()
    person.wait_for_figure(first.rgb, 1)
    assert colors_in(person, first.axes.box) == whole
    assert person.session.view.visible_classes == set(NoiseClass)


def colors_in(person: Person, box: Box) -> dict[NoiseClass, tuple[int, int]]:
    """Pixels in the colour of each class, of good ones in that of the LiDAR's line, in the images
    before and after the repair, which lie in the same place of their pictures, without the
    legend."""
    pictures = [box.view(person.figure(place))[..., ::-1] for place in (0, 1)]
    found = {}
    for noise in NoiseClass:
        color = color_of("lidar") if noise == NoiseClass.GOOD else class_color(noise)
        before, after = (int(np.all(picture == color, axis=2).sum()) for picture in pictures)
        found[noise] = before, after
    return found
