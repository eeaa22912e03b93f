"""The evidence for surfaces: against loops, and what it must and must not depend on."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.denoising.evidence import (
    COLUMNS_AROUND,
    ROWS_AROUND,
    WITNESSES,
    ranges_around,
    weigh_beams,
)
from fusion_core.denoising.support import find_measured_pixels

BEAMS = 31
NOISE = (0.01, 0.01, 0.02)


def density(difference, variance):
    return math.exp(-(difference**2) / (2.0 * variance)) / math.sqrt(2.0 * math.pi * variance)


def side_density(ranges, camera, beam, direction, variance):
    """The neighbour's surface, as the camera sees it go on or as it came from the beam beyond."""
    valid = [k for k in range(1, 6) if 0 <= beam + direction * k < len(ranges)]
    valid = [k for k in valid if not math.isnan(ranges[beam + direction * k])]
    if not valid or valid[0] > 3:
        return None
    near, own = valid[0], ranges[beam]
    neighbour = ranges[beam + direction * near]
    slant = camera.get(beam, math.nan) - camera.get(beam + direction * near, math.nan)
    if abs(slant) <= 0.03 * own * near:
        flat = density(own - neighbour - slant, 2.0 * variance)
    else:
        flat = density(own - neighbour, 2.0 * variance + (NOISE[2] * own * near) ** 2)
    beyond = [k for k in valid if near < k <= near + 2]
    if not beyond:
        return flat
    step = (1.0 / neighbour - 1.0 / ranges[beam + direction * beyond[0]]) / (beyond[0] - near)
    inverse = 1.0 / neighbour + near * step
    if inverse <= 0.0:
        return flat
    return 0.5 * (flat + density(own - 1.0 / inverse, 2.0 * variance))


def looped(ranges, in_time, beam, camera, seen, hidden):
    """The five witnesses of one beam."""
    own, found = ranges[beam], [0.0] * 5
    if math.isnan(own):
        return found
    variance = NOISE[0] ** 2 + (NOISE[1] * own) ** 2
    near = [ranges[k] for k in range(beam - 2, beam + 3) if k != beam and 0 <= k < len(ranges)]
    about = [value for value in [*near, *seen] if not math.isnan(value)]
    burr = 0.1 / max(value for value in ranges if not math.isnan(value))
    if about:
        low = min(about) - 6.0 * math.sqrt(variance)
        high = max(about) + 6.0 * math.sqrt(variance)
        burr += 0.9 / (high - low) if low <= own <= high else 0.0

    def weigh(same, value):
        return math.log(same * value / burr + 1.0 - same)

    for side in range(2):
        value = side_density(ranges, camera, beam, (-1, 1)[side], variance)
        if value is not None:
            found[side] = weigh(0.7, value)
        places = range(beam - 2, beam + 3)
        met = [in_time[side][k] for k in places if 0 <= k < len(ranges)]
        met = [density(own - v, 2.0 * variance) for v in met if not math.isnan(v)]
        if met:
            found[2 + side] = weigh(0.6, sum(met) / len(met))
    looks = [density(own - v, 1.5 * variance) for v in seen if not math.isnan(v)]
    if looks:
        mean = sum(looks) / len(looks)
        found[4] = max(weigh(0.3, mean), 0.0) if hidden else weigh(0.9, mean)
    return found


def random_ranges(rng, size):
    """Steps between surfaces, noise, holes."""
    surfaces = rng.uniform(0.5, 5.0, 5)[np.sort(rng.integers(0, 5, size))]
    ranges = surfaces + rng.normal(0.0, 0.02, size)
    ranges[rng.random(size) < 0.2] = np.nan
    return ranges


@given(seed=st.integers(0, 10_000))
@settings(max_examples=60)
def test_the_evidence_equals_a_loop(seed):
    rng = np.random.default_rng(seed)
    ranges = random_ranges(rng, BEAMS)
    in_time = np.stack([random_ranges(rng, BEAMS), ranges + rng.normal(0.0, 0.03, BEAMS)])
    beams = np.sort(rng.choice(BEAMS, 20, replace=False))
    camera = np.where(rng.random(20) < 0.3, np.nan, ranges[beams] + rng.normal(0.0, 0.05, 20))
    seen = np.stack([random_ranges(rng, 7) for _ in beams])
    seen[0] = np.nan
    hidden = rng.random(20) < 0.4
    evidence = weigh_beams(ranges, in_time, beams, camera, seen, hidden, NOISE)
    by_camera = dict(zip(beams.tolist(), camera.tolist(), strict=True))
    for place, beam in enumerate(beams.tolist()):
        expected = looped(
            ranges.tolist(),
            in_time.tolist(),
            beam,
            by_camera,
            seen[place].tolist(),
            hidden[place],
        )
        np.testing.assert_allclose(evidence[place], expected, rtol=1e-9, atol=1e-12)
    assert evidence.shape == (20, len(WITNESSES))


