"""The rig of Song 2022: what its sensors report lies where the room is, in both of them."""

import dataclasses

import cv2
import numpy as np
import pytest

from fusion_core.lens.projection import inside_image, project_points
from fusion_core.recordings.formats import open_recording
from fusion_core.simulation.rig_recorder import record_turning_rig
from fusion_core.simulation.spinning_lidar import SpinningLidarSettings, beam_pattern, intensity
from fusion_core.simulation.textured_room import SONG_ROOM_M, RoomCaster, make_textured_room
from fusion_core.simulation.turning_rig import (
    T_AXIS_LIDAR_NOMINAL,
    TurningRigSettings,
    axis_from_lidar,
    simulate_turning_rig,
)

EXACT = SpinningLidarSettings(
    columns=400, range_sigma_m=0.0, range_quantum_m=0.0, intensity_noise=0.0
)
SETTINGS = TurningRigSettings(
    lidar=EXACT, turn_s=6.3, image_sigma=0.0, distortion_k1=-0.08, image_scale=0.5
)


@pytest.fixture(scope="module")
def data():
    return simulate_turning_rig(SETTINGS, 4)


@pytest.fixture(scope="module")
def cloud(data):
    return data.cloud_in_rig()


def test_the_cloud_fills_the_room(data, cloud):
    in_room = cloud[0] @ data.T_room_rig[:3, :3].T + data.T_room_rig[:3, 3]
    np.testing.assert_allclose(in_room.min(axis=0), 0.0, atol=1e-4)
    np.testing.assert_allclose(in_room.max(axis=0), data.room_size_m, atol=1e-4)


def test_the_error_of_the_mounting_blurs_it(data, cloud):
    blurred = data.cloud_in_rig(T_AXIS_LIDAR_NOMINAL)[0]
    assert np.linalg.norm(blurred - cloud[0], axis=1).max() > 0.02
    np.testing.assert_allclose(axis_from_lidar(0.0, 0.0, np.zeros(2)), T_AXIS_LIDAR_NOMINAL)


def test_points_are_where_a_ray_through_their_pixel_ends(data, cloud):
    """Cast from the camera, independently of the LiDAR: the same point, or one that hides it."""
    caster = RoomCaster(make_textured_room(4, SONG_ROOM_M), EXACT.beam_footprint_m)
    in_camera = cloud[0] @ data.T_camera_lidar[:3, :3].T + data.T_camera_lidar[:3, 3]
    pixels = project_points(in_camera, data.intrinsics)
    seen = np.flatnonzero(inside_image(pixels, data.intrinsics))
    assert seen.size > 10000
    T_room_camera = data.T_room_rig @ np.linalg.inv(data.T_camera_lidar)
    origin = T_room_camera[:3, 3]
    directions = in_camera[seen] @ T_room_camera[:3, :3].T
    hits = caster.cast(origin, directions)
    visible = hits.distance > 0.999
    assert visible.mean() > 0.7
    rgb = caster.rgb(hits, origin + hits.distance[:, np.newaxis] * directions)
    # Where the paint is even, the image has its colour there, but for the light.
    grey = cv2.cvtColor(data.rgb, cv2.COLOR_RGB2GRAY).astype(float)
    u, v = np.rint(pixels[seen[visible]]).astype(int).T
    u, v = np.clip(u, 0, 639), np.clip(v, 0, 479)
    expected = rgb[visible] @ [0.299, 0.587, 0.114]
    assert np.corrcoef(grey[v, u], expected)[0, 1] > 0.95


def test_infrared_is_related_to_what_is_seen_and_not_given_by_it(data, cloud):
    in_camera = cloud[0] @ data.T_camera_lidar[:3, :3].T + data.T_camera_lidar[:3, 3]
    pixels = project_points(in_camera, data.intrinsics)
    seen = inside_image(pixels, data.intrinsics)
    grey = cv2.cvtColor(data.rgb, cv2.COLOR_RGB2GRAY).astype(float)
    u, v = np.clip(np.rint(pixels[seen]).astype(int), 0, [639, 479]).T
    assert 0.3 < np.corrcoef(grey[v, u], cloud[1][seen])[0, 1] < 0.95


