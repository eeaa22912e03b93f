"""Mirrors, sunlight, corners, a person and rolling exposure in whole worlds."""

from dataclasses import replace

import numpy as np
import pytest

from fusion_core.model.geometry import transform_from_planar, transform_points
from fusion_core.simulation import sensor_mounts, worlds
from fusion_core.simulation.corners import corner_distance_in_image, corner_distance_in_sweep
from fusion_core.simulation.depth_camera import DepthNoise, pixel_rays
from fusion_core.simulation.faults import FaultSettings
from fusion_core.simulation.lidar import LidarNoise
from fusion_core.simulation.ray_casting import RayCaster
from fusion_core.simulation.room_features import add_features
from fusion_core.simulation.scenes import find_scene, plan_run
from fusion_core.simulation.sensor_simulator import SensorSimulator, SimulationSetup
from fusion_core.simulation.solids import Material, box, quad
from fusion_core.simulation.sunlight import Sunlight

WIDTH, DEPTH, HEIGHT = 6.0, 4.0, 2.5
EXACT_LIDAR = LidarNoise(
    sigma_near_m=0.0,
    relative_sigma=0.0,
    relative_sigma_middle=0.0,
    relative_sigma_far=0.0,
    grazing_rad=1.57,
    lost_runs=0.0,
    edge_mixed_fraction=0.0,
    spurious_fraction=0.0,
    spike_fraction=0.0,
    corner_bias_m=0.0,
    mirror_lost_fraction=0.0,
    sunlit_lost_fraction=1.0,
)
EXACT_DEPTH = DepthNoise(
    sigma_per_m=0.0,
    disparity_step_per_m=1e-5,
    near_m=0.01,
    far_m=99.0,
    projector_baseline_m=0.0,
    grazing_rad=1.57,
    edge_lost_fraction=0.0,
    edge_mixed_fraction=0.0,
    speckles=0.0,
    spike_fraction=0.0,
    patches=0.0,
    corner_bias_m=0.0,
    mirror_lost_fraction=0.0,
    mirror_front_rad=0.0,
    sunlit_lost_fraction=1.0,
)


class MovingPath:
    """Straight ahead while turning, both at constant speed."""

    def pose(self, time_s: float) -> np.ndarray:
        return np.array([2.0 + 0.8 * time_s, 2.0, 0.2 + 1.5 * time_s])


def exact(world, path, mounts=None, **changes) -> SensorSimulator:
    return SensorSimulator(
        SimulationSetup(
            world=world,
            mounts=sensor_mounts.home_robot() if mounts is None else mounts,
            path=path,
            seed=1,
            lidar_noise=EXACT_LIDAR,
            depth_noise=EXACT_DEPTH,
            **changes,
        )
    )


def pixel_points(mount, pose, depth_m):
    points = pixel_rays(mount.intrinsics) * depth_m.reshape(-1, 1)
    return transform_points(transform_from_planar(np.array(pose)) @ mount.T_base_optical, points)


def mirrored_room(plain_room):
    """Almost all of the end wall x = WIDTH is a mirror."""
    pane = quad((WIDTH - 1e-3, 0.01, 0.01), (0, 3.98, 0), (0, 0, 2.48), Material.MIRROR)
    return plain_room([pane])


def test_a_beam_over_a_mirror_measures_the_room_behind_it(plain_room, standing):
    """By the method of images the folded path is straight, in a room twice as long."""
    x, y, yaw = 4.0, 1.5, 0.1
    seen = exact(mirrored_room(plain_room), standing(x, y, yaw)).simulate_sweep(0.0, 0)
    azimuth = yaw + (np.arange(682) - 340.5) * 2 * np.pi / 1024
    mirror_x = WIDTH - 1e-3
    with np.errstate(divide="ignore"):
        to_mirror = np.where(np.cos(azimuth) > 0, (mirror_x - x) / np.cos(azimuth), 99.0)
        to_side = np.where(np.sin(azimuth) > 0, DEPTH - y, -y) / np.sin(azimuth)
        to_image_of_end = np.where(np.cos(azimuth) > 0, (2 * mirror_x - x) / np.cos(azimuth), 99.0)
    y_there = y + to_mirror * np.sin(azimuth)
    on_mirror = (to_mirror < 99.0) & (y_there > 0.01) & (y_there < DEPTH - 0.01)
    oblique = on_mirror & (np.abs(azimuth) > EXACT_LIDAR.mirror_front_rad + 1e-6)
    straight_m = np.minimum(to_image_of_end, to_side)
    inside = oblique & (straight_m < 5.6)
    assert inside.sum() > 50
    np.testing.assert_allclose(seen.true_m[on_mirror], to_mirror[on_mirror], atol=1e-9)
    np.testing.assert_allclose(seen.ranges_m[inside], straight_m[inside], atol=2.6e-3)
    assert (seen.kinds[inside & (straight_m - to_mirror > 0.11)] == 2).all()
    assert np.isnan(seen.ranges_m[oblique & (straight_m > 5.61)]).all()
    front = on_mirror & ~oblique
    np.testing.assert_allclose(seen.ranges_m[front], to_mirror[front], atol=1e-3)
    assert (seen.kinds[front] == 0).all()


