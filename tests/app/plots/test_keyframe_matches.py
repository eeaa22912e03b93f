"""Two keyframes, and lines from where one sees a landmark to where the other does."""

import numpy as np
import pytest

from scanloom.plots.keyframe_matches import LINES_MAX, drawn_matches, keyframe_matches_picture
from scanloom.plots.theme import DARK, LIGHT, Theme


def picture(pixels: np.ndarray, theme: Theme = LIGHT, *, wide: int = 64) -> np.ndarray:
    images = np.full((48, 64, 3), 90, np.uint8), np.full((48, wide, 3), 160, np.uint8)
    places = pixels.astype(np.float32), pixels.astype(np.float32)
    return keyframe_matches_picture(images, places, ("first", "second"), width_px=200, theme=theme)


@pytest.mark.parametrize("theme", [LIGHT, DARK])
def test_a_line_joins_both_images(theme: Theme) -> None:
    none = picture(np.empty((0, 2)), theme)
    one = picture(np.array([[32.0, 24.0]]), theme)
    assert none.shape == one.shape
    rows, columns = np.nonzero((none != one).any(axis=2))
    # From the middle of one image to the middle of the other, straight down.
    middle = 8 + 184 * 32.5 / 64
    assert np.abs(columns - middle).max() <= 4.0
    assert rows.max() - rows.min() == pytest.approx(138 + 18 + 8, abs=6)
    assert set(rows) == set(range(rows.min(), rows.max() + 1))


def test_images_of_other_sizes_are_as_wide() -> None:
    both = picture(np.array([[3.0, 4.0]]), wide=128)
    assert both.shape[1] == 200
    grey = (both == 160).all(axis=2)
    assert grey.any(axis=0).sum() == pytest.approx(184, abs=1)


def test_of_many_some_are_drawn_from_left_to_right() -> None:
    pixels = np.random.default_rng(1).uniform(0.0, 640.0, (500, 2)).astype(np.float32)
    chosen = drawn_matches(pixels)
    assert chosen.size == LINES_MAX
    assert (np.diff(pixels[chosen, 0]) >= 0.0).all()
    assert pixels[chosen[0], 0] == pixels[:, 0].min()
    assert pixels[chosen[-1], 0] == pixels[:, 0].max()
    assert drawn_matches(pixels[:5]).size == 5
    assert drawn_matches(pixels[:0]).size == 0
