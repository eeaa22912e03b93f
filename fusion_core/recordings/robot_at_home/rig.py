"""The sensors of Robot@Home: the meaning of its numbers, in either version of the data set.

A LiDAR (Hokuyo URG-04LX) and four Xtions in portrait, whose images are stored landscape: their
columns run upwards. Poses follow MRPT: yaw, pitch and roll of a body frame (x forward).
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from fusion_core.model.conventions import R_BODY_OPTICAL, BoolArray, Float32Array, FloatArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.sensors import CameraIntrinsics, LaserScan
from fusion_core.model.sweep import MAX_BEAMS
from fusion_core.recordings.units import ranges_m

LIDAR_FRAME: Final = "laser"
BASE_FRAME: Final = "base_link"
MAP_FRAME: Final = "map"
# The one calibration that is known, for all four cameras: phir2-lab/robotathome_at_ros.
INTRINSICS: Final = CameraIntrinsics(
    width=320,
    height=240,
    fx=286.441384,
    fy=271.36999,
    cx=157.3245865,
    cy=120.0802295,
    distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
)
URG_APERTURE_RAD: Final = 4.1847
URG_MAX_RANGE_M: Final = 5.6
# One turn of the URG-04LX's mirror at 600 rpm; the observations do not contain it.
_SCAN_TIME_S: Final = 0.1

BeamSpacing = Literal["aperture/N", "aperture/(N-1)"]
"""The angle between two of N beams. 4.1847 / 682 is the URG's own step, 360 / 1024 degrees; MRPT
documents aperture/(N-1), by which the outermost beams lie 0.18 degrees farther out."""

# Depths are 16-bit parts of 10 m. Robot@Home2 keeps the upper 8 bits alone.
_UNITS_PER_METRE: Final = 6553.5
_COARSE_UNITS: Final = 256.0
COARSE_QUANTUM_M: Final = _COARSE_UNITS / _UNITS_PER_METRE

# 100 ns ticks from 1601-01-01 to 1970-01-01.
_TICKS_TO_1970: Final = 11_644_473_600 * 10_000_000
_NS_PER_TICK: Final = 100
_LAST_NS: Final = int(np.iinfo(np.int64).max)

_CAMERA_LABEL = re.compile(r"RGBD_\d{1,2}$")
_LIDAR_LABEL = re.compile(r"HOKUYO\d{0,2}$")


def is_camera(label: str) -> bool:
    """Whether a sensor's label is that of an RGB-D camera."""
    return _CAMERA_LABEL.match(label) is not None


def is_lidar(label: str) -> bool:
    """Whether a sensor's label is that of the LiDAR."""
    return _LIDAR_LABEL.match(label) is not None


def topic_root(label: str) -> str:
    """The namespace of a sensor's topics: /laser, /rgbd_1."""
    return f"/{LIDAR_FRAME}" if is_lidar(label) else f"/{label.lower()}"


def frame_of(label: str) -> str:
    """The frame of a sensor's values: that of the LiDAR, or a camera's optical frame."""
    return LIDAR_FRAME if is_lidar(label) else f"{label.lower()}_optical"


def stamp_ns_of_ticks(ticks: int) -> int:
    """Unix time of MRPT's clock. Raises ValueError for what is no time since 1970."""
    stamp_ns = (ticks - _TICKS_TO_1970) * _NS_PER_TICK
    if not 0 <= stamp_ns <= _LAST_NS:
        raise ValueError(f"{ticks} is no time in ticks of 100 ns since 1601")
    return stamp_ns


def sensor_transform(label: str, pose: FloatArray) -> FloatArray:
    """(4, 4) from the sensor's frame (``frame_of``) to that of a pose x y z yaw pitch roll."""
    rotation = rotation_from_yaw_pitch_roll(float(pose[3]), float(pose[4]), float(pose[5]))
    return make_transform(rotation if is_lidar(label) else rotation @ R_BODY_OPTICAL, pose[:3])


@dataclass(frozen=True, slots=True, kw_only=True)
class RawScan:
    """A scan as both versions have it. ``ranges_m``: (N,), ``valid``: (N,)."""

    aperture_rad: float
    max_range_m: float
    ranges_m: FloatArray
    valid: BoolArray


def checked_beam_count(count: float) -> int:
    """A scan's N, before memory is taken for it. Raises ValueError."""
    if not 2 <= count <= MAX_BEAMS or count != int(count):
        raise ValueError(f"{count:g} beams, readable are 2 to {MAX_BEAMS}")
    return int(count)


def laser_scan(raw: RawScan, stamp_ns: int, spacing: BeamSpacing) -> LaserScan:
    """The scan in its own frame, beams symmetric about straight ahead. Raises ValueError."""
    if not 0.0 < raw.aperture_rad <= 2.0 * np.pi:
        raise ValueError(f"its aperture is {raw.aperture_rad:g} rad")
    if not 0.0 < raw.max_range_m < np.inf:
        raise ValueError(f"its maximum range is {raw.max_range_m:g} m")
    count = raw.ranges_m.size
    step_rad = raw.aperture_rad / (count if spacing == "aperture/N" else count - 1)
    ranges = ranges_m(raw.ranges_m, 0.0, raw.max_range_m)
    return LaserScan(
        stamp_ns=stamp_ns,
        received_ns=None,
        frame_id=LIDAR_FRAME,
        angle_min_rad=-0.5 * (count - 1) * step_rad,
        angle_increment_rad=step_rad,
        range_min_m=0.0,
        range_max_m=raw.max_range_m,
        ranges_m=np.where(raw.valid, ranges, np.nan),
        scan_time_s=_SCAN_TIME_S,
    )


def stored_landscape(pixels: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """The image as the camera stores it. Robot@Home2 has rotated its files upright, by 90 degrees
    counter-clockwise; its poses are still those of the rolled camera."""
    upright = pixels.shape[0] > pixels.shape[1]
    return np.ascontiguousarray(np.rot90(pixels, k=-1)) if upright else pixels


def depth_m_from_pixels(
    pixels: np.ndarray[Any, Any], file: Path
) -> tuple[Float32Array, float | None]:
    """(H, W) metres along the optical axis, NaN for 0, and their step in metres if it is coarse.

    8-bit values, in one channel or three equal ones, stand for the middle of their step.
    Raises RecordingError for an image that is no depth.
    """
    if pixels.ndim == 3 and (pixels == pixels[:, :, :1]).all():
        pixels = pixels[:, :, 0]
    if pixels.ndim != 2 or pixels.dtype not in (np.uint8, np.uint16):
        raise RecordingError(
            f"is no depth image: {pixels.dtype} of shape {pixels.shape}.",
            file=file,
            advice="Depth is 8-bit or 16-bit grey PNG.",
        )
    coarse = pixels.dtype == np.uint8
    units = pixels.astype(np.float32)
    if coarse:
        units = units * np.float32(_COARSE_UNITS) + np.float32(0.5 * (_COARSE_UNITS - 1.0))
    depth_m = units / np.float32(_UNITS_PER_METRE)
    depth_m[pixels == 0] = np.nan
    return stored_landscape(depth_m), COARSE_QUANTUM_M if coarse else None


def most_frequent_pose(poses: FloatArray) -> tuple[FloatArray, int] | None:
    """The most frequent (6,) of (n, 6) poses of a sensor, and how many observations have it.

    None where fewer than half have it: a mount is constant, poses that change are poses in a map.
    """
    if not len(poses):
        return None
    distinct, counts = np.unique(poses, axis=0, return_counts=True)
    best = int(np.argmax(counts))
    return (distinct[best], int(counts[best])) if 2 * counts[best] >= len(poses) else None
