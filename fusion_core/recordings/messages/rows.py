"""Plain rows with the fields of the most frequent messages: scans, poses and transforms.

rosbags creates an object for each part of a message, seven for one transform, which takes longer
than the rest of reading it. ``ros1_rows`` and ``cdr_rows`` read rows directly from the bytes of
messages in the standard layout; for all others, rows are made from the objects of rosbags.

Without these readers, reading takes 1.3 times as long over all recordings of
``python -m tests.benchmarks.bench_reading``, and 1.6 times over its bags of poses and transforms.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

# Position, and the rotation as x y z w.
PoseNumbers = tuple[float, ...]
# Seconds and nanoseconds of the stamp, parent frame, child frame, pose. A PoseStamped has no child.
PoseRow = tuple[int, int, str, str, PoseNumbers]


class ScanRow(NamedTuple):
    """A LaserScan without angle_max, in the order of its fields: seconds, radians, metres.

    ``ranges`` and ``intensities`` are float32 of either byte order, (N,) or (0,), unchecked.
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
