"""Recordings that differ from the others of their rig."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from statsmodels.robust.scale import qn_scale as statsmodels_qn

from fusion_core.evaluation.fleet import FleetValues, find_deviations
from fusion_core.evaluation.fleet_quantities import QUANTITIES, FleetSettings, Quantity
from fusion_core.evaluation.fleet_spread import qn_scale, z_threshold
from fusion_core.model.conventions import FloatArray

SETTINGS = FleetSettings()
YAW, CLOCK, HOLES = (
    [quantity.name for quantity in QUANTITIES].index(name)
    for name in ("yaw_rad", "clock_offset_ms", "depth_hole_share")
)
SEEDS = st.integers(0, 2**32 - 1)


def fleet_of(
    values: FloatArray, sd: FloatArray | None = None, robots: Sequence[str] | None = None
) -> FleetValues:
    count = values.shape[0]
    return FleetValues(
        robot=tuple(robots or [""] * count),
        geometry=("682 beams",) * count,
        values=values,
        sd=np.full(values.shape, np.nan) if sd is None else sd,
    )


def column(index: int, values: FloatArray) -> FloatArray:
    """(N, Q) with one known quantity."""
    full = np.full((values.size, len(QUANTITIES)), np.nan)
    full[:, index] = values
    return full


def sound(seed: int, count: int = 12) -> FloatArray:
    """(count, Q) of one rig, each with its own noise."""
    rng = np.random.default_rng(seed)
    values = np.empty((count, len(QUANTITIES)))
    for index, quantity in enumerate(QUANTITIES):
        noise = rng.normal(size=count)
        if quantity.scale == "proportion":
            values[:, index] = np.sin(0.4 + 0.03 * noise) ** 2
        else:
            values[:, index] = (
                0.3 + float(quantity.smallest_shift(np.zeros(1), SETTINGS)[0]) * 0.2 * noise
            )
    return values


def brute_force_scale(values: FloatArray) -> float:
    """Rousseeuw and Croux (1993), from the definition, without the factor for small samples."""
    n = values.size
    distances = sorted(abs(a - b) for i, a in enumerate(values) for b in values[i + 1 :])
    h = n // 2 + 1
    return 2.219144 * distances[h * (h - 1) // 2 - 1]


@pytest.mark.parametrize("count", [10, 11, 30, 99, 200])
def test_the_scale_is_that_of_its_definition_and_of_another_library(count: int) -> None:
    values = np.sort(np.random.default_rng(count).normal(size=count))
    unbiased = count / (count + 1.4) if count % 2 else count / (count + 3.8)
    assert qn_scale(values) == pytest.approx(unbiased * brute_force_scale(values), rel=1e-5)
    assert qn_scale(values) == pytest.approx(unbiased * statsmodels_qn(values), rel=1e-5)


@pytest.mark.parametrize("count", [*range(2, 12), 25])
def test_the_scale_has_no_bias_in_small_samples(count: int) -> None:
    drawn = np.sort(np.random.default_rng(1).normal(2.0, 3.0, (4000, count)), axis=1)
    assert np.mean([qn_scale(row) for row in drawn]) == pytest.approx(3.0, rel=0.05)


def test_many_values_are_represented_by_some_of_them() -> None:
    values = np.sort(np.random.default_rng(2).normal(0.0, 3.0, 20_001))
    assert qn_scale(values) == pytest.approx(3.0, rel=0.04)


@pytest.mark.parametrize("others", [5, 7, 8, 11, 20])
@pytest.mark.parametrize("probability", [0.05, 0.005])
def test_chance_exceeds_the_threshold_at_most_at_the_given_rate(
    others: int, probability: float
) -> None:
    trials = 6_000
    drawn = np.random.default_rng(others).normal(size=(trials, others + 1))
    z = np.array([(row[0] - np.median(row[1:])) / qn_scale(np.sort(row[1:])) for row in drawn])
    for two_sided in (False, True):
        found = int(
            (
                (np.abs(z) if two_sided else z)
                > z_threshold(probability, others, two_sided=two_sided)
            ).sum()
        )
        # Not above the rate, and not far below it either: it could then find nothing.
        test = stats.binomtest(found, trials, probability)
        assert test.proportion_ci(0.999).low <= probability
        assert found / trials > 0.1 * probability


def test_the_threshold_of_many_recordings_is_that_of_the_normal_distribution() -> None:
    assert z_threshold(0.01, 100_000, two_sided=True) == pytest.approx(stats.norm.isf(0.005), 1e-3)


def test_sound_batches_are_flagged_at_most_at_the_wanted_rate() -> None:
    # Shifts of any size count here: the threshold alone has to hold.
    settings = FleetSettings(
        false_alarm_rate=0.2,
        z_min=1.0,
        angle_shift_min_deg=1e-6,
        position_shift_min_m=1e-9,
        clock_shift_min_ms=1e-6,
        agreement_drop_min=1e-9,
        untrusted_rise_min=1e-9,
        share_factor_min=1.0 + 1e-9,
        share_rise_min=1e-9,
    )
    trials = 60
    flagged = sum(
        find_deviations(fleet_of(sound(seed)), settings).is_flagged.any() for seed in range(trials)
    )
    assert stats.binomtest(flagged, trials, 0.2).proportion_ci(0.999).low <= 0.2
    assert flagged > 0


def test_each_shift_is_found_and_named() -> None:
    values = sound(0)
    values[2, YAW] += np.deg2rad(2.0)
    values[5, CLOCK] -= 90.0
    values[7, HOLES] *= 4.0
    found = find_deviations(fleet_of(values), SETTINGS)
    kinds = {row: [flag.kind for flag in found.flags(row)] for row in range(12)}
    assert {row: kind for row, kind in kinds.items() if kind} == {
        2: ["mount moved"],
        5: ["clock drifts"],
        7: ["lens went blind"],
    }
    flag = next(found.flags(7))
    others = np.delete(values[:, HOLES], 7)
    assert flag.value == values[7, HOLES]
    # The others are eleven: their median is one of them.
    assert flag.median == pytest.approx(np.median(others))
    value, median, low, high = np.arcsin(np.sqrt([flag.value, flag.median, flag.low, flag.high]))
    assert flag.z == pytest.approx((value - median) / (high - median))
    assert high - median == pytest.approx(median - low)


def test_fewer_holes_are_no_failure_of_the_lens() -> None:
    values = sound(0)
    values[7, HOLES] /= 9.0
    assert not find_deviations(fleet_of(values), SETTINGS).is_flagged.any()


@given(SEEDS)
def test_the_order_of_the_recordings_has_no_effect(seed: int) -> None:
    values = sound(seed)
    values[0, YAW] += 0.1
    order = np.random.default_rng(seed).permutation(len(values))
    before = find_deviations(fleet_of(values), SETTINGS)
    after = find_deviations(fleet_of(values[order]), SETTINGS)
    np.testing.assert_array_equal(after.z, before.z[order])
    np.testing.assert_array_equal(after.is_flagged, before.is_flagged[order])


@given(SEEDS, st.floats(-3.0, 3.0))
def test_another_mount_of_the_whole_rig_has_no_effect(seed: int, turn_rad: float) -> None:
    values = sound(seed)
    values[0, YAW] += 0.1
    turned = values.copy()
    turned[:, YAW] = (turned[:, YAW] + turn_rad + np.pi) % (2 * np.pi) - np.pi
    before = find_deviations(fleet_of(values), SETTINGS)
    after = find_deviations(fleet_of(turned), SETTINGS)
    np.testing.assert_allclose(after.z, before.z, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(after.is_flagged, before.is_flagged)


@given(SEEDS, st.floats(1.0, 100.0))
def test_other_units_have_no_effect(seed: int, factor: float) -> None:
    values = column(CLOCK, np.random.default_rng(seed).normal(0.0, 5.0, 12))
    values[0] += 60.0
    settings = FleetSettings(clock_shift_min_ms=20.0 * factor)
    before = find_deviations(fleet_of(values), SETTINGS)
    after = find_deviations(fleet_of(values * factor), settings)
    np.testing.assert_allclose(after.z, before.z, rtol=1e-9)
    np.testing.assert_array_equal(after.is_flagged, before.is_flagged)


@given(SEEDS)
def test_what_is_not_observable_is_neither_flagged_nor_counted(seed: int) -> None:
    values = sound(seed)
    values[3, CLOCK] = np.nan
    found = find_deviations(fleet_of(values), SETTINGS)
    without = find_deviations(fleet_of(np.delete(values, 3, axis=0)), SETTINGS)
    assert np.isnan(found.z[3, CLOCK])
    assert not found.is_flagged[3, CLOCK]
    np.testing.assert_array_equal(np.delete(found.z[:, CLOCK], 3), without.z[:, CLOCK])


def test_an_uncertain_value_is_not_flagged() -> None:
    values = sound(0)
    values[2, YAW] += np.deg2rad(2.0)
    sd = np.full(values.shape, np.nan)
    sd[2, YAW] = np.deg2rad(1.5)
    found = find_deviations(fleet_of(values, sd), SETTINGS)
    assert not found.is_flagged.any()
    expected = (values[2, YAW] - found.median[2, YAW]) / np.hypot(found.spread[2, YAW], sd[2, YAW])
    assert found.z[2, YAW] == pytest.approx(expected)


def test_a_shift_that_does_not_matter_is_not_flagged() -> None:
    values = column(YAW, np.full(12, 0.2))
    values[4, YAW] += np.deg2rad(0.49)
    assert not find_deviations(fleet_of(values.copy()), SETTINGS).is_flagged.any()
    values[4, YAW] += np.deg2rad(0.9)
    assert np.argwhere(find_deviations(fleet_of(values), SETTINGS).is_flagged).tolist() == [
        [4, YAW]
    ]


def test_a_share_must_rise_by_points_and_by_a_factor() -> None:
    for others, value, is_flagged in (
        (0.001, 0.04, False),
        (0.001, 0.06, True),
        (0.3, 0.5, False),
        (0.3, 0.61, True),
    ):
        values = column(HOLES, np.full(12, others))
        values[4, HOLES] = value
        assert find_deviations(fleet_of(values), SETTINGS).is_flagged.any() == is_flagged


def test_too_few_recordings_have_no_flags_and_a_note() -> None:
    values = sound(0, SETTINGS.recordings_min - 1)
    values[0, YAW] += 1.0
    found = find_deviations(fleet_of(values), SETTINGS)
    assert not found.is_flagged.any()
    assert np.isnan(found.z).all()
    assert found.notes == ("682 beams: 7 recordings, nothing is compared in fewer than 8.",)


def test_a_quantity_that_few_recordings_show_is_named() -> None:
    values = sound(0)
    values[4:, CLOCK] = np.nan
    found = find_deviations(fleet_of(values), SETTINGS)
    assert found.notes == (
        "682 beams: not compared, since known in fewer than 8 recordings: clock offset in 4.",
    )


def test_robots_are_compared_with_themselves_and_strays_with_each_other() -> None:
    a, b, strays = sound(1), sound(2), sound(3, 8)
    b[:, YAW] += 0.3
    values = np.concatenate([a, b, strays])
    names = ["a"] * 12 + ["b"] * 12 + [f"stray {n}" for n in range(8)]
    found = find_deviations(fleet_of(values, robots=names), SETTINGS)
    assert not found.is_flagged.any()
    assert found.rig_labels == ("682 beams", "a", "b")
    assert found.rig.tolist() == [1] * 12 + [2] * 12 + [0] * 8
    mixed = find_deviations(fleet_of(values[:13]), SETTINGS)
    assert np.argwhere(mixed.is_flagged).tolist() == [[12, YAW]]


def test_equal_values_differ_by_nothing() -> None:
    found = find_deviations(fleet_of(np.full((12, len(QUANTITIES)), 0.3)), SETTINGS)
    np.testing.assert_array_equal(found.z, 0.0)


def test_a_large_fleet_is_compared_as_a_small_one() -> None:
    values = sound(4, 400)
    values[17, CLOCK] += 100.0
    found = find_deviations(fleet_of(values), SETTINGS)
    assert np.argwhere(found.is_flagged).tolist() == [[17, CLOCK]]


def test_an_empty_batch_has_no_deviations() -> None:
    found = find_deviations(fleet_of(np.empty((0, len(QUANTITIES)))), SETTINGS)
    assert found.z.shape == (0, len(QUANTITIES))
    assert found.notes == ()


def test_a_share_that_varies_along_its_recording_is_compared_with_its_own_variance() -> None:
    values = column(HOLES, sound(3)[:, HOLES])
    values[4, HOLES] = 0.5
    still, varying = np.full(values.shape, np.nan), np.full(values.shape, np.nan)
    still[:, HOLES], varying[:, HOLES] = 0.01, 0.01
    varying[4, HOLES] = 0.15
    assert find_deviations(fleet_of(values, still), SETTINGS).is_flagged[4, HOLES]
    assert not find_deviations(fleet_of(values, varying), SETTINGS).is_flagged.any()


@pytest.mark.parametrize("quantity", QUANTITIES, ids=lambda quantity: quantity.name)
def test_deviations_are_carried_to_the_compared_scale(quantity: Quantity) -> None:
    drawn = np.random.default_rng(2).normal(0.3, 0.03, 20_000)
    stated = quantity.sd_to_scale(np.array([0.3]), np.array([0.03]))
    assert stated[0] == pytest.approx(quantity.to_scale(drawn).std(), rel=0.03)
    assert np.isfinite(quantity.sd_to_scale(np.array([0.0, 1.0]), np.array([0.03, 2.0]))).all()
