"""Patches of planes whose depths have a closed form."""

import numpy as np
import pytest

from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.patches.depth_patches import find_patches
from fusion_core.patches.inside_surfaces import is_flat, is_interior

LENS = CameraIntrinsics(width=160, height=120, fx=144.0, fy=144.0, cx=79.5, cy=59.5)


def plane_depth_m(normal: np.ndarray, distance_m: float) -> np.ndarray:
    """(H, W) depths of the plane n . X = -d, seen from its front."""
    u, v = np.meshgrid(np.arange(LENS.width), np.arange(LENS.height))
    rays = np.stack([(u - LENS.cx) / LENS.fx, (v - LENS.cy) / LENS.fy, np.ones(u.shape)], axis=-1)
    return -distance_m / (rays @ normal)


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (0.4, 0.1, -0.9), (0.1, -0.8, -0.55)])
def test_patches_of_a_plane_lie_on_it(normal) -> None:
    normal = np.array(normal) / np.linalg.norm(normal)
    depth_m = plane_depth_m(normal, 2.0).astype(np.float32)
    depth_m[depth_m > 8.0] = np.nan
    depth_m[depth_m < 0.0] = np.nan
    patches = find_patches(depth_m, LENS)
    assert patches.pixel.size > 100
    np.testing.assert_allclose(patches.points_m @ normal, -2.0, atol=2e-4)
    np.testing.assert_allclose(patches.normals, np.tile(normal, (patches.pixel.size, 1)), atol=1e-3)
    row, column = np.divmod(patches.pixel, LENS.width)
    x = patches.points_m[:, 0] / patches.points_m[:, 2]
    np.testing.assert_allclose(x, (column - LENS.cx) / LENS.fx, atol=1e-12)
    assert row.max() < LENS.height


def test_noise_averages_out_and_is_told() -> None:
    rng = np.random.default_rng(0)
    depth_m = plane_depth_m(np.array([0.0, 0.0, -1.0]), 3.0)
    noisy = (depth_m + rng.normal(0.0, 0.02, depth_m.shape)).astype(np.float32)
    patches = find_patches(noisy, LENS)
    assert np.std(patches.points_m[:, 2]) < 0.02 / 2.0
    assert np.median(patches.spread_m) == pytest.approx(0.02, rel=0.2)
    flat = is_flat(patches.points_m[:, 2], patches.spread_m)
    assert flat.mean() > 0.7


def test_the_foot_of_a_wall_is_no_inside_of_a_surface() -> None:
    """The lower half is a floor, the upper a wall that rises from it."""
    wall = plane_depth_m(np.array([0.0, 0.0, -1.0]), 3.0)
    floor = plane_depth_m(np.array([0.0, -1.0, 0.0]), 0.9)
    depth_m = np.where((floor > 0.0) & (floor < wall), floor, wall).astype(np.float32)
    rng = np.random.default_rng(1)
    depth_m += rng.normal(0.0, 0.03, depth_m.shape).astype(np.float32)
    patches = find_patches(depth_m, LENS)
    inside = is_interior(patches, is_flat(patches.points_m[:, 2], patches.spread_m))
    assert inside.sum() > 100
    points, level = patches.points_m[inside], np.abs(patches.normals[inside, 1]) > 0.9
    assert level.any()
    assert not level.all()
    # What is kept is of one surface: no patch that the edge bends pulls, however noisy it is.
    foot = LENS.cy + LENS.fy * 0.9 / 3.0
    assert np.abs(patches.pixel[inside] // LENS.width - foot).min() > 2.0
    assert np.mean(points[level, 1]) == pytest.approx(0.9, abs=5e-3)
    assert np.mean(points[~level, 2]) == pytest.approx(3.0, abs=5e-3)


def test_holes_and_strange_depths_have_no_patches() -> None:
    for value in (np.nan, 0.0, -1.0, np.inf):
        patches = find_patches(np.full((120, 160), value, dtype=np.float32), LENS)
        assert patches.pixel.size == 0
        assert is_interior(patches, np.zeros(0, dtype=bool)).size == 0
