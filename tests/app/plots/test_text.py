"""Text lies at its place in whole pixels, whatever its characters."""

import threading

import numpy as np
import pytest

from scanloom.plots.text import draw_text, draw_vertical_text, shorten, text_width


def canvas() -> np.ndarray:
    return np.full((60, 200, 3), 255, dtype=np.uint8)


def ink_box(rgb: np.ndarray) -> tuple[int, int, int, int]:
    """First and last row, first and last column that are not white."""
    rows, columns = np.nonzero((rgb < 255).any(axis=2))
    return rows.min(), rows.max(), columns.min(), columns.max()


@pytest.mark.parametrize(("align", "left", "right"), [("left", 100, 132), ("right", 66, 100)])
def test_text_begins_or_ends_at_its_place(align: str, left: int, right: int) -> None:
    rgb = canvas()
    draw_text(rgb, "1234", (100, 30), align=align)
    _, _, first, last = ink_box(rgb)
    assert left <= first < last <= right


def test_the_middle_of_digits_is_at_y() -> None:
    rgb = canvas()
    draw_text(rgb, "0", (100, 30), align="middle")
    top, bottom, first, last = ink_box(rgb)
    assert abs(0.5 * (top + bottom) - 30) <= 1
    assert abs(0.5 * (first + last) - 100) <= 1


def test_vertical_text_reads_upwards() -> None:
    flat, vertical = canvas(), np.full((200, 60, 3), 255, dtype=np.uint8)
    draw_text(flat, "Lo", (100, 30), align="middle")
    draw_vertical_text(vertical, "Lo", (30, 100))
    cut = []
    for rgb in (np.rot90(flat), vertical):
        top, bottom, left, right = ink_box(rgb)
        assert abs(0.5 * (top + bottom) - 100) <= 2
        cut.append(rgb[top : bottom + 1, left : right + 1])
    assert np.array_equal(*cut)


@pytest.mark.parametrize("place", [(-5, 30), (195, 30), (100, -2), (100, 61), (-900, 900)])
def test_text_beyond_the_edge_is_cut(place: tuple[int, int]) -> None:
    draw_text(canvas(), "Beyond", place)
    draw_vertical_text(canvas(), "Beyond", place)


def test_characters_that_the_font_lacks_are_replaced() -> None:
    rgb = canvas()
    draw_text(rgb, "日\n", (20, 30))
    assert (rgb < 255).any()


def test_no_text_draws_nothing() -> None:
    rgb = canvas()
    for text in ("", " "):
        draw_text(rgb, text, (20, 30))
    assert (rgb == 255).all()


def test_a_long_text_is_cut_to_its_width() -> None:
    words = "/camera/depth/image_rect_raw " * 8
    short = shorten(words, 120)
    assert short.endswith("…")
    assert text_width(short) <= 120
    assert text_width(f"{words[: len(short)]}…") > 120
    assert shorten("short", 120) == "short"
    assert shorten("anything", 1) == ""


def test_threads_draw_the_same() -> None:
    texts = [f"text {number}: ε = {number / 7:.3f} °" for number in range(60)]
    pictures = [np.full((1200, 200, 3), 255, dtype=np.uint8) for _ in range(4)]

    def draw(rgb: np.ndarray) -> None:
        for place, text in enumerate(texts):
            draw_text(rgb, text, (4, 10 + 20 * place))

    threads = [threading.Thread(target=draw, args=(rgb,)) for rgb in pictures]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(rgb, pictures[0]) for rgb in pictures)
