"""The peak of a field against closed forms, and the mean field against numpy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.alignment.search import MeanField, SearchSettings, find_peak
from fusion_core.alignment.similarity import SimilarityField
from fusion_core.model.errors import AlignmentFailed

SETTINGS = SearchSettings(prior_samples=2, runner_up_distance=4)


def field_of(scores: np.ndarray, u_first: int = 0) -> SimilarityField:
    overlap = np.linspace(0.5, 1.0, scores.size).reshape(scores.shape)
    return SimilarityField(scores=scores, overlap=overlap, u_first=u_first)


def hill(u: float, v: float, height: float = 0.9, shape: tuple[int, int] = (30, 40)) -> np.ndarray:
    """A paraboloid with its top at (u, v): a parabola in each row and column."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return height - 0.002 * (columns - u) ** 2 - 0.001 * (rows - v) ** 2


@given(u=st.floats(1.0, 38.0), v=st.floats(1.0, 28.0), u_first=st.integers(-20, 5))
def test_peak_of_a_paraboloid_is_exact(u: float, v: float, u_first: int) -> None:
    peak = find_peak(field_of(hill(u, v), u_first), SETTINGS)
    assert peak.u == pytest.approx(u_first + u, abs=1e-6)
    assert peak.v == pytest.approx(v, abs=1e-6)
    assert 0.9 - peak.score <= 0.003 * 0.25 + 1e-12


def test_score_and_overlap_are_those_of_the_highest_cell() -> None:
    field = field_of(hill(12.0, 7.0))
    peak = find_peak(field, SETTINGS)
    assert (peak.u, peak.v) == (12.0, 7.0)
    assert peak.score == field.scores[7, 12]
    assert peak.overlap == field.overlap[7, 12]


@pytest.mark.parametrize("distance", [1, 4, 9])
def test_runner_up_is_the_best_at_least_the_distance_away(distance: int) -> None:
    scores = np.random.default_rng(3).uniform(0.1, 0.8, (12, 50))
    scores[5, 20] = 0.9
    # Just far enough, and just too near.
    scores[7, 20 - distance], scores[8, 20 + distance - 1] = 0.85, 0.87
    scores[scores < 0.2] = np.nan
    peak = find_peak(field_of(scores, -4), SearchSettings(runner_up_distance=distance))
    best, place = -np.inf, (0, 0)
    for v in range(12):
        for column in range(50):
            if abs(column - 20) >= distance and scores[v, column] > best:
                best, place = scores[v, column], (v, column)
    assert (peak.runner_up_v, peak.runner_up_u) == (place[0], place[1] - 4)
    assert peak.ratio == pytest.approx(0.9 / best)


def test_no_ratio_without_a_positive_runner_up() -> None:
    alone = np.full((3, 10), np.nan)
    alone[1, 4] = 0.7
    peak = find_peak(field_of(alone), SETTINGS)
    assert np.isnan([peak.ratio, peak.runner_up_u, peak.runner_up_v]).all()
    assert (peak.u, peak.v, peak.score) == (4.0, 1.0, 0.7)

    negative = np.full((3, 10), -0.2)
    negative[1, 0] = 0.7
    assert np.isnan(find_peak(field_of(negative), SETTINGS).ratio)


def test_the_prior_limits_the_peak_to_its_window() -> None:
    scores = hill(8.0, 10.0, height=0.6)
    scores[:, 25:] = hill(30.0, 10.0, height=0.9)[:, 25:]
    field = field_of(scores, -3)
    assert find_peak(field, SETTINGS).u == pytest.approx(27.0)
    near = find_peak(field, SETTINGS, prior_u=4.6)
    assert near.u == pytest.approx(5.0)
    # The peak outside of the window is still the runner-up, and shows how uncertain the prior is.
    assert near.runner_up_u == 27.0
    assert near.ratio == pytest.approx(0.6 / 0.9)


@given(prior=st.floats(0.0, 39.0), reach=st.integers(0, 4), seed=st.integers(0, 50))
def test_peak_stays_within_the_window_and_half_a_sample(
    prior: float, reach: int, seed: int
) -> None:
    scores = np.random.default_rng(seed).uniform(0.0, 1.0, (8, 40))
    peak = find_peak(field_of(scores), SearchSettings(prior_samples=reach), prior_u=prior)
    # With prior_samples = 0 the nearest whole offset is still allowed.
    reach_or_nearest = max(reach, 0.5)
    within = [u for u in range(40) if abs(u - prior) <= reach_or_nearest]
    assert abs(peak.u - prior) <= reach_or_nearest + 0.5
    assert peak.score == scores[:, within].max()


@pytest.mark.parametrize("prior", [10.0, 30.0])
def test_on_a_slope_the_peak_is_the_edge_of_the_window(prior: float) -> None:
    """The parabola through an edge and the higher cell beyond it has no maximum to move to."""
    top = 20.0
    scores = np.exp(-np.abs(np.arange(41.0) - top) / 5.0)[np.newaxis] * np.ones((3, 1))
    peak = find_peak(field_of(scores), SETTINGS, prior_u=prior)
    assert peak.u == prior + np.copysign(SETTINGS.prior_samples, top - prior)


def test_no_score_anywhere_is_a_failure() -> None:
    empty = field_of(np.full((4, 9), np.nan))
    with pytest.raises(AlignmentFailed, match="min_overlap"):
        find_peak(empty, SETTINGS)


def test_no_score_in_the_window_is_a_failure() -> None:
    with pytest.raises(AlignmentFailed):
        find_peak(field_of(hill(12.0, 7.0)), SETTINGS, prior_u=80.0)


def frames_of(seed: int, count: int, missing: float) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    frames = rng.uniform(-1.0, 1.0, (count, 5, 7))
    frames[rng.random(frames.shape) < missing] = np.nan
    return list(frames)


def mean_of(frames: list[np.ndarray]) -> SimilarityField:
    mean = MeanField()
    for scores in frames:
        overlap = np.isfinite(scores) * 0.8
        field = SimilarityField(scores=scores.copy(), overlap=overlap, u_first=-2)
        mean.add({"pearson": field})
    return mean.mean("pearson")


@given(
    seed=st.integers(0, 1000), count=st.integers(1, 9), missing=st.floats(0.0, 0.9), data=st.data()
)
def test_the_mean_field_equals_numpys_where_half_of_the_frames_have_a_score(
    seed: int, count: int, missing: float, data: st.DataObject
) -> None:
    frames = frames_of(seed, count, missing)
    expected = np.full((5, 7), np.nan)
    for cell in np.ndindex(5, 7):
        valid = [scores[cell] for scores in frames if not np.isnan(scores[cell])]
        if len(valid) >= count / 2:
            expected[cell] = np.nanmean([scores[cell] for scores in frames])
    found = mean_of(data.draw(st.permutations(frames)))
    np.testing.assert_allclose(found.scores, expected, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(found.overlap, 0.8 * np.isfinite(frames).mean(axis=0), atol=1e-12)
    assert found.u_first == -2


def test_each_metric_has_its_own_mean() -> None:
    mean = MeanField()
    for k in range(3):
        mean.add({"pearson": field_of(hill(3.0, 3.0) - k), "cosine": field_of(hill(9.0, 5.0) + k)})
    np.testing.assert_allclose(mean.mean("pearson").scores, hill(3.0, 3.0) - 1.0)
    np.testing.assert_allclose(mean.mean("cosine").scores, hill(9.0, 5.0) + 1.0)


def test_mean_of_no_frame_is_a_failure() -> None:
    with pytest.raises(AlignmentFailed, match="max_gap_ms"):
        MeanField().mean("pearson")
