"""Deviations of the mount, where the errors and the surfaces are known."""

from dataclasses import replace

import numpy as np
import pytest

from fusion_core.alignment.mount import estimate_mount
from fusion_core.alignment.mount_cost import MountCost
from fusion_core.alignment.mount_floor import find_floor_tilt
from fusion_core.alignment.mount_height import HeightSamples, _inner_minimum, keep_sight
from fusion_core.model.rig import Mount
from fusion_core.model.two_way_covariance import (
    correlation_length,
    shared_grouping,
    two_way_covariance,
)
from tests.alignment.test_mount import LENS, LIDAR_HEIGHT_M, SETTINGS, drive, random_mount


def test_independent_frames_are_blocks_of_their_own() -> None:
    rng = np.random.default_rng(0)
    series = rng.normal(size=(60, 3))
    assert correlation_length(series) == 1
    assert correlation_length(np.repeat(series[:20], 3, axis=0)) in (2, 3)
    assert correlation_length(np.zeros((8, 2))) == 1


def test_a_deviation_counts_errors_that_frames_and_places_share() -> None:
    """A line through points whose errors are drawn by frame and by place: closed form of the fit,
    its error over many draws against what each draw states."""
    rng = np.random.default_rng(1)
    frames, places = 24, 30
    frame, place = (grid.ravel() for grid in np.mgrid[0:frames, 0:places])
    design = np.stack([np.ones(frame.size), place / places - 0.5], axis=1)
    information = design[:, :, None] * design[:, None, :]
    solve = np.linalg.inv(information.sum(axis=0)) @ design.T
    normalised, naive = [], []
    for _ in range(150):
        noise = rng.normal(size=frame.size) + rng.normal(size=frames)[frame]
        noise += rng.normal(size=places)[place]
        fit = solve @ noise
        scores = (noise - design @ fit)[:, None] * design
        covariance = two_way_covariance(scores, information, np.zeros((2, 2)), frame, place)
        assert covariance is not None
        normalised.append(fit**2 / np.diag(covariance))
        naive.append(fit**2 / np.diag(np.linalg.inv(information.sum(axis=0))) / 3.0)
    mean = np.mean(normalised, axis=0)
    assert ((mean > 0.6) & (mean < 1.5)).all(), mean
    assert (np.mean(naive, axis=0) > 4.0).all()


def test_few_blocks_are_never_too_bold_where_points_share_nothing() -> None:
    """As above with independent errors, on a dozen frames and nine places of unequal weight."""
    rng = np.random.default_rng(2)
    frame, place = (grid.ravel() for grid in np.mgrid[0:12, 0:9])
    normalised = []
    for _ in range(100):
        design = rng.normal(size=(9, 4))[place] * rng.uniform(0.5, 1.5, size=(9, 1))[place]
        design += 0.5 * rng.normal(size=(12, 4))[frame]
        information = design[:, :, None] * design[:, None, :]
        noise = rng.normal(size=frame.size)
        fit = np.linalg.solve(information.sum(axis=0), design.T @ noise)
        scores = (noise - design @ fit)[:, None] * design
        covariance = two_way_covariance(scores, information, np.zeros((4, 4)), frame, place)
        if covariance is not None:
            normalised.append(fit**2 / np.diag(covariance))
    assert len(normalised) > 60
    mean = np.mean(normalised, axis=0)
    assert ((mean > 0.1) & (mean < 1.0)).all(), mean


def test_the_grouping_that_shares_errors_is_found() -> None:
    rng = np.random.default_rng(3)
    first, second = (grid.ravel() for grid in np.mgrid[0:20, 0:30])
    noise = rng.normal(size=first.size)
    for shared in (first, second):
        residuals = noise + 0.3 * rng.normal(size=30)[shared]
        assert shared_grouping(residuals, (first, second)) is shared
    alone = shared_grouping(noise, (first, second))
    assert np.unique(alone).size == noise.size
    assert np.unique(shared_grouping(noise, (alone,))).size == noise.size


