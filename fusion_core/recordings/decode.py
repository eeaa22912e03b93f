"""ROS 1 and ROS 2 messages to model values, in SI units and nanoseconds.

Ranges and depths are converted by ``units``. Values that a message type marks as missing are NaN
before: the inverse depth 0 in ``compressed_image``, the point 0 0 0 in ``point_cloud``.
"""

import struct
from collections.abc import Callable
from math import inf, isfinite
from typing import Any

import numpy as np

from fusion_core.model.conventions import NS_PER_S, FloatArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.geometry import POSITION_MAX_M
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    ColorImage,
    DepthImage,
    JointSample,
    LaserScan,
    PointCloud,
    PoseSample,
    SensorValue,
    Transform,
    TransformBatch,
)
from fusion_core.model.stamps import NO_STAMP
from fusion_core.model.sweep import ImplausibleSweep, require_plausible_sweep
from fusion_core.recordings.messages.bad_message import BadMessage
from fusion_core.recordings.messages.compressed_image import decompress_image, decompressed_encoding
from fusion_core.recordings.messages.image_pixels import (
    is_depth_encoding,
    read_depth_pixels,
    read_rgb_pixels,
)
from fusion_core.recordings.messages.point_cloud import read_offsets, read_points, read_rings
from fusion_core.recordings.messages.rows import PoseNumbers, PoseRow, ScanRow
from fusion_core.recordings.units import depth_m_from_metres, depth_m_from_millimetres, ranges_m

_SHORTEST_QUATERNION = 1e-12
_MATRIX = struct.Struct("=16d")

# A sensor's clock counts from 1970, and ROS 2 holds the seconds in 31 bits.
_END_OF_STAMPS_NS = 2**31 * NS_PER_S
_MAX_NAME_CHARACTERS = 4096
# OpenCV knows no model with more.
_MAX_DISTORTION = 14

# A raw message is an object with the fields of its ROS definition, or a row of ``rows``.
RawMessage = Any


def decode_message(
    raw: RawMessage, message_type: str, *, topic: str, received_ns: int | None
) -> SensorValue:
    """The model value of a raw ROS message of a type in ``READABLE_TYPES``.

    Raises RecordingError, naming topic, value and advice, for a message that contradicts itself.
    """
    try:
        return _DECODERS[message_type](raw, received_ns)
    except BadMessage as error:
        raise RecordingError(f"{topic}: {error.problem}.", advice=error.advice) from error
    except (ValueError, TypeError, AttributeError, IndexError, OverflowError) as error:
        problem = " ".join(str(error).split())
        raise RecordingError(
            f"{topic}: {message_type} does not hold what its type promises: {problem}.",
            advice="Check the driver that recorded it.",
        ) from error


def stamp_of_value_ns(value: SensorValue) -> int | None:
    """The sensor's own stamp; None for an empty batch of transforms."""
    if isinstance(value, TransformBatch):
        return value.transforms[0].stamp_ns if value.transforms else None
    return value.stamp_ns


def header_stamp_ns(raw: RawMessage) -> int:
    """The sensor's stamp of a raw message, without decoding the rest of it; NO_STAMP where its
    header is invalid, and for a batch of transforms, which has no header of its own."""
    try:
        if isinstance(raw, tuple):
            seconds, nanoseconds = raw[:2]
            return _time_ns(seconds, nanoseconds)
        return NO_STAMP if isinstance(raw, list) else _header_stamp_ns(raw.header)
    except (BadMessage, ValueError, TypeError, AttributeError, OverflowError):
        return NO_STAMP


def image_encoding(raw: RawMessage) -> str:
    """The encoding of a raw Image, or of a raw CompressedImage when it is unpacked."""
    packed = hasattr(raw, "format")
    return str(decompressed_encoding(raw.format, raw.data) if packed else raw.encoding)


def _header_stamp_ns(header: RawMessage) -> int:
    return _time_ns(int(header.stamp.sec), int(header.stamp.nanosec))


def _time_ns(seconds: int, nanoseconds: int) -> int:
    stamp_ns = seconds * NS_PER_S + nanoseconds
    if not 0 <= stamp_ns < _END_OF_STAMPS_NS:
        raise BadMessage(
            f"header stamp {seconds} s {nanoseconds} ns is not between 1970 and 2038",
            "Check the clock of the computer that recorded it.",
        )
    return stamp_ns


def _clean_frame_name(name: str) -> str:
    """A frame's name as tf2 has it: the first tf wrote a leading slash."""
    if len(name) > _MAX_NAME_CHARACTERS:
        raise _long_name_error("a frame", name)
    return name.lstrip("/")


def _long_name_error(what: str, name: str) -> BadMessage:
    return BadMessage(
        f"the name of {what} has {len(name)} characters, more than {_MAX_NAME_CHARACTERS}",
        "The message is damaged; leave the topic out.",
    )


