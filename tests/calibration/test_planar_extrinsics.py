"""A pose in six degrees of freedom from rooms whose walls and floor have a closed form."""

from dataclasses import replace

import numpy as np
import pytest

from fusion_core.alignment.mount_refinement import fit_lines
from fusion_core.calibration.planar.planar_extrinsics import PlanarPriors, PlanarProblem
from fusion_core.calibration.planar.planar_frames import FlatFrames, ScanWithPatches
from fusion_core.calibration.planar.planar_residuals import (
    CLOCK,
    FLOOR,
    POSE,
    STRETCH,
    UNKNOWNS,
    PlanarState,
    surface_residuals,
)
from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_yaw_pitch_roll,
    transform_from_planar,
)
from fusion_core.model.polar import points_from_polar
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.patches.depth_patches import find_patches
from tests.alignment.conftest import FURNITURE, BoxRoom

LENS = CameraIntrinsics(width=160, height=120, fx=144.0, fy=144.0, cx=79.5, cy=59.5)
SIZE = (LENS.width, LENS.height)
LIDAR_HEIGHT_M = 0.3
ROOM = BoxRoom(boxes=FURNITURE)
ANGLES = np.deg2rad(np.arange(-120.0, 120.0, 0.5))


def camera_pose(seed: int) -> np.ndarray:
    """T_camera_lidar of a camera that is tilted and rolled."""
    rng = np.random.default_rng(seed)
    yaw, pitch, roll = np.deg2rad(rng.uniform([-20.0, 0.0, -6.0], [20.0, 8.0, 6.0]))
    place = rng.uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 0.7])
    body = rotation_from_yaw_pitch_roll(yaw, pitch, roll)
    return invert_transform(make_transform(body @ R_BODY_OPTICAL, place))


def frame_at(
    pose: np.ndarray,
    T_camera_lidar: np.ndarray,
    rng: np.random.Generator,
    *,
    velocity: np.ndarray,
    after_s: float,
    late_s: float = 0.0,
    stretch: float = 0.0,
    room: BoxRoom = ROOM,
) -> ScanWithPatches:
    """A scan at ``pose`` (x, y, yaw), and an image that is stamped ``after_s`` later."""
    ranges = room.scan_m(pose[0], pose[1], LIDAR_HEIGHT_M, pose[2], ANGLES)
    ranges = ranges + rng.normal(0.0, 0.008, ranges.shape)
    points = points_from_polar(ranges, ANGLES)
    normals, sd_rad = fit_lines(points, np.zeros(ANGLES.size, dtype=np.int64), 0.03 + 0.02 * ranges)
    delay = after_s - late_s
    moved = np.array([*(velocity[:2] * delay), velocity[2] * delay])
    T_room_lidar = transform_from_planar(pose) @ transform_from_planar(moved)
    T_room_lidar[2, 3] += LIDAR_HEIGHT_M
    depth_m = room.depth_m(T_room_lidar @ invert_transform(T_camera_lidar), LENS)
    depth_m = depth_m * (1.0 + stretch) + rng.normal(0.0, 0.004, depth_m.shape) * depth_m
    return ScanWithPatches(
        azimuths_rad=ANGLES,
        points_m=points,
        normals=np.where(np.isfinite(sd_rad)[:, np.newaxis], normals, np.nan),
        normal_sd_rad=sd_rad,
        velocity=velocity,
        image_after_scan_s=after_s,
        heading_rad=float(pose[2]),
        patches=find_patches(depth_m.astype(np.float32), LENS),
    )


def drive(T_camera_lidar: np.ndarray, seed: int, count: int = 20, **values) -> list:
    rng = np.random.default_rng(seed)
    frames = []
    for angle in 2.0 * np.pi * np.arange(count) / count:
        x, y = rng.normal((3.0 + 0.6 * np.cos(angle), 2.4 + 0.6 * np.sin(angle)), 0.05)
        pose = np.array([x, y, 3.0 * angle + rng.normal(0.0, 0.2)])
        velocity = np.array([rng.uniform(0.0, 0.4), 0.0, rng.uniform(-0.6, 0.6)])
        after_s = float(rng.uniform(-0.03, 0.03))
        frames.append(
            frame_at(pose, T_camera_lidar, rng, velocity=velocity, after_s=after_s, **values)
        )
    return frames


def priors(T: np.ndarray, **changes) -> PlanarPriors:
    own = PlanarPriors(
        up_m=float(invert_transform(T)[2, 3]),
        up_sd_m=0.2,
        angle_sd_rad=float(np.deg2rad(10.0)),
        place_sd_m=1.0,
        stretch_sd=0.02,
        range_sd_m=1e-4,
        clock_s=0.0,
        clock_sd_s=0.08,
    )
    return replace(own, **changes)


