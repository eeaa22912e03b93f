"""The heatmap: colours where the scores are, picking, marks inside the field, fields of nothing."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.plots.canvas import LINE_PX, MARGIN_PX
from scanloom.plots.color_scale import hatch
from scanloom.plots.heatmap import Heatmap, heatmap
from scanloom.plots.palette import color_map
from scanloom.plots.score_field import Mark, MarkKind
from scanloom.plots.theme import DARK


@dataclass
class Field:
    scores: np.ndarray
    u_first: int = 0


def ramp(rows: int = 60, columns: int = 90, u_first: int = 0) -> Field:
    values = np.linspace(0.2, 0.9, rows * columns).reshape(rows, columns)
    return Field(values, u_first)


def drawn(field: Field, *marks: Mark, width_px: int = 420, height_px: int = 380) -> Heatmap:
    return heatmap(field, marks, width_px=width_px, height_px=height_px)


def color_at(picture: Heatmap, u: float, v: float) -> list[int]:
    x, y = picture.axes.to_pixel(u, v)
    return picture.rgb[round(y), round(x)].tolist()


def test_the_least_score_is_darkest_and_the_greatest_lightest() -> None:
    picture = drawn(ramp())
    colors = color_map("viridis")
    assert color_at(picture, 0, 0) == colors[0].tolist()
    assert color_at(picture, 89, 59) == colors[255].tolist()
    assert picture.limits == pytest.approx((0.2, 0.9))


def test_a_cell_is_where_u_and_v_say() -> None:
    field = Field(np.zeros((50, 80)), u_first=-10)
    field.scores[30, 25] = 1.0
    picture = drawn(field)
    colors = color_map("viridis")
    assert color_at(picture, 15, 30) == colors[255].tolist()
    for u, v in ((14, 30), (16, 30), (15, 29), (15, 31)):
        assert color_at(picture, u, v) == colors[0].tolist()


def test_cells_without_a_score_are_hatched() -> None:
    field = ramp()
    field.scores[:30, :45] = np.nan
    picture = drawn(field)
    inside = picture.axes.box.view(picture.rgb)
    height, width = inside.shape[0] // 2 - 4, inside.shape[1] // 2 - 4
    assert np.array_equal(inside[:height, :width], hatch(*inside.shape[:2])[:height, :width])


@settings(max_examples=60)
@given(
    rows=st.integers(1, 300),
    columns=st.integers(1, 300),
    u_first=st.integers(-50, 50),
    fraction=st.tuples(st.floats(0, 1), st.floats(0, 1)),
)
def test_picking_undoes_drawing(
    rows: int, columns: int, u_first: int, fraction: tuple[float, float]
) -> None:
    picture = drawn(Field(np.zeros((rows, columns)), u_first), width_px=300, height_px=260)
    u, v = u_first + fraction[0] * (columns - 1), fraction[1] * (rows - 1)
    assert picture.offset_at(*picture.axes.to_pixel(u, v)) == pytest.approx((u, v), abs=1e-9)


@settings(max_examples=60)
@given(rows=st.integers(1, 300), columns=st.integers(1, 300), data=st.data())
def test_a_click_picks_the_cell_that_is_seen_there(
    rows: int, columns: int, data: st.DataObject
) -> None:
    field = Field(np.zeros((rows, columns)))
    empty = drawn(field, width_px=300, height_px=260)
    box = empty.axes.box
    x = data.draw(st.integers(box.left, box.right - 1))
    y = data.draw(st.integers(box.top, box.bottom - 1))
    offset = empty.offset_at(x, y)
    assert offset is not None
    u, v = (round(value) for value in offset)
    field.scores[v, u] = 1.0
    if rows * columns > 1:
        best = color_map("viridis")[255].tolist()
        shown = drawn(field, width_px=300, height_px=260).rgb[y, x].tolist()
        # On the border between two cells either may be picked.
        on_border = any(abs(value % 1.0 - 0.5) < 1e-9 for value in offset)
        assert shown == best or on_border


def test_outside_of_the_field_nothing_is_picked() -> None:
    picture = drawn(ramp())
    box = picture.axes.box
    for x, y in (
        (box.left - 1, box.top + 5),
        (box.right, box.top + 5),
        (box.left + 5, box.top - 1),
        (box.left + 5, box.bottom),
        (float("nan"), box.top + 5),
    ):
        assert picture.offset_at(x, y) is None


@pytest.mark.parametrize("kind", ["peak", "runner_up", "picked"])
@pytest.mark.parametrize("at", [(0.0, 0.0), (89.0, 59.0), (40.0, 20.0)])
def test_a_mark_is_drawn_at_its_place_and_nowhere_outside_of_the_field(
    kind: MarkKind, at: tuple[float, float]
) -> None:
    field = ramp()
    # So wide that the legend is of one line in both.
    without = drawn(field, Mark("prior", 40.0), width_px=800)
    picture = drawn(field, Mark("prior", 40.0), Mark(kind, *at), width_px=800)
    assert picture.axes.box == without.axes.box
    box = picture.axes.box
    changed = (picture.rgb != without.rgb).any(axis=2)
    # The legend names the mark; everything else around the field stays.
    changed[-LINE_PX - MARGIN_PX :] = False
    assert changed.any()
    rows, columns = np.nonzero(changed)
    x, y = picture.axes.to_pixel(*at)
    assert np.abs(rows - y).max() <= 12
    assert np.abs(columns - x).max() <= 12
    assert (rows >= box.top).all()
    assert (rows < box.bottom).all()
    assert (columns >= box.left).all()
    assert (columns < box.right).all()


def test_marks_differ_in_shape() -> None:
    shapes = []
    for kind in ("peak", "runner_up", "picked"):
        picture = drawn(ramp(), Mark(kind, 45.0, 30.0))
        x, y = (round(value) for value in picture.axes.to_pixel(45.0, 30.0))
        shapes.append(picture.rgb[y - 9 : y + 10, x - 9 : x + 10].tobytes())
    assert len(set(shapes)) == 3


def test_the_prior_is_a_line_through_all_rows() -> None:
    field = ramp()
    picture, without = drawn(field, Mark("prior", 33.0)), drawn(field)
    x = round(picture.axes.to_pixel(33.0, 0)[0])
    box = picture.axes.box
    column = picture.rgb[box.top : box.bottom, x]
    assert (column != without.rgb[box.top : box.bottom, x]).any(axis=1).all()
    assert len({tuple(color) for color in column.tolist()}) == 2


@pytest.mark.parametrize("at", [(1e300, -1e300), (-500.0, None), (45.0, 60.0)])
def test_a_mark_beyond_the_field_is_not_drawn_in_it(at: tuple[float, float | None]) -> None:
    # The legend is of one line in both.
    picture = drawn(ramp(), Mark("picked", *at), width_px=800)
    without = drawn(ramp(), Mark("prior", -9.0), width_px=800)
    assert picture.axes.box == without.axes.box
    assert np.array_equal(picture.axes.box.view(picture.rgb), without.axes.box.view(without.rgb))


def test_a_mark_that_does_not_exist_leaves_no_trace() -> None:
    nan = float("nan")
    assert np.array_equal(drawn(ramp(), Mark("runner_up", nan, nan)).rgb, drawn(ramp()).rgb)


@pytest.mark.parametrize(
    "field",
    [
        Field(np.full((240, 183), np.nan)),
        Field(np.random.default_rng(0).random((240, 1))),
        Field(np.array([[0.3]]), 7),
        Field(np.full((60, 320), 0.5), -40),
        Field(np.full((1, 200), -1.0)),
    ],
    ids=["all NaN", "one column", "one cell", "constant", "one row"],
)
def test_fields_of_little_are_drawn(field: Field) -> None:
    picture = drawn(field, Mark("peak", field.u_first, 0.0), Mark("prior", field.u_first))
    assert picture.rgb.shape == (380, 420, 3)
    assert picture.rgb.dtype == np.uint8
    assert (picture.limits is None) == bool(np.isnan(field.scores).all())
    box = picture.axes.box
    middle = picture.offset_at(box.left + box.width / 2, box.top + box.height / 2)
    assert middle is not None
    assert field.u_first <= middle[0] <= field.u_first + field.scores.shape[1] - 1


def test_a_picture_has_its_own_canvas_and_is_not_shared() -> None:
    picture = drawn(ramp())
    assert picture.rgb[3, 3].tolist() == [255, 255, 255]
    picture.rgb[:] = 0
    assert drawn(ramp()).rgb.any()


@settings(max_examples=60)
@given(
    rows=st.integers(1, 300),
    columns=st.integers(1, 300),
    u_first=st.integers(-50, 50),
    fraction=st.tuples(st.floats(0, 1), st.floats(0, 1)),
    width_px=st.sampled_from([350, 410]),
)
def test_place_and_offset_undo_each_other(
    rows: int, columns: int, u_first: int, fraction: tuple[float, float], width_px: int
) -> None:
    field = Field(np.zeros((rows, columns)), u_first)
    picture = heatmap(field, (), width_px=width_px, height_px=330)
    u, v = u_first + round(fraction[0] * (columns - 1)), round(fraction[1] * (rows - 1))
    place = picture.place_of(u, v)
    assert place is not None
    assert picture.offset_at(*place) == pytest.approx((u, v), abs=1e-9)
    for outside in ((u_first - 1, v), (u_first + columns, v), (u, -1), (u, rows)):
        assert picture.place_of(*outside) is None
    assert picture.place_of(float("nan"), v) is None


def test_a_field_takes_nearly_all_the_width_and_its_box_stays() -> None:
    marks = [Mark("peak", 45.0, 30.0), Mark("runner_up", 3.0, 4.0), Mark("prior", 40.0)]
    full = heatmap(ramp(), marks, width_px=410, height_px=330)
    assert full.rgb.shape == (330, 410, 3)
    assert full.axes.box.width >= 370
    assert full.axes.box.height >= 260
    empty = Field(np.full((60, 90), np.nan))
    dark = heatmap(empty, (), width_px=410, height_px=330, theme=DARK)
    assert dark.axes.box == full.axes.box
    assert dark.limits is None
    assert dark.rgb[1, 1].tolist() == list(DARK.background)


def test_the_best_scores_take_most_of_the_colours() -> None:
    picture = drawn(Field(np.linspace(0.0, 1.0, 101)[np.newaxis].repeat(20, axis=0)))
    good, better, best = (np.array(color_at(picture, u, 5)) for u in (80, 90, 100))
    bad, worse = (np.array(color_at(picture, u, 5)) for u in (20, 10))
    assert np.abs(best - better).sum() > 4 * np.abs(bad - worse).sum()
    assert np.abs(better - good).sum() > 4 * np.abs(bad - worse).sum()


def test_too_small_a_picture_is_refused() -> None:
    with pytest.raises(ValueError, match="px"):
        heatmap(ramp(), (), width_px=60, height_px=60)
    with pytest.raises(ValueError, match="px"):
        drawn(ramp(), width_px=420, height_px=50)
