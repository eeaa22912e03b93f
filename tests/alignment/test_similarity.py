"""The similarity field against the paper's formulae written out, and against dense products."""

from collections.abc import Sequence

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view
from skimage.registration._masked_phase_cross_correlation import cross_correlate_masked

from fusion_core.alignment.centred_curves import centre
from fusion_core.alignment.similarity import (
    Metric,
    similarity_field,
    similarity_fields,
    similarity_of_windows,
)
from fusion_core.model.errors import AlignmentFailed

METRICS: tuple[Metric, ...] = ("pearson", "cosine", "inverse_cosine", "euclidean")

# Squares lose half of the digits: of the difference in eq. (4) where a row equals the curve, of
# the variance in eq. (2) where there are millimetres beside metres.
TOLERANCE = {"pearson": 1e-7, "cosine": 1e-12, "inverse_cosine": 1e-12, "euclidean": 2e-6}


def paper_score(d: np.ndarray, l_hat: np.ndarray, metric: Metric) -> float:
    """Xu 2024 eqs. (2)-(4) on two vectors without holes; NaN where a denominator is zero."""
    if metric == "pearson":
        d, l_hat = d - d.mean(), l_hat - l_hat.mean()
        if max(abs(d)) < 1e-10 or max(abs(l_hat)) < 1e-10:
            return np.nan
        return float(d @ l_hat / np.sqrt((d @ d) * (l_hat @ l_hat)))
    norm_d, norm_l = np.linalg.norm(d), np.linalg.norm(l_hat)
    if norm_d == 0.0 or norm_l == 0.0:
        return np.nan
    if metric == "euclidean":
        return float(1.0 - np.linalg.norm(d - l_hat) / max(norm_d, norm_l))
    cosine = float(d @ l_hat / (norm_d * norm_l))
    return cosine if metric == "cosine" else 1.0 - cosine


def brute_force(
    curve: np.ndarray, rows: np.ndarray, metric: Metric, offsets: Sequence[int], least: float
) -> tuple[np.ndarray, np.ndarray]:
    """Scores and overlap, pair by pair."""
    height, width = rows.shape
    scores = np.full((height, len(offsets)), np.nan)
    overlap = np.zeros_like(scores)
    for v in range(height):
        for column, u in enumerate(offsets):
            pairs = [
                (rows[v, w], curve[u + w])
                for w in range(width)
                if 0 <= u + w < curve.size
                and not np.isnan(rows[v, w])
                and not np.isnan(curve[u + w])
            ]
            overlap[v, column] = len(pairs) / width
            if pairs and len(pairs) >= least:
                d, l_hat = np.array(pairs, dtype=np.float64).T
                scores[v, column] = paper_score(d, l_hat, metric)
    return scores, overlap


