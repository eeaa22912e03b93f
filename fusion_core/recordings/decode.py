"""ROS 1 and ROS 2 messages to model values.

This is the only module that changes units: millimetres, seconds, and every way in which a file
says "missing" (0, inf, out of limits, 65535) end here.
"""

from collections.abc import Callable
from math import inf, isfinite
from typing import Any

import numpy as np

from fusion_core.model.conventions import NS_PER_S, ByteArray, Float32Array, FloatArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    ColorImage,
    DepthImage,
    LaserScan,
    PoseSample,
    SensorValue,
    Transform,
    TransformBatch,
)

MILLIMETRES_PER_METRE = 1000.0
# Kinect drivers and 7-Scenes write the largest value where they saw nothing.
SATURATED_MM = 65535
_SHORTEST_QUATERNION = 1e-12

# Bytes a pixel, and the channels in the order red, green, blue.
_COLOR_ENCODINGS: dict[str, tuple[int, list[int]]] = {
    "rgb8": (3, [0, 1, 2]),
    "bgr8": (3, [2, 1, 0]),
    "8UC3": (3, [2, 1, 0]),
    "rgba8": (4, [0, 1, 2]),
    "bgra8": (4, [2, 1, 0]),
    "mono8": (1, [0, 0, 0]),
    "8UC1": (1, [0, 0, 0]),
}
_DEPTH_DTYPES = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}

# A raw message is an object with the fields of its ROS definition.
RawMessage = Any


class BadMessage(ValueError):
    """A message contradicts itself: ``problem`` names the value, ``advice`` what to do."""

    def __init__(self, problem: str, advice: str) -> None:
        super().__init__(problem)
        self.problem = problem
        self.advice = advice


def decode(
    raw: RawMessage, message_type: str, *, topic: str, received_ns: int | None
) -> SensorValue:
    """The model value of a raw ROS message of a type in ``READABLE_TYPES``.

    Raises RecordingError, naming topic, value and advice, for a message that contradicts itself.
    """
    try:
        return _DECODERS[message_type](raw, received_ns)
    except BadMessage as error:
        raise RecordingError(f"{topic}: {error.problem}.", advice=error.advice) from error
    except (ValueError, TypeError, AttributeError, IndexError) as error:
        raise RecordingError(
            f"{topic}: {message_type} does not hold what its type promises: {error}.",
            advice="Check the driver that recorded it.",
        ) from error


def stamp_ns(value: SensorValue) -> int | None:
    """The sensor's own stamp; None for an empty batch of transforms."""
    if isinstance(value, TransformBatch):
        return value.transforms[0].stamp_ns if value.transforms else None
    return value.stamp_ns


def is_depth_encoding(encoding: str) -> bool:
    """Whether an image of this encoding holds depth. ``mono16`` may also be a grey image."""
    return encoding in _DEPTH_DTYPES


def is_color_encoding(encoding: str) -> bool:
    """Whether an image of this encoding can be shown as colour."""
    return encoding in _COLOR_ENCODINGS


def ranges_m(ranges: FloatArray, range_min_m: float, range_max_m: float) -> FloatArray:
    """(N,) ranges with NaN where the beam gave nothing.

    A range of ``range_max`` or more is a driver's way to say "no return"; REP 117 says it by
    infinities.
    """
    valid = (ranges > 0.0) & (ranges >= range_min_m) & (ranges < range_max_m)
    return np.where(valid, ranges, np.nan).astype(np.float64)


def depth_m_from_millimetres(depth_mm: np.ndarray[Any, Any]) -> Float32Array:
    """(H, W) uint16 millimetres to float32 metres, NaN for 0 and 65535."""
    depth_m = depth_mm.astype(np.float32)
    depth_m /= np.float32(MILLIMETRES_PER_METRE)
    depth_m[(depth_mm == 0) | (depth_mm == SATURATED_MM)] = np.nan
    return depth_m


def millimetres_from_depth_m(depth_m: Float32Array) -> np.ndarray[Any, np.dtype[np.uint16]]:
    """(H, W) metres to uint16 millimetres; 0 for NaN and for what does not fit."""
    depth_mm = np.rint(depth_m.astype(np.float64) * MILLIMETRES_PER_METRE)
    fits = (depth_mm > 0) & (depth_mm < SATURATED_MM)
    return np.where(fits, depth_mm, 0).astype(np.uint16)


