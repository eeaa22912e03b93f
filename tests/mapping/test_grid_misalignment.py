"""The misalignment of two grids: against the motion by which one was drawn wrongly."""

import numpy as np
import pytest

from fusion_core.mapping.grid import GridBuilder, GridSettings
from fusion_core.mapping.grid_misalignment import (
    GridFusionSettings,
    GridMisalignment,
    estimate_misalignment,
)
from fusion_core.mapping.moved_grid import move_grid
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import RegistrationFailed
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.planar_poses import compose_poses, invert_pose, transform_planar_points
from tests.mapping.box_room import BoxRoom

ROOM = BoxRoom(
    size_m=(6.0, 5.0, 2.5),
    boxes=((1.0, 3.2, 0.0, 1.6, 3.9, 2.0), (4.1, 1.1, 0.0, 4.6, 1.8, 2.0)),
)
CORRIDOR = BoxRoom(size_m=(60.0, 2.0, 2.5))
SETTINGS = GridFusionSettings()


def draw(
    room: BoxRoom,
    poses: FloatArray,
    rng: np.random.Generator,
    *,
    moved: FloatArray,
    sigma_m: float,
    half_width_rad: float = np.pi,
    range_max_m: float = 8.0,
) -> OccupancyGrid:
    """The grid of scans at poses, drawn at poses that are ``moved`` in the map frame."""
    builder = GridBuilder(GridSettings())
    for pose in poses:
        scan = room.scan(pose, range_max_m=range_max_m)
        noisy_m = scan.ranges_m + rng.normal(scale=sigma_m, size=scan.ranges_m.size)
        noisy_m[np.abs(scan.angles_rad) > half_width_rad] = np.nan
        builder.add_scan(compose_poses(moved, pose), scan.angles_rad, noisy_m, range_max_m)
    return builder.build()


def lidar_and_camera(
    room: BoxRoom, seed: int, *, turned_rad: float, error: FloatArray, lidar_sigma_m: float = 0.01
) -> tuple[OccupancyGrid, OccupancyGrid]:
    """Two maps that share no beam; the camera's is wrong by ``error`` in the map frame."""
    rng = np.random.default_rng(seed)
    low, high = (1.8, 0.3, -3.0), (3.9, 3.0, 3.0)
    if room is CORRIDOR:
        low, high = (25.0, 0.7, -0.3), (35.0, 1.3, 0.3)
    base = np.array([0.0, 0.0, turned_rad])
    lidar = draw(room, rng.uniform(low, high, (25, 3)), rng, moved=base, sigma_m=lidar_sigma_m)
    camera = draw(
        room,
        rng.uniform(low, high, (40, 3)),
        rng,
        moved=compose_poses(error, base),
        sigma_m=0.02,
        half_width_rad=0.5,
        range_max_m=4.0,
    )
    return lidar, camera


def away_from(found: GridMisalignment, error: FloatArray) -> FloatArray:
    """Estimate minus truth of (x, y, yaw) at the centre."""
    undone = invert_pose(error)
    centre_m = found.centre_m[np.newaxis]
    true_m = (transform_planar_points(undone, centre_m) - centre_m)[0]
    return found.shift - np.array([*true_m, undone[2]])


