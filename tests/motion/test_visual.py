"""Visual odometry before a textured wall, drawn by its homography, and the planar fit alone."""

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares

from fusion_core.model.conventions import R_BODY_OPTICAL, FloatArray
from fusion_core.model.errors import MissingStream
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_yaw_pitch_roll,
    transform_from_planar,
    transform_points,
)
from fusion_core.model.planar_poses import relative_pose
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.motion.planar_reprojection import FeatureNoise, estimate_planar_step
from fusion_core.motion.steps import integrate_steps
from fusion_core.motion.visual import VisualOdometrySettings, visual_odometry
from tests.motion.simulated_motion import STEP_NS, stamps, step_errors

INTRINSICS = CameraIntrinsics(width=320, height=240, fx=288.0, fy=288.0, cx=159.5, cy=119.5)
K = np.array(
    [[INTRINSICS.fx, 0.0, INTRINSICS.cx], [0.0, INTRINSICS.fy, INTRINSICS.cy], [0.0, 0.0, 1.0]]
)
# 10 cm ahead, 4 cm to the left and 60 cm above the LiDAR, looking 7 degrees left and 5 down.
T_LIDAR_CAMERA = make_transform(
    rotation_from_yaw_pitch_roll(0.12, 0.09, 0.0) @ R_BODY_OPTICAL, np.array([0.1, 0.04, 0.6])
)
WALL_M = 3.5
PX_PER_M = 120.0
COUNT = 30


def _texture() -> np.ndarray:
    """8 m of a wall: random blocks of many sizes."""
    random = np.random.default_rng(3)
    size = int(8.0 * PX_PER_M)
    drawn = np.full((size, size), 128.0)
    for cells in (20, 60, 160):
        grid = random.uniform(-60.0, 60.0, (cells, cells)).astype(np.float32)
        drawn += cv2.resize(grid, (size, size), interpolation=cv2.INTER_NEAREST)
    return cv2.GaussianBlur(np.clip(drawn, 0, 255).astype(np.uint8), (0, 0), 1.0)


TEXTURE = _texture()


def frame(pose: FloatArray, number: int, *, light: float = 1.0, depth_scale: int = 1) -> RgbdFrame:
    """What the camera sees at a pose of the LiDAR: the wall at x = WALL_M, and the depth of it."""
    T_camera_map = invert_transform(transform_from_planar(pose) @ T_LIDAR_CAMERA)
    # Wall pixels (a, b) lie at y = 4 - a / PX_PER_M, z = 4 - b / PX_PER_M.
    wall = np.array([[0.0, 0.0, WALL_M], [-1.0 / PX_PER_M, 0.0, 4.0], [0.0, -1.0 / PX_PER_M, 4.0]])
    H = K @ (T_camera_map[:3, :3] @ wall + np.outer(T_camera_map[:3, 3], [0.0, 0.0, 1.0]))
    gray = cv2.warpPerspective(
        TEXTURE, H, (INTRINSICS.width, INTRINSICS.height), flags=cv2.INTER_LINEAR
    )
    random = np.random.default_rng(number)
    noisy = np.clip(light * gray + random.normal(0.0, 2.0, gray.shape), 0, 255).astype(np.uint8)
    rows, columns = np.mgrid[
        : INTRINSICS.height : depth_scale, : INTRINSICS.width : depth_scale
    ].astype(float)
    rows, columns = (x + 0.5 * (depth_scale - 1) for x in (rows, columns))
    rays = np.stack(
        [
            (columns - INTRINSICS.cx) / INTRINSICS.fx,
            (rows - INTRINSICS.cy) / INTRINSICS.fy,
            np.ones(rows.shape),
        ],
        axis=-1,
    )
    T_map_camera = invert_transform(T_camera_map)
    depth_m = (WALL_M - T_map_camera[0, 3]) / (rays @ T_map_camera[0, :3])
    depth_m += random.normal(0.0, 0.003, depth_m.shape) * depth_m**2
    depth_m[random.uniform(size=depth_m.shape) < 0.05] = np.nan
    stamp_ns = int(stamps(1)[0]) + number * STEP_NS
    return RgbdFrame(stamp_ns=stamp_ns, gray=noisy, depth_m=depth_m.astype(np.float32))


STEPS = np.stack(
    [np.full(COUNT - 1, 0.03), np.zeros(COUNT - 1), 0.03 * np.cos(np.arange(COUNT - 1) / 4.0)], 1
)
POSES = integrate_steps(STEPS)


def test_it_gives_the_motion_of_the_lidar_not_of_the_camera() -> None:
    trajectory = visual_odometry(
        (frame(p, k) for k, p in enumerate(POSES)), INTRINSICS, T_LIDAR_CAMERA
    )
    assert trajectory.measured.all()
    error = relative_pose(POSES[-1], trajectory.poses_odom_lidar[-1])
    assert np.hypot(error[0], error[1]) < 0.03
    assert abs(error[2]) < 0.01
    errors = step_errors(trajectory, STEPS)
    said = np.sqrt(np.diagonal(trajectory.step_covariance, axis1=1, axis2=2).mean(axis=0))
    assert (np.sqrt((errors**2).mean(axis=0)) < 2.0 * said).all()
    assert said[0] < 0.05


def test_depth_of_half_the_size_does_as_well() -> None:
    frames = (frame(p, k, depth_scale=2) for k, p in enumerate(POSES[:10]))
    trajectory = visual_odometry(frames, INTRINSICS, T_LIDAR_CAMERA)
    assert trajectory.measured.all()
    error = relative_pose(POSES[9], trajectory.poses_odom_lidar[-1])
    assert np.hypot(error[0], error[1]) < 0.02


