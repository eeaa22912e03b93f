"""Relation files of the SLAM benchmark: ``t1 t2 x y z roll pitch yaw`` on each line.

Seconds, metres, radians: the pose at t2 seen from the pose at t1. Source: Kümmerle et al. 2009,
"On measuring the accuracy of SLAM algorithms".
"""

from array import array
from pathlib import Path

import numpy as np

from fusion_core.model.relations import Relations
from fusion_core.recordings.number_lines import read_numeric_lines

COLUMNS = "t1 t2 x y z roll pitch yaw"


def read_relations(file: Path) -> Relations:
    """Read relations; stamps are exact to the nanosecond.

    Raises RecordingError for a line that is no relation, OSError where the file cannot be read.
    """
    from scipy.spatial.transform import Rotation

    stamps = array("q")
    values = array("d")
    for line in read_numeric_lines(file, COLUMNS):
        stamps.extend((line.time_ns(0), line.time_ns(1)))
        values.extend(line.numbers(2))
    stamps_ns = np.array(stamps, dtype=np.int64).reshape(-1, 2)
    poses = np.array(values, dtype=np.float64).reshape(-1, 6)
    transforms = np.tile(np.eye(4), (len(poses), 1, 1))
    yaw_pitch_roll = poses[:, :2:-1]
    transforms[:, :3, :3] = Rotation.from_euler("ZYX", yaw_pitch_roll).as_matrix()
    transforms[:, :3, 3] = poses[:, :3]
    return Relations(
        first_stamps_ns=stamps_ns[:, 0].copy(),
        second_stamps_ns=stamps_ns[:, 1].copy(),
        T_first_second=transforms,
    )