def _depth_m_from_metres(depth: Float32Array) -> Float32Array:
    return np.where(np.isfinite(depth) & (depth > 0.0), depth, np.nan).astype(np.float32)


def _stamp(header: RawMessage) -> int:
    stamp = header.stamp
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def _frame(name: str) -> str:
    """A frame's name as tf2 has it: the first tf wrote a leading slash."""
    return name.lstrip("/")


def _laser_scan(raw: RawMessage, received_ns: int | None) -> LaserScan:
    range_min_m, range_max_m = float(raw.range_min), float(raw.range_max)
    if not range_max_m > max(range_min_m, 0.0):
        raise BadMessage(
            f"range_max {range_max_m} is not above range_min {range_min_m}",
            "Set the scanner's range limits in its driver.",
        )
    increment_rad = float(raw.angle_increment)
    if not np.isfinite([raw.angle_min, increment_rad]).all() or increment_rad == 0.0:
        raise BadMessage(
            f"angle_min {raw.angle_min} and angle_increment {increment_rad} give no angles",
            "Set the scanner's field of view in its driver.",
        )
    # Compared as the file has them: range_max in float32, so that a sentinel equal to it is met.
    ranges = ranges_m(raw.ranges, raw.range_min, raw.range_max)
    has_intensities = len(raw.intensities) == len(ranges) > 0
    return LaserScan(
        stamp_ns=_stamp(raw.header),
        received_ns=received_ns,
        frame_id=_frame(raw.header.frame_id),
        angle_min_rad=float(raw.angle_min),
        angle_increment_rad=increment_rad,
        range_min_m=range_min_m,
        range_max_m=range_max_m,
        ranges_m=ranges,
        intensities=raw.intensities.astype(np.float64) if has_intensities else None,
        scan_time_s=float(raw.scan_time),
        time_increment_s=float(raw.time_increment),
    )


def _image(raw: RawMessage, received_ns: int | None) -> DepthImage | ColorImage:
    encoding = raw.encoding
    if is_depth_encoding(encoding):
        return _depth_image(raw, received_ns)
    if is_color_encoding(encoding):
        return _color_image(raw, received_ns)
    known = ", ".join([*_DEPTH_DTYPES, *_COLOR_ENCODINGS])
    raise BadMessage(f"image encoding {encoding!r} is not read", f"Readable are {known}.")


def _depth_image(raw: RawMessage, received_ns: int | None) -> DepthImage:
    kind = _DEPTH_DTYPES[raw.encoding]
    dtype = np.dtype((">" if raw.is_bigendian else "<") + kind)
    pixels = _pixel_bytes(raw, dtype.itemsize).view(dtype)
    return DepthImage(
        stamp_ns=_stamp(raw.header),
        received_ns=received_ns,
        frame_id=_frame(raw.header.frame_id),
        depth_m=depth_m_from_millimetres(pixels) if kind == "u2" else _depth_m_from_metres(pixels),
        encoding="16UC1" if kind == "u2" else "32FC1",
    )


def _color_image(raw: RawMessage, received_ns: int | None) -> ColorImage:
    pixel_bytes, order = _COLOR_ENCODINGS[raw.encoding]
    pixels = _pixel_bytes(raw, pixel_bytes).reshape(raw.height, raw.width, pixel_bytes)
    return ColorImage(
        stamp_ns=_stamp(raw.header),
        received_ns=received_ns,
        frame_id=_frame(raw.header.frame_id),
        # The copy frees the chunk of the file that the message points into.
        rgb=pixels.copy() if order == [0, 1, 2] == [*range(pixel_bytes)] else pixels[:, :, order],
    )


def _pixel_bytes(raw: RawMessage, pixel_bytes: int) -> ByteArray:
    """(H, W * pixel_bytes) rows of an image without the padding at their ends."""
    height, width, step = int(raw.height), int(raw.width), int(raw.step)
    row_bytes = width * pixel_bytes
    if height == 0 or width == 0 or step < row_bytes:
        raise BadMessage(
            f"a {raw.encoding} image of {width} x {height} pixels cannot have step {step}",
            "Check the camera driver's image settings.",
        )
    data: ByteArray = raw.data
    # The last row may lack its padding.
    needed = (height - 1) * step + row_bytes
    if data.size < needed:
        raise BadMessage(
            f"the image holds {data.size} bytes, {width} x {height} {raw.encoding} need {needed}",
            "The message was cut short; record again or leave the topic out.",
        )
    if data.size < height * step:
        data = np.concatenate([data, np.zeros(height * step - data.size, dtype=np.uint8)])
    rows = data[: height * step].reshape(height, step)[:, :row_bytes]
    return np.ascontiguousarray(rows)