def test_too_few_groups_state_nothing() -> None:
    scores, information = np.ones((6, 1)), np.ones((6, 1, 1))
    label = np.array([0, 0, 1, 1, 2, 2])
    assert two_way_covariance(scores, information, np.zeros((1, 1)), label, label) is None


def test_replicates_that_agree_are_known_to_a_step_of_the_grid() -> None:
    best = np.array([0.1, 0.3, 0.05, 0.0, 0.02, 0.0])
    samples = HeightSamples(
        best=best, least=best, mounts=np.tile(best, (20, 1)), is_height_known=True, range_m=2.0
    )
    assert samples.sd() == pytest.approx([0.0, 0.05 / np.sqrt(12.0), 0.0, 0.0, 0.0, 0.0])
    assert replace(samples, is_height_known=False).sd()[1] == np.inf


@pytest.mark.parametrize("delta_z_m", [0.6, 1.0])
def test_walls_alone_show_no_height(box_room, delta_z_m: float) -> None:
    """All heights explain walls. Near ones meet the LiDAR's plane below the image, and a lower
    camera has more of them in it, which is no evidence."""
    mount = Mount(yaw_rad=0.1, delta_z_m=delta_z_m, pitch_rad=float(np.deg2rad(-6.0)))
    frames = drive(box_room(size_m=(4.6, 4.0, 9.0)), mount, 1)
    estimate = estimate_mount(frames, SETTINGS, yaw_rad=mount.yaw_rad)
    assert estimate.mount.sd[1] is None, (estimate.mount.delta_z_m, estimate.mount.sd[1])


def test_a_mount_under_which_too_little_agrees_states_nothing(furnished_room) -> None:
    mount = replace(random_mount(2), delta_z_m=0.4)
    frames = drive(furnished_room, mount, 2)
    # Every fourth image contradicts the others.
    for index in range(0, len(frames), 4):
        farther_m = np.float32(1.25) * frames[index].depth_m
        frames[index] = replace(frames[index], depth_m=farther_m, raw_depth_m=farther_m)
    estimate = estimate_mount(frames, SETTINGS, yaw_rad=mount.yaw_rad)
    assert 0.5 < estimate.agreement < SETTINGS.min_agreement
    assert [estimate.mount.sd[index] for index in (0, 1, 2, 3, 5)] == [None] * 5


def test_an_upright_wall_stays_in_sight() -> None:
    """A wall 3 m ahead of the LiDAR, seen by a pitched camera: under another height and pitch the
    pixel of its point in the LiDAR's plane is still of that wall."""
    true = np.array([0.0, 0.5, 0.04, 0.0, 0.06, 0.0])
    wall_m, range_m = 3.0, 2.96
    for height, pitch in ((0.2, 0.0), (0.9, -0.05), (0.5, 0.12)):
        moved = keep_sight(true, range_m, height, pitch)
        # The ray to the wall's point in the LiDAR's plane under the moved mount, in the camera ...
        below = np.arctan2(height, wall_m - moved[2]) - pitch
        # ... which the true camera sees on the wall, at this depth along its axis ...
        depth_m = (wall_m - true[2]) / np.cos(below + true[4]) * np.cos(below)
        # ... so that the moved mount puts the wall here.
        seen_m = moved[2] + depth_m / np.cos(below) * np.cos(below + pitch)
        assert seen_m == pytest.approx(wall_m, abs=5e-3)


@pytest.mark.parametrize("seed", range(4))
def test_the_floor_shows_the_pitch(furnished_room, seed: int) -> None:
    mount = replace(random_mount(seed), delta_z_m=0.5, pitch_rad=0.02 * seed)
    frames = drive(furnished_room, mount, seed, count=12)
    found = find_floor_tilt(frames, MountCost(frames, SETTINGS).headings_rad(), SETTINGS)
    assert found is not None
    error = found.pitch_rad - mount.pitch_rad
    assert abs(error) < np.deg2rad(0.5)
    assert abs(error) < 4.0 * found.pitch_sd_rad
    assert found.height_m == pytest.approx(LIDAR_HEIGHT_M + mount.delta_z_m, abs=0.01)