def dense_pearson(curve: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Eq. (2) by six masked matrix products, with no least overlap."""
    windows = sliding_window_view(curve, rows.shape[1]).T
    mask_d, mask_l = np.isfinite(rows) * 1.0, np.isfinite(windows) * 1.0
    d, l_hat = np.nan_to_num(rows), np.nan_to_num(windows)
    n, s_d, s_l = mask_d @ mask_l, d @ mask_l, mask_d @ l_hat
    s_dd, s_ll, s_dl = d**2 @ mask_l, mask_d @ l_hat**2, d @ l_hat
    with np.errstate(invalid="ignore", divide="ignore"):
        return (n * s_dl - s_d * s_l) / np.sqrt((n * s_dd - s_d**2) * (n * s_ll - s_l**2))


def room(seed: int, height: int, width: int, length: int) -> tuple[np.ndarray, np.ndarray]:
    """A LiDAR curve and rows that look like it at one place, with noise of 2 cm."""
    rng = np.random.default_rng(seed)
    curve = 3.0 + 0.15 * rng.normal(size=length).cumsum()
    start = (length - width) // 2
    rows = curve[start : start + width] + rng.normal(0.0, 0.02, (height, width))
    return curve, rows


def with_holes(values: np.ndarray, seed: int, fraction: float, longest: int) -> np.ndarray:
    """A copy with runs of NaN of 1 to ``longest`` samples over at least ``fraction`` of a line."""
    rng = np.random.default_rng(seed)
    result = values.copy()
    for line in result.reshape(-1, values.shape[-1]):
        while np.isnan(line).mean() < fraction:
            start = rng.integers(-longest, line.size)
            line[max(0, start) : max(0, start + rng.integers(1, longest + 1))] = np.nan
    return result


@st.composite
def curves_and_rows(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Millimetre values with flat pieces, zeros and holes, so that every NaN rule is met."""
    width = draw(st.integers(1, 12))
    length = draw(st.integers(width, 24))
    height = draw(st.integers(1, 4))
    value = st.one_of(
        st.integers(500, 8000).map(lambda mm: mm / 1000.0), st.sampled_from([0.0, 2.0, np.nan])
    )
    piece = st.tuples(value, st.integers(1, 5))

    def line(size: int) -> list[float]:
        values: list[float] = []
        while len(values) < size:
            held, repeats = draw(piece)
            values += [held] * repeats
        return values[:size]

    return np.array(line(length)), np.array([line(width) for _ in range(height)])


@settings(max_examples=200)
@given(curves_and_rows(), st.sampled_from([0.0, 0.3, 0.5, 1.0]), st.booleans())
def test_field_is_the_papers_formula_on_the_common_samples(
    pair: tuple[np.ndarray, np.ndarray], min_overlap: float, partial: bool
) -> None:
    curve, rows = pair
    width = rows.shape[1]
    least = max(1, int(np.ceil(min_overlap * width - 1e-9)))
    offsets = (
        range(least - width, curve.size - least + 1) if partial else range(curve.size - width + 1)
    )
    fields = similarity_fields(
        curve, rows, metrics=METRICS, min_overlap=min_overlap, partial=partial
    )
    for metric in METRICS:
        scores, overlap = brute_force(curve, rows, metric, offsets, least)
        assert fields[metric].u_first == offsets[0]
        np.testing.assert_allclose(fields[metric].overlap, overlap, rtol=0, atol=1e-15)
        np.testing.assert_allclose(
            fields[metric].scores, scores, rtol=0, atol=TOLERANCE[metric], err_msg=metric
        )


@settings(max_examples=100)
@given(st.lists(curves_and_rows(), min_size=1, max_size=3), st.sampled_from([0.0, 0.5, 1.0]))
def test_windows_have_the_papers_scores_too(
    pairs: list[tuple[np.ndarray, np.ndarray]], min_overlap: float
) -> None:
    rows = pairs[0][1]
    width = rows.shape[1]
    curves = np.stack([np.resize(curve, width + 2) for curve, _ in pairs])
    least = max(1, int(np.ceil(min_overlap * width - 1e-9)))
    found = similarity_of_windows(curves, centre(rows), metrics=METRICS, min_overlap=min_overlap)
    for curve, fields in zip(curves, found, strict=True):
        for metric in METRICS:
            scores, overlap = brute_force(curve, rows, metric, range(3), least)
            np.testing.assert_allclose(fields[metric].overlap, overlap, rtol=0, atol=1e-15)
            np.testing.assert_allclose(
                fields[metric].scores, scores, rtol=0, atol=TOLERANCE[metric], err_msg=metric
            )


@pytest.mark.parametrize(
    ("fraction", "longest"), [(0.0, 1), (0.1, 30), (0.3, 3), (0.6, 40)], ids=str
)
@pytest.mark.parametrize("size", [(40, 180, 240), (20, 320, 1080)], ids=["product", "FFT"])
def test_pearson_equals_dense_masked_products(
    size: tuple[int, int, int], fraction: float, longest: int
) -> None:
    curve, rows = room(1, *size)
    curve, rows = with_holes(curve, 2, fraction, longest), with_holes(rows, 3, fraction, longest)
    field = similarity_field(curve, rows, metric="pearson", min_overlap=0.1)
    expected = np.where(field.overlap >= 0.1, dense_pearson(curve, rows), np.nan)
    assert np.isfinite(expected).any()
    np.testing.assert_allclose(field.scores, expected, rtol=0, atol=1e-9)


def test_pearson_without_holes_equals_match_template() -> None:
    curve, rows = room(4, 30, 160, 320)
    field = similarity_field(curve, rows, metric="pearson")
    image = curve[np.newaxis].astype(np.float32)
    for v, row in enumerate(rows.astype(np.float32)):
        peer = cv2.matchTemplate(image, row[np.newaxis], cv2.TM_CCOEFF_NORMED)[0]
        np.testing.assert_allclose(field.scores[v], peer, rtol=0, atol=2e-4)


def test_partial_pearson_equals_padfields_masked_correlation() -> None:
    curve, rows = room(5, 6, 50, 80)
    curve, rows = with_holes(curve, 6, 0.1, 8), with_holes(rows, 7, 0.1, 8)
    field = similarity_field(curve, rows, metric="pearson", min_overlap=0.4, partial=True)
    assert field.u_first == -30
    for v, row in enumerate(rows):
        # Its index 0 is the row's last sample on the curve's first.
        peer = cross_correlate_masked(
            np.nan_to_num(curve),
            np.nan_to_num(row),
            np.isfinite(curve),
            np.isfinite(row),
            axes=(0,),
            overlap_ratio=0.0,
        )[row.size - 1 + field.u_first :][: field.scores.shape[1]]
        scored = np.isfinite(field.scores[v])
        assert scored.sum() > 40
        np.testing.assert_allclose(field.scores[v][scored], peer[scored], rtol=0, atol=1e-9)


@pytest.mark.parametrize("metric", METRICS)
def test_field_moves_with_the_curve(metric: Metric) -> None:
    curve, rows = room(8, 10, 60, 100)
    curve, rows = with_holes(curve, 9, 0.1, 8), with_holes(rows, 10, 0.1, 8)
    field = similarity_field(curve, rows, metric=metric)
    moved = similarity_field(np.concatenate([np.full(7, 5.0), curve]), rows, metric=metric)
    tolerance = TOLERANCE[metric]
    np.testing.assert_allclose(moved.scores[:, 7:], field.scores, rtol=0, atol=tolerance)
    partial = similarity_field(curve, rows, metric=metric, partial=True)
    inside = partial.scores[:, -partial.u_first :][:, : field.scores.shape[1]]
    np.testing.assert_allclose(inside, field.scores, rtol=0, atol=tolerance)


@settings(max_examples=30)
@given(
    st.floats(0.01, 100.0),
    st.floats(-1e4, 1e4),
    st.floats(0.01, 100.0),
    st.floats(-1e4, 1e4),
    st.booleans(),
)
def test_pearson_ignores_scale_and_offset(
    scale_d: float, offset_d: float, scale_l: float, offset_l: float, mirrored: bool
) -> None:
    curve, rows = room(11, 5, 40, 60)
    curve, rows = with_holes(curve, 12, 0.1, 6), with_holes(rows, 13, 0.1, 6)
    sign = -1.0 if mirrored else 1.0
    field = similarity_field(curve, rows, metric="pearson")
    changed = similarity_field(
        sign * scale_l * curve + offset_l, scale_d * rows + offset_d, metric="pearson"
    )
    np.testing.assert_allclose(changed.scores, sign * field.scores, rtol=0, atol=1e-7)


@pytest.mark.parametrize("metric", METRICS)
def test_rows_are_scored_independently(metric: Metric) -> None:
    curve, rows = room(14, 12, 60, 100)
    curve, rows = with_holes(curve, 15, 0.1, 8), with_holes(rows, 16, 0.2, 8)
    order = np.random.default_rng(17).permutation(12)
    field = similarity_field(curve, rows, metric=metric)
    permuted = similarity_field(curve, rows[order], metric=metric)
    np.testing.assert_allclose(permuted.scores, field.scores[order], rtol=0, atol=TOLERANCE[metric])
    np.testing.assert_array_equal(permuted.overlap, field.overlap[order])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("offset_m", [0.0, 100.0, 10_000.0])
def test_small_variance_on_a_large_offset_is_kept(dtype: type, offset_m: float) -> None:
    """In float32 sums 2 cm on 10 km would be lost; what the values themselves hold must not be."""
    rng = np.random.default_rng(18)
    shape = rng.normal(0.0, 0.02, 300)
    curve = with_holes(shape + offset_m, 19, 0.1, 20).astype(dtype)
    rows = np.stack([shape[40:240], shape[90:290]]) + rng.normal(0.0, 0.005, (2, 200))
    rows += np.array([[offset_m], [-3.0 * offset_m]])
    rows = with_holes(rows, 20, 0.1, 20).astype(dtype)
    field = similarity_field(curve, rows, metric="pearson")
    expected, _ = brute_force(
        curve.astype(np.float64), rows.astype(np.float64), "pearson", range(101), 100
    )
    np.testing.assert_allclose(field.scores, expected, rtol=0, atol=1e-7)
    assert np.nanargmax(field.scores, axis=1).tolist() == [40, 90]


def test_the_fft_keeps_a_small_variance_beside_a_far_burr() -> None:
    """The rounding of an FFT is that of its greatest value, everywhere."""
    rng = np.random.default_rng(26)
    shape = rng.normal(0.0, 0.002, 1000)
    curve, rows = 3.0 + shape, np.stack([3.0 + shape[100:400], 3.0 + shape[600:900]])
    rows += rng.normal(0.0, 0.0005, rows.shape)
    curve[950] = 65.535
    field = similarity_field(curve, rows, metric="pearson")
    expected, _ = brute_force(curve, rows, "pearson", range(701), 150)
    np.testing.assert_allclose(field.scores, expected, rtol=0, atol=1e-9)
    assert np.nanargmax(field.scores, axis=1).tolist() == [100, 600]


def test_a_flat_window_beside_a_far_burr_has_no_pearson() -> None:
    curve, rows = room(21, 3, 40, 200)
    curve[50:120] = 0.1 + 0.2  # Not 0.3 in binary, so that rounding would show.
    curve[150] = 65.535
    rows[1] = 1.7
    rows[2, :30] = 2.4
    rows[2, 30:] = np.nan
    field = similarity_field(curve, rows, metric="pearson")
    assert np.isnan(field.scores[0, 50:81]).all()
    assert np.isfinite(np.delete(field.scores[0], range(50, 81))).all()
    assert np.isnan(field.scores[1:]).all()
    euclidean = similarity_field(curve, rows, metric="euclidean")
    assert np.isfinite(euclidean.scores).all()


@pytest.mark.parametrize("metric", METRICS)
def test_a_window_of_zeros_has_no_score(metric: Metric) -> None:
    curve, rows = room(22, 3, 40, 120)
    curve[30:90] = 0.0
    rows[2] = 0.0
    field = similarity_field(curve, rows, metric=metric)
    assert np.isnan(field.scores[:, 30:51]).all()
    assert np.isnan(field.scores[2]).all()
    assert np.isfinite(field.scores[:2, :30]).all()


def test_too_little_overlap_has_no_score() -> None:
    curve, rows = room(23, 2, 20, 50)
    rows[0, 5:16] = np.nan  # 9 of 20 left
    rows[1, 5:15] = np.nan  # 10 of 20 left
    curve[40:] = np.nan
    field = similarity_field(curve, rows, metric="euclidean", min_overlap=0.5)
    assert np.isnan(field.scores[0]).all()
    np.testing.assert_allclose(field.overlap[0, :21], 9 / 20)
    assert np.isfinite(field.scores[1, :21]).all()
    assert np.isnan(field.scores[1, 21:]).all()


def test_a_row_of_exactly_the_least_overlap_has_a_score() -> None:
    curve, rows = room(30, 1, 100, 100)
    rows[0, 55:] = np.nan  # In binary 0.55 * 100 is a little more than 55.
    field = similarity_field(curve, rows, metric="pearson", min_overlap=0.55)
    assert np.isfinite(field.scores).all()


def test_nothing_valid_gives_no_score_and_no_overlap() -> None:
    curve, rows = room(24, 4, 20, 50)
    for empty_curve, empty_rows in ((np.full(50, np.nan), rows), (curve, np.full((4, 20), np.nan))):
        for field in similarity_fields(empty_curve, empty_rows, metrics=METRICS).values():
            assert np.isnan(field.scores).all()
            assert not field.overlap.any()


def test_partial_overlap_finds_a_row_that_extends_beyond_the_curve() -> None:
    rng = np.random.default_rng(25)
    wide = 3.0 + 0.2 * rng.normal(size=140).cumsum()
    curve = wide[20:120]
    rows = np.stack([wide[:60], wide[80:]])
    field = similarity_field(curve, rows, metric="pearson", partial=True)
    peaks = np.nanargmax(field.scores, axis=1) + field.u_first
    assert peaks.tolist() == [-20, 60]
    np.testing.assert_allclose(field.overlap[[0, 1], peaks - field.u_first], 40 / 60)


def test_an_equal_row_has_the_best_score_of_each_metric() -> None:
    curve, _ = room(26, 1, 60, 100)
    fields = similarity_fields(curve, curve[np.newaxis, 17:77], metrics=METRICS)
    for metric, best in (("pearson", 1.0), ("cosine", 1.0), ("euclidean", 1.0)):
        assert int(np.argmax(fields[metric].scores)) == 17
        assert fields[metric].scores[0, 17] == pytest.approx(best, abs=TOLERANCE[metric])
    # Printed as a dissimilarity: the true place is its worst.
    assert int(np.argmin(fields["inverse_cosine"].scores)) == 17


def test_inputs_are_unchanged_and_results_read_only() -> None:
    curve, rows = room(27, 4, 30, 50)
    curve, rows = with_holes(curve, 28, 0.1, 5), with_holes(rows, 29, 0.1, 5)
    before = curve.tobytes(), rows.tobytes()
    curve.setflags(write=False)
    rows.setflags(write=False)
    field = similarity_field(curve, rows, metric="pearson", partial=True)
    assert (curve.tobytes(), rows.tobytes()) == before
    with pytest.raises(ValueError, match="read-only"):
        field.scores[0, 0] = 1.0


def test_a_curve_shorter_than_a_row_is_refused() -> None:
    with pytest.raises(AlignmentFailed, match=r"has 19 samples, a depth row of 20 needs 20"):
        similarity_field(np.ones(19), np.ones((2, 20)), metric="cosine")
    field = similarity_field(np.ones(19), np.ones((2, 20)), metric="cosine", partial=True)
    assert field.scores.shape == (2, 20)
    with pytest.raises(AlignmentFailed, match="needs 10"):
        similarity_field(np.ones(9), np.ones((2, 20)), metric="cosine", partial=True)


@pytest.mark.parametrize(
    ("curve", "rows", "min_overlap"),
    [
        (np.ones((2, 30)), np.ones((2, 20)), 0.5),
        (np.ones(30), np.ones(20), 0.5),
        (np.ones(30), np.ones((0, 20)), 0.5),
        (np.ones(30), np.ones((2, 20)), 1.1),
        (np.ones(30), np.ones((2, 20)), float("nan")),
    ],
    ids=["curve of two axes", "one row alone", "no rows", "overlap above 1", "overlap nan"],
)
def test_wrong_arguments_are_refused(
    curve: np.ndarray, rows: np.ndarray, min_overlap: float
) -> None:
    with pytest.raises(ValueError, match=r"need a|min_overlap"):
        similarity_field(curve, rows, metric="pearson", min_overlap=min_overlap)