def in_lidar(T: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Forward, left and up of a place's error."""
    return T[:3, :3].T @ error[3:]


@pytest.mark.parametrize("seed", range(3))
def test_all_that_walls_and_floor_show_is_found(seed: int) -> None:
    T = camera_pose(seed)
    problem = PlanarProblem(drive(T, seed, late_s=0.02, stretch=0.01), SIZE, 700)
    start = apply_pose_error(T, np.array([0.05, -0.06, 0.04, 0.06, 0.0, -0.08]))
    fit = problem.fit(start, priors(start))
    error = pose_error(T, fit.T_camera_lidar)
    assert np.rad2deg(np.abs(error[:3])).max() < 0.15
    assert np.abs(in_lidar(T, error)[:2]).max() < 0.01
    assert fit.stretch == pytest.approx(0.01, abs=0.003)
    assert fit.clock_s == pytest.approx(0.02, abs=0.01)
    assert fit.floor_m == pytest.approx(invert_transform(T)[2, 3] + LIDAR_HEIGHT_M, abs=0.01)
    assert fit.covariance is not None
    sd = np.sqrt(np.diag(fit.covariance))
    assert np.rad2deg(sd[:3]).max() < 0.15
    # Walls do not show how high the LiDAR is.
    along_up = T[:3, 2]
    assert np.sqrt(along_up @ fit.covariance[3:, 3:] @ along_up) > 0.1
    assert fit.agreement > 0.4
    assert fit.floor_patches > 100


@pytest.mark.parametrize("seed", range(3))
def test_what_stands_before_every_wall_below_the_camera_does_not_tilt_it(seed: int) -> None:
    """A ledge before each wall: the scan's lines are 0.2 m before most of what the camera sees."""
    x, y, _ = ROOM.size_m
    ledges = (
        (0.0, 0.0, 0.0, x, 0.2, 0.5),
        (0.0, y - 0.2, 0.0, x, y, 0.5),
        (0.0, 0.0, 0.0, 0.2, y, 0.5),
        (x - 0.2, 0.0, 0.0, x, y, 0.5),
    )
    T = camera_pose(seed)
    frames = drive(T, seed, room=BoxRoom(boxes=(*FURNITURE, *ledges)))
    problem = PlanarProblem(frames, SIZE, 700)
    off = apply_pose_error(T, np.array([0.02, 0.05, -0.02, 0.05, 0.0, -0.05]))
    for start in (T, off):
        fit = problem.fit(start, priors(T), with_covariance=False)
        error = pose_error(T, fit.T_camera_lidar)
        assert np.rad2deg(np.abs(error[:3])).max() < 0.1
        assert np.abs(in_lidar(T, error)[:2]).max() < 0.01


def test_a_wrong_pose_has_less_support_whatever_noise_it_learns() -> None:
    """Of poses as they are: no step is made."""
    T = camera_pose(1)
    problem = PlanarProblem(drive(T, 1), SIZE, 700)
    support = [
        problem.fit(
            apply_pose_error(T, np.array([0.0, np.deg2rad(yaw_deg), 0.0, 0.0, 0.0, 0.0])),
            priors(T),
            with_covariance=False,
            iterations_max=0,
        ).support
        for yaw_deg in (0.0, 1.0, 3.0)
    ]
    assert support[0] > support[1] > support[2]


def test_a_line_ends_at_the_corner() -> None:
    """Beams beside a corner do not take the other wall's points into their line's distance."""
    azimuths = np.deg2rad(np.arange(-60.0, 60.0, 0.5))
    ahead_m, left_m = 2.0, 1.5
    on_left = np.tan(azimuths) > left_m / ahead_m
    points = np.where(
        on_left[:, np.newaxis],
        np.stack([left_m / np.tan(np.where(on_left, azimuths, 1.0)), np.full(240, left_m)], -1),
        np.stack([np.full(240, ahead_m), ahead_m * np.tan(azimuths)], -1),
    )
    frame = replace(
        drive(camera_pose(0), 0, count=1)[0],
        azimuths_rad=azimuths,
        points_m=points,
        normals=np.where(on_left[:, np.newaxis], [0.0, 1.0], [1.0, 0.0]),
        normal_sd_rad=np.full(240, 0.01),
    )
    flat = FlatFrames.of([frame], 100)
    np.testing.assert_allclose(flat.beam_offset_m, np.where(on_left, left_m, ahead_m), atol=1e-12)


def test_a_measured_height_of_the_lidar_makes_its_own_observable() -> None:
    T = camera_pose(1)
    problem = PlanarProblem(drive(T, 1), SIZE, 700)
    start = apply_pose_error(T, np.array([0.0, 0.0, 0.0, 0.0, 0.15, 0.0]))
    fit = problem.fit(start, priors(start, lidar_height_m=LIDAR_HEIGHT_M))
    assert np.abs(in_lidar(T, pose_error(T, fit.T_camera_lidar))).max() < 0.02
    assert np.sqrt(np.diag(fit.covariance))[4] < 0.02


@pytest.mark.slow
def test_deviations_are_those_of_the_errors() -> None:
    """The normalised error squared over seeds, within its 99 % interval of chi^2 for errors that
    are normal, twice as wide above: a jackknife of twenty frames knows no better."""
    normalised = []
    for seed in range(8):
        T = camera_pose(seed)
        fit = PlanarProblem(drive(T, seed), SIZE, 700).fit(T, priors(T))
        known = [0, 1, 2, 3]
        error = pose_error(T, fit.T_camera_lidar)[known]
        covariance = fit.covariance[np.ix_(known, known)]
        normalised.append(error @ np.linalg.solve(covariance, error))
    assert 1.7 < np.mean(normalised) < 2.0 * 7.1


def test_an_offset_of_all_ranges_is_counted_in() -> None:
    T = camera_pose(0)
    problem = PlanarProblem(drive(T, 0), SIZE, 700)
    sure, unsure = (problem.fit(T, priors(T, range_sd_m=sd)) for sd in (1e-6, 0.02))
    np.testing.assert_array_equal(sure.T_camera_lidar, unsure.T_camera_lidar)
    forward = T[:3, 0]
    assert forward @ unsure.covariance[3:, 3:] @ forward > 0.01**2
    assert forward @ sure.covariance[3:, 3:] @ forward < 0.005**2


def test_the_jacobian_is_that_of_differences() -> None:
    T = camera_pose(2)
    flat = FlatFrames.of(drive(T, 2, count=6), 100)
    kept = np.ones(6, dtype=bool)
    floor_m = float(invert_transform(T)[2, 3]) + LIDAR_HEIGHT_M

    def state(change: np.ndarray) -> PlanarState:
        return PlanarState(
            apply_pose_error(T, change[:POSE]),
            0.01 + change[STRETCH],
            0.005 + change[CLOCK],
            floor_m + change[FLOOR],
        )

    def along(found) -> np.ndarray:
        return found.value

    base = surface_residuals(flat, state(np.zeros(UNKNOWNS)), kept, SIZE)
    assert base.is_floor.any()
    assert (~base.is_floor).sum() > 50
    step = 1e-6
    for unknown, row in enumerate(step * np.eye(UNKNOWNS)):
        ahead = surface_residuals(flat, state(row), kept, SIZE)
        behind = surface_residuals(flat, state(-row), kept, SIZE)
        if ahead.value.size != base.value.size or behind.value.size != base.value.size:
            pytest.fail("a patch changed sides within a step")
        numeric = (along(ahead) - along(behind)) / (2.0 * step)
        # Where the residual is small, the change of the ray's slope does not count.
        near = np.abs(base.value) < 0.01
        off = np.abs(numeric - base.jacobian[:, unknown])[near]
        assert np.quantile(off, 0.9) < 0.05 * max(1.0, np.abs(numeric[near]).max()), unknown


def test_a_bare_wall_does_not_show_the_place_along_it() -> None:
    """One wall ahead, far from all others, and a robot that does not turn."""
    hall = BoxRoom(size_m=(60.0, 60.0, 30.0))
    T = camera_pose(0)
    rng = np.random.default_rng(0)
    frames = [
        frame_at(
            np.array([58.0 - 0.02 * n, 30.0 + 0.05 * n, 0.0]),
            T,
            rng,
            velocity=np.zeros(3),
            after_s=0.0,
            room=hall,
        )
        for n in range(20)
    ]
    fit = PlanarProblem(frames, SIZE, 700).fit(T, priors(T))
    left = T[:3, 1]
    assert fit.covariance is None or left @ fit.covariance[3:, 3:] @ left > 0.05**2


def test_without_surfaces_there_is_no_pose() -> None:
    T = camera_pose(0)
    empty = find_patches(np.full((120, 160), np.nan, dtype=np.float32), LENS)
    frames = [replace(frame, patches=empty) for frame in drive(T, 0, count=3)]
    with pytest.raises(CalibrationFailed, match="plane surface"):
        PlanarProblem(frames, SIZE, 700)
    with pytest.raises(CalibrationFailed, match="plane surface"):
        PlanarProblem([], SIZE, 700)
    away = apply_pose_error(T, np.array([0.0, 3.0, 0.0, 0.0, 0.0, 0.0]))
    problem = PlanarProblem(drive(T, 0, count=4), SIZE, 50)
    with pytest.raises(CalibrationFailed, match="hardly any surface"):
        problem.fit(away, priors(away))