def test_walls_alone_leave_the_lidar_where_it_usually_is(box_room) -> None:
    """They look alike at all heights: the floor is seen, and the LiDAR is assumed 0.3 m above it.
    What is assumed is not observable."""
    mount = replace(random_mount(1), delta_z_m=0.6, pitch_rad=0.15)
    estimate = estimate_mount(drive(box_room(), mount, 1), SETTINGS, yaw_rad=mount.yaw_rad)
    assumed_m = LIDAR_HEIGHT_M + mount.delta_z_m - SETTINGS.assumed_lidar_height_m
    assert estimate.mount.delta_z_m == pytest.approx(assumed_m, abs=0.15)
    assert estimate.mount.sd[1] is None


def test_costs_that_fall_at_a_bound_tell_no_height() -> None:
    """Costs of heights x pitches: the inner minimum counts; a bound only where there is none."""
    costs = np.array([[0.1, 0.2], [0.6, 0.5], [0.4, 0.3], [0.7, 0.6], [0.2, 0.0]])
    assert _inner_minimum(costs.ravel(), 5) == 5
    assert _inner_minimum(costs[::-1].ravel(), 5) == 5
    assert _inner_minimum(np.sort(costs.ravel()), 5) == 0
    assert _inner_minimum(-np.sort(-costs.ravel()), 5) == 9


def test_depths_of_few_steps_state_no_exact_pitch(furnished_room) -> None:
    """A camera that is all but level sees a row of a floor at one step of disparity, in all of its
    frames: the errors do not average out, and of some rows the steps lie on a plane exactly."""
    rng = np.random.default_rng(0)
    height_m, wall_m = 0.6, 3.5
    # In 1/m: those of a first Kinect, and half of one as noise.
    step, noise = 2.85e-3, 1.2e-3
    below = (np.arange(LENS.height) - LENS.cy) / LENS.fy
    observed = drive(furnished_room, random_mount(0), 0, count=24)
    headings_rad = MountCost(observed, SETTINGS).headings_rad()
    normalised = []
    for pitch_rad in np.deg2rad([-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3]):
        inverse = (below * np.cos(pitch_rad) + np.sin(pitch_rad)) / height_m
        inverse = np.repeat(np.maximum(inverse, 1.0 / wall_m)[:, None], LENS.width, axis=1)
        frames = []
        for frame in observed:
            steps = np.rint((inverse + rng.normal(0.0, noise, inverse.shape)) / step)
            frames.append(replace(frame, raw_depth_m=(1.0 / (steps * step)).astype(np.float32)))
        found = find_floor_tilt(frames, headings_rad, SETTINGS)
        assert found is not None
        normalised.append((found.pitch_rad - pitch_rad) / found.pitch_sd_rad)
    assert np.mean(np.square(normalised)) < 2.0, normalised


@pytest.mark.parametrize("roll_deg", [-5.0, -2.5, 1.0, 4.0])
def test_the_floor_shows_the_roll(furnished_room, roll_deg: float) -> None:
    """The plane in closed form, seen by a camera that is turned about its own axis."""
    seed = round(abs(roll_deg))
    mount = replace(random_mount(seed), delta_z_m=0.5, pitch_rad=0.03 * seed)
    frames = drive(furnished_room, mount, seed, count=12, roll_rad=float(np.deg2rad(roll_deg)))
    headings_rad = MountCost(frames, SETTINGS).headings_rad()
    found = find_floor_tilt(frames, headings_rad, SETTINGS)
    assert found is not None
    assert found.is_rolled
    errors = np.array([found.roll_rad - np.deg2rad(roll_deg), found.pitch_rad - mount.pitch_rad])
    assert (np.abs(errors) < np.deg2rad([0.05, 0.2])).all()
    assert (np.abs(errors) < 4.0 * np.array([found.roll_sd_rad, found.pitch_sd_rad])).all()
    # Its cameras rolled, the rig is level, and its pitch is the same.
    rolled = [frame.rolled(found.roll_rad) for frame in frames]
    again = find_floor_tilt(rolled, headings_rad, SETTINGS)
    assert again is not None
    assert not again.is_rolled
    assert again.pitch_rad == pytest.approx(found.pitch_rad, abs=1e-4)


