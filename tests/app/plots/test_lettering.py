"""Text lies where it is asked for, in whole pixels, whatever its signs."""

import threading

import numpy as np
import pytest

from scanloom.plots.lettering import shortened, width_of, write


def paper() -> np.ndarray:
    return np.full((60, 200, 3), 255, dtype=np.uint8)


def inked(sheet: np.ndarray) -> tuple[int, int, int, int]:
    """First and last row, first and last column that are not white."""
    rows, columns = np.nonzero((sheet < 255).any(axis=2))
    return rows.min(), rows.max(), columns.min(), columns.max()


@pytest.mark.parametrize(("align", "left", "right"), [("left", 100, 132), ("right", 66, 100)])
def test_text_begins_or_ends_at_its_place(align: str, left: int, right: int) -> None:
    sheet = paper()
    write(sheet, "1234", 100, 30, align=align)
    _, _, first, last = inked(sheet)
    assert left <= first < last <= right


def test_the_middle_of_figures_is_at_y() -> None:
    sheet = paper()
    write(sheet, "0", 100, 30, align="middle")
    top, bottom, first, last = inked(sheet)
    assert abs(0.5 * (top + bottom) - 30) <= 1
    assert abs(0.5 * (first + last) - 100) <= 1


def test_turned_text_reads_upwards() -> None:
    flat, turned = paper(), np.full((200, 60, 3), 255, dtype=np.uint8)
    write(flat, "Lo", 100, 30, align="middle")
    write(turned, "Lo", 30, 100, align="middle", turned=True)
    cut = []
    for sheet in (np.rot90(flat), turned):
        top, bottom, left, right = inked(sheet)
        assert abs(0.5 * (top + bottom) - 100) <= 2
        cut.append(sheet[top : bottom + 1, left : right + 1])
    assert np.array_equal(*cut)


@pytest.mark.parametrize("place", [(-5, 30), (195, 30), (100, -2), (100, 61), (-900, 900)])
def test_text_beyond_the_edge_is_cut(place: tuple[int, int]) -> None:
    write(paper(), "Beyond", *place)
    write(paper(), "Beyond", *place, turned=True)


def test_signs_that_the_font_lacks_are_shown_as_such() -> None:
    sheet = paper()
    write(sheet, "日\n", 20, 30)
    assert (sheet < 255).any()


def test_no_text_draws_nothing() -> None:
    sheet = paper()
    for text in ("", " "):
        write(sheet, text, 20, 30)
    assert (sheet == 255).all()


def test_a_long_text_is_cut_to_its_width() -> None:
    words = "/camera/depth/image_rect_raw " * 8
    short = shortened(words, 120)
    assert short.endswith("…")
    assert width_of(short) <= 120
    assert width_of(f"{words[: len(short)]}…") > 120
    assert shortened("short", 120) == "short"
    assert shortened("anything", 1) == ""


def test_threads_draw_the_same() -> None:
    texts = [f"text {number}: ε = {number / 7:.3f} °" for number in range(60)]
    sheets = [np.full((1200, 200, 3), 255, dtype=np.uint8) for _ in range(4)]

    def draw(sheet: np.ndarray) -> None:
        for place, text in enumerate(texts):
            write(sheet, text, 4, 10 + 20 * place)

    threads = [threading.Thread(target=draw, args=(sheet,)) for sheet in sheets]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(sheet, sheets[0]) for sheet in sheets)
