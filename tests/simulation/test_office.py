"""The painted office and the two rooms alike: what stands there, what is seen of it, and where."""

import numpy as np
import pytest

from fusion_core.model.geometry import transform_from_planar
from fusion_core.recordings.world_file import read_world, world_path
from fusion_core.simulation import office, twin_rooms
from fusion_core.simulation.faults import FaultSettings
from fusion_core.simulation.lidar import LidarNoise
from fusion_core.simulation.paint import PaintReader, paint_mesh
from fusion_core.simulation.paths import WeavingPath
from fusion_core.simulation.scenes import SceneSettings, find_scene, plan_run, write_scene
from fusion_core.simulation.sensor_mounts import office_robot
from fusion_core.simulation.sensor_simulator import SensorSimulator, SimulationSetup
from fusion_core.simulation.solids import Material, quad
from fusion_core.simulation.textures import Texture
from fusion_core.simulation.truth import truth_path
from fusion_core.simulation.visibility import VisibilityTracker

LIDAR_HEIGHT_M = 0.4
SMALL = SceneSettings(duration_s=0.6, camera_rate_hz=5.0, image_scale=0.1)
WORLDS = {"office": office.office, "twin_rooms": twin_rooms.twin_rooms}


def drive(name: str) -> np.ndarray:
    """(N, 3) poses over the scene's own duration, every 0.1 s."""
    scene = find_scene(name)
    path = WeavingPath(
        WORLDS[name](0).route_m,
        speed_m_s=scene.speed_m_s,
        start=scene.start,
        weave_m=scene.weave_m,
        wavelength_m=scene.wavelength_m,
    )
    return np.array([path.pose(t) for t in np.arange(0.0, scene.settings.duration_s, 0.1)])


def first_hit(mesh, origin, direction) -> tuple[float, int]:
    """Distance along a ray and number of the first triangle, all triangles tried one by one
    (Möller & Trumbore 1997)."""
    best, which = np.inf, -1
    for number, (a, b, c) in enumerate(mesh.corners_m):
        e1, e2 = b - a, c - a
        p = np.cross(direction, e2)
        det = e1 @ p
        if abs(det) < 1e-12:
            continue
        s = origin - a
        u = s @ p / det
        q = np.cross(s, e1)
        v = direction @ q / det
        t = e2 @ q / det
        if u >= -1e-9 and v >= -1e-9 and u + v <= 1.0 + 1e-9 and 1e-6 < t < best:
            best, which = t, number
    return best, which


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("office") / "office.mcap"
    write_scene("office", path, settings=SMALL)
    return path


@pytest.mark.parametrize("name", WORLDS)
def test_the_robot_touches_nothing_and_comes_back(name):
    at = drive(name)
    for x0, y0, x1, y1 in WORLDS[name](0).blocks_m:
        nearest = np.stack([np.clip(at[:, 0], x0, x1), np.clip(at[:, 1], y0, y1)], axis=1)
        assert np.linalg.norm(at[:, :2] - nearest, axis=1).min() > 0.25
    # A loop: the last three seconds pass places of the first ones again, the same way round.
    again = np.linalg.norm(at[-30:, None, :2] - at[None, :250, :2], axis=2).argmin(axis=1)
    apart = at[-30:] - at[again]
    assert np.linalg.norm(apart[:, :2], axis=1).max() < 0.05
    assert np.abs(np.angle(np.exp(1j * apart[:, 2]))).max() < 0.1


def test_low_things_are_below_the_lidars_plane_and_the_camera_sees_them():
    world = office.office(0)
    low = [thing for thing in world.obstacles if thing.z_max_m <= 0.3]
    assert len(low) >= 8
    assert min(thing.z_max_m for thing in low) == 0.05
    assert max(thing.z_max_m for thing in low) == 0.3
    # Nothing else ends between them and the plane: the LiDAR meets all the rest, but for seats.
    others = [thing for thing in world.obstacles if thing not in low]
    assert all(thing.z_max_m > LIDAR_HEIGHT_M + 0.09 for thing in others)
    run = plan_run(find_scene("office"), SMALL, FaultSettings())
    tracker = VisibilityTracker(run.simulation)
    for pose in drive("office")[::25]:
        T_world_base = transform_from_planar(pose)
        tracker.add_sweep(T_world_base, 0.0)
        tracker.add_image(0, T_world_base, 0.0)
    seen = {thing.name: thing for thing in tracker.outline().obstacles}
    for thing in low:
        assert not seen[thing.name].seen_samples("lidar").any()
        assert seen[thing.name].seen_samples("camera").mean() > 0.2