def test_a_rolled_camera_moves_no_mount(furnished_room) -> None:
    """It looks down, where a roll that is left out turns the yaw."""
    mount = replace(random_mount(3), delta_z_m=0.5, pitch_rad=0.25)
    frames = drive(furnished_room, mount, 3, roll_rad=float(np.deg2rad(3.0)))
    estimate = estimate_mount(frames, SETTINGS, yaw_rad=mount.yaw_rad)
    assert estimate.roll_rad == pytest.approx(np.deg2rad(3.0), abs=np.deg2rad(0.05))
    errors = np.abs(estimate.mount.vector() - mount.vector())
    assert (errors[[0, 2, 3]] < [np.deg2rad(0.3), 0.03, 0.02]).all(), errors


def test_a_level_rig_is_not_rolled(furnished_room) -> None:
    mount = replace(random_mount(3), delta_z_m=0.5, pitch_rad=0.06)
    frames = drive(furnished_room, mount, 3, count=12)
    estimate = estimate_mount(frames, SETTINGS, yaw_rad=mount.yaw_rad)
    assert estimate.tilt is not None
    assert estimate.roll_rad == 0.0
    # A mount that is recorded has its roll in the camera's pose.
    known = estimate_mount(frames, SETTINGS, yaw_rad=mount.yaw_rad, recorded=mount)
    assert known.tilt is None
    assert known.roll_rad == 0.0


def test_a_camera_that_looks_up_sees_no_floor(furnished_room) -> None:
    mount = Mount(yaw_rad=0.1, delta_z_m=0.4, pitch_rad=-0.45)
    frames = drive(furnished_room, mount, 0, count=8)
    headings_rad = MountCost(frames, SETTINGS).headings_rad()
    assert find_floor_tilt(frames, headings_rad, SETTINGS) is None


def test_depths_that_are_too_long_move_no_mount(furnished_room) -> None:
    """A camera measures all lengths 1.5 % long, of which the method is not told."""
    truth = replace(random_mount(5), delta_z_m=0.4)
    frames = [
        replace(frame, depth_m=np.float32(1.015) * frame.depth_m)
        for frame in drive(furnished_room, truth, 5)
    ]
    estimate = estimate_mount(frames, SETTINGS, yaw_rad=truth.yaw_rad)
    error = (estimate.mount.vector() - truth.vector())[[0, 2, 3]]
    sd = np.array([estimate.mount.sd[index] for index in (0, 2, 3)])
    assert (np.abs(error) < [np.deg2rad(0.5), 0.03, 0.02]).all()
    assert (np.abs(error) < 4.0 * sd).all()


@pytest.mark.parametrize("rate_rad_s", [0.5, -0.3])
def test_a_delay_that_cannot_be_seen_turns_the_yaw_as_stated(
    furnished_room, rate_rad_s: float
) -> None:
    """Under a steady turn a late camera looks like a turned one: the yaw errs by the delay times
    what is stated for a second of it, and the delay is not observable."""
    truth = replace(random_mount(1), delta_z_m=0.4)
    yaws_rad = []
    for delay_ms in (0.0, 60.0):
        late = replace(truth, clock_offset_ms=delay_ms)
        frames = drive(furnished_room, late, 1, rate=rate_rad_s)
        estimate = estimate_mount(frames, SETTINGS, yaw_rad=truth.yaw_rad)
        assert estimate.mount.sd[5] is None
        yaws_rad.append(estimate.mount.yaw_rad)
    turned_rad = 0.060 * estimate.yaw_per_delay_rad_s
    assert yaws_rad[0] - yaws_rad[1] == pytest.approx(turned_rad, abs=np.deg2rad(0.3))
    assert abs(turned_rad) == pytest.approx(abs(0.060 * rate_rad_s), rel=0.3)
