"""A body's poses over time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.errors import StampOutsideRange
from fusion_core.model.geometry import planar_from_transform
from fusion_core.model.planar_poses import interpolate_pose
from fusion_core.model.trajectory import Trajectory


def trajectory(poses: list[list[float]], stamps_ns: list[int]) -> Trajectory:
    return Trajectory.from_planar(np.array(stamps_ns, dtype=np.int64), np.array(poses))


def test_a_recorded_stamp_gives_the_recorded_pose() -> None:
    path = trajectory([[0, 0, 0], [1, 2, 0.5], [3, 1, -2.0]], [10, 20, 40])
    for index, stamp_ns in enumerate([10, 20, 40]):
        assert np.array_equal(path.pose_at(stamp_ns), path.T_map_body[index])
    assert np.allclose(path.planar_poses, [[0, 0, 0], [1, 2, 0.5], [3, 1, -2.0]])


@given(st.lists(st.floats(-10, 10), min_size=6, max_size=6), st.integers(0, 1000))
def test_between_two_stamps_it_is_the_planar_interpolation(values: list[float], at_ns: int) -> None:
    before, after = np.array(values[:3]), np.array(values[3:])
    turn = abs((after[2] - before[2] + np.pi) % (2 * np.pi) - np.pi)
    if turn > 3.1:  # Half a turn has no shorter arc.
        return
    path = trajectory([before.tolist(), after.tolist()], [0, 1000])
    expected = interpolate_pose(before, after, at_ns / 1000)
    pose = planar_from_transform(path.pose_at(at_ns))
    assert np.allclose(pose[:2], expected[:2])
    assert np.exp(1j * pose[2]) == pytest.approx(np.exp(1j * expected[2]))


def test_large_stamps_keep_their_nanoseconds() -> None:
    """Unix stamps in nanoseconds exceed the precision of a float64."""
    start_ns = 1_700_000_000_000_000_001
    path = trajectory([[0, 0, 0], [10, 0, 0]], [start_ns, start_ns + 10])
    assert path.pose_at(start_ns + 3)[0, 3] == pytest.approx(3.0)


@pytest.mark.parametrize("stamp_ns", [9, 41])
def test_outside_of_the_stamps_the_error_names_the_range(stamp_ns: int) -> None:
    path = trajectory([[0, 0, 0], [1, 2, 0.5]], [10, 40])
    with pytest.raises(StampOutsideRange, match=f"at {stamp_ns} ns: known from 10 to 40 ns") as e:
        path.pose_at(stamp_ns)
    assert (e.value.start_ns, e.value.end_ns, e.value.stamp_ns) == (10, 40, stamp_ns)


@pytest.mark.parametrize("stamps_ns", [[10, 10], [20, 10], []])
def test_stamps_must_increase(stamps_ns: list[int]) -> None:
    with pytest.raises(ValueError, match="stamps_ns"):
        trajectory([[0.0, 0.0, 0.0]] * len(stamps_ns), stamps_ns)


def test_poses_must_be_finite_and_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="finite"):
        trajectory([[np.nan, 0, 0]], [0])
    path = trajectory([[0, 0, 0]], [0])
    with pytest.raises(ValueError, match="read-only"):
        path.T_map_body[0, 0, 3] = 1.0
    path.pose_at(0)[0, 3] = 1.0
    assert path.pose_at(0)[0, 3] == 0.0
