"""Dense depth: surfaces of blocks, their alignment, and what contradicts a motion."""

import cv2
import numpy as np
import pytest

from fusion_core.model.geometry import invert_transform
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.slam.visual.depth_alignment import align_depths
from fusion_core.slam.visual.depth_consistency import (
    contradicted_share,
)
from fusion_core.slam.visual.depth_surface import SurfaceSampler
from fusion_core.slam.visual.doubtful_stretches import PoseCheck
from fusion_core.slam.visual.pose_optimisation import exp_se3

CAMERA = CameraIntrinsics(width=320, height=240, fx=290.0, fy=288.0, cx=158.0, cy=121.0)
SIGMA = 0.003
# Planes n x = d of the world, whose axes are those of the camera at the identity.
ROOM = (((0.1, 0.0, 1.0), 2.5), ((0.0, 1.0, 0.1), 0.9), ((1.0, 0.0, 0.2), 1.3))
WALL = (((0.0, 0.0, 1.0), 2.0),)
CORRIDOR = (((1.0, 0.0, 0.0), 1.0), ((-1.0, 0.0, 0.0), 1.0), ((0.0, 1.0, 0.0), 1.2))
MOTION = exp_se3(np.array([0.03, -0.05, 0.02, 0.06, 0.02, -0.04]))


