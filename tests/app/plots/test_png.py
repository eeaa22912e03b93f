"""Pictures encoded for the browser: exactly, once for each, and not kept longer than they are."""

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from fusion_core.model.conventions import ByteArray
from scanloom.plots.png import png_of, show_picture


@pytest.fixture
def picture() -> ByteArray:
    return np.random.default_rng(1).integers(0, 256, (30, 40, 3), dtype=np.uint8)


def test_a_png_holds_the_picture_exactly(picture: ByteArray) -> None:
    bgr = cv2.imdecode(np.frombuffer(png_of(picture), np.uint8), cv2.IMREAD_COLOR)
    assert bgr is not None
    assert np.array_equal(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), picture)


def test_every_place_shows_the_same_bytes(picture: ByteArray) -> None:
    places: list[Any] = [SimpleNamespace(), SimpleNamespace()]
    for place in places:
        show_picture(place, picture)
    assert places[0]._format == "png"
    assert places[0]._data is places[1]._data


def test_an_encoded_picture_cannot_change(picture: ByteArray) -> None:
    png_of(picture)
    with pytest.raises(ValueError, match="read-only"):
        picture[0, 0] = 0


def test_another_picture_at_the_same_place_in_memory_is_encoded_anew() -> None:
    # A freed picture's identity is given to the next.
    seen = {png_of(np.full((8, 8, 3), shade, dtype=np.uint8)) for shade in range(50)}
    assert len(seen) == 50