def _laser_scan(raw: RawMessage, received_ns: int | None) -> LaserScan:
    row = raw if isinstance(raw, ScanRow) else _scan_row(raw)
    if not row.range_max > max(row.range_min, 0.0):
        raise BadMessage(
            f"range_max {row.range_max} is not above range_min {row.range_min}",
            "Set the scanner's range limits in its driver.",
        )
    try:
        # Before memory is taken for the ranges.
        require_plausible_sweep(len(row.ranges), row.angle_min, row.angle_increment)
    except ImplausibleSweep as error:
        raise BadMessage(error.problem, error.advice) from None
    intensities = None
    # A signalling NaN is no failure.
    with np.errstate(invalid="ignore"):
        ranges = ranges_m(row.ranges, row.range_min, row.range_max)
        if len(row.intensities) == len(ranges) > 0:
            intensities = row.intensities.astype(np.float64)
    return LaserScan(
        stamp_ns=_time_ns(row.seconds, row.nanoseconds),
        received_ns=received_ns,
        frame_id=_clean_frame_name(row.frame),
        angle_min_rad=row.angle_min,
        angle_increment_rad=row.angle_increment,
        range_min_m=row.range_min,
        range_max_m=row.range_max,
        ranges_m=ranges,
        intensities=intensities,
        scan_time_s=row.scan_time,
        time_increment_s=row.time_increment,
    )


def _scan_row(raw: RawMessage) -> ScanRow:
    return ScanRow(
        seconds=int(raw.header.stamp.sec),
        nanoseconds=int(raw.header.stamp.nanosec),
        frame=raw.header.frame_id,
        angle_min=float(raw.angle_min),
        angle_increment=float(raw.angle_increment),
        time_increment=float(raw.time_increment),
        scan_time=float(raw.scan_time),
        range_min=float(raw.range_min),
        range_max=float(raw.range_max),
        ranges=raw.ranges,
        intensities=raw.intensities,
    )


def _image(raw: RawMessage, received_ns: int | None) -> DepthImage | ColorImage:
    pixels = read_depth_pixels(raw) if is_depth_encoding(raw.encoding) else read_rgb_pixels(raw)
    return _image_value(raw, received_ns, pixels)


def _compressed_image(raw: RawMessage, received_ns: int | None) -> DepthImage | ColorImage:
    return _image_value(raw, received_ns, decompress_image(raw.format, raw.data))


def _image_value(
    raw: RawMessage, received_ns: int | None, pixels: np.ndarray[Any, Any]
) -> DepthImage | ColorImage:
    """``pixels``: (H, W, 3) uint8 RGB, (H, W) uint16 millimetres or (H, W) float32 metres."""
    stamp_ns, frame_id = _header_stamp_ns(raw.header), _clean_frame_name(raw.header.frame_id)
    if pixels.ndim == 3:
        return ColorImage(stamp_ns=stamp_ns, received_ns=received_ns, frame_id=frame_id, rgb=pixels)
    in_metres = pixels.dtype.kind == "f"
    return DepthImage(
        stamp_ns=stamp_ns,
        received_ns=received_ns,
        frame_id=frame_id,
        depth_m=depth_m_from_metres(pixels) if in_metres else depth_m_from_millimetres(pixels),
        encoding="32FC1" if in_metres else "16UC1",
    )


def _camera_info(raw: RawMessage, received_ns: int | None) -> CameraInfo:
    # ROS 1 spells the matrices upper-case, ROS 2 lower-case.
    k = raw.K if hasattr(raw, "K") else raw.k
    d = raw.D if hasattr(raw, "D") else raw.d
    intrinsics = None
    if len(d) > _MAX_DISTORTION:
        raise BadMessage(
            f"{len(d)} distortion coefficients are given, no model has more than {_MAX_DISTORTION}",
            "Calibrate the camera, or leave this topic out.",
        )
    if len(raw.distortion_model) > _MAX_NAME_CHARACTERS:
        raise _long_name_error("the distortion model", raw.distortion_model)
    # K[0] == 0 marks an uncalibrated camera.
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
        stamp_ns=_header_stamp_ns(raw.header),
        received_ns=received_ns,
        frame_id=_clean_frame_name(raw.header.frame_id),
        intrinsics=intrinsics,
    )


def _pose_matrix(numbers: PoseNumbers) -> FloatArray:
    """(4, 4) from position and quaternion, as ``geometry.rotation_from_quaternion`` makes it.

    In plain floats: recordings hold ten thousands of transforms, and numpy would take several
    times as long for arrays of four numbers.
    """
    px, py, pz, x, y, z, w = numbers
    if not (abs(px) <= POSITION_MAX_M and abs(py) <= POSITION_MAX_M and abs(pz) <= POSITION_MAX_M):
        is_far = isfinite(px) and isfinite(py) and isfinite(pz)
        what = f"lies farther than {POSITION_MAX_M:g} m" if is_far else "is not finite"
        raise BadMessage(f"position {px} {py} {pz} {what}", "Check the source of the pose.")
    xx, yy, zz = x * x, y * y, z * z
    squared = xx + yy + zz + w * w
    if not _SHORTEST_QUATERNION**2 < squared < inf:
        raise BadMessage(
            f"quaternion {x} {y} {z} {w} is no rotation", "Check the source of the pose."
        )
    s = 2.0 / squared
    xy, xz, yz, xw, yw, zw = x * y, x * z, y * z, x * w, y * w, z * w
    # fmt: off
    rows = _MATRIX.pack(
        1.0 - s * (yy + zz), s * (xy - zw), s * (xz + yw), px,
        s * (xy + zw), 1.0 - s * (xx + zz), s * (yz - xw), py,
        s * (xz - yw), s * (yz + xw), 1.0 - s * (xx + yy), pz,
        0.0, 0.0, 0.0, 1.0,
    )
    # fmt: on
    return np.ndarray((4, 4), np.float64, rows)


