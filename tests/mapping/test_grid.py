"""The grid builder, against a rule-by-rule copy in plain Python and by symmetry."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.mapping.grid import GridBuilder, GridSettings
from fusion_core.mapping.rays import trace_ray
from fusion_core.model.errors import MappingFailed
from fusion_core.model.grids import OccupancyGrid

Scan = tuple[np.ndarray, np.ndarray, np.ndarray, float]
HIT, MISS = math.log(0.7 / 0.3), math.log(0.4 / 0.6)

# A power of two, so that moving by whole cells is exact.
RESOLUTION_M = 0.125
SETTINGS = GridSettings(resolution_m=RESOLUTION_M)


def random_scans(seed: int, count: int) -> list[Scan]:
    rng = np.random.default_rng(seed)
    scans = []
    for _ in range(count):
        angles_rad = np.linspace(-2.0, 2.0, 15)
        ranges_m = rng.uniform(0.05, 5.0, 15)
        ranges_m[rng.random(15) < 0.2] = np.nan
        scans.append((rng.uniform(-2, 2, 3), angles_rad, ranges_m, 4.0))
    return scans


def built(scans: list[Scan], settings: GridSettings = SETTINGS) -> OccupancyGrid:
    builder = GridBuilder(settings)
    for scan in scans:
        builder.add_scan(*scan)
    return builder.build()


def cells_of(grid: OccupancyGrid) -> dict[tuple[int, int], float]:
    """Known cells by their whole-number place in the map frame: (row, column) to log odds."""
    row, column = (round(value / grid.resolution_m) for value in grid.origin_m[::-1])
    return {
        (row + int(r), column + int(c)): float(grid.log_odds[r, c])
        for r, c in zip(*np.nonzero(grid.known), strict=True)
    }


def oracle(scans: list[Scan], resolution_m: float) -> dict[tuple[int, int], float]:
    """One scan after the other: the cells of all beams first, then one update for each cell."""
    log_odds: dict[tuple[int, int], float] = {}
    buffer = np.empty((1000, 2), dtype=np.int64)
    for (x, y, yaw), angles_rad, ranges_m, range_max_m in scans:
        hits, passed = set(), set()
        for angle_rad, range_m in zip(angles_rad, ranges_m, strict=True):
            if math.isnan(range_m):
                continue
            reached_m = min(range_m, range_max_m)
            x1 = (x + reached_m * np.cos(angle_rad + yaw)) / resolution_m
            y1 = (y + reached_m * np.sin(angle_rad + yaw)) / resolution_m
            count = trace_ray(x / resolution_m, y / resolution_m, x1, y1, buffer)
            cells = [tuple(cell) for cell in buffer[:count].tolist()]
            passed.update(cells[:-1])
            if range_m <= range_max_m:
                hits.add(cells[-1])
        for cell in hits | passed:
            step = HIT if cell in hits else MISS
            value = log_odds.get(cell, 0.0) + step
            log_odds[cell] = min(max(value, math.log(0.1192 / 0.8808)), math.log(0.971 / 0.029))
    return log_odds


@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
def test_the_grid_equals_plain_python(seed: int, count: int) -> None:
    scans = random_scans(seed, count)
    ours, expected = cells_of(built(scans)), oracle(scans, RESOLUTION_M)
    assert ours.keys() == expected.keys()
    for cell, value in expected.items():
        assert ours[cell] == pytest.approx(value)


def test_one_beam() -> None:
    grid = built([(np.zeros(3), np.array([0.0]), np.array([0.5]), 4.0)])
    expected = [[MISS, MISS, MISS, MISS, HIT]]
    assert np.allclose(grid.log_odds, expected)
    assert grid.origin_m == (0.0, 0.0)
    assert np.allclose(grid.probability, [[0.4, 0.4, 0.4, 0.4, 0.7]])


def test_a_hit_wins_over_a_pass_of_the_same_scan_whatever_the_order() -> None:
    angles_rad, ranges_m = np.array([0.0, 0.0]), np.array([0.25, 0.5])
    for order in ([0, 1], [1, 0]):
        grid = built([(np.zeros(3), angles_rad[order], ranges_m[order], 4.0)])
        assert np.allclose(grid.log_odds, [[MISS, MISS, HIT, MISS, HIT]])


def test_missing_beams_add_nothing() -> None:
    angles_rad = np.array([0.0, np.pi / 2])
    one = built([(np.zeros(3), angles_rad[:1], np.array([0.5]), 4.0)])
    other = built([(np.zeros(3), angles_rad, np.array([0.5, np.nan]), 4.0)])
    assert np.array_equal(one.log_odds, other.log_odds)
    with pytest.raises(MappingFailed, match="no scan has a valid beam"):
        built([(np.zeros(3), angles_rad, np.full(2, np.nan), 4.0)])
    with pytest.raises(MappingFailed, match="no scan has a valid beam"):
        GridBuilder(SETTINGS).build()


def test_beyond_the_maximum_range_a_beam_frees_and_hits_nothing() -> None:
    grid = built([(np.zeros(3), np.array([0.0]), np.array([9.0]), 0.5)])
    assert np.allclose(grid.log_odds, [[MISS] * 4])


def test_probabilities_stay_within_their_limits() -> None:
    grid = built([(np.zeros(3), np.array([0.0]), np.array([0.5]), 4.0)] * 50)
    assert np.allclose(grid.probability, [[0.1192] * 4 + [0.971]])


@given(st.integers(0, 2**32 - 1), st.integers(-90, 90), st.integers(-90, 90))
def test_moving_by_whole_cells_moves_the_map(seed: int, rows: int, columns: int) -> None:
    scans = random_scans(seed, 4)
    # Poses on a fine binary raster, so that the sums are exact.
    scans = [(np.round(pose * 1024) / 1024, *rest) for pose, *rest in scans]
    shift = np.array([columns, rows, 0]) * RESOLUTION_M
    moved = [(pose + shift, *rest) for pose, *rest in scans]
    expected = {(r + rows, c + columns): v for (r, c), v in cells_of(built(scans)).items()}
    ours = cells_of(built(moved))
    # An end within rounding of a border may fall on its other side.
    assert len(ours.keys() ^ expected.keys()) <= 1
    same = [ours[cell] == pytest.approx(expected[cell]) for cell in ours.keys() & expected.keys()]
    assert sum(same) >= len(same) - 2


@given(st.integers(0, 2**32 - 1), st.randoms(use_true_random=False))
def test_the_order_of_scans_does_not_matter_where_nothing_is_clamped(
    seed: int, random: object
) -> None:
    scans = random_scans(seed, 4)
    wide = GridSettings(resolution_m=RESOLUTION_M, p_lowest=0.001, p_highest=0.999)
    shuffled = scans.copy()
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    first, second = built(scans, wide), built(shuffled, wide)
    assert first.origin_m == second.origin_m
    assert np.allclose(first.log_odds, second.log_odds, equal_nan=True)


def test_a_symmetric_room_gives_four_equal_quarters() -> None:
    angles_rad = (np.arange(360) + 0.5) * np.pi / 180
    ranges_m = 2.0 / np.maximum(np.abs(np.cos(angles_rad)), np.abs(np.sin(angles_rad)))
    centre = np.array([RESOLUTION_M / 2, RESOLUTION_M / 2, 0.0])
    grid = built([(centre, angles_rad, ranges_m, 10.0)])
    assert grid.log_odds.shape[0] == grid.log_odds.shape[1]
    for other in (grid.log_odds[::-1], grid.log_odds[:, ::-1], grid.log_odds.T):
        assert np.allclose(grid.log_odds, other, equal_nan=True)


def test_memory_follows_the_area_and_not_the_number_of_scans() -> None:
    builder = GridBuilder(SETTINGS)
    scans = random_scans(0, 20)
    for scan in scans:
        builder.add_scan(*scan)
    size = builder._grid.log_odds.size
    for scan in scans * 20:
        builder.add_scan(*scan)
    assert builder._grid.log_odds.size == size


@pytest.mark.parametrize("x_m", [2e4, 1e30, -1e300])
def test_an_implausible_pose_is_refused_and_the_map_stays(x_m: float) -> None:
    builder = GridBuilder(GridSettings(resolution_m=RESOLUTION_M, cells_max=100_000))
    scan = (np.array([0.0]), np.array([0.5]), 4.0)
    builder.add_scan(np.zeros(3), *scan)
    before = builder.build()
    with pytest.raises(MappingFailed, match=r"100000 cells of 0\.125 m"):
        builder.add_scan(np.array([x_m, 0.0, 0.0]), *scan)
    assert np.array_equal(builder.build().log_odds, before.log_odds)
    builder.add_scan(np.zeros(3), *scan)


def test_padding_does_not_count_as_map() -> None:
    """A map that just fits is the same as one with spare cells, however it has grown."""
    scans = random_scans(3, 20)
    free = GridBuilder(SETTINGS)
    for scan in scans:
        free.add_scan(*scan)
    drawn = free.build()
    assert free._grid.reached is not None
    reached = free._grid.reached.size
    tight = GridBuilder(SETTINGS.model_copy(update={"cells_max": reached}))
    for scan in scans:
        tight.add_scan(*scan)
    np.testing.assert_array_equal(tight.build().log_odds, drawn.log_odds)
    smaller = GridBuilder(SETTINGS.model_copy(update={"cells_max": reached - 1}))
    refused = 0
    for scan in scans:
        try:
            smaller.add_scan(*scan)
        except MappingFailed:
            refused += 1
    assert refused > 0


def test_wrong_arguments_are_refused() -> None:
    builder = GridBuilder(SETTINGS)
    with pytest.raises(ValueError, match="angles and ranges"):
        builder.add_scan(np.zeros(3), np.zeros(2), np.ones(3), 4.0)
    with pytest.raises(ValueError, match="pose must be finite"):
        builder.add_scan(np.full(3, np.nan), np.zeros(2), np.ones(2), 4.0)


def test_an_unconfirmed_return_marks_an_unknown_cell_as_undecided_and_changes_no_other() -> None:
    builder = GridBuilder(SETTINGS)
    builder.add_scan(np.zeros(3), np.zeros(1), np.array([2.0625]), 4.0)
    before = cells_of(builder.build())
    pose = np.array([0.0, 0.0, 0.5])
    # At the hit, at a cell that was passed, and at two that no ray has reached.
    angles_rad, ranges_m = np.array([-0.5, -0.5, 0.0, 0.3]), np.array([2.0625, 1.0, 3.0, np.nan])
    builder.mark_unconfirmed(pose, angles_rad, ranges_m)
    after = cells_of(builder.build())
    column, row = (math.floor(3.0 * f(0.5) / RESOLUTION_M) for f in (math.cos, math.sin))
    assert after == before | {(row, column): 0.0}
    builder.add_scan(pose, np.zeros(1), np.array([3.0]), 4.0)
    assert cells_of(builder.build())[(row, column)] == pytest.approx(HIT)


def test_unconfirmed_returns_cannot_make_a_map_too_large() -> None:
    builder = GridBuilder(GridSettings(resolution_m=1.0, cells_max=100))
    with pytest.raises(MappingFailed, match="larger than 100"):
        builder.mark_unconfirmed(np.zeros(3), np.array([0.0, 1.6]), np.array([50.0, 50.0]))
