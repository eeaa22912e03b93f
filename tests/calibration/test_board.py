"""The corners of a board: against where a homography has drawn them."""

import cv2
import numpy as np
import pytest

from fusion_core.calibration.board.board import Board, find_board, find_boards, parse_board
from fusion_core.calibration.board.board_pose import fit_plane_pose
from fusion_core.model.errors import CalibrationFailed, SettingsError
from fusion_core.model.sensors import CameraIntrinsics
from tests.calibration.boards import BOARD, board_image, board_pose


@pytest.fixture(scope="module")
def drawn():
    rng = np.random.default_rng(3)
    return [board_image(board_pose(rng), seed=seed) for seed in range(4)]


def distance(found, true):
    """Largest distance, with the board either way round."""
    ends = (true, true[::-1])
    return min(np.abs(found - end).max() for end in ends)


def test_corners_lie_where_they_were_drawn(drawn):
    found = find_boards([image for image, _ in drawn], BOARD)
    assert found.board == BOARD
    for corners, (_, true) in zip(found.corners_px, drawn, strict=True):
        assert distance(corners, true) < 0.15


def test_one_image_of_a_video_gives_the_same(drawn):
    image, true = drawn[0]
    assert distance(find_board(image, BOARD), true) < 0.15
    assert find_board(np.full((480, 640), 128, np.uint8), BOARD) is None


@pytest.mark.parametrize(("text", "counted"), [("7x5", "inner corners"), ("8x6", "squares")])
def test_the_size_may_count_corners_or_squares(drawn, text, counted):
    found = find_boards([image for image, _ in drawn], parse_board(text, 0.1))
    assert found.board.size == (7, 5)
    assert found.board.counted == counted


def test_a_wrong_size_names_the_one_that_is_seen(drawn):
    with pytest.raises(CalibrationFailed, match=r"show a board of (7x5|5x7).*Give --board 7x5"):
        find_boards([drawn[0][0]], parse_board("6x4", 0.1))


def test_no_board_is_an_error():
    with pytest.raises(CalibrationFailed, match="no board of 7x5 inner corners"):
        find_boards([np.full((240, 320), 99, np.uint8)], BOARD)


@pytest.mark.parametrize("text", ["7", "7x", "2x5", "axb", "700x5", "7x5x3"])
def test_what_is_no_size_is_refused(text):
    with pytest.raises(SettingsError, match="no size of a checkerboard"):
        parse_board(text, 0.1)


@pytest.mark.parametrize("square_m", [105.0, 0.0, -0.1, float("nan")])
def test_squares_in_millimetres_are_refused(square_m):
    with pytest.raises(SettingsError, match="in metres"):
        parse_board("7x5", square_m)


def test_the_thorough_detector_gives_the_corners_in_the_order_of_the_board(drawn, monkeypatch):
    monkeypatch.setattr(cv2, "findChessboardCorners", lambda *_, **__: (False, None))
    standing = Board(columns=5, rows=7, square_m=0.1)
    found = find_boards([image for image, _ in drawn], standing)
    assert found.board == standing
    camera = CameraIntrinsics(width=640, height=480, fx=520.0, fy=520.0, cx=320.0, cy=240.0)
    for corners, (_, true) in zip(found.corners_px, drawn, strict=True):
        pose = fit_plane_pose(standing.points_m(), corners, camera)
        assert pose.rms_px < 0.3
        nearest = np.linalg.norm(true[:, None] - corners[None], axis=2).min(axis=1)
        assert nearest.max() < 0.4
