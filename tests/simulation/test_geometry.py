"""Where rays land: against closed forms and a loop over all triangles."""

import numpy as np
import pytest

from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.geometry import make_transform, transform_from_planar, transform_points
from fusion_core.simulation import sensor_mounts, worlds
from fusion_core.simulation.depth_camera import DepthNoise, pixel_rays
from fusion_core.simulation.ray_casting import RayCaster
from fusion_core.simulation.sensor_simulator import SensorSimulator, SimulationSetup
from fusion_core.simulation.solids import Material, box, quad


def simulator(world, mounts, path, **changes):
    return SensorSimulator(
        SimulationSetup(world=world, mounts=mounts, path=path, seed=1, **changes)
    )


@pytest.mark.parametrize("pose", [(3.0, 2.0, 0.0), (1.2, 3.1, 2.2), (5.5, 0.4, -1.0)])
def test_ranges_in_a_rectangular_room(plain_room, standing, pose):
    x, y, yaw = pose
    mounts = sensor_mounts.home_robot()
    sweep = simulator(plain_room(), mounts, standing(x, y, yaw)).simulate_sweep(0.0, 0)
    azimuth = yaw + (np.arange(682) - 340.5) * 2 * np.pi / 1024
    np.testing.assert_allclose(sweep.true_m, plain_room.range_m(x, y, azimuth), atol=1e-12)


@pytest.mark.parametrize("make_mounts", [sensor_mounts.home_robot, sensor_mounts.robot_at_home])
def test_back_projected_pixels_lie_on_the_room(plain_room, standing, make_mounts):
    mounts = make_mounts()
    pose = (2.5, 1.7, 0.4)
    watching = simulator(plain_room(), mounts, standing(*pose))
    for number, camera in enumerate(mounts.cameras):
        true_m = watching.simulate_image(number, 0.0, 0).true_m
        points = pixel_rays(camera.intrinsics) * true_m.reshape(-1, 1)
        x, y, z = transform_points(
            transform_from_planar(np.array(pose)) @ camera.T_base_optical, points
        ).T
        planes = np.abs(np.stack([x, x - 6.0, y, y - 4.0, z, z - 2.5]))
        assert planes.min(axis=0).max() < 1e-12


