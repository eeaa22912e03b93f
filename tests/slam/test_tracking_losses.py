"""Breaks of the way: what loops confirm, refute and join."""

import numpy as np

from fusion_core.slam.local_trajectory import LocalTrajectory
from fusion_core.slam.pose_graph import Edge
from fusion_core.slam.tracking_losses import TrackingLosses

STARTS = (10, 20, 30)


def trajectory(part, told=()):
    """Forty key scans; ``told``: of the first of each part but the first one, if not all are."""
    is_told = np.ones(40, dtype=np.bool_)
    is_told[list(STARTS[: len(told)])] = told
    return LocalTrajectory(
        stamps_ns=np.arange(40),
        poses_local_scan=np.zeros((40, 3)),
        is_trusted=np.ones(40, dtype=np.bool_),
        key_scans=np.arange(40),
        node_points_m=[np.zeros((1, 2))] * 40,
        segment=part,
        is_bridged=is_told,
        submaps=[],
    )


def breaks(told=(True, True, True)):
    """Four parts of ten key scans."""
    return TrackingLosses(trajectory(np.arange(40) // 10, told))


def loop(first, second):
    return Edge(
        first=first,
        second=second,
        pose_first_second=np.zeros(3),
        information=np.eye(3),
        is_loop=True,
    )


def joined_parts(of, loops):
    return of.connected_by(loops)[::10].tolist()


def test_a_loop_where_odometry_has_the_place_confirms_all_breaks_between():
    of, edge = breaks(), loop(2, 35)
    of.add_loop(edge, agrees_with_odometry=True)
    assert of.is_confirmed.all()
    assert joined_parts(of, [edge]) == [True] * 4
    # Once the loop is dropped, so is what hung on it.
    assert joined_parts(of, []) == [True, False, False, False]


def test_a_loop_elsewhere_refutes_and_joins_its_own_parts_alone():
    of, edge = breaks(), loop(2, 35)
    of.add_loop(edge, agrees_with_odometry=False)
    assert not of.is_bridged.any()
    assert joined_parts(of, [edge]) == [True, False, False, True]
    np.testing.assert_array_equal(of.unbridged_segments()[::10], [0, 1, 2, 3])


def test_what_is_confirmed_is_not_refuted():
    of = breaks()
    of.add_loop(loop(2, 15), agrees_with_odometry=True)
    of.add_loop(loop(2, 35), agrees_with_odometry=False)
    np.testing.assert_array_equal(of.is_bridged, [True, False, False])


def test_over_a_break_that_odometry_did_not_tell_nothing_is_confirmed():
    of, edge = breaks((True, False, True)), loop(2, 35)
    of.add_loop(edge, agrees_with_odometry=True)
    assert not of.is_confirmed.any()
    np.testing.assert_array_equal(of.unbridged_segments()[::10], [0, 0, 1, 1])
    assert of.are_connected(np.array([5, 15, 25, 35]), 5).tolist() == [True, False, False, True]


def test_a_short_part_is_not_joined_by_odometry_alone():
    local = trajectory(np.array([0] * 10 + [1] * 4 + [2] * 26))
    over, into = loop(2, 35), loop(2, 11)
    for loops, expected in (([over], [True, False, True]), ([over, into], [True, True, True])):
        of = TrackingLosses(local)
        for edge in loops:
            of.add_loop(edge, agrees_with_odometry=True)
        assert of.connected_by(loops)[[5, 11, 30]].tolist() == expected
