"""Conventions of the whole project: units, frames, pixels, and the types that go with them.

* SI units, radians, int64 nanoseconds. ``stamp_ns`` is the sensor's own header stamp,
  ``received_ns`` the time at which the log took the message. Algorithms use ``stamp_ns``.
  Time ranges are half open: ``start <= t < end``.
* ``T_a_b`` maps coordinates in frame b to frame a: ``p_a = T_a_b @ p_b``.
* Body frames have x forward, y left, z up; optical frames x right, y down, z forward.
* Pixels are ``(u, v)`` = (column, row). In the similarity field u is the offset along the LiDAR
  curve and v the depth row, both 0-based, v counted from the top.
* A *curve* runs left to right as the camera sees it, for LiDAR and depth alike: index 0 is the
  leftmost sample, so azimuth (counter-clockwise from x) falls along a curve.
* A missing value is NaN in memory, whatever the file had. Invalid is never zero.
"""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]
RingArray = npt.NDArray[np.uint16]
Int32Array = npt.NDArray[np.int32]
BoolArray = npt.NDArray[np.bool_]
ByteArray = npt.NDArray[np.uint8]

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000

# Optical axes (right, down, forward) written in body axes (forward, left, up).
R_BODY_OPTICAL: FloatArray = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
R_BODY_OPTICAL.setflags(write=False)


def wrap_angle(angle_rad: npt.ArrayLike) -> FloatArray:
    """Wrap angles to [-pi, pi)."""
    return (np.asarray(angle_rad, dtype=np.float64) + np.pi) % (2.0 * np.pi) - np.pi


def read_only(array: npt.NDArray[np.generic]) -> None:
    """Make an array that a frozen value holds unwritable."""
    array.setflags(write=False)
