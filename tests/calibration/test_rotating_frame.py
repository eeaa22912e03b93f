"""The axis of a frame that turns, from poses, and the way a LiDAR lies on it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.calibration.turning.rotating_frame import find_rotation_axis
from fusion_core.calibration.turning.turn import rotate_about_z
from fusion_core.calibration.turning.turn_axis import axis_aligned_mountings, occupied_voxels
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.geometry import make_transform, transform_points
from tests.calibration.box_turns import make_turn


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**31 - 1))
def test_points_stand_still_in_the_frame_of_the_axis(seed):
    """Whatever the axis' place and direction: fixed points, seen from the frame that turns, come
    to one place when they are turned back."""
    rng = np.random.default_rng(seed)
    line = Rotation.random(random_state=seed)
    angles = np.cumsum(rng.uniform(0.02, 0.3, 40))
    lever = make_transform(Rotation.random(random_state=seed + 1).as_matrix(), rng.normal(size=3))
    base = make_transform(line.as_matrix(), rng.normal(size=3))
    spun = [
        base @ make_transform(Rotation.from_euler("z", a).as_matrix(), np.zeros(3)) @ lever
        for a in angles
    ]
    order = rng.permutation(40)
    stamps_ns = np.arange(40) * 10**7
    found = find_rotation_axis(stamps_ns[order], np.stack(spun)[order])
    world = rng.normal(size=3)
    seen = np.stack(
        [
            transform_points(found.T_axis_frame @ np.linalg.inv(T), world[np.newaxis])[0]
            for T in spun
        ]
    )
    still = rotate_about_z(seen, found.angles.at(stamps_ns))
    np.testing.assert_allclose(still, np.broadcast_to(still[0], still.shape), atol=1e-9)


def test_a_frame_that_turns_about_its_z_is_its_own_axis():
    T = [
        make_transform(Rotation.from_euler("z", a).as_matrix(), np.array([1.0, 2.0, 3.0]))
        for a in np.linspace(0.0, 6.0, 30)
    ]
    found = find_rotation_axis(np.arange(30) * 10**8, np.stack(T))
    np.testing.assert_allclose(found.T_axis_frame, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(found.angles.angles_rad, np.linspace(0.0, 6.0, 30), atol=1e-9)


@pytest.mark.parametrize("count", [1, 5])
def test_a_frame_that_stands_still_has_no_axis(count):
    with pytest.raises(CalibrationFailed, match="stands still"):
        find_rotation_axis(np.arange(count), np.broadcast_to(np.eye(4), (count, 4, 4)))


@pytest.mark.parametrize("name", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_the_sharpest_cloud_tells_how_the_lidar_lies(name):
    mountings = axis_aligned_mountings()
    T = mountings[name]
    np.testing.assert_allclose(np.linalg.det(T[:3, :3]), 1.0)
    # Tilted a little beside: about a spin axis that is the turning axis nothing would show.
    lies = make_transform(Rotation.from_euler("xyz", [0.3, 0.4, 0.2]).as_matrix(), np.zeros(3)) @ T
    turn = make_turn(scans=60, columns=48, nominal=lies, parameters=np.zeros(4))
    in_tilted = turn.points_in_lidar_m @ (T[:3, :3].T @ lies[:3, :3]).T
    voxels = {n: occupied_voxels(in_tilted, turn.axis_angles_rad, m) for n, m in mountings.items()}
    assert min(voxels, key=lambda n: voxels[n]) == name
