"""Tracking losses: which ones loops confirm, refute and connect."""

import numpy as np

from fusion_core.slam.local_trajectory import LocalTrajectory
from fusion_core.slam.pose_graph import Edge
from fusion_core.slam.tracking_losses import TrackingLosses

STARTS = (10, 20, 30)


def trajectory(segment, is_bridged=()):
    """Forty keyframes; ``is_bridged``: of each loss, by default all."""
    node_is_bridged = np.ones(40, dtype=np.bool_)
    node_is_bridged[list(STARTS[: len(is_bridged)])] = is_bridged
    return LocalTrajectory(
        stamps_ns=np.arange(40),
        poses_local_scan=np.zeros((40, 3)),
        is_trusted=np.ones(40, dtype=np.bool_),
        keyframes=np.arange(40),
        node_points_m=[np.zeros((1, 2))] * 40,
        segment=segment,
        is_bridged=node_is_bridged,
        submaps=[],
    )


def losses(is_bridged=(True, True, True)):
    """Four segments of ten keyframes."""
    return TrackingLosses(trajectory(np.arange(40) // 10, is_bridged))


def loop(first, second):
    return Edge(
        first=first,
        second=second,
        pose_first_second=np.zeros(3),
        information=np.eye(3),
        is_loop=True,
    )


def connected_segments(state, loops):
    return state.connected_by(loops)[::10].tolist()


def test_a_loop_that_agrees_with_odometry_confirms_all_losses_between():
    state, edge = losses(), loop(2, 35)
    state.add_loop(edge, agrees_with_odometry=True)
    assert state.is_confirmed.all()
    assert connected_segments(state, [edge]) == [True] * 4
    # Without the loop, the segments that depend on it are not connected.
    assert connected_segments(state, []) == [True, False, False, False]


def test_a_loop_that_disagrees_refutes_and_connects_its_own_segments_only():
    state, edge = losses(), loop(2, 35)
    state.add_loop(edge, agrees_with_odometry=False)
    assert not state.is_bridged.any()
    assert connected_segments(state, [edge]) == [True, False, False, True]
    np.testing.assert_array_equal(state.unbridged_segments()[::10], [0, 1, 2, 3])


def test_what_is_confirmed_is_not_refuted():
    state = losses()
    state.add_loop(loop(2, 15), agrees_with_odometry=True)
    state.add_loop(loop(2, 35), agrees_with_odometry=False)
    np.testing.assert_array_equal(state.is_bridged, [True, False, False])


def test_over_an_unbridged_loss_nothing_is_confirmed():
    state, edge = losses((True, False, True)), loop(2, 35)
    state.add_loop(edge, agrees_with_odometry=True)
    assert not state.is_confirmed.any()
    np.testing.assert_array_equal(state.unbridged_segments()[::10], [0, 0, 1, 1])
    assert state.are_connected(np.array([5, 15, 25, 35]), 5).tolist() == [True, False, False, True]


def test_a_short_segment_is_not_connected_by_odometry_alone():
    local = trajectory(np.array([0] * 10 + [1] * 4 + [2] * 26))
    over, into = loop(2, 35), loop(2, 11)
    for loops, expected in (([over], [True, False, True]), ([over, into], [True, True, True])):
        state = TrackingLosses(local)
        for edge in loops:
            state.add_loop(edge, agrees_with_odometry=True)
        assert state.connected_by(loops)[[5, 11, 30]].tolist() == expected
