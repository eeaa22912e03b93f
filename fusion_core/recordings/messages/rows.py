"""The fields of the messages that recordings hold by the ten thousand, as plain rows.

A reader of any type makes an object of each part of a message, seven for one transform: more work
than all the rest of reading it. ``ros1_rows`` and ``cdr_rows`` read rows straight from the bytes of
messages that are laid out as ROS lays them out; for all others, rows are made of the objects.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

# Position, and the rotation as x y z w.
PoseNumbers = tuple[float, ...]
# Seconds and nanoseconds of the stamp, parent, child, pose. A PoseStamped has no child's name.
PoseRow = tuple[int, int, str, str, PoseNumbers]


class ScanRow(NamedTuple):
    """A LaserScan without angle_max, in the order of its fields: seconds, radians, metres.

    ``ranges`` and ``intensities`` are float32 of either byte order, (N,) or (0,), and what the file
    has, whatever that means.
    """

    seconds: int
    nanoseconds: int
    frame: str
    angle_min: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    ranges: npt.NDArray[np.floating[Any]]
    intensities: npt.NDArray[np.floating[Any]]
