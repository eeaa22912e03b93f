"""Gaps in time on paper: where each image is drawn, and what is beyond the plot."""

from typing import Any

import numpy as np
import pytest

from scanloom.plots.gaps_picture import GapsPicture, gaps_picture
from scanloom.plots.lettering import INK
from scanloom.plots.palette import color_of

SIZE = {"width_px": 480, "height_px": 280}
TIMES_S = np.linspace(0.0, 6.0, 13)


def drawn(gap_ms: Any, paired: Any = None, period_ms: float = float("nan")) -> GapsPicture:
    gap_ms = np.asarray(gap_ms, dtype=float)
    paired = np.ones(gap_ms.shape, dtype=bool) if paired is None else np.asarray(paired)
    times_s = TIMES_S[: gap_ms.size]
    return gaps_picture(times_s, gap_ms, paired, period_ms=period_ms, max_gap_ms=60.0, **SIZE)


def inside(picture: GapsPicture, color: tuple[int, int, int]) -> np.ndarray:
    """(rows, columns) bool: pixels of the plot of exactly this colour."""
    return (picture.box.view(picture.rgb) == color).all(axis=-1)


def test_each_image_is_a_dot_at_its_time_and_gap() -> None:
    gaps_ms = np.linspace(-20.0, 30.0, 13)
    picture = drawn(gaps_ms)
    assert picture.reach_ms > 30.0
    depth = color_of("depth")
    expected = np.zeros(picture.rgb.shape[:2], dtype=bool)
    for time_s, gap_ms in zip(TIMES_S, gaps_ms, strict=True):
        share = (time_s - TIMES_S[0]) / (TIMES_S[-1] - TIMES_S[0])
        x = round(picture.box.left + share * (picture.box.width - 1))
        y = round(
            picture.box.top + (1.0 - gap_ms / picture.reach_ms) / 2.0 * (picture.box.height - 1)
        )
        expected[y - 1 : y + 2, x - 1 : x + 2] = True
    assert np.array_equal(inside(picture, depth), picture.box.view(expected))


def test_an_image_without_a_scan_is_a_cross_at_the_edge() -> None:
    gaps_ms = np.zeros(13)
    gaps_ms[[4, 8]] = 500.0, np.nan
    paired = np.isfinite(gaps_ms) & (gaps_ms < 60.0)
    picture = drawn(gaps_ms, paired)
    for index in (4, 8):
        x, y = picture.place_of(float(TIMES_S[index]), np.inf)
        assert y == picture.box.top
        near = picture.rgb[y : y + 6, x - 5 : x + 6]
        assert (near.max(axis=-1) < 90).any()
    # The pairs keep the scale.
    assert picture.reach_ms < 1.0


def test_all_is_drawn_where_nothing_is_paired() -> None:
    picture = drawn(np.full(13, -300.0), np.zeros(13, dtype=bool))
    assert picture.reach_ms > 300.0
    assert not inside(picture, color_of("depth")).any()
    row = picture.place_of(0.0, -300.0)[1] - picture.box.top
    dark = picture.box.view(picture.rgb).max(axis=-1) < 90
    assert dark[row - 3 : row + 4].sum() > 13 * 5
    assert not dark[: row - 4].any()


def test_half_the_scans_period_is_dashed_where_it_is_in_the_plot() -> None:
    gaps_ms = np.linspace(-45.0, 45.0, 13)
    with_lines, without = drawn(gaps_ms, period_ms=80.0), drawn(gaps_ms, period_ms=200.0)
    rows = [with_lines.place_of(0.0, gap)[1] for gap in (-40.0, 40.0)]
    for row in rows:
        line = slice(with_lines.box.left, with_lines.box.right)
        dashed = (with_lines.rgb[row, line] < 200).all(axis=-1)
        assert 0.3 < dashed.mean() < 0.8
        assert (without.rgb[row, line] < 200).all(axis=-1).mean() < 0.1


def test_the_present_frame_is_marked_in_a_copy() -> None:
    picture = drawn(np.linspace(-20.0, 30.0, 13))
    before = picture.rgb.copy()
    marked = picture.with_present(3.0, 5.0)
    assert np.array_equal(picture.rgb, before)
    x, y = picture.place_of(3.0, 5.0)
    changed = (marked != before).any(axis=-1)
    columns = np.flatnonzero(changed.any(axis=0))
    assert columns.min() >= x - 7
    assert columns.max() <= x + 7
    assert (marked[picture.box.top + 1, x] == INK).all()
    ring = changed[y - 7 : y + 8, x - 7 : x + 8].any(axis=0).sum()
    assert ring > 8
    # Without a gap there is a line and no ring.
    line = (picture.with_present(3.0, None) != before).any(axis=-1)
    assert np.flatnonzero(line.any(axis=0)).tolist() == [x]


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_and_one_image_can_be_drawn(count: int) -> None:
    picture = drawn(np.full(count, 7.0))
    assert inside(picture, color_of("depth")).sum() == 9 * count
    picture.with_present(0.0, 7.0)
