"""Which points of a cloud are sent: few enough, more where the camera looks, and steady."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanloom.scene.camera_views import CameraView
from scanloom.scene.level_of_detail import DetailLevels, in_sight, point_width_m

AHEAD = CameraView(
    position_m=np.zeros(3), look_at_m=np.array([1.0, 0.0, 0.0]), up=np.array([0.0, 0.0, 1.0])
)


def cloud(points_m: np.ndarray) -> DetailLevels:
    return DetailLevels(points_m.astype(np.float32), np.zeros(points_m.shape, dtype=np.uint8))


def walls(count: int = 60_000) -> np.ndarray:
    """Evenly on four walls 2 m ahead, 4 m ahead, 2 m behind and 2 m to the left."""
    rng = np.random.default_rng(3)
    aside, height = rng.uniform(-0.5, 0.5, (2, count))
    near = np.full(count, 2.0)
    return np.concatenate(
        [
            np.column_stack([near, aside, height]),
            np.column_stack([2.0 * near, aside, height]),
            np.column_stack([-near, aside, height]),
            np.column_stack([aside, near, height]),
        ]
    )


@given(st.integers(0, 3000), st.integers(1, 1000), st.floats(0.1, 5.0))
def test_at_most_so_many_points_are_sent_and_each_once(
    count: int, limit: int, aspect: float
) -> None:
    points_m = np.random.default_rng(count).normal(size=(count, 3))
    chosen = cloud(points_m).seen_from(AHEAD, aspect, limit)
    assert chosen.size == min(count, limit)
    assert (np.diff(chosen) > 0).all()
    assert count == 0 or (chosen.min() >= 0 and chosen.max() < count)


def test_what_is_near_and_in_sight_is_denser() -> None:
    points_m = walls()
    chosen = cloud(points_m).seen_from(AHEAD, 1.6, 20_000)
    near, far, behind, aside = np.bincount(chosen // 60_000, minlength=4)
    # Twice the distance: a quarter of the points, as of the screen.
    assert near / far == pytest.approx(4.0, rel=0.15)
    assert min(near, far) > 10 * max(behind, aside)


def test_another_viewpoint_gives_other_points_and_a_near_one_most_of_the_same() -> None:
    points_m = walls()
    levels = cloud(points_m)
    back = CameraView(position_m=np.zeros(3), look_at_m=-AHEAD.look_at_m, up=AHEAD.up)
    aside = CameraView(
        position_m=np.array([0.0, 0.05, 0.0]), look_at_m=np.array([1.0, 0.05, 0.0]), up=AHEAD.up
    )
    first, turned, moved = (
        set(levels.seen_from(view, 1.6, 20_000).tolist()) for view in (AHEAD, back, aside)
    )
    assert len(first & turned) < 0.3 * len(first)
    assert len(first & moved) > 0.9 * len(first)


def test_the_same_view_gives_the_same_points() -> None:
    points_m = walls(5000)
    chosen = [cloud(points_m).seen_from(AHEAD, 1.6, 700) for _ in range(2)]
    np.testing.assert_array_equal(*chosen)


def test_in_sight_is_what_a_pinhole_sees() -> None:
    points_m = np.random.default_rng(5).normal(size=(4000, 3))
    # Looking along x: right is -y, down is -z.
    with np.errstate(divide="ignore"):
        u, v = -points_m[:, 1] / points_m[:, 0], -points_m[:, 2] / points_m[:, 0]
    half = 1.15 * np.tan(0.5 * AHEAD.fov_rad)
    expected = (points_m[:, 0] > 0.0) & (np.abs(u) <= half * 1.5) & (np.abs(v) <= half)
    np.testing.assert_array_equal(in_sight(points_m.astype(np.float32), AHEAD, 1.5), expected)


def test_points_are_as_wide_as_they_are_apart() -> None:
    u, v = np.meshgrid(np.arange(80), np.arange(80))
    grid = 0.02 * np.column_stack([u.ravel(), v.ravel(), 0 * u.ravel()])
    # The fourth neighbour on a square raster is as near as the first.
    assert point_width_m(grid.astype(np.float32)) == pytest.approx(0.02, rel=1e-3)
    assert point_width_m(grid[:1].astype(np.float32)) > 0.0
    assert point_width_m(np.empty((0, 3), np.float32)) > 0.0
