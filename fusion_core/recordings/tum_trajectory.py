"""Trajectory files of the TUM RGB-D benchmark: ``stamp x y z qx qy qz qw`` on each line.

Seconds, metres, and the quaternion that turns body axes to map axes. Source: Sturm et al. 2012,
"A Benchmark for the Evaluation of RGB-D SLAM Systems", and the benchmark's page on file formats.
"""

from array import array
from dataclasses import dataclass
from math import hypot
from pathlib import Path

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.number_lines import read_numeric_lines

COLUMNS = "stamp x y z qx qy qz qw"

# Files with few digits come near a length of 1; other columns in their place do not.
_LENGTH_TOLERANCE = 0.1


@dataclass(frozen=True, slots=True)
class TrajectoryFile:
    """A trajectory, and warnings of what was corrected in its file."""

    trajectory: Trajectory
    warnings: tuple[str, ...]


def read_tum_trajectory(file: Path) -> TrajectoryFile:
    """Read a trajectory; stamps are exact to the nanosecond.

    Lines are sorted by stamp, and of several lines with one stamp the first is kept, each with a
    warning: files of the benchmark itself need both. Raises RecordingError for any other line that
    is no pose, OSError where the file cannot be read.
    """
    stamps = array("q")
    poses = array("d")
    for line in read_numeric_lines(file, COLUMNS):
        values = line.numbers(1)
        length = hypot(*values[3:])
        if abs(length - 1.0) > _LENGTH_TOLERANCE:
            raise line.error(f"the quaternion has the length {length:.3g}, not 1")
        stamps.append(line.time_ns(0))
        poses.extend(values)
    unsorted_ns = np.array(stamps, dtype=np.int64)
    warnings = []
    if (np.diff(unsorted_ns) < 0).any():
        warnings.append(f"{file.name}: its stamps do not ascend; its lines are sorted.")
    # Also sorts, and gives the first of equal stamps.
    stamps_ns, kept = np.unique(unsorted_ns, return_index=True)
    if kept.size < unsorted_ns.size:
        warnings.append(
            f"{file.name}: lines left out because another has their stamp: "
            f"{unsorted_ns.size - kept.size}."
        )
    return TrajectoryFile(
        Trajectory(
            stamps_ns=stamps_ns,
            T_map_body=_transforms(np.array(poses, dtype=np.float64).reshape(-1, 7)[kept]),
        ),
        tuple(warnings),
    )


def _transforms(values: FloatArray) -> FloatArray:
    """(N, 4, 4) of (N, 7) positions and quaternions."""
    from scipy.spatial.transform import Rotation

    transforms = np.tile(np.eye(4), (len(values), 1, 1))
    transforms[:, :3, :3] = Rotation.from_quat(values[:, 3:]).as_matrix()
    transforms[:, :3, 3] = values[:, :3]
    return transforms
