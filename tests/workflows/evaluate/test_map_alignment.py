"""A map in a frame of its own is laid back over the world."""

import numpy as np
import pytest

from fusion_core.model.errors import RegistrationFailed
from fusion_core.model.planar_poses import transform_planar_points
from fusion_core.model.world_outline import WorldOutline
from fusion_core.simulation import arena, sensor_mounts
from fusion_core.simulation.paths import WeavingPath
from fusion_core.simulation.sensor_simulator import SimulationSetup
from fusion_core.simulation.visibility import VisibilityTracker
from fusion_core.workflows.evaluate.map_alignment import align_map

RESOLUTION_M = 0.05


@pytest.fixture(scope="module")
def world() -> WorldOutline:
    made = arena.arena(1)
    path = WeavingPath(made.route_m, speed_m_s=0.3, start=0.0)
    return VisibilityTracker(
        SimulationSetup(world=made, mounts=sensor_mounts.turtlebot2(), path=path, seed=1)
    ).outline()


def drawn(world: WorldOutline, pose_map_world: np.ndarray, noise_m: float = 0.01) -> np.ndarray:
    """Occupied cells of a map whose frame is another one, with noise and strays, in part."""
    rng = np.random.default_rng(5)
    samples = np.concatenate([own.samples_m() for own in world.obstacles])
    samples = samples[samples[:, 1] < 2.4]
    samples = samples + noise_m * rng.standard_normal(samples.shape)
    strays = rng.uniform((0.0, 0.0), (5.6, 2.4), (40, 2))
    points = transform_planar_points(pose_map_world, np.concatenate([samples, strays]))
    cells = np.unique(np.floor(points / RESOLUTION_M).astype(int), axis=0)
    return (cells + 0.5) * RESOLUTION_M


def inverse(pose: np.ndarray) -> np.ndarray:
    back = transform_planar_points(np.array([0.0, 0.0, -pose[2]]), -pose[None, :2])[0]
    return np.array([*back, -pose[2]])


def apart(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Metres at a corner of the world, and degrees."""
    corner = np.array([[5.6, 3.18]])
    off = transform_planar_points(first, corner) - transform_planar_points(second, corner)
    turn = (first[2] - second[2] + np.pi) % (2 * np.pi) - np.pi
    return float(np.linalg.norm(off)), float(np.degrees(abs(turn)))


@pytest.mark.parametrize(
    "pose_map_world",
    [(0.0, 0.0, 0.0), (0.4, -0.3, 0.1), (-2.3, 1.1, 2.0), (4.0, 3.0, np.pi), (-30.0, 12.0, -1.3)],
)
def test_a_shifted_map_is_laid_back(world, pose_map_world):
    pose = np.array(pose_map_world)
    found = align_map(drawn(world, pose), world, None)
    off_m, off_deg = apart(found.pose_world_map, inverse(pose))
    # Half a cell.
    assert off_m < 0.025
    assert off_deg < 0.3
    assert found.inlier_fraction > 0.9


def test_a_guess_decides_where_to_look(world):
    pose = np.array([-3.0, 2.0, 0.8])
    cells = drawn(world, pose)
    near = inverse(pose) + np.array([0.3, -0.4, 0.1])
    assert apart(align_map(cells, world, near).pose_world_map, inverse(pose))[0] < 0.015
    # Half a turn off: the search stays there, where less fits.
    x, y, yaw = inverse(pose)
    far = np.array([5.6 - x, 3.18 - y, yaw + np.pi])
    found = align_map(cells, world, far)
    assert apart(found.pose_world_map, inverse(pose))[1] > 150.0


def test_what_fits_nowhere_is_refused(world):
    with pytest.raises(RegistrationFailed, match="3 occupied cells"):
        align_map(np.zeros((3, 2)), world, None)
    with pytest.raises(RegistrationFailed, match="fits nowhere"):
        align_map(drawn(world, np.zeros(3)), world, np.array([500.0, 0.0, 0.0]))
    with pytest.raises(RegistrationFailed, match="no outline"):
        align_map(np.ones((50, 2)), WorldOutline(robot_height_m=0.5, obstacles=()), None)


def test_the_same_map_gives_the_same_pose(world):
    cells = drawn(world, np.array([1.0, 2.0, 0.5]))
    first, second = (align_map(cells, world, None) for _ in range(2))
    np.testing.assert_array_equal(first.pose_world_map, second.pose_world_map)
