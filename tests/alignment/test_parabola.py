"""The extremum between samples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.alignment.parabola import parabola_offset


@given(
    peak=st.floats(-0.49, 0.49), curvature=st.floats(0.01, 100.0), height=st.floats(-100.0, 100.0)
)
def test_parabola_offset_is_exact_on_parabolas(
    peak: float, curvature: float, height: float
) -> None:
    places = np.arange(5.0) - 2.0 - peak
    low = height + curvature * places**2
    assert parabola_offset(low, 2) == pytest.approx(peak, abs=1e-6)
    assert parabola_offset(-low, 2) == pytest.approx(peak, abs=1e-6)


@pytest.mark.parametrize(
    ("values", "best"),
    [
        ([3.0, 2.0, 1.0], 0),
        ([1.0, 2.0, 3.0], 2),
        ([np.nan, 2.0, 1.0], 1),
        ([1.0, 2.0, np.nan], 1),
        ([2.0, 2.0, 2.0], 1),
        ([1.0, 2.0, 4.0], 1),
        ([4.0, 2.0, 1.0], 1),
    ],
)
def test_parabola_offset_is_zero_where_there_is_no_parabola(values: list[float], best: int) -> None:
    assert parabola_offset(np.array(values), best) == 0.0
