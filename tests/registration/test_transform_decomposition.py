"""What a map does, against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.registration.models import apply_transform
from fusion_core.registration.transform_decomposition import decompose_transform

AT_M = np.array([0.4, 2.5])


def affine(linear: np.ndarray, shift_m: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    A = np.eye(3)
    A[:2, :2], A[2, :2] = linear, shift_m
    return A


def turn(angle_rad: float) -> np.ndarray:
    """Of row vectors, to the left as seen from above."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[cosine, sine], [-sine, cosine]])


@given(
    angle_rad=st.floats(-3.0, 3.0),
    scale=st.floats(0.5, 2.0),
    shift_m=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
)
def test_a_similarity_is_its_rotation_scale_and_translation(angle_rad, scale, shift_m):
    meaning = decompose_transform(affine(scale * turn(angle_rad), shift_m), AT_M)
    assert meaning.rotation_rad == pytest.approx(angle_rad, abs=1e-12)
    for found in (meaning.scale, meaning.scale_x, meaning.scale_z):
        assert found == pytest.approx(scale)
    assert (meaning.scale_min, meaning.scale_max) == pytest.approx((scale, scale))
    assert meaning.shear_rad == pytest.approx(0.0, abs=1e-7)
    np.testing.assert_allclose(meaning.translation_m, shift_m, atol=1e-12)
    np.testing.assert_array_equal(meaning.perspective_per_m, 0.0)
    assert not meaning.is_mirrored


def test_left_is_left():
    """A point ahead goes to the left, which is towards negative x."""
    A = affine(turn(np.deg2rad(3.0)))
    assert apply_transform(A, np.array([[0.0, 1.0]]))[0, 0] < 0.0
    assert decompose_transform(A, AT_M).rotation_rad == pytest.approx(np.deg2rad(3.0))


def test_scale_and_shear_are_those_of_the_axes():
    meaning = decompose_transform(affine(np.array([[1.1, 0.0], [0.3, 0.9]])), AT_M)
    assert meaning.scale_x == pytest.approx(1.1)
    assert meaning.scale_z == pytest.approx(np.hypot(0.3, 0.9))
    assert np.tan(meaning.shear_rad) == pytest.approx(0.3 / 0.9)
    assert meaning.scale == pytest.approx(np.sqrt(1.1 * 0.9))
    assert meaning.scale_min * meaning.scale_max == pytest.approx(1.1 * 0.9)


def test_a_point_moves_by_its_image():
    A = affine(turn(0.1), (0.05, -0.02))
    moved_m = apply_transform(A, AT_M[np.newaxis])[0] - AT_M
    np.testing.assert_allclose(decompose_transform(A, AT_M).displacement_m, moved_m)


def test_a_mirror_is_recognised():
    assert decompose_transform(affine(np.diag([-1.0, 1.0])), AT_M).is_mirrored


def test_a_tilt_is_the_growth_of_w_at_the_point():
    A = np.eye(3)
    A[:2, 2] = 0.01, 0.03
    w = 1.0 + AT_M @ A[:2, 2]
    np.testing.assert_allclose(
        decompose_transform(A, AT_M).perspective_per_m, np.array([0.01, 0.03]) / w
    )
    # A map's scale is free: twice the matrix is the same map.
    np.testing.assert_allclose(
        decompose_transform(2.0 * A, AT_M).perspective_per_m,
        decompose_transform(A, AT_M).perspective_per_m,
    )
