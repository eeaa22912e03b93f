"""The rig's tilt by walls, which are upright in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from fusion_core.alignment.mount import estimate_mount
from fusion_core.alignment.mount_cost import MountCost
from fusion_core.alignment.mount_floor import find_floor_tilt
from fusion_core.alignment.mount_observation import MountObservation
from fusion_core.alignment.mount_walls import find_wall_tilt
from fusion_core.alignment.rig_tilt import RigTilt
from fusion_core.model.rig import Mount
from tests.alignment.test_mount import LIDAR_HEIGHT_M, SETTINGS, drive, frame_at, random_mount


def wall_tilt(frames: list[MountObservation]) -> RigTilt | None:
    return find_wall_tilt(frames, MountCost(frames, SETTINGS).headings_rad(), SETTINGS)


@pytest.mark.parametrize("seed", range(4))
def test_walls_show_pitch_and_roll(furnished_room, seed: int) -> None:
    mount = replace(random_mount(seed), delta_z_m=0.5, pitch_rad=0.06 * seed - 0.1)
    roll_rad = 0.02 * seed - 0.03
    found = wall_tilt(drive(furnished_room, mount, seed, roll_rad=roll_rad))
    assert found is not None
    assert found.height_m is None
    errors = np.array([found.pitch_rad - mount.pitch_rad, found.roll_rad - roll_rad])
    assert (np.abs(errors) < np.deg2rad(0.5)).all(), np.rad2deg(errors)
    assert (np.abs(errors) < 4.0 * np.array([found.pitch_sd_rad, found.roll_sd_rad])).all()


def test_the_tilt_is_in_no_way_drawn_to_level(furnished_room) -> None:
    """Over many drives with one pitch and roll the errors have no mean."""
    errors = []
    for seed in range(12):
        mount = replace(random_mount(seed), delta_z_m=0.5, pitch_rad=0.15)
        found = wall_tilt(drive(furnished_room, mount, seed, roll_rad=0.08))
        assert found is not None
        errors.append([found.pitch_rad - mount.pitch_rad, found.roll_rad - 0.08])
    mean, sd = np.mean(errors, axis=0), np.std(errors, axis=0, ddof=1) / np.sqrt(len(errors))
    assert (np.abs(mean) < np.maximum(3.0 * sd, np.deg2rad(0.05))).all(), (mean, sd)


def test_a_wall_says_nothing_of_a_turn_about_its_normal(box_room) -> None:
    """Nor does the noise of its normals, which look as if some were of other walls."""
    rng = np.random.default_rng(0)
    mount = Mount(yaw_rad=0.0, delta_z_m=0.5, pitch_rad=0.05)
    frames = [
        frame_at(box_room((6.0, 30.0, 2.6)), mount, (3.5, 15.0 + 0.1 * step, 0.0), rng=rng)
        for step in range(16)
    ]
    found = wall_tilt(frames)
    assert found is not None
    assert found.pitch_rad == pytest.approx(mount.pitch_rad, abs=np.deg2rad(0.2))
    assert found.pitch_sd_rad < np.deg2rad(0.3)
    assert found.roll_sd_rad > np.deg2rad(1.0)
    assert not found.is_rolled


def test_without_depths_there_is_no_tilt(furnished_room) -> None:
    frames = drive(furnished_room, random_mount(0), 0, count=8)
    blind = [
        replace(frame, raw_depth_m=np.full_like(frame.raw_depth_m, np.nan)) for frame in frames
    ]
    assert wall_tilt(blind) is None


def test_exact_depths_are_no_fault(box_room) -> None:
    """A wall straight ahead at one depth: no residual is left."""
    frames = drive(box_room(), Mount(yaw_rad=0.0), 0, count=8)
    flat = [replace(frame, raw_depth_m=np.full_like(frame.raw_depth_m, 2.0)) for frame in frames]
    found = wall_tilt(flat)
    assert found is None or abs(found.pitch_rad) < 1e-6


def without_floor(frame: MountObservation, mount: Mount) -> MountObservation:
    """The observation of a camera to which a floor and what is near it return nothing."""
    row, column = np.indices(frame.raw_depth_m.shape)
    rays = frame.camera.rays(row.ravel(), column.ravel()) @ frame.camera.T_rig_camera[:3, :3].T
    up = mount.T_lidar_rig[2, :3]
    above_lidar_m = mount.delta_z_m + (rays @ up).reshape(row.shape) * frame.raw_depth_m
    is_dark = above_lidar_m < 0.1 - LIDAR_HEIGHT_M
    return replace(
        frame,
        raw_depth_m=np.where(is_dark, np.nan, frame.raw_depth_m).astype(np.float32),
        depth_m=np.where(is_dark, np.nan, frame.depth_m).astype(np.float32),
    )


@pytest.mark.parametrize("seed", [2, 4, 5])
def test_a_camera_that_sees_no_floor_knows_its_pitch_and_its_place(
    furnished_room, seed: int
) -> None:
    mount = replace(random_mount(seed), delta_z_m=0.6, pitch_rad=0.12)
    frames = [without_floor(frame, mount) for frame in drive(furnished_room, mount, seed)]
    assert find_floor_tilt(frames, MountCost(frames, SETTINGS).headings_rad(), SETTINGS) is None
    estimate = estimate_mount(frames, SETTINGS, yaw_rad=mount.yaw_rad)
    assert estimate.is_confident
    errors = np.abs(estimate.mount.vector() - mount.vector())
    assert (errors[[0, 2, 3, 4]] < [np.deg2rad(0.6), 0.02, 0.02, np.deg2rad(0.2)]).all(), errors
    assert estimate.mount.sd[4] is not None
    assert errors[4] < 4.0 * estimate.mount.sd[4]


def test_the_lidar_is_not_assumed_high_above_what_is_seen_lowest(box_room) -> None:
    """No floor is in the image, and walls look alike at all heights; but the floor is no higher
    than the lowest that is seen, and the LiDAR not far above it."""
    mount = replace(random_mount(3), delta_z_m=1.2, pitch_rad=0.0)
    frames = drive(box_room((4.0, 4.0, 9.0)), mount, 3)
    problem = MountCost(frames, SETTINGS)
    lowest_m = problem.lowest_surface_m(mount.pitch_rad)
    assert find_floor_tilt(frames, problem.headings_rad(), SETTINGS) is None
    estimate = estimate_mount(frames, SETTINGS, yaw_rad=mount.yaw_rad)
    assert estimate.mount.sd[1] is None
    least_m = -lowest_m - SETTINGS.assumed_lidar_height_m
    assert estimate.mount.delta_z_m > least_m - 2.0 * SETTINGS.assumed_lidar_height_sd_m
    assert -lowest_m < LIDAR_HEIGHT_M + mount.delta_z_m + 0.1


@pytest.mark.parametrize("pitch_rad", [0.1, 0.35])
def test_the_lowest_surface_is_the_floor_under_any_pitch(furnished_room, pitch_rad: float) -> None:
    mount = Mount(yaw_rad=0.0, delta_z_m=0.8, pitch_rad=pitch_rad)
    problem = MountCost(drive(furnished_room, mount, 1), SETTINGS)
    lowest_m = problem.lowest_surface_m(mount.pitch_rad)
    assert lowest_m == pytest.approx(-LIDAR_HEIGHT_M - mount.delta_z_m, abs=0.06)