def test_a_camera_sees_the_room_behind_a_mirror(plain_room, standing):
    pose, mounts = (4.0, 1.5, 0.1), sensor_mounts.home_robot()
    image = exact(mirrored_room(plain_room), standing(*pose), mounts).simulate_image(0, 0.0, 0)
    reported = pixel_points(mounts.cameras[0], pose, image.depth_m.astype(float))
    truth = pixel_points(mounts.cameras[0], pose, image.true_m)
    ghosts = (image.kinds == 2).reshape(-1)
    assert ghosts.mean() > 0.5
    np.testing.assert_allclose(truth[ghosts][:, 0], WIDTH - 1e-3, atol=1e-9)
    # In the image of the room each point lies on a wall, the floor or the ceiling again.
    x, y, z = reported[ghosts].T
    folded = 2 * (WIDTH - 1e-3) - x
    planes = np.abs(np.stack([folded, y, y - DEPTH, z, z - HEIGHT]))
    assert (x > WIDTH).all()
    assert planes.min(axis=0).max() < 0.02
    # Its colours are those of the room, too: the floor in the mirror is brown.
    on_floor = ghosts & (reported[:, 2] < 0.02)
    red, _, blue = image.rgb.reshape(-1, 3)[on_floor].astype(float).T
    assert on_floor.sum() > 500
    # But for the foot of a wall.
    assert (red > 1.5 * blue).mean() > 0.9


@pytest.fixture
def sunny_room(plain_room):
    """The sun shines through a window in the wall y = 0 onto the floor, past a box."""
    direction = np.array([0.3, 0.7, -0.5])
    sunlight = Sunlight(
        direction=direction / np.linalg.norm(direction),
        windows_m=np.array([[(2.0, 0.0, 0.9), (1.5, 0.0, 0.0), (0.0, 0.0, 1.0)]]),
        size_m=(WIDTH, DEPTH),
    )
    room = plain_room([box((2.6, 1.2, 0.0), (2.9, 1.5, 0.6), Material.WOOD)])
    return replace(room, sunlight=sunlight)


def is_sunlit(point, sunlight) -> bool:
    """March from a point towards the sun until the wall."""
    (corner, along, up), place = sunlight.windows_m[0], point.copy()
    while place[1] > 0.0:
        place = place - 0.004 * sunlight.direction
        inside = (2.6 < place[0] < 2.9) and (1.2 < place[1] < 1.5) and (0.0 < place[2] < 0.6)
        if inside and place[1] > 0.004:
            return False
    across, height = place[0] - corner[0], place[2] - corner[2]
    return bool(0.0 <= across <= along[0] and 0.0 <= height <= up[2])


@pytest.mark.parametrize("pose", [(2.0, 3.0, -0.6), (5.0, 3.0, -2.2)])
def test_sunlight_lies_where_marching_towards_the_sun_says(sunny_room, standing, pose):
    """The same patch in the world from every pose: no depth there, depth everywhere else."""
    mounts = sensor_mounts.home_robot().scaled(0.5)
    image = exact(sunny_room, standing(*pose), mounts).simulate_image(0, 0.0, 0)
    points = pixel_points(mounts.cameras[0], pose, image.true_m)
    lost = (image.kinds == 1).reshape(-1)
    assert 0.005 < lost.mean() < 0.6
    chosen = np.random.default_rng(0).choice(np.flatnonzero(points[:, 1] > 0.02), 400)
    agree = [is_sunlit(points[i], sunny_room.sunlight) == lost[i] for i in chosen]
    # Only at the edges of light may a step of 4 mm decide otherwise.
    assert np.mean(agree) > 0.98


def test_the_sun_takes_beams_away_where_it_shines_at_their_height(sunny_room, standing):
    pose = (2.9, 0.5, 1.8)
    sweep = exact(sunny_room, standing(*pose)).simulate_sweep(0.0, 0)
    azimuth = pose[2] + (np.arange(682) - 340.5) * 2 * np.pi / 1024
    place = np.array(pose[:2]) + sweep.true_m[:, None] * np.stack(
        [np.cos(azimuth), np.sin(azimuth)], axis=1
    )
    within = sweep.true_m < 5.5
    points = np.column_stack([place, np.full(682, 0.31)])
    lit = np.array([is_sunlit(point, sunny_room.sunlight) for point in points])
    lost = sweep.kinds == 1
    assert lit[within].sum() > 20
    assert (lit == lost)[within & (points[:, 1] > 0.02)].mean() > 0.99


