"""How long something lasts, as people say it."""

import pytest

from scanloom.scene.duration_text import duration_text


@pytest.mark.parametrize(
    ("duration_s", "text"),
    [
        (0.0, "0 s"),
        (0.3712, "0.37 s"),
        (1.97, "2 s"),
        (59.4, "59 s"),
        (59.6, "1 min"),
        (104.0, "1 min 44 s"),
        (2672.3, "44 min 32 s"),
        (3599.7, "1 h"),
        (7500.0, "2 h 5 min"),
    ],
)
def test_a_duration_has_the_digits_that_it_deserves(duration_s: float, text: str) -> None:
    assert duration_text(duration_s) == text
