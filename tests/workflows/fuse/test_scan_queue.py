"""Each input scan comes out once, with the repairs of the images nearest in time."""

from types import SimpleNamespace

import numpy as np

from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.scan_queue import RepairedScanQueue

BEAMS = 6
GOOD, HOLE, BURR, CONFLICT = range(4)


def scan(stamp_ns, *, lost=()):
    ranges_m = np.arange(1.0, BEAMS + 1.0)
    ranges_m[list(lost)] = np.nan
    return LaserScan(
        stamp_ns=stamp_ns,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=0.0,
        angle_increment_rad=0.1,
        range_min_m=0.1,
        range_max_m=9.0,
        ranges_m=ranges_m,
        intensities=np.full(BEAMS, 77.0),
    )


def result(gap_ns, beams, range_m, noise):
    """The fields of a frame's result that the queue reads."""
    count = len(beams)
    return SimpleNamespace(
        gap_ns=gap_ns,
        beam=np.array(beams),
        lidar_repaired_m=np.full(count, range_m),
        lidar_class=np.full(count, noise),
    )


def test_a_scan_that_no_image_met_is_itself_with_holes_by_value():
    merge = RepairedScanQueue()
    raw = scan(5, lost=(1, 4))
    merge.push(raw)
    ((given, repaired),) = merge.flush()
    assert given is raw
    np.testing.assert_array_equal(repaired.ranges_m, raw.ranges_m)
    np.testing.assert_array_equal(repaired.intensities, [0, 1, 0, 0, 1, 0])
    assert repaired.stamp_ns == 5


def test_the_image_nearer_in_time_decides_beam_by_beam():
    for order in ((0, 1), (1, 0)):
        merge = RepairedScanQueue()
        raw = scan(5, lost=(0,))
        merge.push(raw)
        near, far = result(-10, [0, 1, 2], 8.0, BURR), result(40, [2, 3], 7.0, CONFLICT)
        for index in order:
            merge.apply_repairs(raw, (near, far)[index])
        ((_, repaired),) = merge.flush()
        np.testing.assert_array_equal(repaired.ranges_m, [8.0, 8.0, 8.0, 7.0, 5.0, 6.0])
        np.testing.assert_array_equal(repaired.intensities, [BURR, BURR, BURR, CONFLICT, 0, 0])
    np.testing.assert_array_equal(raw.ranges_m[1:], [2.0, 3.0, 4.0, 5.0, 6.0])


def test_every_scan_comes_once_in_order_and_few_wait():
    merge = RepairedScanQueue()
    arrived, out = [], []
    for stamp_ns in range(1000):
        arrived.append(scan(stamp_ns))
        merge.push(arrived[-1])
        out.extend(raw for raw, _ in merge.pop_settled())
        assert len(arrived) - len(out) <= 64
    out.extend(raw for raw, _ in merge.flush())
    assert all(a is b for a, b in zip(arrived, out, strict=True))
    assert list(merge.flush()) == []


def test_two_scans_of_one_stamp_are_two_scans():
    merge = RepairedScanQueue()
    first, second = scan(5), scan(5)
    merge.push(first)
    merge.push(second)
    merge.apply_repairs(second, result(0, [3], 8.5, BURR))
    (_, untouched), (_, repaired) = merge.flush()
    np.testing.assert_array_equal(untouched.ranges_m, first.ranges_m)
    assert repaired.ranges_m[3] == 8.5
