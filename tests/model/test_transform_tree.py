"""Look-ups between frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.model.errors import FramesNotConnected, StampOutsideRange
from fusion_core.model.geometry import (
    invert_transform,
    planar_from_transform,
    transform_from_planar,
)
from fusion_core.model.sensors import Transform
from fusion_core.model.transform_tree import TransformTree


def pose(x: float, y: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    return transform_from_planar(np.array([x, y, yaw]))


def add(
    tree: TransformTree,
    parent: str,
    child: str,
    stamp_ns: int | None,
    T_parent_child: np.ndarray,
) -> None:
    """Add a transform, static where it has no stamp."""
    sample = Transform(
        stamp_ns=stamp_ns or 0, parent=parent, child=child, T_parent_child=T_parent_child
    )
    tree.add(sample, static=stamp_ns is None)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    T[:3, 3] = rng.normal(size=3)
    return T


@given(st.integers(0, 2**32 - 1), st.integers(2, 8))
def test_every_pair_in_a_random_tree(seed: int, count: int) -> None:
    """Against poses of all frames in one root, recorded in either direction."""
    rng = np.random.default_rng(seed)
    T_root_frame = {0: np.eye(4)} | {frame: random_pose(rng) for frame in range(1, count)}
    tree = TransformTree()
    for frame in range(1, count):
        other = int(rng.integers(frame))
        a, b = (frame, other) if rng.random() < 0.5 else (other, frame)
        T_a_b = invert_transform(T_root_frame[a]) @ T_root_frame[b]
        if rng.random() < 0.5:
            add(tree, str(a), str(b), None, T_a_b)
        else:
            add(tree, str(a), str(b), 100, T_a_b)
            add(tree, str(a), str(b), 200, T_a_b)
    for target in range(count):
        for source in range(count):
            expected = invert_transform(T_root_frame[target]) @ T_root_frame[source]
            assert np.allclose(tree.lookup(str(target), str(source), 130), expected)


def test_timed_transforms_are_interpolated_whatever_the_order_of_arrival() -> None:
    tree = TransformTree()
    for stamp_ns, x, yaw in [(300, 3.0, -3.0), (100, 1.0, 2.0), (200, 2.0, 3.0)]:
        add(tree, "odom", "base", stamp_ns, pose(x, yaw=yaw))
    assert np.allclose(planar_from_transform(tree.lookup("odom", "base", 150)), [1.5, 0, 2.5])
    across = planar_from_transform(tree.lookup("odom", "base", 250))
    assert across[0] == pytest.approx(2.5)
    # From 3 to -3 rad the shorter arc goes through pi.
    assert abs(across[2]) == pytest.approx(np.pi)
    assert np.allclose(
        tree.lookup("base", "odom", 150), invert_transform(tree.lookup("odom", "base", 150))
    )


def test_a_static_mount_needs_no_time() -> None:
    tree = TransformTree()
    add(tree, "base", "lidar", None, pose(0.2))
    add(tree, "base", "lidar", None, pose(0.3))
    assert tree.lookup("base", "lidar", 10**18)[0, 3] == pytest.approx(0.3)
    assert np.array_equal(tree.lookup("lidar", "lidar", 0), np.eye(4))


def test_unconnected_frames_are_named_with_all_that_is_known() -> None:
    tree = TransformTree()
    add(tree, "base", "lidar", None, pose(0.2))
    add(tree, "map", "odom", 5, pose(0.2))
    with pytest.raises(FramesNotConnected, match=r"'lidar' to 'map'.*'base', 'lidar', 'map'"):
        tree.lookup("map", "lidar", 5)
    with pytest.raises(FramesNotConnected, match="'camera'"):
        tree.lookup("base", "camera", 5)
    with pytest.raises(FramesNotConnected, match="known frames: none"):
        TransformTree().lookup("a", "b", 0)


@pytest.mark.parametrize("stamp_ns", [99, 201])
def test_outside_of_the_known_time_a_lookup_fails(stamp_ns: int) -> None:
    tree = TransformTree()
    add(tree, "base", "lidar", None, pose(0.2))
    add(tree, "odom", "base", 100, pose(1.0))
    add(tree, "odom", "base", 200, pose(2.0))
    with pytest.raises(StampOutsideRange, match=r"'lidar' to 'odom'.*from 100 to 200 ns") as e:
        tree.lookup("odom", "lidar", stamp_ns)
    assert (e.value.start_ns, e.value.end_ns) == (100, 200)


def test_a_new_parent_takes_over() -> None:
    tree = TransformTree()
    add(tree, "old", "new", None, pose(100.0))
    for stamp_ns in (0, 10):
        add(tree, "old", "base", stamp_ns, pose(1.0))
    for stamp_ns in (11, 20):
        add(tree, "new", "base", stamp_ns, pose(2.0))
    assert tree.lookup("old", "base", 5)[0, 3] == pytest.approx(1.0)
    assert tree.lookup("old", "base", 15)[0, 3] == pytest.approx(102.0)
    with pytest.raises(StampOutsideRange):
        tree.lookup("old", "base", 30)


def test_of_two_parents_the_one_with_closer_samples_counts() -> None:
    """A, then B, then A: A's two samples around B's time are far apart."""
    tree = TransformTree()
    add(tree, "map", "a", None, pose(0.0))
    add(tree, "map", "b", None, pose(0.0))
    for parent, stamp_ns, x in [("a", 0, 0.0), ("b", 40, 7.0), ("b", 60, 7.0), ("a", 100, 0.0)]:
        add(tree, parent, "base", stamp_ns, pose(x))
    assert tree.lookup("map", "base", 50)[0, 3] == pytest.approx(7.0)
    assert tree.lookup("map", "base", 30)[0, 3] == pytest.approx(0.0)


def test_cycles_end_and_the_shortest_chain_counts() -> None:
    tree = TransformTree()
    names = "abcd"
    for parent, child in zip(names, names[1:] + names[0], strict=True):
        add(tree, parent, child, None, pose(1.0))
    add(tree, "b", "a", None, pose(-1.0))
    assert tree.lookup("a", "b", 0)[0, 3] == pytest.approx(1.0)
    assert tree.lookup("a", "d", 0)[0, 3] == pytest.approx(-1.0)
    with pytest.raises(FramesNotConnected):
        tree.lookup("a", "elsewhere", 0)


def test_invalid_transforms_are_rejected_and_counted() -> None:
    tree = TransformTree()
    mirrored = np.diag([1.0, 1.0, -1.0, 1.0])
    for bad in (np.full((4, 4), np.nan), 2.0 * np.eye(4), mirrored, np.zeros((4, 4))):
        add(tree, "a", "b", 0, bad)
    add(tree, "a", "a", 0, np.eye(4))
    assert tree.rejected_count == 5
    assert tree.frames == ()


def test_memory_is_bounded_and_the_newest_samples_stay() -> None:
    limit = 100
    tree = TransformTree(samples_per_pair=limit)
    for stamp_ns in range(10_000):
        add(tree, "odom", "base", stamp_ns, pose(float(stamp_ns)))
    (samples,) = tree._timed.values()
    assert samples._stamps_ns.size == samples._poses.shape[0] == limit
    assert tree.lookup("odom", "base", 9_999)[0, 3] == 9_999.0
    assert tree.lookup("odom", "base", 9_930)[0, 3] == 9_930.0
    with pytest.raises(StampOutsideRange):
        tree.lookup("odom", "base", 9_000)


@given(
    st.lists(st.integers(0, 60), min_size=1, max_size=120),
    st.one_of(st.none(), st.integers(2, 20)),
)
def test_any_order_of_arrival_against_a_dictionary(stamps_ns: list[int], limit: int | None) -> None:
    """The later of two samples with one stamp counts; what is kept is the newest, without gaps."""
    tree = TransformTree(samples_per_pair=limit)
    last: dict[int, float] = {}
    for arrival, stamp_ns in enumerate(stamps_ns):
        add(tree, "odom", "base", stamp_ns, pose(float(arrival)))
        last[stamp_ns] = float(arrival)
    (samples,) = tree._timed.values()
    kept = samples._stamps_ns[: samples._size].tolist()
    assert kept == sorted(last)[-len(kept) :]
    if limit is None:
        assert len(kept) == len(last)
    for stamp_ns in kept:
        assert tree.lookup("odom", "base", stamp_ns)[0, 3] == last[stamp_ns]


def test_what_is_added_may_change_afterwards() -> None:
    tree = TransformTree()
    given_pose = pose(1.0)
    add(tree, "a", "b", 0, given_pose)
    given_pose.setflags(write=True)
    given_pose[0, 3] = 5.0
    result = tree.lookup("a", "b", 0)
    result[0, 3] = 6.0
    assert tree.lookup("a", "b", 0)[0, 3] == 1.0