@pytest.mark.parametrize("seed", range(6))
def test_a_wrong_mount_is_found_within_its_uncertainty(seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    error = rng.uniform([-0.3, -0.3, -0.05], [0.3, 0.3, 0.05])
    turned_rad = 0.0 if seed % 2 else float(rng.uniform(0.0, 1.5))
    lidar, camera = lidar_and_camera(ROOM, seed, turned_rad=turned_rad, error=error)
    found = estimate_misalignment(lidar, camera, SETTINGS)
    off = away_from(found, error)
    # A fifth of a cell, and what the estimate says of itself.
    assert np.abs(off[:2]).max() < 0.01
    assert abs(off[2]) < 0.005
    assert (np.abs(off) < 3.0 * found.sigma).all()
    assert (found.sigma[:2] < 0.03).all()
    assert found.is_significant
    # Moved by it, the second lies on the first.
    again = estimate_misalignment(lidar, move_grid(camera, found.pose_first_second), SETTINGS)
    assert not again.is_significant


def test_walls_that_are_several_cells_thick_hold_a_map_too() -> None:
    error = np.array([0.11, -0.16, 0.02])
    lidar, camera = lidar_and_camera(ROOM, 1, turned_rad=0.2, error=error, lidar_sigma_m=0.05)
    found = estimate_misalignment(lidar, camera, SETTINGS)
    off = away_from(found, error)
    assert np.abs(off[:2]).max() < 0.02
    assert (np.abs(off) < 3.0 * found.sigma).all()
    assert found.pairs > 400


def test_maps_that_fit_are_not_misaligned() -> None:
    lidar, camera = lidar_and_camera(ROOM, 3, turned_rad=0.0, error=np.zeros(3))
    found = estimate_misalignment(lidar, camera, SETTINGS)
    assert not found.is_significant
    assert found.pairs > 200


def test_the_length_of_a_corridor_is_not_observable() -> None:
    error = np.array([0.12, 0.1, 0.0])
    lidar, camera = lidar_and_camera(CORRIDOR, 0, turned_rad=0.0, error=error)
    found = estimate_misalignment(lidar, camera, SETTINGS)
    np.testing.assert_array_equal(np.isnan(found.shift), [True, False, False])
    assert abs(away_from(found, error)[1]) < 0.01
    assert abs(found.correction[0]) < 0.005


def test_a_corridor_at_an_angle_shows_what_is_across_it() -> None:
    error, along = np.array([0.12, 0.1, 0.0]), 0.4
    lidar, camera = lidar_and_camera(CORRIDOR, 0, turned_rad=along, error=error)
    found = estimate_misalignment(lidar, camera, SETTINGS)
    np.testing.assert_array_equal(np.isnan(found.shift), [True, True, False])
    across = np.array([-np.sin(along), np.cos(along)])
    assert found.correction[:2] @ across == pytest.approx(-error[:2] @ across, abs=0.015)
    assert abs(found.correction[:2] @ [np.cos(along), np.sin(along)]) < 0.005


def test_grids_without_walls_in_common_say_so() -> None:
    lidar, camera = lidar_and_camera(ROOM, 0, turned_rad=0.0, error=np.zeros(3))
    far = move_grid(camera, np.array([40.0, 0.0, 0.0]))
    with pytest.raises(RegistrationFailed, match="not observable"):
        estimate_misalignment(lidar, far, SETTINGS)
    empty = OccupancyGrid(resolution_m=0.05, origin_m=(0.0, 0.0), log_odds=np.full((9, 9), -1.0))
    with pytest.raises(RegistrationFailed, match="only 0 occupied cells"):
        estimate_misalignment(lidar, empty, SETTINGS)


def test_a_grid_moved_by_whole_cells_is_the_same_grid() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(7, 4))
    values[rng.random((7, 4)) < 0.3] = np.nan
    grid = OccupancyGrid(resolution_m=0.5, origin_m=(1.0, -2.0), log_odds=values)
    moved = move_grid(grid, np.array([1.5, -1.0, 0.0]))
    assert moved.origin_m == (2.5, -3.0)
    np.testing.assert_array_equal(moved.log_odds, values)


def test_a_quarter_turn_turns_the_cells() -> None:
    grid = OccupancyGrid(
        resolution_m=1.0, origin_m=(0.0, 0.0), log_odds=np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    )
    moved = move_grid(grid, np.array([0.0, 0.0, np.pi / 2.0]))
    kept = moved.log_odds[:, np.isfinite(moved.log_odds).any(axis=0)]
    kept = kept[np.isfinite(kept).any(axis=1)]
    # x becomes y, and y becomes -x.
    np.testing.assert_array_equal(kept, [[4.0, 1.0], [5.0, 2.0], [6.0, 3.0]])