def test_the_camera_hangs_where_the_papers_table_2_has_it():
    mounts = office_robot()
    assert mounts.lidar.beams == 400
    assert np.degrees(mounts.lidar.angle_increment_rad) == pytest.approx(0.9)
    camera = mounts.cameras[0].intrinsics
    assert (camera.width, camera.height) == (640, 480)
    assert 2.0 * np.degrees(np.arctan(320.0 / camera.fx)) == pytest.approx(58.4)
    assert 2.0 * np.degrees(np.arctan(240.0 / camera.fy)) == pytest.approx(45.5)
    # The paper's own LiDAR axes: x ahead, y to the right, z down.
    T_lidar_camera = mounts.T_lidar_camera()[0]
    in_camera = np.linalg.inv(T_lidar_camera) @ np.diag([1.0, -1.0, -1.0, 1.0])
    printed = [
        [0.0405, 0.9981, 0.0478, 0.1672],
        [-0.3506, -0.0305, 0.9361, 0.0152],
        [0.9356, -0.0548, 0.3485, -0.1108],
    ]
    np.testing.assert_allclose(in_camera[:3], printed, atol=2e-3)


def test_a_recording_has_all_streams_and_a_world_to_measure_by(recorded):
    truth = np.load(truth_path(recorded))
    assert truth["depth_true"].shape == (3, 48, 64)
    assert truth["scan_true"].shape == (9, 400)
    outline = read_world(world_path(recorded))
    assert {line.name for line in outline.lines} == {"line 1", "line 2"}
    assert len(outline.angles) == 2
    assert any(thing.seen_by["camera"].size for thing in outline.obstacles)


def test_the_truth_is_what_rays_meet_one_by_one(recorded):
    truth, world = np.load(truth_path(recorded)), office.office(0)
    rng = np.random.default_rng(0)
    mounts = office_robot().scaled(0.1)
    poses = truth["pose"]
    for beam in rng.choice(400, 12, replace=False):
        angle = poses[0, 2] + truth["lidar_angle_min"] + beam * truth["lidar_angle_increment"]
        origin = np.array([*poses[0, :2], LIDAR_HEIGHT_M])
        distance, _ = first_hit(world.mesh, origin, np.array([np.cos(angle), np.sin(angle), 0.0]))
        assert truth["scan_true"][0, beam] == pytest.approx(distance, abs=1e-4)
    camera = mounts.cameras[0]
    path = plan_run(find_scene("office"), SMALL, FaultSettings()).simulation.path
    T_world_optical = transform_from_planar(path.pose(0.013)) @ camera.T_base_optical
    for row, column in zip(rng.choice(48, 12), rng.choice(64, 12), strict=True):
        x = (column - camera.intrinsics.cx) / camera.intrinsics.fx
        y = (row - camera.intrinsics.cy) / camera.intrinsics.fy
        direction = T_world_optical[:3, :3] @ np.array([x, y, 1.0])
        depth_m, _ = first_hit(world.mesh, T_world_optical[:3, 3], direction)
        assert truth["depth_true"][0, row, column] == pytest.approx(1000.0 * depth_m, abs=0.6)


