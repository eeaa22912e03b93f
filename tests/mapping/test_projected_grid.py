"""The grid from an octree by projection, against a loop over cells by octomap_server's rule."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.exporting.ros_map import (
    FREE_PIXEL,
    OCCUPIED_PIXEL,
    UNKNOWN_PIXEL,
    trinary_pixels,
)
from fusion_core.mapping.octree import OctreeBuilder, OctreeSettings
from fusion_core.mapping.octree_nodes import leaves_of
from fusion_core.mapping.projected_grid import (
    FREE_BELOW,
    OCCUPIED_ABOVE,
    ProjectedGridSettings,
    project_octree,
)
from fusion_core.model.errors import MappingFailed

RESOLUTION_M = 0.25


def projected_pixels(grid):
    return trinary_pixels(grid, occupied_above=OCCUPIED_ABOVE, free_below=FREE_BELOW)


def octree_of(seed, count=3):
    random = np.random.default_rng(seed)
    builder = OctreeBuilder(OctreeSettings(resolution_m=RESOLUTION_M))
    for _ in range(count):
        builder.add(random.uniform(-3.0, 3.0, (40, 3)), random.uniform(-1.0, 1.0, 3))
    return builder.build()


def octree_with_large_leaves():
    """Free space that many clouds of a half sphere have made certain, and a few points within."""
    random = np.random.default_rng(1)
    builder = OctreeBuilder(OctreeSettings(resolution_m=RESOLUTION_M))
    azimuth, height = random.uniform(-np.pi, np.pi, 4000), random.uniform(-1.0, 1.0, 4000)
    across = np.sqrt(1.0 - height**2)
    shell_m = 4.0 * np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), height])
    for _ in range(8):
        builder.add(shell_m, np.array([0.1, 0.1, 0.1]))
    for _ in range(5):
        builder.add(random.uniform(-1.0, 1.0, (3, 3)), np.array([0.1, 0.1, 0.1]))
    return builder.build()


def by_octomap_servers_rule(octree, low_m, high_m):
    """State of each (x, y) cell: occupied overrides free; a leaf counts where it overlaps the
    band: z + half > low and z - half < high."""
    states = {}
    leaves = leaves_of(octree)
    for corner, side, value in zip(leaves.corners, leaves.sides, leaves.log_odds, strict=True):
        z_m = (corner[2] + 0.5 * side) * RESOLUTION_M
        half_m = 0.5 * side * RESOLUTION_M
        if not (z_m + half_m > low_m and z_m - half_m < high_m):
            continue
        for x in range(corner[0], corner[0] + side):
            for y in range(corner[1], corner[1] + side):
                if value >= 0.0:
                    states[x, y] = "occupied"
                else:
                    states.setdefault((x, y), "free")
    return states


@given(
    seed=st.integers(0, 99),
    floor=st.integers(-4, 4),
    band=st.tuples(st.integers(-8, 4), st.integers(1, 8)),
)
def test_against_a_loop(seed, floor, band):
    check_against_a_loop(octree_of(seed), floor, band)


@pytest.mark.parametrize("band", [(-20, 40), (-8, 12), (2, 3)])
def test_leaves_of_several_sizes(band):
    octree = octree_with_large_leaves()
    assert len(np.unique(leaves_of(octree).sides)) >= 3
    check_against_a_loop(octree, 0, band)


def check_against_a_loop(octree, floor, band):
    # Multiples of an eighth: borders of cells and their middles, exact in floating point.
    floor_m, low_m, high_m = floor / 8.0, band[0] / 8.0, (band[0] + band[1]) / 8.0
    settings = ProjectedGridSettings(height_min_m=low_m, height_max_m=high_m)
    expected = by_octomap_servers_rule(octree, floor_m + low_m, floor_m + high_m)
    if not expected:
        with pytest.raises(MappingFailed, match="no leaf"):
            project_octree(octree, floor_m, settings)
        return
    grid = project_octree(octree, floor_m, settings)
    pixels = np.flipud(projected_pixels(grid))
    names = {OCCUPIED_PIXEL: "occupied", FREE_PIXEL: "free"}
    first = np.rint(np.array(grid.origin_m) / RESOLUTION_M).astype(int)
    rows, columns = np.nonzero(pixels != UNKNOWN_PIXEL)
    found = {
        (int(first[0] + column), int(first[1] + row)): names[int(pixels[row, column])]
        for row, column in zip(rows, columns, strict=True)
    }
    assert found == expected
    assert np.array_equal(pixels == UNKNOWN_PIXEL, np.isnan(grid.log_odds))
    # Cut to what is known.
    assert grid.known.any(axis=0)[[0, -1]].all()
    assert grid.known.any(axis=1)[[0, -1]].all()


def test_a_band_that_touches_a_leaf_does_not_see_it():
    """0.1 m cells: 3 * 0.1 exceeds 0.3 in floating point."""
    builder = OctreeBuilder(OctreeSettings(resolution_m=0.1))
    builder.add(np.array([[1.05, 0.05, 0.25]]), np.array([0.05, 0.05, 0.25]))
    octree = builder.build()
    with pytest.raises(MappingFailed, match="no leaf"):
        project_octree(octree, 0.0, ProjectedGridSettings(height_min_m=0.3, height_max_m=1.0))
    with pytest.raises(MappingFailed, match="no leaf"):
        project_octree(octree, 0.0, ProjectedGridSettings(height_min_m=0.1, height_max_m=0.2))
    grid = project_octree(octree, -0.05, ProjectedGridSettings(height_min_m=0.3, height_max_m=0.4))
    assert grid.log_odds.shape == (1, 11)
    assert (grid.log_odds[0, :-1] < 0.0).all()
    assert grid.log_odds[0, -1] > 0.0


def test_one_half_is_occupied_as_in_octomap():
    """A hit and a miss that cancel leave log odds of exactly zero."""
    settings = OctreeSettings(resolution_m=0.25, p_hit=0.75, p_miss=0.25)
    builder = OctreeBuilder(settings)
    origin_m = np.array([0.1, 0.1, 0.1])
    builder.add(np.array([[1.1, 0.1, 0.1]]), origin_m)
    builder.add(np.array([[2.1, 0.1, 0.1]]), origin_m)
    octree = builder.build()
    grid = project_octree(octree, 0.0, ProjectedGridSettings(height_min_m=0.0))
    cell = grid.log_odds[0, 4]
    assert cell == 0.0
    assert projected_pixels(grid)[0, 4] == OCCUPIED_PIXEL


def test_a_grid_that_is_too_large():
    octree = octree_of(0)
    with pytest.raises(MappingFailed, match="more than 10") as raised:
        project_octree(octree, 0.0, ProjectedGridSettings(cells_max=10))
    assert "\n" not in str(raised.value)