def evidence_of(ranges, beam, *, before=None, seen=()):
    """The witnesses of one beam that the camera may see."""
    ranges = np.asarray(ranges, dtype=np.float64)
    nothing = np.full(ranges.size, np.nan)
    in_time = np.stack([nothing if before is None else np.asarray(before), nothing])
    around = np.array([seen if len(seen) else [np.nan]], dtype=np.float64)
    return weigh_beams(
        ranges,
        in_time,
        np.array([beam]),
        np.array([np.nan]),
        around,
        np.array([False]),
        NOISE,
    )[0]


def test_a_witness_without_a_value_says_nothing():
    alone = np.full(BEAMS, np.nan)
    alone[10] = 2.0
    np.testing.assert_array_equal(evidence_of(alone, 10), 0.0)
    np.testing.assert_array_equal(evidence_of(alone, 11), 0.0)


@pytest.mark.parametrize("other", [2.2, 3.0, 5.0])
def test_a_match_between_surfaces_far_apart_counts_for_more(other):
    """A burr would match by chance where they are close together."""
    edge = np.where(np.arange(BEAMS) < 15, 2.0, other)
    wider = np.where(np.arange(BEAMS) < 15, 2.0, other + 1.0)
    assert 0.0 < evidence_of(edge, 14)[0] < evidence_of(wider, 14)[0]
    assert evidence_of(edge, 14)[1] < 0.0


def test_a_match_before_all_surfaces_counts_for_most():
    between = np.where(np.arange(BEAMS) < 15, 1.0, 3.0)
    between[15] = 2.0
    before_all = np.full(BEAMS, 3.0)
    before_all[15] = 2.0
    steady = [evidence_of(scan, 15, before=scan)[2] for scan in (between, before_all)]
    assert 0.0 < steady[0] < steady[1] - 1.0


def test_a_wall_that_slants_steeply_is_a_surface_and_a_beam_off_it_is_not():
    angle = np.deg2rad(84.0) - np.arange(BEAMS) * np.deg2rad(0.36)
    wall = 1.0 / np.cos(angle)
    assert np.diff(wall[:4]).min() < -0.2
    on_wall = [evidence_of(wall, beam).sum() for beam in range(4, 20)]
    assert min(on_wall) > 0.0
    for beam in range(4, 12):
        off = wall.copy()
        off[beam] = 0.5 * (wall[beam] + wall[beam + 1]) + 0.5
        assert evidence_of(off, beam).sum() < 0.0


def test_the_camera_speaks_for_a_range_that_it_sees_and_against_another():
    ranges = np.full(BEAMS, 3.0)
    ranges[10] = 2.0
    assert evidence_of(ranges, 10, seen=[3.0] * 6)[4] == pytest.approx(np.log(0.1), abs=1e-3)
    assert evidence_of(ranges, 10, seen=[3.0] * 3 + [2.0] * 3)[4] > 0.0


def test_the_ranges_around_a_pixel_equal_a_loop():
    rng = np.random.default_rng(3)
    depth = rng.uniform(1.0, 4.0, (24, 17)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = np.nan
    rows, columns = np.array([-1, 0, 12, 23]), np.array([-1, 16, 8, 0])
    depth[0, 16], depth[12, 8], depth[23, 0] = 2.0, 2.5, 3.0
    as_range = np.array([np.nan, 2.2, 2.6, 3.1])
    found = ranges_around(depth, rows, columns, as_range)
    assert np.isnan(found[0]).all()
    for place in (1, 2, 3):
        expected = []
        for r in range(rows[place] - ROWS_AROUND, rows[place] + ROWS_AROUND + 1):
            for c in range(columns[place] - COLUMNS_AROUND, columns[place] + COLUMNS_AROUND + 1):
                inside = 0 <= r < 24 and 0 <= c < 17
                if inside and (r, c) != (rows[place], columns[place]):
                    own = depth[rows[place], columns[place]]
                    expected.append(as_range[place] * depth[r, c] / own)
        expected = np.array(expected)
        np.testing.assert_allclose(
            np.sort(found[place][np.isfinite(found[place])]),
            np.sort(expected[np.isfinite(expected)]),
            rtol=1e-6,
        )


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40)
def test_measured_pixels_equal_a_loop(seed):
    rng = np.random.default_rng(seed)
    ranges, before, after = (random_ranges(rng, BEAMS) for _ in range(3))
    beams = np.arange(BEAMS)
    as_range = np.where(rng.random(BEAMS) < 0.2, np.nan, rng.uniform(0.5, 5.0, BEAMS))
    tolerance = rng.uniform(0.0, 0.4, BEAMS)
    in_time = np.stack([before, after])
    found = find_measured_pixels(as_range, tolerance, beams, ranges, in_time)
    for beam in range(BEAMS):
        places = [(ranges, beam + step) for step in (-3, -2, -1, 1, 2, 3)]
        for scan in in_time:
            places += [(scan, beam + step) for step in (-1, 0, 1)]
        met = [scan[k] for scan, k in places if 0 <= k < BEAMS]
        expected = any(abs(value - as_range[beam]) <= tolerance[beam] for value in met)
        assert found[beam] == expected
