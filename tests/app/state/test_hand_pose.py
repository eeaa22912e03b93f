"""A camera's pose in six numbers, against rotations of another library."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.errors import SettingsError
from scanloom.state.hand_pose import HandPose
from scanloom.state.view import View, view_of_link

ANGLES = st.floats(-179.0, 179.0)
PLACES = st.floats(-20.0, 20.0)
POSES = st.builds(
    HandPose,
    yaw_deg=ANGLES,
    pitch_deg=st.floats(-88.0, 88.0),
    roll_deg=ANGLES,
    forward_m=PLACES,
    left_m=PLACES,
    up_m=PLACES,
)


@given(pose=POSES)
def test_numbers_and_transform_are_the_same_pose(pose: HandPose) -> None:
    back = HandPose.of_transform(pose.T_lidar_camera)
    for name, value in pose.model_dump().items():
        # At a pitch of 88 degrees yaw and roll are told apart by a thirtieth of their digits.
        assert getattr(back, name) == pytest.approx(value, abs=1e-4)


@given(pose=POSES)
def test_the_rotation_is_yaw_pitch_and_roll_about_the_cameras_axes(pose: HandPose) -> None:
    T = pose.T_lidar_camera
    body = Rotation.from_euler(
        "ZYX", [pose.yaw_deg, pose.pitch_deg, pose.roll_deg], degrees=True
    ).as_matrix()
    # Ahead is the optical z, left the optical -x, up the optical -y.
    np.testing.assert_allclose(
        T[:3, :3], np.stack([-body[:, 1], -body[:, 2], body[:, 0]], axis=1), atol=1e-12
    )
    np.testing.assert_allclose(T[:3, 3], [pose.forward_m, pose.left_m, pose.up_m])


def test_signs_are_what_the_labels_say() -> None:
    ahead = HandPose(yaw_deg=90.0).T_lidar_camera[:3, 2]
    np.testing.assert_allclose(ahead, [0.0, 1.0, 0.0], atol=1e-12)
    down = HandPose(pitch_deg=30.0).T_lidar_camera[:3, 2]
    assert down[2] == pytest.approx(-0.5)
    # Rolled clockwise, its right side is lower.
    assert HandPose(roll_deg=30.0).T_lidar_camera[2, 0] == pytest.approx(-0.5)


@given(pose=POSES)
def test_a_link_carries_it(pose: HandPose) -> None:
    view = View(recording="a", extrinsics=pose)
    assert view_of_link(view.to_link()) == view
    assert view_of_link(view.to_link()).hand_pose == pose


@pytest.mark.parametrize(
    "value", ["file", {"yaw_deg": 181.0}, {"pitch_deg": float("nan")}, {"x": 1.0}, {"up_m": 1e9}, 3]
)
def test_anything_else_is_refused(value: object) -> None:
    with pytest.raises(SettingsError, match="extrinsics"):
        View(recording="a").changed(extrinsics=value)


def test_another_recording_has_its_own_pose() -> None:
    view = View(recording="a", extrinsics=HandPose(yaw_deg=3.0))
    assert view.of_recording("b").extrinsics is None


@pytest.mark.parametrize(("place", "turn"), [((30.0, 0.0, 0.0), 0.0), ((0.0, 0.0, 0.0), -90.0)])
def test_a_pose_that_no_rig_has_is_one_line(place: tuple[float, ...], turn: float) -> None:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("y", turn, degrees=True).as_matrix() @ R_BODY_OPTICAL
    T[:3, 3] = place
    with pytest.raises(SettingsError, match="not on the LiDAR's robot"):
        HandPose.of_transform(T)