def test_what_a_pane_or_a_mirror_shows_is_as_bright_as_it_is(plain_room, standing):
    """Outside it is day: behind a pane there is nothing to measure, nor over a mirror."""
    dark = SensorSimulator(
        SimulationSetup(
            world=plain_room([quad((4.0, 0.01, 0.01), (0, 3.98, 0), (0, 0, 2.48), Material.GLASS)]),
            mounts=sensor_mounts.home_robot(),
            path=standing(2.0, 2.0, 0.0),
            seed=1,
            depth_noise=EXACT_DEPTH.model_copy(update={"glass_through_fraction": 1.0}),
        )
    )
    seen = dark.simulate_image(0, 0.0, 0)
    through = seen.kinds == 2
    assert through.mean() > 0.3
    day = Sunlight(
        direction=np.array([0.0, 0.0, -1.0]), windows_m=np.zeros((0, 3, 3)), size_m=(4.5, DEPTH)
    )
    setup = dark._simulation
    bright = SensorSimulator(replace(setup, world=replace(setup.world, sunlight=day)))
    beyond = bright.simulate_image(0, 0.0, 0)
    points = pixel_points(setup.mounts.cameras[0], (2.0, 2.0, 0.0), seen.depth_m.astype(float))
    x = points[:, 0].reshape(through.shape)
    # The image has steps.
    outside, inside = through & (x > 4.55), through & (x < 4.45)
    assert outside.sum() > 1000
    assert inside.sum() > 1000
    assert (beyond.kinds[outside] == 1).all()
    assert (beyond.kinds[inside] == 2).all()


def test_corners_of_a_room_are_found_and_those_of_a_box_are_not(plain_room, standing):
    room = plain_room([box((2.8, 1.6, 0.0), (3.4, 2.4, 1.2), Material.WOOD)])
    pose = (1.2, 1.0, 2.0)
    eye = np.array([*pose[:2], 0.31])
    azimuth = pose[2] + (np.arange(682) - 340.5) * 2 * np.pi / 1024
    directions = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    hits = RayCaster(room).cast(eye, directions, 0.0)
    points = eye + hits.distance[:, None] * directions
    away = np.sum(hits.normals * directions, axis=1) > 0
    normals = np.where(away[:, None], -hits.normals, hits.normals)
    bright = np.ones(682, bool)
    found = corner_distance_in_sweep(points, normals, bright)
    corners = np.array([(0.0, 0.0), (WIDTH, 0.0), (WIDTH, DEPTH), (0.0, DEPTH)])
    nearest = np.linalg.norm(points[:, None, :2] - corners, axis=2).min(axis=1)
    near = nearest < 0.15
    assert near.sum() > 20
    # The corner is known to half a beam.
    np.testing.assert_allclose(found[near], nearest[near], atol=0.03)
    on_box = (np.abs(points[:, 0] - 2.8) < 1e-6) & (np.abs(points[:, 1] - 2.0) < 0.4)
    assert on_box.sum() > 50
    assert found[on_box].min() > 1.0
    assert np.isinf(corner_distance_in_sweep(points, normals, ~bright)).all()


def test_edges_between_walls_floor_and_ceiling_are_corners_of_an_image(plain_room, standing):
    pose, mounts = (2.5, 1.7, 0.4), sensor_mounts.home_robot()
    camera = mounts.cameras[0]
    image = exact(plain_room(), standing(*pose), mounts).simulate_image(0, 0.0, 0)
    points = pixel_points(camera, pose, image.true_m)
    planes = np.abs(
        np.stack(
            [
                points[:, 0],
                points[:, 0] - WIDTH,
                points[:, 1],
                points[:, 1] - DEPTH,
                points[:, 2],
                points[:, 2] - HEIGHT,
            ],
            axis=1,
        )
    )
    own = planes.argmin(axis=1)
    inwards = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
    # On its own plane a point's distance to an edge is that to the next plane.
    to_edge = np.sort(planes, axis=1)[:, 1]
    shape = image.true_m.shape
    found = corner_distance_in_image(
        points.reshape(*shape, 3),
        inwards[own].astype(float).reshape(*shape, 3),
        np.ones(shape, bool),
    ).reshape(-1)
    near = to_edge < 0.1
    inside = np.zeros(shape, bool)
    inside[12:-12, 12:-12] = True
    near &= inside.reshape(-1)
    assert near.sum() > 500
    assert np.median(np.abs(found[near] - to_edge[near])) < 0.03
    assert found[(to_edge > 0.3)].min() > 0.2


