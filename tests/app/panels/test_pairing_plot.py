"""Gaps in time as curves: each image at its time and gap, and what is beyond the plot."""

from typing import Any

import numpy as np
import pytest

from fusion_core.model.conventions import NS_PER_S
from fusion_core.workflows.fuse.pairing_gaps import PairingGaps
from scanloom.panels.pairing_plot import GapCurves

TIMES_S = np.linspace(0.0, 6.0, 13)
FIRST_NS = 10**18


def curves(gap_ms: Any, paired: Any = None, period_ms: float = float("nan")) -> GapCurves:
    gap_ms = np.asarray(gap_ms, dtype=float)
    paired = np.ones(gap_ms.shape, dtype=bool) if paired is None else np.asarray(paired)
    times_ns = FIRST_NS + np.rint(TIMES_S[: gap_ms.size] * NS_PER_S).astype(np.int64)
    return GapCurves(
        PairingGaps(time_ns=times_ns, gap_ms=gap_ms, is_paired=paired, scan_period_ms=period_ms),
        FIRST_NS,
    )


def at(drawn: GapCurves, time_s: float = 3.0) -> list[np.ndarray]:
    """Times, pairs, images without a scan, both lines of half a period, and the present frame."""
    return list(drawn.data_at(FIRST_NS + round(time_s * NS_PER_S)))


def test_each_image_is_at_its_time_and_gap() -> None:
    gaps_ms = np.linspace(-20.0, 30.0, 13)
    drawn = curves(gaps_ms)
    assert drawn.limit_ms > 30.0
    time_s, pair_ms, alone_ms, *_ = at(drawn)
    known = np.isfinite(pair_ms)
    np.testing.assert_allclose(time_s[known], TIMES_S)
    np.testing.assert_array_equal(pair_ms[known], gaps_ms)
    assert np.isnan(alone_ms).all()
    assert (np.diff(time_s) >= 0.0).all()


def test_images_in_another_order_are_drawn_in_that_of_time() -> None:
    gaps = PairingGaps(
        time_ns=FIRST_NS + np.array([4, 2, 3], dtype=np.int64) * NS_PER_S,
        gap_ms=np.array([40.0, 20.0, 30.0]),
        is_paired=np.ones(3, dtype=bool),
        scan_period_ms=np.nan,
    )
    time_s, pair_ms, *_ = at(GapCurves(gaps, FIRST_NS), 0.0)
    known = np.isfinite(pair_ms)
    assert time_s[known].tolist() == [2.0, 3.0, 4.0]
    assert pair_ms[known].tolist() == [20.0, 30.0, 40.0]


def test_an_image_without_a_scan_is_at_the_edge() -> None:
    gaps_ms = np.zeros(13)
    gaps_ms[[4, 8]] = 500.0, np.nan
    paired = np.isfinite(gaps_ms) & (gaps_ms < 60.0)
    drawn = curves(gaps_ms, paired)
    time_s, pair_ms, alone_ms, *_ = at(drawn)
    alone = np.isfinite(alone_ms)
    np.testing.assert_allclose(time_s[alone], TIMES_S[[4, 8]])
    assert (alone_ms[alone] == drawn.limit_ms).all()
    assert np.isfinite(pair_ms).sum() == 11
    # The pairs keep the scale.
    assert drawn.limit_ms < 1.0


def test_all_is_drawn_where_nothing_is_paired() -> None:
    drawn = curves(np.full(13, -300.0), np.zeros(13, dtype=bool))
    assert drawn.limit_ms > 300.0
    _, pair_ms, alone_ms, *_ = at(drawn)
    assert np.isnan(pair_ms).all()
    assert alone_ms[np.isfinite(alone_ms)].tolist() == [-300.0] * 13


def test_half_the_scans_period_is_drawn_where_it_is_in_the_plot() -> None:
    gaps_ms = np.linspace(-45.0, 45.0, 13)
    *_, upper, lower, _ = at(curves(gaps_ms, period_ms=80.0))
    assert set(upper[np.isfinite(upper)]) == {40.0}
    assert set(lower[np.isfinite(lower)]) == {-40.0}
    *_, upper, lower, _ = at(curves(gaps_ms, period_ms=200.0))
    assert np.isnan([upper, lower]).all()


@pytest.mark.parametrize("count", [0, 1, 13])
def test_the_present_frame_is_a_line_from_edge_to_edge(count: int) -> None:
    drawn = curves(np.full(count, 7.0))
    time_s, pair_ms, *_, here = at(drawn, 3.2)
    marked = np.isfinite(here)
    assert time_s[marked].tolist() == [3.2, 3.2]
    assert here[marked].tolist() == [-drawn.limit_ms, drawn.limit_ms]
    # The line stands beside the images, and is none.
    assert np.isfinite(pair_ms).sum() == count
    assert not (np.isfinite(pair_ms) & marked).any()
