"""Numbers as text: with a deviation, against decimal arithmetic, and with what they count."""

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.number_text import counted, with_deviation


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (-0.0812, 0.0043, "-0.0812 ± 0.0043"),
        (-10.1634, 0.0443, "-10.163 ± 0.044"),
        (-0.49, 1.87, "-0.5 ± 1.9"),
        (1.23456, 0.0996, "1.23 ± 0.10"),
        (-0.0001, 0.03, "0.000 ± 0.030"),
        (1234.6, 456.7, "1235 ± 457"),
        (0.25, 0.0, "0.25 ± 0"),
    ],
)
def test_both_have_the_digits_that_the_deviation_leaves(value: float, sd: float, text: str) -> None:
    assert " ± ".join(with_deviation(value, sd)) == text


@given(st.floats(-1e3, 1e3), st.floats(1e-6, 99.0))
def test_rounding_is_small_beside_the_deviation_and_no_deviation_vanishes(
    value: float, sd: float
) -> None:
    number, deviation = (Decimal(text) for text in with_deviation(value, sd))
    assert number.as_tuple().exponent == deviation.as_tuple().exponent
    assert 10 <= int(deviation.scaleb(-int(deviation.as_tuple().exponent))) <= 99
    # Half a unit of the second of two digits, at least 10.
    assert abs(deviation - Decimal(sd)) <= Decimal(sd) / 19
    assert abs(number - Decimal(value)) <= Decimal(sd) / 19


@pytest.mark.parametrize(
    ("value", "sd"), [(float("nan"), 1.0), (1.0, float("inf")), (1.0, -0.1), (1.0, float("nan"))]
)
def test_what_is_unknown_is_not_stated(value: float, sd: float) -> None:
    with pytest.raises(ValueError, match="need a finite number"):
        with_deviation(value, sd)


def test_one_thing_is_no_plural() -> None:
    said = [counted(number, "keyframe") for number in (0, 1, 2, 1234)]
    assert said == ["0 keyframes", "1 keyframe", "2 keyframes", "1,234 keyframes"]
