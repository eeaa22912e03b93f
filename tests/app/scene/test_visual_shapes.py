"""Keyframes, loops and clicks of visual SLAM in space."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from scanloom.scene.visual_shapes import (
    KEYFRAME_DEPTH_M,
    HalfView,
    floor_place,
    height_colors,
    keyframe_segments,
    loop_segments,
    nearest_keyframe,
)

VIEW = HalfView(across=0.5, down=0.25)


def poses(count: int) -> np.ndarray:
    rng = np.random.default_rng(count)
    return np.array(
        [
            make_transform(
                rotation_from_yaw_pitch_roll(*rng.uniform(-1.0, 1.0, 3)), rng.normal(size=3)
            )
            for _ in range(count)
        ]
    ).reshape(-1, 4, 4)


def test_a_keyframe_is_a_pyramid_from_its_camera() -> None:
    T = poses(3)
    lines = keyframe_segments(T, VIEW, 0.4)
    assert lines.shape == (24, 2, 3)
    for number, pose in enumerate(T):
        own = lines[8 * number : 8 * number + 8].astype(np.float64)
        in_camera = (own - pose[:3, 3]) @ pose[:3, :3]
        np.testing.assert_allclose(in_camera[:4, 0], 0.0, atol=1e-6)
        base = in_camera[4:].reshape(-1, 3)
        np.testing.assert_allclose(base[:, 2], 0.4, atol=1e-6)
        np.testing.assert_allclose(np.abs(base[:, 0]), 0.2, atol=1e-6)
        np.testing.assert_allclose(np.abs(base[:, 1]), 0.1, atol=1e-6)
    assert keyframe_segments(poses(0), VIEW).shape == (0, 2, 3)


def test_a_loop_joins_the_places_of_its_keyframes() -> None:
    T = poses(4)
    (line,) = loop_segments(T, np.array([[1, 3]]))
    np.testing.assert_allclose(line, T[[1, 3], :3, 3], atol=1e-6)
    assert loop_segments(T, np.empty((0, 2), np.int64)).shape == (0, 2, 3)


def test_a_click_means_the_first_keyframe_that_it_hits() -> None:
    T = np.repeat(np.eye(4)[np.newaxis], 3, axis=0)
    T[:, 2, 3] = [3.0, 1.0, 5.0]
    origin, ahead = np.zeros(3), np.array([0.0, 0.0, 2.0])
    assert nearest_keyframe(T, origin, ahead, 0.05) == 1
    assert nearest_keyframe(T, origin, -ahead, 0.05) is None
    beside = np.array([0.06, 0.0, 0.0])
    assert nearest_keyframe(T, beside, ahead, 0.05) is None
    # Between the second and the first: what is behind is not meant.
    assert nearest_keyframe(T, np.array([0.0, 0.0, 1.0 + KEYFRAME_DEPTH_M]), ahead, 0.05) == 0
    assert nearest_keyframe(T[:0], origin, ahead, 0.05) is None


@given(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(0.1, 9.0))
def test_a_ray_meets_the_floor_where_it_points(x_m: float, y_m: float, height_m: float) -> None:
    origin = np.array([1.0, -2.0, height_m])
    found = floor_place(origin, 0.3 * (np.array([x_m, y_m, 0.0]) - origin))
    assert found is not None
    np.testing.assert_allclose(found, [x_m, y_m], atol=1e-9)
    assert floor_place(origin, np.array([1.0, 0.0, 0.0])) is None
    assert floor_place(origin, np.array([1.0, 0.0, 1.0])) is None


def test_heights_are_coloured_from_low_to_high() -> None:
    colors = height_colors(np.linspace(0.0, 2.0, 100)).astype(float)
    assert (np.diff(colors[:, 1]) >= 0.0).all()
    assert len(height_colors(np.empty(0))) == 0
    assert height_colors(np.full(3, 1.0)).shape == (3, 3)
    assert pytest.approx(VIEW.aspect) == 2.0