def depth_of(planes, T_camera_world, seed=0, sigma=0.002):
    """(H, W) float32 of the nearest plane ahead of each pixel, with noise and holes."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], -1)
    depth_m = np.full(u.shape, np.inf)
    for normal, distance in planes:
        n = T_camera_world[:3, :3] @ np.array(normal)
        with np.errstate(divide="ignore"):
            z = (distance + n @ T_camera_world[:3, 3]) / (rays @ n)
        depth_m = np.where((z > 0.1) & (z < depth_m), z, depth_m)
    random = np.random.default_rng(seed)
    depth_m = np.where(np.isfinite(depth_m), depth_m, np.nan)
    depth_m += random.normal(0.0, sigma, u.shape) * depth_m**2
    depth_m[random.uniform(size=u.shape) < 0.1] = np.nan
    return depth_m.astype(np.float32)


def surface_of(planes, T_camera_world, seed=0, sigma=0.002):
    sampler = SurfaceSampler(CAMERA)
    return sampler.surface(sampler.reduce(depth_of(planes, T_camera_world, seed, sigma)))


def small_motion(T):
    """(6,) of a motion near the identity."""
    return np.concatenate([cv2.Rodrigues(T[:3, :3])[0].ravel(), T[:3, 3]])


def test_a_surface_lies_on_its_planes():
    surface = surface_of(WALL, np.eye(4))
    known = np.isfinite(surface.normals[..., 0])
    assert known.mean() > 0.9
    assert surface.points_m[known][:, 2] == pytest.approx(2.0, abs=0.03)
    assert np.abs(surface.normals[known][:, 2]).mean() > 0.95


def test_the_lens_is_taken_off():
    """A wall seen by a lens with distortion is as flat, and as wide, as without."""
    intrinsics = CameraIntrinsics(
        width=320, height=240, fx=290.0, fy=288.0, cx=158.0, cy=121.0,
        distortion=(-0.2, 0.05, 0.0, 0.0, 0.0),
    )  # fmt: skip
    v, u = np.mgrid[:240, :320].astype(float)
    seen = np.column_stack([u.ravel(), v.ravel()])[:, np.newaxis]
    rays = cv2.undistortPoints(seen, intrinsics.matrix, np.array(intrinsics.distortion))
    x = rays[:, 0, 0].reshape(240, 320)
    # The plane x + 2 z = 4.
    sampler = SurfaceSampler(intrinsics)
    surface = sampler.surface(sampler.reduce((4.0 / (x + 2.0)).astype(np.float32)))
    points = surface.points_m[np.isfinite(surface.points_m[..., 2])]
    assert np.abs(points[:, 0] + 2.0 * points[:, 2] - 4.0).max() < 0.01


@pytest.mark.parametrize("seed", range(3))
def test_the_motion_between_two_images_is_found(seed):
    found = align_depths(
        surface_of(ROOM, np.eye(4), 2 * seed),
        surface_of(ROOM, MOTION, 2 * seed + 1),
        np.eye(4),
        SIGMA,
        0.25,
    )
    assert found is not None
    off = small_motion(found[0] @ invert_transform(MOTION))
    assert np.abs(off[:3]).max() < 2e-3
    assert np.abs(off[3:]).max() < 4e-3
    assert np.linalg.eigvalsh(found[1]).min() > 1.0


def test_a_wall_says_nothing_of_what_slides_along_it():
    T = exp_se3(np.array([0.0, 0.0, 0.0, 0.0, 0.0, -0.05]))
    found = align_depths(surface_of(WALL, np.eye(4)), surface_of(WALL, T, 1), np.eye(4), SIGMA, 0.2)
    assert found is not None
    x, y, z = found[1][3, 3], found[1][4, 4], found[1][5, 5]
    assert max(x, y) < 0.02 * z
    assert found[0][2, 3] == pytest.approx(-0.05, abs=2e-3)


def test_normals_follow_all_blocks_around():
    """Noise turns a normal as much less as twenty-five blocks tell its slope better than two do."""
    depth_m = depth_of((((0.5, 0.0, 1.0), 4.0),), np.eye(4), sigma=SIGMA)
    sampler = SurfaceSampler(CAMERA)
    surface = sampler.surface(sampler.reduce(depth_m))
    n = surface.normals[np.isfinite(surface.normals[..., 0])]
    # The plane's u slope is n_x / (n p) / fx; four pixels are averaged to a block.
    points = surface.points_m[np.isfinite(surface.normals[..., 0])]
    slopes = n[:, 0] / (n * points).sum(axis=1) / surface.camera[0]
    expected = SIGMA / 2.0 / np.sqrt(50.0)
    assert slopes.mean() == pytest.approx(0.5 / 4.0 / surface.camera[0], abs=0.2 * expected)
    assert slopes.std() == pytest.approx(expected, rel=0.25)


@pytest.mark.parametrize("seed", range(3))
def test_what_a_corridor_hides_is_not_claimed(seed):
    """Noise of normals far away must not say that the camera stood still."""
    T = exp_se3(np.array([0.0, 0.0, 0.0, 0.0, 0.0, -0.3]))
    first, second = surface_of(CORRIDOR, np.eye(4), 2 * seed), surface_of(CORRIDOR, T, 2 * seed + 1)
    found = align_depths(first, second, T, SIGMA, 0.2)
    assert found is not None
    off = found[0][2, 3] + 0.3
    assert off**2 / np.linalg.inv(found[1])[5, 5] < 9.0


CORNER = (((0.3, 0.0, 1.0), 1.6), ((-0.5, 0.0, 1.0), 1.8), ((0.0, 1.0, 0.3), 0.9))


@pytest.mark.parametrize(("planes", "ahead_m"), [(CORRIDOR, 0.3), (CORNER, -1.5)])
def test_the_information_is_that_of_the_error(planes, ahead_m):
    """Squared errors, normalised, have the mean of their six degrees of freedom: where noise of the
    normals says more than the surfaces do, and where many blocks fall into one of the other."""
    T = exp_se3(np.array([0.0, 0.02, 0.0, 0.05, 0.0, -ahead_m]))
    chi2 = []
    for seed in range(16):
        # The mean of four pixels errs by half as much as one.
        first, second = (
            surface_of(planes, pose, 2 * seed + k, sigma=2.0 * SIGMA)
            for k, pose in enumerate((np.eye(4), T))
        )
        found = align_depths(first, second, T, SIGMA, 0.2)
        assert found is not None
        off = small_motion(found[0] @ invert_transform(T))
        chi2.append(off @ found[1] @ off)
    # Four standard deviations of that mean, and 0.2 for the edges between surfaces.
    assert np.mean(chi2) / 6.0 == pytest.approx(1.0, abs=4.0 * np.sqrt(12.0 / 16.0) / 6.0 + 0.2)


def test_images_are_not_slid_until_they_agree():
    """The walls of a corridor fit wherever along it the other camera stood."""
    T = exp_se3(np.array([0.0, 0.1, 0.0, 0.0, 0.0, 3.0]))
    first, second = (
        surface_of(CORRIDOR, pose, seed, sigma=0.005) for seed, pose in ((2, np.eye(4)), (3, T))
    )
    assert align_depths(first, second, T, SIGMA, 0.25) is None


def test_images_that_share_too_little_are_not_aligned():
    away = exp_se3(np.array([0.0, 2.0, 0.0, 0.0, 0.0, 0.0]))
    first, second = surface_of(ROOM, np.eye(4)), surface_of(ROOM, away)
    assert align_depths(first, second, away, SIGMA, 0.25) is None


def test_what_moves_contradicts_the_motion():
    first, second = surface_of(ROOM, np.eye(4)), surface_of(ROOM, MOTION, 1)
    assert contradicted_share(first, second, MOTION, SIGMA) < 0.01
    wrong = exp_se3(np.array([0.0, 0.0, 0.0, 0.0, 0.0, -0.3]))
    assert contradicted_share(first, second, wrong @ MOTION, SIGMA) > 0.3


def test_neighbouring_doubts_are_one_stretch():
    shares = iter([0.0, 0.2, 0.3, 0.0, 0.15, None])
    check = PoseCheck(
        lambda *_: next(shares),
        check_images=5,
        share_max=0.1,
        gap_images=0,
        says="of the depth image contradicts the motion",
    )
    for image in range(30):
        check.check(image, None, None, None)
    found = check.doubtful(np.arange(30, dtype=np.int64))
    assert [(s.first_stamp_ns, s.last_stamp_ns) for s in found] == [(1, 10), (16, 20)]
    assert found[0].share == 0.3
    assert "30 %" in found[0].reason