def _pose_numbers(position: RawMessage, orientation: RawMessage) -> PoseNumbers:
    q = orientation
    return position.x, position.y, position.z, q.x, q.y, q.z, q.w


def _odometry(raw: RawMessage, received_ns: int | None) -> PoseSample:
    if isinstance(raw, tuple):
        return _pose_sample(raw, received_ns)
    return _pose_sample(_pose_row(raw.header, raw.child_frame_id, raw.pose.pose), received_ns)


def _pose_stamped(raw: RawMessage, received_ns: int | None) -> PoseSample:
    row = raw if isinstance(raw, tuple) else _pose_row(raw.header, "", raw.pose)
    return _pose_sample(row, received_ns)


def _pose_row(header: RawMessage, child: str, pose: RawMessage) -> PoseRow:
    return (
        int(header.stamp.sec),
        int(header.stamp.nanosec),
        header.frame_id,
        child,
        _pose_numbers(pose.position, pose.orientation),
    )


def _pose_sample(row: PoseRow, received_ns: int | None) -> PoseSample:
    seconds, nanoseconds, parent, child, numbers = row
    return PoseSample(
        stamp_ns=_time_ns(seconds, nanoseconds),
        received_ns=received_ns,
        parent=_clean_frame_name(parent),
        child=_clean_frame_name(child),
        T_parent_child=_pose_matrix(numbers),
    )


def _transforms(raw: RawMessage, received_ns: int | None) -> TransformBatch:
    rows = raw if isinstance(raw, list) else [_transform_row(entry) for entry in raw.transforms]
    transforms = [
        Transform(
            stamp_ns=_time_ns(seconds, nanoseconds),
            parent=_clean_frame_name(parent),
            child=_clean_frame_name(child),
            T_parent_child=_pose_matrix(numbers),
        )
        for seconds, nanoseconds, parent, child, numbers in rows
    ]
    return TransformBatch(received_ns=received_ns, transforms=tuple(transforms))


def _transform_row(entry: RawMessage) -> PoseRow:
    return (
        int(entry.header.stamp.sec),
        int(entry.header.stamp.nanosec),
        entry.header.frame_id,
        entry.child_frame_id,
        _pose_numbers(entry.transform.translation, entry.transform.rotation),
    )


def _point_cloud(raw: RawMessage, received_ns: int | None) -> PointCloud:
    xyz_m, intensity = read_points(raw)
    stamp_ns = _header_stamp_ns(raw.header)
    return PointCloud(
        stamp_ns=stamp_ns,
        received_ns=received_ns,
        frame_id=_clean_frame_name(raw.header.frame_id),
        xyz_m=xyz_m,
        intensity=intensity,
        offsets_s=read_offsets(raw, stamp_ns),
        rings=read_rings(raw),
    )


def _joint_state(raw: RawMessage, received_ns: int | None) -> JointSample:
    names = tuple(raw.name)
    for name in names:
        if len(name) > _MAX_NAME_CHARACTERS:
            raise _long_name_error("a joint", name)
    return JointSample(
        stamp_ns=_header_stamp_ns(raw.header),
        received_ns=received_ns,
        names=names,
        positions=_joint_values(raw.position, names, "positions"),
        velocities=_joint_values(raw.velocity, names, "velocities"),
    )


def _joint_values(values: FloatArray, names: tuple[str, ...], what: str) -> FloatArray | None:
    """A copy, NaN where not finite; None where the message leaves the array empty."""
    if len(values) == 0:
        return None
    if len(values) != len(names):
        raise BadMessage(
            f"{len(names)} joints have {len(values)} {what}",
            "Check the driver that publishes the joints.",
        )
    return np.where(np.isfinite(values), values, np.nan).astype(np.float64)


_DECODERS: dict[str, Callable[[RawMessage, int | None], SensorValue]] = {
    "sensor_msgs/msg/LaserScan": _laser_scan,
    "sensor_msgs/msg/Image": _image,
    "sensor_msgs/msg/CompressedImage": _compressed_image,
    "sensor_msgs/msg/CameraInfo": _camera_info,
    "sensor_msgs/msg/PointCloud2": _point_cloud,
    "sensor_msgs/msg/JointState": _joint_state,
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": _pose_stamped,
    "tf2_msgs/msg/TFMessage": _transforms,
    "tf/msg/tfMessage": _transforms,
}
READABLE_TYPES = frozenset(_DECODERS)