def test_rows_are_exposed_one_after_the_other(plain_room):
    """Each row is that of an instant image taken when the row is exposed."""
    rolling_s, mounts = 0.03, sensor_mounts.home_robot().scaled(0.25)
    rolling = exact(plain_room(), MovingPath(), mounts, rolling_s=rolling_s)
    instant = exact(plain_room(), MovingPath(), mounts)
    image = rolling.simulate_image(0, 1.0, 0)
    height = image.true_m.shape[0]
    for row in (0, 7, height // 2, height - 1):
        then_s = 1.0 + rolling_s * row / (height - 1)
        np.testing.assert_allclose(
            image.true_m[row], instant.simulate_image(0, then_s, 0).true_m[row], atol=1e-9
        )
    assert np.abs(image.true_m - instant.simulate_image(0, 1.0, 0).true_m).max() > 0.01


def test_settings_of_a_scene_reach_the_simulation():
    scene = find_scene("furnished_room")
    asked = {"mirror": True, "sunlight": True, "person": True}
    moving = {"lidar_skew": True, "rolling_s": 0.02}
    settings = scene.settings.model_copy(update=asked | moving)
    simulation = plan_run(scene, settings, FaultSettings()).simulation
    assert simulation.lidar_skew
    assert simulation.rolling_s == 0.02
    assert simulation.world.sunlight is not None
    assert len(simulation.world.walkers) == 1
    assert (simulation.world.mesh.materials == Material.MIRROR).sum() == 2
    settings = scene.settings.model_copy(update=dict.fromkeys(asked, False))
    world = plan_run(scene, settings, FaultSettings()).simulation.world
    assert not (world.mesh.materials == Material.MIRROR).any()
    assert world.sunlight is None
    assert world.walkers == ()


MAKERS = [worlds.furnished_room, worlds.bedroom, worlds.two_rooms, worlds.open_corridor]


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("seed", range(4))
def test_features_fit_into_their_world(make, seed):
    plain = make(seed)
    world = add_features(plain, seed, mirror=True, sunlight=True, person=True)
    again = add_features(plain, seed, mirror=True, sunlight=True, person=True)
    np.testing.assert_array_equal(world.mesh.corners_m, again.mesh.corners_m)
    assert world.walkers == again.walkers
    triangles = len(plain.mesh.materials)
    np.testing.assert_array_equal(world.mesh.corners_m[:triangles], plain.mesh.corners_m)
    np.testing.assert_array_equal(world.blocks_m, plain.blocks_m)
    mirror = world.mesh.corners_m[triangles:].reshape(-1, 3)
    if mirror.size:
        (x0, y0, z0), (x1, y1, z1) = mirror.min(axis=0), mirror.max(axis=0)
        assert z0 < 0.25 < 0.31 < z1
        to_walls = [x0, y0, world.size_m[0] - x1, world.size_m[1] - y1]
        assert 0.0 < min(to_walls) < 0.01
        # No furniture within half a metre before it, no window behind it.
        inwards = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])[int(np.argmin(to_walls))]
        ahead = np.array([(x0, y0), (x1, y1)]) + 0.5 * inwards
        low, high = np.minimum(ahead[0], (x0, y0)), np.maximum(ahead[1], (x1, y1))
        for bx0, by0, bx1, by1 in world.blocks_m:
            assert max(bx0 - high[0], low[0] - bx1, by0 - high[1], low[1] - by1) > 0.0
        glass = world.mesh.materials[:triangles] == Material.GLASS
        for pane in world.mesh.corners_m[:triangles][glass]:
            least, most = pane.min(axis=0), pane.max(axis=0)
            gaps = [least[0] - x1, x0 - most[0], least[1] - y1, y0 - most[1]]
            assert max(gaps) > 0.05
    for walker in world.walkers:
        way = np.linspace(walker.start_m, walker.end_m, 50)
        for x0, y0, x1, y1 in world.blocks_m:
            off = np.maximum(np.maximum([x0, y0] - way, way - [x1, y1]), 0.0)
            assert np.hypot(*off.T).min() > 0.34


def test_a_world_without_windows_has_no_sunlight(plain_room):
    world = add_features(plain_room(), 1, mirror=False, sunlight=True, person=False)
    assert world.sunlight is None


@pytest.mark.parametrize("seed", range(6))
def test_a_person_and_the_robot_do_not_meet(seed):
    scene = find_scene("hard_room")
    simulation = plan_run(
        scene, scene.settings.model_copy(update={"seed": seed}), FaultSettings()
    ).simulation
    for time_s in np.arange(0.0, 60.0, 0.5):
        x, y, _ = simulation.path.pose(time_s)
        for walker in simulation.world.walkers:
            corners = walker.mesh_at(time_s).corners_m[..., :2].reshape(-1, 2)
            assert np.hypot(corners[:, 0] - x, corners[:, 1] - y).min() > 0.2
