"""Axis angles between samples, and the mounting of Song's (1)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.calibration.turning.axis_angles import make_axis_angles
from fusion_core.calibration.turning.turn import apply_mounting_error, rotate_about_z
from fusion_core.model.errors import CalibrationFailed
from tests.calibration.box_turns import FLOOR, ON_ITS_SIDE, ROOM, SOMEWHERE, make_turn

ANGLES = st.floats(-0.3, 0.3)


@given(st.integers(0, 2**32 - 1), st.floats(-3.0, 3.0))
def test_an_even_turn_is_read_between_its_samples_however_it_is_wrapped(seed, rate):
    rng = np.random.default_rng(seed)
    stamps_ns = 10**18 + np.cumsum(rng.integers(1, 10**8, 50))
    true = rate * (stamps_ns - stamps_ns[0]) * 1e-9
    order = rng.permutation(50)
    wrapped = np.arctan2(np.sin(true), np.cos(true))
    axis = make_axis_angles(stamps_ns[order], wrapped[order])
    asked = rng.integers(stamps_ns[0], stamps_ns[-1], 30)
    expected = rate * (asked - stamps_ns[0]) * 1e-9
    np.testing.assert_allclose(axis.at(asked), expected, atol=1e-6)


def test_outside_its_samples_and_in_gaps_the_axis_is_unknown():
    axis = make_axis_angles(
        np.array([0, 100, 10**9, 10**9 + 100]), np.array([0.0, 1.0, np.nan, 1.5])
    )
    known = np.isfinite(axis.at(np.array([-1, 0, 50, 100, 5 * 10**8, 10**9 + 101])))
    assert known.tolist() == [False, True, True, True, False, False]


def test_one_sample_and_none():
    axis = make_axis_angles(np.array([5]), np.array([0.3]))
    np.testing.assert_array_equal(axis.at(np.array([4, 5])), [np.nan, 0.3])
    with pytest.raises(CalibrationFailed, match="angle"):
        make_axis_angles(np.array([5]), np.array([np.nan]))


@given(ANGLES, ANGLES)
def test_the_rotation_is_the_one_printed_for_theta_and_its_analogue_for_beta(theta, beta):
    """(1): R'_x with the signs as printed, R'_y the same about y, passive by -θ and -β."""
    c, s = np.cos(-theta), np.sin(-theta)
    about_x = np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    c, s = np.cos(-beta), np.sin(-beta)
    about_y = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    T = apply_mounting_error(np.eye(4), np.array([theta, beta, 0.01, -0.02]))
    np.testing.assert_allclose(T[:3, :3], about_x @ about_y, atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], [0.01, -0.02, 0.0])


def test_a_turn_assembles_to_the_planes_that_it_saw():
    """The rays of the test's own geometry, and the assembly, share no line of code."""
    cloud = make_turn().in_rig(SOMEWHERE)
    distances = np.abs(np.stack([cloud @ np.array(n) - d for n, d in ROOM]))
    assert distances.min(axis=0).max() < 1e-9
    uncalibrated = make_turn([FLOOR]).in_rig(np.zeros(4))
    assert np.abs(uncalibrated[:, 2] + FLOOR[1]).max() > 0.03


def test_half_a_turn_about_z():
    np.testing.assert_allclose(
        rotate_about_z(np.array([[1.0, 2.0, 3.0]]), np.pi), [[-1.0, -2.0, 3.0]], atol=1e-12
    )
    assert ON_ITS_SIDE[1, 2] == 1.0