def _camera_info(raw: RawMessage, received_ns: int | None) -> CameraInfo:
    # ROS 1 spells the matrices upper-case, ROS 2 lower-case.
    k = raw.K if hasattr(raw, "K") else raw.k
    d = raw.D if hasattr(raw, "D") else raw.d
    intrinsics = None
    # K[0] == 0 is how an uncalibrated camera says so.
    if k[0] != 0.0:
        try:
            intrinsics = CameraIntrinsics(
                width=int(raw.width),
                height=int(raw.height),
                fx=float(k[0]),
                fy=float(k[4]),
                cx=float(k[2]),
                cy=float(k[5]),
                distortion_model=raw.distortion_model or "plumb_bob",
                distortion=tuple(float(value) for value in d),
            )
        except ValueError as error:
            raise BadMessage(str(error), "Calibrate the camera, or leave this topic out.") from None
    return CameraInfo(
        stamp_ns=_stamp(raw.header),
        received_ns=received_ns,
        frame_id=_frame(raw.header.frame_id),
        intrinsics=intrinsics,
    )


def _pose_matrix(position: RawMessage, orientation: RawMessage) -> FloatArray:
    """(4, 4) in plain floats: recordings hold transforms by the ten thousand, and arrays of four
    numbers would take several times as long (as ``geometry.rotation_from_quaternion`` does).
    """
    px, py, pz = position.x, position.y, position.z
    x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
    if not isfinite(px + py + pz):
        raise BadMessage(f"position {px} {py} {pz} is not finite", "Check the source of the pose.")
    squared = x * x + y * y + z * z + w * w
    if not _SHORTEST_QUATERNION**2 < squared < inf:
        raise BadMessage(
            f"quaternion {x} {y} {z} {w} is no rotation", "Check the source of the pose."
        )
    s = 2.0 / squared
    matrix: FloatArray = np.array(
        (
            *(1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w), px),
            *(s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w), py),
            *(s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y), pz),
            *(0.0, 0.0, 0.0, 1.0),
        )
    ).reshape(4, 4)
    return matrix


def _odometry(raw: RawMessage, received_ns: int | None) -> PoseSample:
    pose = raw.pose.pose
    return PoseSample(
        stamp_ns=_stamp(raw.header),
        received_ns=received_ns,
        parent=_frame(raw.header.frame_id),
        child=_frame(raw.child_frame_id),
        T_parent_child=_pose_matrix(pose.position, pose.orientation),
    )


def _pose_stamped(raw: RawMessage, received_ns: int | None) -> PoseSample:
    return PoseSample(
        stamp_ns=_stamp(raw.header),
        received_ns=received_ns,
        parent=_frame(raw.header.frame_id),
        child="",
        T_parent_child=_pose_matrix(raw.pose.position, raw.pose.orientation),
    )


def _transforms(raw: RawMessage, received_ns: int | None) -> TransformBatch:
    return TransformBatch(
        received_ns=received_ns,
        transforms=tuple(
            Transform(
                stamp_ns=_stamp(entry.header),
                parent=_frame(entry.header.frame_id),
                child=_frame(entry.child_frame_id),
                T_parent_child=_pose_matrix(entry.transform.translation, entry.transform.rotation),
            )
            for entry in raw.transforms
        ),
    )


_DECODERS: dict[str, Callable[[RawMessage, int | None], SensorValue]] = {
    "sensor_msgs/msg/LaserScan": _laser_scan,
    "sensor_msgs/msg/Image": _image,
    "sensor_msgs/msg/CameraInfo": _camera_info,
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": _pose_stamped,
    "tf2_msgs/msg/TFMessage": _transforms,
    "tf/msg/tfMessage": _transforms,
}
READABLE_TYPES = frozenset(_DECODERS)
