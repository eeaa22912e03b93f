"""What the scene draws of a run of visual SLAM, as it works and in the end."""

import numpy as np
import pytest

from fusion_core.model.visual_slam_view import VisualSlamView
from scanloom.scene.visual_picture import picture_of_view


def view(first: np.ndarray, *, is_lost: bool = False) -> VisualSlamView:
    """Three images, the second not tracked, with the first and the last as keyframes."""
    T = np.repeat(first[np.newaxis], 3, axis=0)
    T[1] = np.nan
    # A metre ahead.
    T[2, :3, 3] += T[2, :3, 2]
    return VisualSlamView(
        stage="tracking",
        stamps_ns=np.arange(3, dtype=np.int64),
        T_map_camera=T,
        keyframe_stamps_ns=np.array([0, 2]),
        T_map_keyframe=T[[0, 2]],
        loops=np.empty((0, 2), dtype=np.int64),
        points_in_map_m=np.array([[0.0, 1.0, 2.0]], dtype=np.float32),
        rgb=np.zeros((1, 3), np.uint8),
        is_lost=is_lost,
    )


def test_a_map_in_optical_axes_is_turned_upright() -> None:
    shown = picture_of_view(view(np.eye(4)))
    # Down in the image is down in space, ahead is along x.
    np.testing.assert_allclose(shown.points_m, [[2.0, 0.0, -1.0]], atol=1e-6)
    np.testing.assert_allclose(shown.path_m[2], [1.0, 0.0, 0.0], atol=1e-6)
    assert np.isnan(shown.path_m[1]).all()
    assert shown.now is not None
    np.testing.assert_allclose(shown.now[:3, 3], [1.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(shown.T_map_keyframe[0, :3, 2], [1.0, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("is_lost", [False, True])
def test_a_levelled_map_stays_as_it_is(is_lost: bool) -> None:
    first = np.eye(4)
    first[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    first[2, 3] = 1.4
    shown = picture_of_view(view(first, is_lost=is_lost))
    np.testing.assert_array_equal(shown.points_m, [[0.0, 1.0, 2.0]])
    np.testing.assert_allclose(shown.path_m[2], [1.0, 0.0, 1.4], atol=1e-6)
    assert shown.is_lost == is_lost