def test_rays_agree_with_a_loop_over_all_triangles():
    world = worlds.furnished_room(3)
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((200, 3))
    origin = np.array([world.size_m[0] / 2, world.size_m[1] / 2, 0.9])
    hits = RayCaster(world).cast(origin, directions, 0.0)
    nearest = np.full(200, np.inf)
    material = np.zeros(200, dtype=int)
    for (a, b, c), kind in zip(world.mesh.corners_m, world.mesh.materials, strict=True):
        # Möller & Trumbore 1997.
        across = np.cross(directions, c - a)
        area = across @ (b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            first = across @ (origin - a) / area
            turned = np.cross(origin - a, b - a)
            second = directions @ turned / area
            distance = (c - a) @ turned / area
            inside = (first >= 0) & (second >= 0) & (first + second <= 1) & (distance > 0)
        closer = inside & (distance < nearest)
        nearest[closer] = distance[closer]
        material[closer] = kind
    np.testing.assert_allclose(hits.distance, nearest, rtol=1e-9)
    np.testing.assert_array_equal(hits.materials, material)


def test_only_the_lidar_meets_a_low_box(plain_room, standing):
    low_box = box((2.6, 1.8, 0.0), (3.0, 2.2, 0.36), Material.WOOD)
    mounts, path = sensor_mounts.home_robot(), standing(2.0, 2.0, 0.0)
    with_box, without = (simulator(plain_room(extra), mounts, path) for extra in ([low_box], []))
    ahead = slice(335, 346)
    np.testing.assert_allclose(with_box.simulate_sweep(0.0, 0).true_m[ahead], 0.6, atol=1e-3)
    np.testing.assert_array_equal(
        with_box.simulate_image(0, 0.0, 0).true_m, without.simulate_image(0, 0.0, 0).true_m
    )


def test_only_the_camera_meets_a_table_top(plain_room, standing):
    top = box((3.2, 1.5, 0.7), (4.2, 2.5, 0.74), Material.WOOD)
    mounts, path = sensor_mounts.home_robot(), standing(2.0, 2.0, 0.0)
    with_top, without = (simulator(plain_room(extra), mounts, path) for extra in ([top], []))
    np.testing.assert_array_equal(
        with_top.simulate_sweep(0.0, 0).true_m, without.simulate_sweep(0.0, 0).true_m
    )
    differs = with_top.simulate_image(0, 0.0, 0).true_m < without.simulate_image(0, 0.0, 0).true_m
    assert differs.mean() > 0.02


def test_the_true_range_of_glass_is_the_pane(plain_room, standing):
    pane = quad((4.0, 0.0, 0.0), (0, 4.0, 0), (0, 0, 2.5), Material.GLASS)
    watching = simulator(plain_room([pane]), sensor_mounts.home_robot(), standing(2.0, 2.0, 0.0))
    sweep = watching.simulate_sweep(0.0, 0)
    assert sweep.true_m[340] == pytest.approx(2.0, abs=1e-4)
    seen_through = (sweep.kinds == 2) & (sweep.ranges_m > 3.9)
    assert seen_through.sum() > 5
    image = watching.simulate_image(0, 0.0, 0)
    assert 0.6 < np.isnan(image.depth_m).mean() < 0.95
    burr = image.kinds == 2
    # All but speckles.
    assert (image.depth_m[burr] > image.true_m[burr] + 0.1).mean() > 0.95


def test_the_projector_casts_a_shadow_to_the_left_of_a_near_object(plain_room, standing):
    post = box((3.05, 1.7, 0.0), (3.06, 2.3, 2.5), Material.WOOD)
    mounts = sensor_mounts.turtlebot_low()
    camera = mounts.cameras[0]
    # Looking straight along x, so that both depths are constant.
    straight = sensor_mounts.SensorMounts(
        lidar=mounts.lidar,
        cameras=(
            sensor_mounts.CameraMount(
                namespace=camera.namespace,
                frame_id=camera.frame_id,
                intrinsics=camera.intrinsics,
                T_base_optical=sensor_mounts.home_robot().lidar.T_base_lidar @ _optical(),
            ),
        ),
        camera_yaw_rad=0.0,
        T_base_rig=np.eye(4),
    )
    quiet = DepthNoise(
        edge_lost_fraction=0.0, edge_mixed_fraction=0.0, speckles=0.0, patches=0.0, grazing_rad=1.57
    )
    watching = simulator(plain_room([post]), straight, standing(2.0, 2.0, 0.0), depth_noise=quiet)
    image = watching.simulate_image(0, 0.0, 0)
    row = image.kinds[100]
    dark = np.flatnonzero(row == 1)
    width = camera.intrinsics.fx * 0.075 * (1 / 1.05 - 1 / 4.0)
    left_edge = np.flatnonzero(image.true_m[100] < 2.0)[0]
    assert dark.size == pytest.approx(width, abs=1.5)
    assert dark[-1] == left_edge - 1


def _optical():
    return make_transform(np.array(R_BODY_OPTICAL), np.zeros(3))


def test_portrait_cameras_are_rolled_and_ordered_from_left_to_right():
    mounts = sensor_mounts.robot_at_home()
    in_lidar = mounts.T_lidar_camera()
    yaw = np.degrees(np.arctan2(in_lidar[:, 1, 2], in_lidar[:, 0, 2]))
    np.testing.assert_allclose(yaw, [47.5, 2.5, -42.5, -87.5])
    for T in in_lidar:
        # Columns run upwards, rows to the right.
        np.testing.assert_allclose(T[:3, 0], [0, 0, 1], atol=1e-12)
        right = np.cross(T[:3, 2], [0, 0, 1])
        np.testing.assert_allclose(T[:3, 1], right, atol=1e-12)


def test_scaling_an_image_keeps_its_rays():
    camera = sensor_mounts.home_robot().cameras[0]
    full = pixel_rays(camera.intrinsics).reshape(240, 320, 3)
    half = pixel_rays(camera.scaled(0.5).intrinsics).reshape(120, 160, 3)
    blocks = full.reshape(120, 2, 160, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(half, blocks, atol=1e-12)


def test_a_person_walks_back_and_forth():
    walker = worlds.Walker(start_m=(1.0, 1.0), end_m=(3.0, 1.0), speed_m_s=1.0)
    middles = [walker.mesh_at(t).corners_m[..., 0].mean() for t in (0.0, 1.0, 2.0, 3.0, 4.0)]
    np.testing.assert_allclose(middles, [1.0, 2.0, 3.0, 2.0, 1.0], atol=0.02)


def test_a_sweep_with_skew_follows_the_robot(plain_room):
    class Driving:
        def pose(self, time_s):
            return np.array([2.0 + 0.5 * time_s, 2.0, 0.3 * time_s])

    mounts = sensor_mounts.home_robot()
    sweep = simulator(plain_room(), mounts, Driving(), lidar_skew=True).simulate_sweep(1.0, 0)
    times = 1.0 + np.arange(682) * 0.1 / 1024
    azimuth = 0.3 * times + (np.arange(682) - 340.5) * 2 * np.pi / 1024
    expected = [
        plain_room.range_m(2.0 + 0.5 * t, 2.0, a) for t, a in zip(times, azimuth, strict=True)
    ]
    np.testing.assert_allclose(sweep.true_m, expected, atol=1e-12)
