"""The z-buffer, against loops and scenes whose answer is plain."""

import math

import numpy as np

from fusion_core.calibration.refinement.hidden_points import visible_points


def visible_by_loop(pixels, depth_m, cell_px, tolerance):
    cell = [tuple(math.floor(x / cell_px) for x in pixel) for pixel in pixels]
    nearest: dict[tuple[int, int], float] = {}
    for place, depth in zip(cell, depth_m, strict=True):
        nearest[place] = min(depth, nearest.get(place, math.inf))

    def at(place, du, dv):
        return nearest.get((place[0] + du, place[1] + dv), math.inf)

    seen = []
    for place, depth in zip(cell, depth_m, strict=True):
        surfaces = [nearest[place]]
        for du, dv in ((1, 0), (0, 1), (1, 1), (1, -1)):
            surfaces.append(max(at(place, du, dv), at(place, -du, -dv)))
        seen.append(depth <= min(surfaces) * (1.0 + tolerance))
    return seen


def test_agrees_with_a_loop():
    rng = np.random.default_rng(4)
    for _ in range(20):
        count = rng.integers(1, 120)
        pixels = rng.uniform(-20.0, 60.0, (count, 2))
        depth_m = rng.uniform(2.0, 30.0, count)
        seen = visible_points(pixels, depth_m, cell_px=7.0, tolerance=0.1)
        assert seen.tolist() == visible_by_loop(pixels, depth_m, 7.0, 0.1)


def test_a_wall_behind_a_board_is_hidden_and_the_ground_is_not():
    u, v = (grid.ravel() for grid in np.meshgrid(np.arange(0.0, 100.0, 5.0), np.arange(0, 100, 5)))
    wall = np.stack([u, v], axis=1)
    board = wall[(u > 30) & (u < 60) & (v > 30) & (v < 60)] + 1.3
    pixels = np.concatenate([wall, board])
    depth_m = np.concatenate([np.full(len(wall), 20.0), np.full(len(board), 5.0)])
    seen = visible_points(pixels, depth_m, cell_px=7.5, tolerance=0.1)
    assert seen[len(wall) :].all()
    behind = (u > 36) & (u < 54) & (v > 36) & (v < 54)
    assert not seen[: len(wall)][behind].any()
    beside = (u < 20) | (u > 70) | (v < 20) | (v > 70)
    assert seen[: len(wall)][beside].all()
    # Ground seen at a grazing angle: each row is nearer than the one above it.
    ground_m = 150.0 / (5.0 + v)
    assert visible_points(wall, ground_m, cell_px=5.0, tolerance=0.1).all()


def test_no_points_are_none():
    assert visible_points(np.empty((0, 2)), np.empty(0), cell_px=3.0, tolerance=0.1).size == 0
