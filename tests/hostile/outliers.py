"""Recordings with lone values far beyond all others: ranges that no beam reaches, poses that no
robot drives to."""

from dataclasses import replace

import numpy as np

from fusion_core.model.sensors import TransformBatch
from tests.hostile.drive import ODOMETRY, SCAN, TF, write_drive

RANGE_M = 5e5
RANGE_MAX_M = 1e6
POSE_M = 1e5


def far_ranges(path, *, beam=100, **drive):
    """One beam of each scan is ``RANGE_M`` long, below the scan's range_max."""

    def change(topic, number, value):
        if topic != SCAN:
            return value
        ranges_m = value.ranges_m.copy()
        ranges_m[beam] = RANGE_M
        return replace(value, range_max_m=RANGE_MAX_M, ranges_m=ranges_m)

    return write_drive(path, change, **drive)


def far_poses(path, *, numbers=(7,), **drive):
    """The poses of these numbers lie ``POSE_M`` away, from /odom or /tf."""

    def change(topic, number, value):
        if topic not in (ODOMETRY, TF) or number not in numbers:
            return value
        if isinstance(value, TransformBatch):
            moved = tuple(_moved(entry) for entry in value.transforms)
            return replace(value, transforms=moved)
        return _moved(value)

    return write_drive(path, change, **drive)


def _moved(value):
    T = value.T_parent_child.copy()
    T[:2, 3] += POSE_M * np.array([1.0, -1.0])
    return replace(value, T_parent_child=T)
