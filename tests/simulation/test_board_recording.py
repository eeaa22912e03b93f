"""The simulated board: against its own geometry by brute force, and the same each time."""

import cv2
import numpy as np
import pytest

from fusion_core.calibration.board.board import Board, find_board
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.recordings.formats import open_recording
from fusion_core.simulation.board_recording import BoardSceneSettings, write_board_recording
from fusion_core.simulation.board_room import (
    HALF_M,
    INTRINSICS,
    BoardImages,
    Carrier,
    draw_board_pose,
    draw_camera,
    true_ranges_m,
)
from fusion_core.simulation.truth import truth_path

SHORT = BoardSceneSettings(seed=5, places=2, still_s=0.4, carried_s=0.3)


@pytest.fixture(scope="module")
def placed():
    T_camera_lidar = draw_camera(3)
    rng = np.random.default_rng(0)
    return T_camera_lidar, [draw_board_pose(T_camera_lidar, rng) for _ in range(3)]


def test_beams_on_the_board_end_in_its_plane_and_inside_it(placed):
    angles = np.radians(np.linspace(-60.0, 60.0, 481))
    for T_lidar_board in placed[1]:
        ranges, cosines = true_ranges_m(angles, T_lidar_board, Carrier(0.4, 0.1))
        points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles), 0.0 * ranges], axis=1)
        on_board = transform_points(invert_transform(T_lidar_board), points)
        hit = (np.abs(on_board[:, :2]) < HALF_M).all(axis=1) & (np.abs(on_board[:, 2]) < 1e-9)
        assert hit.sum() > 20
        rays = points[hit] / ranges[hit, None]
        np.testing.assert_allclose(cosines[hit], np.abs(rays @ T_lidar_board[:3, 2]), atol=1e-12)


def test_corners_appear_where_the_pinhole_puts_them(placed):
    T_camera_lidar, poses = placed
    images = BoardImages(T_camera_lidar, seed=3)
    board = Board(columns=7, rows=5, square_m=0.1)
    for T_lidar_board in poses:
        rgb = images.image(T_lidar_board, np.random.default_rng(1))
        corners = find_board(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), board, is_expected=True)
        in_board = board.points_m() - board.points_m().mean(axis=0)
        seen = transform_points(T_camera_lidar @ T_lidar_board, in_board)
        true = seen[:, :2] / seen[:, 2:] * (INTRINSICS.fx, INTRINSICS.fy)
        true += (INTRINSICS.cx, INTRINSICS.cy)
        off = min(np.abs(corners - end).max() for end in (true, true[::-1]))
        assert off < 0.2


def test_a_recording_is_the_same_each_time(tmp_path):
    files = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for file in files:
        write_board_recording(file, SHORT)
    assert files[0].read_bytes() == files[1].read_bytes()
    truths = [truth_path(file).read_bytes() for file in files]
    assert truths[0] == truths[1]


def test_a_recording_holds_scans_images_and_its_truth(tmp_path):
    file = tmp_path / "board.mcap"
    write_board_recording(file, SHORT)
    with open_recording(file) as recording:
        counts = {topic.role: topic.count for topic in recording.topics}
    assert counts == {"lidar": 14, "color": 7, "camera_info": 7}
    with np.load(truth_path(file)) as truth:
        np.testing.assert_array_equal(truth["T_camera_lidar"], draw_camera(5))
        assert truth["T_lidar_board"].shape == (7, 4, 4)
        assert truth["image_stamp"].shape == (7,)
