"""Shared maps against grids that share nothing, and a scan's cells against a plain loop."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.errors import MappingFailed
from fusion_core.slam import particle_maps
from fusion_core.slam.particle_maps import OCCUPANCY, TILE, UNKNOWN, ParticleMaps, add_scan

PARTICLES = 4
# Windows of at most 3 x 3 tiles on both sides of the origin.
CELL = st.integers(-2 * TILE, 2 * TILE - 1)


class PlainMaps:
    """A dictionary of tiles for each particle; a tile that changes is a new object."""

    def __init__(self):
        self.of = [{} for _ in range(PARTICLES)]

    def window(self, particle, low, high):
        rows = range(low[0] // TILE, high[0] // TILE + 1)
        columns = range(low[1] // TILE, high[1] // TILE + 1)
        empty = np.zeros((TILE, TILE), dtype=np.uint8)
        return np.block([[self.of[particle].get((r, c), empty) for c in columns] for r in rows])

    def write(self, particle, first, cells):
        for r in range(cells.shape[0] // TILE):
            for c in range(cells.shape[1] // TILE):
                part = cells[r * TILE : (r + 1) * TILE, c * TILE : (c + 1) * TILE]
                at = (first[0] // TILE + r, first[1] // TILE + c)
                before = self.of[particle].get(at, np.zeros_like(part))
                if (part != before).any():
                    self.of[particle][at] = part.copy()

    def resample(self, parents):
        self.of = [dict(self.of[parent]) for parent in parents]

    @property
    def tiles(self):
        return len({id(tile) for tiles in self.of for tile in tiles.values()})


def corners(a, b, c, d):
    return (min(a, c), min(b, d)), (max(a, c), max(b, d))


WINDOWS = st.builds(corners, CELL, CELL, CELL, CELL)
WRITES = st.tuples(st.integers(0, PARTICLES - 1), WINDOWS, st.integers(0, 40))
RESAMPLINGS = st.lists(st.integers(0, PARTICLES - 1), min_size=PARTICLES, max_size=PARTICLES)


@given(st.lists(st.one_of(WRITES, RESAMPLINGS), max_size=12), st.integers(0, 2**32 - 1))
def test_shared_maps_are_as_plain_ones(steps, seed):
    rng = np.random.default_rng(seed)
    maps, plain = ParticleMaps(PARTICLES), PlainMaps()
    for step in steps:
        if isinstance(step, list):
            maps.resample(np.array(step))
            plain.resample(step)
        else:
            particle, (low, high), changes = step
            window = maps.window(particle, low, high)
            at = rng.integers(0, window.cells.shape, (changes, 2))
            window.cells[at[:, 0], at[:, 1]] = rng.integers(0, 256, changes)
            plain.write(particle, (window.first_row, window.first_column), window.cells)
            maps.write(particle, window)
        assert maps.tiles == plain.tiles
        everywhere = ((-2 * TILE, -2 * TILE), (2 * TILE - 1, 2 * TILE - 1))
        for particle in range(PARTICLES):
            window = maps.window(particle, *everywhere)
            expected = plain.window(particle, *everywhere)
            np.testing.assert_array_equal(window.cells, expected)
            np.testing.assert_array_equal(window.occupancy, OCCUPANCY[expected])


def test_a_window_beyond_all_that_was_seen_is_unknown():
    window = ParticleMaps(1).window(0, (-1000, 5000), (-990, 5010))
    assert (window.cells == UNKNOWN).all()
    assert window.first_row <= -1000
    assert window.first_row + window.cells.shape[0] > -990
    assert window.first_row % TILE == 0


def test_writing_what_is_there_copies_nothing():
    maps = ParticleMaps(3)
    window = maps.window(0, (0, 0), (0, 2 * TILE))
    window.cells[0, 0] = window.cells[0, 2 * TILE] = 200
    maps.write(0, window)
    assert maps.tiles == 2
    maps.resample(np.zeros(3, dtype=np.int64))
    maps.write(1, maps.window(1, (0, 0), (0, 2 * TILE)))
    assert maps.tiles == 2
    window = maps.window(1, (0, 0), (0, 2 * TILE))
    window.cells[0, 0] = 201
    maps.write(1, window)
    assert maps.tiles == 3
    assert maps.window(2, (0, 0), (0, 0)).cells[0, 0] == 200
    # Two are left with the old one: the first of them copies it, for the last it is its own.
    for particle, tiles in ((2, 4), (0, 4)):
        window = maps.window(particle, (0, 0), (0, 0))
        window.cells[0, 0] = 202 + particle
        maps.write(particle, window)
        assert maps.tiles == tiles


def test_maps_beyond_the_limit_are_refused(monkeypatch):
    monkeypatch.setattr(particle_maps, "_TILES_MAX", 20)
    maps = ParticleMaps(2)
    for particle, row in itertools.product(range(2), range(10)):
        window = maps.window(particle, (TILE * row, 0), (TILE * row, 0))
        window.cells[0, 0] = 200
        maps.write(particle, window)
    assert maps.capacity == 20
    window = maps.window(0, (TILE * 10, 0), (TILE * 10, 0))
    window.cells[0, 0] = 200
    with pytest.raises(MappingFailed, match="the maps of 2 particles take more than 1 GB"):
        maps.write(0, window)


def test_memory_follows_the_area_and_not_time():
    maps = ParticleMaps(4)
    rng = np.random.default_rng(5)
    for _ in range(200):
        for particle in range(4):
            window = maps.window(particle, (0, 0), (2 * TILE - 1, 2 * TILE - 1))
            window.cells[rng.integers(0, 2 * TILE, 9), rng.integers(0, 2 * TILE, 9)] += 1
            maps.write(particle, window)
        maps.resample(rng.integers(0, 4, 4))
    assert maps.tiles <= 4 * 4
    assert maps.capacity <= 2 * 4 * 4


def test_a_cell_is_a_probability():
    assert OCCUPANCY[UNKNOWN] == 0
    assert OCCUPANCY[128] == 128
    assert OCCUPANCY[255] == round(255 * 0.98)
    assert OCCUPANCY[1] == round(255 * 0.02)
    assert (np.diff(OCCUPANCY[1:].astype(int)) >= 0).all()


@pytest.mark.parametrize("seed", range(5))
def test_a_scan_frees_its_rays_and_hits_its_walls(seed):
    rng = np.random.default_rng(seed)
    before = rng.integers(0, 256, (TILE, TILE)).astype(np.uint8)
    origin = rng.uniform(20.0, 40.0, 2)
    ends, hits = rng.uniform(0.5, TILE - 0.5, (30, 2)), rng.uniform(0.5, TILE - 0.5, (40, 2))
    cells = before.copy()
    add_scan(cells, origin, hits, ends)

    is_hit, is_passed = np.zeros_like(before, dtype=bool), np.zeros_like(before, dtype=bool)
    is_hit[tuple(np.floor(hits[:, ::-1]).astype(int).T)] = True
    # At steps of a thousandth no cell of a ray is missed, except corners that it only grazes.
    for end in ends:
        places = origin + np.linspace(0.0, 1.0, 20_001)[:, np.newaxis] * (end - origin)
        passed = np.floor(places[:, ::-1]).astype(int)
        passed = passed[(passed != passed[-1]).any(axis=1)]
        is_passed[tuple(passed.T)] = True
    start = np.where(before == UNKNOWN, 128, before.astype(int))
    expected = np.where(is_hit, start + 13, np.where(is_passed, start - 3, before))
    touched = is_hit | is_passed
    expected[touched] = np.clip(expected[touched], 1, 255)
    assert np.count_nonzero(expected != cells) <= 2
    assert is_passed.sum() > 300
