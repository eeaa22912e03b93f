"""The floor in depth images, against cameras whose height and tilt are known."""

import numpy as np
import pytest

from fusion_core.mapping.floor_plane import find_floor
from fusion_core.model.errors import AlignmentFailed
from tests.mapping.box_room import INTRINSICS, BoxRoom, camera_pose

UP = np.array([0.0, -1.0, 0.0])
POSES = [np.array([x, 2.0, yaw]) for x in (1.5, 2.5) for yaw in (0.0, 1.2, 2.5)]


def images(room, T, noise=11):
    rng = np.random.default_rng(noise)
    return [room.depth(pose, T, noise=rng) for pose in POSES]


@pytest.mark.parametrize(
    ("height", "pitch", "roll"),
    [(0.9, 0.0, 0.0), (0.9, 0.06, -0.04), (0.3, 0.02, 0.01), (1.3, 0.5, 0.1)],
)
def test_height_and_tilt_are_the_cameras(height, pitch, roll):
    # A bed and boxes are level too.
    room = BoxRoom(
        boxes=((3.5, 0.5, 0.0, 5.0, 2.5, 0.5), (0.2, 3.5, 0.0, 2.5, 4.6, 0.4), (3, 3, 0, 4, 4, 0.1))
    )
    T = camera_pose(height, pitch=pitch, roll=roll)
    floor = find_floor(images(room, T), INTRINSICS, UP, tilt_max_rad=0.7)
    assert floor.camera_height_m == pytest.approx(height, abs=0.01)
    off = np.arccos(np.clip(floor.up @ T[2, :3], -1.0, 1.0))
    assert np.rad2deg(off) < 0.3
    assert floor.tilt_rad == pytest.approx(np.arccos(UP @ T[2, :3]), abs=0.01)
    assert floor.images >= 3


def test_a_large_table_is_not_the_floor():
    room = BoxRoom(size_m=(9.0, 4.0, 2.5), boxes=((2.6, 0.0, 0.0, 9.0, 2.9, 0.45),))
    T = camera_pose(1.2, pitch=0.35)
    floor = find_floor(images(room, T), INTRINSICS, UP, tilt_max_rad=0.6)
    assert floor.camera_height_m == pytest.approx(1.2, abs=0.015)


@pytest.mark.parametrize("pitch", [-0.9, 0.0])
def test_walls_alone_are_no_floor(pitch):
    room = BoxRoom(size_m=(6.0, 5.0, 20.0))
    with pytest.raises(AlignmentFailed, match="no floor plane") as caught:
        find_floor(images(room, camera_pose(9.0, pitch=pitch)), INTRINSICS, UP, tilt_max_rad=0.2)
    assert "lidar_height_m" in caught.value.advice


def test_a_hand_held_camera_is_refused():
    room = BoxRoom()
    rng = np.random.default_rng(2)
    hand_held = [
        room.depth(
            pose, camera_pose(0.8 + 0.12 * i, pitch=0.2 + 0.08 * i, roll=0.1 * (-1) ** i), noise=rng
        )
        for i, pose in enumerate(POSES)
    ]
    with pytest.raises(AlignmentFailed):
        find_floor(hand_held, INTRINSICS, UP, tilt_max_rad=0.8)


def test_no_image_shows_no_floor():
    empty = np.full((INTRINSICS.height, INTRINSICS.width), np.nan, dtype=np.float32)
    for depths in ([], [empty], [empty[:4, :4]]):
        with pytest.raises(AlignmentFailed):
            find_floor(depths, INTRINSICS, UP, tilt_max_rad=0.2)


def test_the_same_images_give_the_same_plane():
    depths = images(BoxRoom(), camera_pose())
    first, second = (find_floor(depths, INTRINSICS, UP, tilt_max_rad=0.3) for _ in range(2))
    assert first.up.tobytes() == second.up.tobytes()
    assert first.camera_height_m == second.camera_height_m
