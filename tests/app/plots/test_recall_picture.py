"""Recall curves on paper: where they are drawn, the paper's band, and the present epsilon."""

import numpy as np
import pytest

from scanloom.plots.lettering import INK
from scanloom.plots.palette import Color, color_of
from scanloom.plots.recall_picture import RecallPicture, recall_picture

FACTORS = np.linspace(0.2, 6.0, 30)
RISING = np.linspace(0.1, 0.9, 30)
BAND = (1.0, float(np.sqrt(2.0)))


def drawn(xi: np.ndarray | None = RISING, eta: np.ndarray | None = RISING[::-1]) -> RecallPicture:
    return recall_picture(FACTORS, xi, eta, band=BAND, width_px=480, height_px=300)


def has_near(picture: RecallPicture, place: tuple[int, int], color: Color) -> bool:
    """Whether a colour is within two pixels of a place."""
    x, y = place
    part = picture.rgb[max(y - 2, 0) : y + 3, max(x - 2, 0) : x + 3].astype(int)
    return bool((np.abs(part - color).max(axis=-1) <= 2).any())


@pytest.mark.parametrize(("name", "shares"), [("good", RISING), ("burr", RISING[::-1])])
def test_each_recall_goes_through_its_shares(name: str, shares: np.ndarray) -> None:
    picture = drawn()
    color = color_of(name)  # type: ignore[arg-type]  # one of the palette's names
    for factor, share in zip(FACTORS, shares, strict=True):
        assert has_near(picture, picture.place_of(factor, share), color)
    assert not has_near(picture, picture.place_of(3.0, 0.95), color)


def test_shares_run_from_bottom_to_top_and_factors_from_left_to_right() -> None:
    picture = drawn()
    left, bottom = picture.place_of(0.0, 0.0)
    right, top = picture.place_of(FACTORS[-1], 1.0)
    box = picture.box
    assert (left, right, top, bottom) == (box.left, box.right - 1, box.top, box.bottom - 1)
    assert picture.place_of(100.0, 0.5)[0] == right


def test_the_papers_band_is_grey() -> None:
    picture = drawn(None, None)
    row = picture.rgb[picture.place_of(0.0, 0.45)[1]]
    inside = row[picture.place_of(1.2, 0.0)[0]]
    assert inside.max() < 240
    for factor in (0.9, 1.6):
        assert (row[picture.place_of(factor, 0.0)[0]] == 255).all()


def test_what_there_is_no_pair_of_is_not_drawn() -> None:
    only_good = drawn(eta=None)
    box = only_good.box.view(only_good.rgb)
    assert not (box == color_of("burr")).all(axis=-1).any()
    assert (box == color_of("good")).all(axis=-1).any()


def test_the_present_epsilon_is_marked_in_a_copy() -> None:
    picture = drawn()
    before = picture.rgb.copy()
    marked = picture.with_present(2.5, [0.4, 0.6])
    assert np.array_equal(picture.rgb, before)
    changed = (marked != before).any(axis=-1)
    x, _ = picture.place_of(2.5, 0.0)
    columns = np.flatnonzero(changed.any(axis=0))
    assert columns.min() >= x - 8
    assert columns.max() <= x + 8
    assert (marked[picture.box.top + 2, x] == INK).all()
    wide = np.flatnonzero(changed[:, x + 4])
    for share in (0.4, 0.6):
        assert np.abs(wide - picture.place_of(2.5, share)[1]).min() <= 4
    assert np.abs(wide - picture.place_of(2.5, 0.5)[1]).min() > 4