def test_dark_images_are_not_measured_and_what_follows_is_right_again() -> None:
    dark = range(10, 14)
    frames = (frame(pose, k, light=0.0 if k in dark else 1.0) for k, pose in enumerate(POSES[:20]))
    trajectory = visual_odometry(frames, INTRINSICS, T_LIDAR_CAMERA)
    np.testing.assert_array_equal(np.flatnonzero(~trajectory.measured), np.arange(9, 14))
    assert "visual: 5 steps not measured: 4 too few" in trajectory.notes[0]
    error = relative_pose(POSES[19], trajectory.poses_odom_lidar[-1])
    assert np.hypot(error[0], error[1]) < 0.03


def test_without_depth_or_images_there_is_nothing_to_follow() -> None:
    blind = [
        RgbdFrame(stamp_ns=f.stamp_ns, gray=f.gray, depth_m=np.full_like(f.depth_m, np.nan))
        for f in (frame(p, k) for k, p in enumerate(POSES[:3]))
    ]
    trajectory = visual_odometry(blind, INTRINSICS, T_LIDAR_CAMERA)
    assert not trajectory.measured.any()
    assert "too few features with depth" in trajectory.notes[0]
    with pytest.raises(MissingStream, match="needs an image"):
        visual_odometry([], INTRINSICS, T_LIDAR_CAMERA)


def test_two_runs_give_the_same_bytes() -> None:
    frames = [frame(p, k) for k, p in enumerate(POSES[:6])]
    one, other = (visual_odometry(frames, INTRINSICS, T_LIDAR_CAMERA) for _ in range(2))
    assert one.poses_odom_lidar.tobytes() == other.poses_odom_lidar.tobytes()


def test_a_wall_without_texture_is_not_measured() -> None:
    flat = [
        RgbdFrame(stamp_ns=f.stamp_ns, gray=np.full_like(f.gray, 90), depth_m=f.depth_m)
        for f in (frame(p, k) for k, p in enumerate(POSES[:3]))
    ]
    trajectory = visual_odometry(flat, INTRINSICS, T_LIDAR_CAMERA, VisualOdometrySettings())
    assert not trajectory.measured.any()


def scattered(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points in the LiDAR's frame, where they are seen after a step, and the step."""
    random = np.random.default_rng(seed)
    in_camera = random.uniform([-1.0, -0.8, 1.5], [1.0, 0.8, 4.0], (80, 3))
    points = transform_points(T_LIDAR_CAMERA, in_camera)
    step = np.array([0.12, -0.03, 0.08])
    now = transform_points(invert_transform(transform_from_planar(step) @ T_LIDAR_CAMERA), points)
    return points, now[:, :2] / now[:, 2:], step


def fit(points: FloatArray, seen: FloatArray, depth_sigma: float = 1e-9):
    return estimate_planar_step(
        points,
        seen,
        np.zeros(3),
        T_LIDAR_CAMERA,
        FeatureNoise(focal_px=INTRINSICS.fx, sigma_px=0.5, depth_sigma_per_m2=depth_sigma),
    )


def test_the_planar_fit_is_exact_on_exact_points() -> None:
    points, seen, step = scattered(0)
    found = fit(points, seen)
    assert found is not None
    np.testing.assert_allclose(found.step, step, atol=1e-6)
    assert found.is_inlier.all()


def test_the_planar_fit_is_that_of_scipy() -> None:
    """With Huber's loss on each point's error, as scipy has it."""
    points, seen, _ = scattered(1)
    noisy = seen + np.random.default_rng(1).normal(0.0, 0.5 / INTRINSICS.fx, seen.shape)
    noisy[:6] += 0.05
    found = fit(points, noisy)
    assert found is not None

    def sizes(step: FloatArray) -> FloatArray:
        now = transform_points(
            invert_transform(transform_from_planar(step) @ T_LIDAR_CAMERA), points
        )
        return INTRINSICS.fx * np.linalg.norm(now[:, :2] / now[:, 2:] - noisy, axis=1) / 0.5

    best = least_squares(sizes, np.zeros(3), loss="huber", f_scale=1.345, xtol=1e-12, ftol=1e-14)
    np.testing.assert_allclose(found.step, best.x, atol=2e-5)
    assert not found.is_inlier[:6].any()


def test_the_planar_covariance_is_that_of_many_fits() -> None:
    points, seen, step = scattered(2)
    depth_sigma = 0.003
    errors, said = [], []
    depths = transform_points(invert_transform(T_LIDAR_CAMERA), points)[:, 2]
    rays = (points - T_LIDAR_CAMERA[:3, 3]) / depths[:, np.newaxis]
    for seed in range(200):
        random = np.random.default_rng(seed)
        off_m = random.normal(0.0, depth_sigma * depths**2)
        measured = points + off_m[:, np.newaxis] * rays
        found = fit(
            measured, seen + random.normal(0.0, 0.5 / INTRINSICS.fx, seen.shape), depth_sigma
        )
        assert found is not None
        errors.append(found.step - step)
        said.append(found.covariance)
    sampled = np.sqrt(np.diag(np.cov(np.array(errors).T)))
    np.testing.assert_allclose(np.sqrt(np.diag(np.mean(said, axis=0))), sampled, rtol=0.3)


def test_points_in_one_place_determine_nothing() -> None:
    points, seen, _ = scattered(3)
    assert fit(np.repeat(points[:1], 10, axis=0), np.repeat(seen[:1], 10, axis=0)) is None
