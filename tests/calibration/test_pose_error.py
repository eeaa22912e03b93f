"""Errors of poses: inverse of each other, along the axes that they name."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.calibration.pose_error import apply_pose_error, pose_error, rotation_angle_rad
from fusion_core.model.geometry import make_transform

_numbers = st.floats(-1.0, 1.0)


@given(st.tuples(*[_numbers] * 6), st.tuples(*[_numbers] * 6))
def test_an_error_leads_from_the_estimate_to_the_truth(
    pose: tuple[float, ...], error: tuple[float, ...]
) -> None:
    rotation = Rotation.from_rotvec(pose[:3]).as_matrix()
    T_estimate = make_transform(rotation, np.array(pose[3:]))
    T_true = apply_pose_error(T_estimate, np.array(error))
    assert pose_error(T_true, T_estimate) == pytest.approx(error, abs=1e-9)
    assert rotation_angle_rad(T_true, T_estimate) == pytest.approx(np.linalg.norm(error[:3]))


def test_the_axes_are_those_of_the_first_frame() -> None:
    T_a_b = make_transform(Rotation.from_euler("z", 90, degrees=True).as_matrix(), np.zeros(3))
    moved = apply_pose_error(T_a_b, np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0]))
    assert moved[:3, 3] == pytest.approx([1.0, 0.0, 0.0])
    turned = apply_pose_error(T_a_b, np.array([0.5 * np.pi, 0.0, 0.0, 0.0, 0.0, 0.0]))
    # b's x is a's y, which a quarter turn about a's x brings to a's z.
    assert turned[:3, 0] == pytest.approx([0.0, 0.0, 1.0])