def test_the_same_seed_gives_the_same_turn():
    short = TurningRigSettings(
        lidar=EXACT.model_copy(update={"columns": 40}), turn_s=0.5, image_scale=0.05
    )
    first, again, other = (simulate_turning_rig(short, seed) for seed in (7, 7, 8))
    for a, b in zip(first.scans, again.scans, strict=True):
        for field in dataclasses.fields(a):
            np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name))
    np.testing.assert_array_equal(first.rgb, again.rgb)
    assert not np.array_equal(first.rgb, other.rgb)
    assert first.theta_rad != other.theta_rad


def test_the_rings_are_those_of_the_data_sheet():
    pattern = beam_pattern(SpinningLidarSettings(columns=16))
    elevation_deg = np.rad2deg(np.arcsin(pattern.directions[:16, 2]))
    np.testing.assert_allclose(elevation_deg, np.arange(-15, 16, 2))
    np.testing.assert_allclose(np.linalg.norm(pattern.directions, axis=1), 1.0)
    assert 0.09 < pattern.offsets_s[-1] < 0.1


def test_intensity_falls_with_range_and_angle():
    settings = SpinningLidarSettings(intensity_noise=0.0, range_exponent=2.0)
    rng = np.random.default_rng(0)
    values = intensity(
        np.array([0.5, 0.5, 0.5, 1.0]),
        np.array([2.5, 5.0, 2.5, 0.5]),
        np.array([1.0, 1.0, 0.5, 1.0]),
        settings,
        rng,
    )
    np.testing.assert_array_equal(values, [50.0, np.rint(12.5), 25.0, 255.0])


def test_too_many_points_are_refused():
    with pytest.raises(ValueError, match="points"):
        TurningRigSettings(turn_s=300.0)


def test_the_recording_holds_the_turn(tmp_path):
    short = TurningRigSettings(
        lidar=EXACT.model_copy(update={"columns": 40}), turn_s=0.5, image_scale=0.05
    )
    path = tmp_path / "rig.mcap"
    record_turning_rig(short, 7, path)
    data = simulate_turning_rig(short, 7)
    with open_recording(path) as recording:
        clouds = [m.value for m in recording.messages(["/lidar/points"])]
        joints = [m.value for m in recording.messages(["/joint_states"])]
        image = next(recording.messages(["/camera/image_raw"])).value
        info = next(recording.messages(["/camera/camera_info"])).value
    assert len(clouds) == len(data.scans)
    for cloud, scan in zip(clouds, data.scans, strict=True):
        np.testing.assert_array_equal(cloud.xyz_m, scan.points_m)
        np.testing.assert_array_equal(cloud.intensity, scan.intensity)
        np.testing.assert_array_equal(cloud.rings, scan.rings)
        np.testing.assert_allclose(cloud.offsets_s, scan.offsets_s, atol=1e-8)
        assert cloud.stamp_ns == scan.stamp_ns
    np.testing.assert_allclose([j.positions[0] for j in joints], data.joint_angles_rad)
    np.testing.assert_array_equal(image.rgb, data.rgb)
    assert info.intrinsics == dataclasses.replace(
        data.intrinsics, distortion=info.intrinsics.distortion
    )
    assert max(j.stamp_ns for j in joints) > max(c.stamp_ns for c in clouds)
    truth = dict(np.load(tmp_path / "rig.truth.npz"))
    np.testing.assert_array_equal(truth["T_camera_lidar"], data.T_camera_lidar)
    np.testing.assert_array_equal(truth["delta_m"], data.delta_m)
    first = path.read_bytes()
    record_turning_rig(short, 7, path)
    assert path.read_bytes() == first
