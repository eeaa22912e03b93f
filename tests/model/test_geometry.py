"""What is a rigid transform, and what is not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.model.geometry import make_transform, rigid_fault

ANGLES = st.floats(-3.0, 3.0)


@given(st.tuples(ANGLES, ANGLES, ANGLES))
def test_a_rotation_printed_with_four_decimals_is_rigid(vector):
    T = make_transform(Rotation.from_rotvec(vector).as_matrix(), np.array([1.0, -2.0, 3.0]))
    assert rigid_fault(T) == ""
    assert rigid_fault(T.round(4)) == ""


@pytest.mark.parametrize(
    ("T", "fault"),
    [
        (np.eye(3), "must be (4, 4) and finite, got (3, 3)"),
        (np.full((4, 4), np.nan), "must be (4, 4) and finite"),
        (np.diag([2.0, 2.0, 2.0, 1.0]), "off by 3, its determinant is 8"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "its determinant is -1"),
        (np.diag([1.0, 1.0, 1.0, 2.0]), "off by 1"),
        (np.eye(4) + 0.002 * np.eye(4, k=1), "off by 0.002"),
        (np.diag([1e300, 1.0, 1.0, 1.0]), "off by inf"),
    ],
)
def test_what_else_is_not_says_why(T, fault):
    assert fault in rigid_fault(T)