def test_the_two_rooms_look_the_same_and_the_corridor_does_not(standing):
    world = twin_rooms.twin_rooms(0)
    mounts = office_robot().scaled(0.25)

    def look(x: float, y: float, yaw: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        setup = SimulationSetup(
            world=world,
            mounts=mounts,
            path=standing(x, y, yaw),
            seed=3,
            lidar_noise=LidarNoise(),
        )
        simulator = SensorSimulator(setup)
        image = simulator.simulate_image(0, 0.0, 0)
        return image.rgb, image.true_m, simulator.simulate_sweep(0.0, 0).true_m

    for x, y, yaw in ((1.0, 3.5, 1.8), (3.6, 5.1, 0.4), (1.2, 5.2, 2.9)):
        first, second = look(x, y, yaw), look(x + twin_rooms.SHIFT_M, y, yaw)
        np.testing.assert_allclose(first[1], second[1], atol=1e-9)
        # A texel's border may round to its other side.
        assert (first[0] != second[0]).any(axis=2).mean() < 1e-3
        assert np.ptp(first[0].astype(float)) > 100
        # Beams through the door meet the corridor.
        assert (np.abs(first[2] - second[2]) < 1e-9).mean() > 0.9
    first, second = look(1.5, 0.9, 0.3), look(1.5 + twin_rooms.SHIFT_M, 0.9, 0.3)
    assert (first[0] != second[0]).any(axis=2).mean() > 0.5


def test_the_outlines_of_the_two_rooms_are_one_shifted():
    inside = {0: [], 1: []}
    for thing in twin_rooms.twin_rooms(0).obstacles:
        low = thing.outline_m.min(axis=0)
        if "wall" in thing.name or low[1] < twin_rooms.CORRIDOR_M:
            continue
        second = int(low[0] > twin_rooms.ROOM_M[0])
        corners = np.round(thing.outline_m - [second * twin_rooms.SHIFT_M, 0.0], 6)
        inside[second].append((thing.z_max_m, sorted(map(tuple, corners.tolist()))))
    assert len(inside[0]) > 10
    assert sorted(inside[0]) == sorted(inside[1])


def test_paint_is_read_texel_by_texel_and_from_afar_as_a_mean():
    rng = np.random.default_rng(1)
    picture = rng.integers(0, 256, (16, 32, 3), dtype=np.uint8)
    texture = Texture(picture, np.zeros((16, 32), dtype=np.float32))
    plain = quad((0, 0, 1.0), (1, 0, 0), (0, 1, 0), Material.WALL)
    wall = quad((0, 0, 0), (3.2, 0, 0), (0, 0, 1.6), Material.WALL)
    mesh = type(wall)(
        np.concatenate([plain.corners_m, wall.corners_m]),
        np.concatenate([plain.materials, wall.materials]),
    )
    reader = PaintReader(paint_mesh(mesh, [None, texture]))
    row, column = (grid.reshape(-1) for grid in np.indices((16, 32)))
    points = np.stack([0.1 * (column + 0.5), np.zeros(512), 1.6 - 0.1 * (row + 0.5)], axis=1)
    rgb, painted = reader.rgb(np.full(512, 2), points, np.full(512, 1e-3))
    np.testing.assert_array_equal(painted, np.arange(512))
    np.testing.assert_allclose(rgb, picture.reshape(-1, 3), atol=1e-6)
    # A pixel that sees four texels has their mean.
    centers = np.stack([0.2 * np.arange(1, 15) + 0.1, np.zeros(14), np.full(14, 0.9)], axis=1)
    rgb, _ = reader.rgb(np.full(14, 3), centers, np.full(14, 0.2))
    means = picture[6:8].reshape(2, 16, 2, 3).mean(axis=(0, 2))
    np.testing.assert_allclose(rgb, means[1:15], atol=0.51)
    # The plain rectangle, a ray into nothing, a person's triangle.
    for triangle in (0, -1, 4):
        assert reader.rgb(np.array([triangle]), points[:1], np.ones(1))[1].size == 0


def test_colours_have_noise_of_their_own(standing):
    scene = find_scene("office")
    setup = {"world": office.office(0), "mounts": office_robot().scaled(0.2), "seed": 3}
    still = SensorSimulator(SimulationSetup(**setup, path=standing(1.2, 3.0, 0.0)))
    noisy = SensorSimulator(
        SimulationSetup(**setup, path=standing(1.2, 3.0, 0.0), color_sigma=scene.color_sigma)
    )
    clean = still.simulate_image(0, 0.0, 0)
    first, second = (noisy.simulate_image(0, 0.0, index).rgb.astype(float) for index in (0, 1))
    inner = (clean.rgb > 20) & (clean.rgb < 235)
    assert (first - clean.rgb)[inner].std() == pytest.approx(scene.color_sigma, rel=0.05)
    assert (first - second)[inner].std() == pytest.approx(2**0.5 * scene.color_sigma, rel=0.05)
