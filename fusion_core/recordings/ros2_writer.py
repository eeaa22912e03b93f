"""Model values to one MCAP file of ROS 2 messages, as ROS 2 tools open it."""

import struct
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, assert_never

import numpy as np

from fusion_core.model.conventions import NS_PER_S, Float32Array, FloatArray, IntArray
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.interpolation import quaternion_from_rotation
from fusion_core.model.sensors import (
    CameraInfo,
    ColorImage,
    DepthImage,
    JointSample,
    LaserScan,
    PointCloud,
    PoseSample,
    SensorValue,
    TransformBatch,
)
from fusion_core.recordings.mcap.output import McapOutput
from fusion_core.recordings.messages.bad_message import BadMessage
from fusion_core.recordings.units import millimetres_from_depth_m

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_POINT_FIELDS = {"<u2": 4, "<f4": 7}


@cache
def _typestore() -> "Typestore":
    # What only reads and displays does not wait for it.
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


class Ros2McapWriter:
    """Writes model values to one .mcap file, which appears whole or not at all.

    The log time of a message is ``received_ns``, or the stamp where that is None. A value that its
    ROS message cannot represent raises BadMessage; the file stays valid.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._output = McapOutput(path)
        self._channels: dict[str, tuple[int, str]] = {}

    def write(self, topic: str, value: SensorValue, *, odometry: bool = True) -> None:
        """Any value, as the message that fits it; a pose as PoseStamped unless as ``odometry``."""
        match value:
            case LaserScan():
                self.write_laser_scan(topic, value)
            case DepthImage():
                self.write_depth(topic, value)
            case ColorImage():
                self.write_color(topic, value)
            case CameraInfo():
                self.write_camera_info(topic, value)
            case PoseSample() if odometry:
                self.write_odometry(topic, value)
            case PoseSample():
                self.write_pose_stamped(topic, value)
            case TransformBatch():
                self.write_transforms(topic, value)
            case PointCloud():
                self.write_point_cloud(topic, value)
            case JointSample():
                self.write_joint_state(topic, value)
            case _:
                assert_never(value)

    def write_laser_scan(self, topic: str, scan: LaserScan) -> None:
        """sensor_msgs/LaserScan; a missing range is NaN."""
        last = max(scan.ranges_m.size - 1, 0)
        intensities = np.zeros(0) if scan.intensities is None else scan.intensities
        message = _message(
            "sensor_msgs/msg/LaserScan",
            header=_header(scan.stamp_ns, scan.frame_id),
            angle_min=scan.angle_min_rad,
            angle_max=scan.angle_min_rad + last * scan.angle_increment_rad,
            angle_increment=scan.angle_increment_rad,
            time_increment=scan.time_increment_s,
            scan_time=scan.scan_time_s,
            range_min=scan.range_min_m,
            range_max=scan.range_max_m,
            ranges=_float32(scan.ranges_m),
            intensities=_float32(intensities),
        )
        self._write(topic, message, scan.stamp_ns, scan.received_ns)

    def write_depth(self, topic: str, image: DepthImage) -> None:
        """sensor_msgs/Image: 16UC1 in millimetres with 0 for missing, or 32FC1 in metres with NaN.

        16UC1 ends at 65.534 m; what is farther becomes missing.
        """
        pixels: np.ndarray[Any, Any]
        if image.encoding == "16UC1":
            pixels = millimetres_from_depth_m(image.depth_m).astype("<u2")
        elif image.encoding == "32FC1":
            pixels = image.depth_m.astype("<f4")
        else:
            raise ValueError(f"depth is written as 16UC1 or 32FC1, not as {image.encoding}")
        self._write_image(topic, image, image.encoding, pixels)

    def write_classes(self, topic: str, image: DepthImage, classes: IntArray) -> None:
        """sensor_msgs/Image, 8SC1: a code from -1 for each pixel of a depth image, (H, W)."""
        self._write_image(topic, image, "8SC1", classes.astype(np.int8))

    def write_color(self, topic: str, image: ColorImage) -> None:
        """sensor_msgs/Image, rgb8."""
        self._write_image(topic, image, "rgb8", image.rgb)

    def write_camera_info(self, topic: str, info: CameraInfo) -> None:
        """sensor_msgs/CameraInfo; all zero where the camera is uncalibrated."""
        k, p = np.zeros((3, 3)), np.zeros((3, 4))
        camera = info.intrinsics
        if camera is not None:
            k = camera.matrix
            p[:, :3] = k
        message = _message(
            "sensor_msgs/msg/CameraInfo",
            header=_header(info.stamp_ns, info.frame_id),
            height=0 if camera is None else camera.height,
            width=0 if camera is None else camera.width,
            distortion_model="" if camera is None else camera.distortion_model,
            d=np.array([] if camera is None else camera.distortion, dtype=np.float64),
            k=k.ravel(),
            r=np.eye(3).ravel(),
            p=p.ravel(),
            binning_x=0,
            binning_y=0,
            roi=_message(
                "sensor_msgs/msg/RegionOfInterest",
                x_offset=0,
                y_offset=0,
                height=0,
                width=0,
                do_rectify=False,
            ),
        )
        self._write(topic, message, info.stamp_ns, info.received_ns)

    def write_transforms(self, topic: str, batch: TransformBatch) -> None:
        """tf2_msgs/TFMessage. An empty batch has no time of its own and is written at time 0."""
        entries = [
            _message(
                "geometry_msgs/msg/TransformStamped",
                header=_header(entry.stamp_ns, entry.parent),
                child_frame_id=entry.child,
                transform=_message(
                    "geometry_msgs/msg/Transform",
                    translation=_vector("Vector3", entry.T_parent_child[:3, 3]),
                    rotation=_quaternion(entry.T_parent_child[:3, :3]),
                ),
            )
            for entry in batch.transforms
        ]
        stamp_ns = batch.transforms[0].stamp_ns if batch.transforms else 0
        message = _message("tf2_msgs/msg/TFMessage", transforms=entries)
        self._write(topic, message, stamp_ns, batch.received_ns)

    def write_odometry(self, topic: str, sample: PoseSample) -> None:
        """nav_msgs/Odometry without twist or covariance."""
        zero = np.zeros(3)
        message = _message(
            "nav_msgs/msg/Odometry",
            header=_header(sample.stamp_ns, sample.parent),
            child_frame_id=sample.child,
            pose=_message(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=_pose(sample.T_parent_child),
                covariance=np.zeros(36),
            ),
            twist=_message(
                "geometry_msgs/msg/TwistWithCovariance",
                twist=_message(
                    "geometry_msgs/msg/Twist",
                    linear=_vector("Vector3", zero),
                    angular=_vector("Vector3", zero),
                ),
                covariance=np.zeros(36),
            ),
        )
        self._write(topic, message, sample.stamp_ns, sample.received_ns)

    def write_pose_stamped(self, topic: str, sample: PoseSample) -> None:
        """geometry_msgs/PoseStamped; the message has no place for the child frame."""
        message = _message(
            "geometry_msgs/msg/PoseStamped",
            header=_header(sample.stamp_ns, sample.parent),
            pose=_pose(sample.T_parent_child),
        )
        self._write(topic, message, sample.stamp_ns, sample.received_ns)

    def write_occupancy_grid(
        self, topic: str, grid: OccupancyGrid, stamp_ns: int, received_ns: int | None = None
    ) -> None:
        """nav_msgs/OccupancyGrid: the probability as 0..100, -1 where unknown."""
        percent = np.where(grid.known, np.rint(100.0 * grid.probability), -1.0)
        rows, columns = grid.log_odds.shape
        origin = np.eye(4)
        origin[:2, 3] = grid.origin_m
        message = _message(
            "nav_msgs/msg/OccupancyGrid",
            header=_header(stamp_ns, grid.frame_id),
            info=_message(
                "nav_msgs/msg/MapMetaData",
                map_load_time=_time(stamp_ns),
                resolution=grid.resolution_m,
                width=columns,
                height=rows,
                origin=_pose(origin),
            ),
            data=percent.astype(np.int8).ravel(),
        )
        self._write(topic, message, stamp_ns, received_ns)

    def write_point_cloud(self, topic: str, cloud: PointCloud) -> None:
        """sensor_msgs/PointCloud2: one row of x, y, z and, as far as they are known, intensity,
        ring and time (seconds since the stamp), as Velodyne's driver has them."""
        columns: dict[str, np.ndarray[Any, Any]] = dict(zip("xyz", cloud.xyz_m.T, strict=True))
        if cloud.intensity is not None:
            columns["intensity"] = cloud.intensity
        if cloud.rings is not None:
            columns["ring"] = cloud.rings
        if cloud.offsets_s is not None:
            columns["time"] = cloud.offsets_s
        formats = {name: "<u2" if name == "ring" else "<f4" for name in columns}
        layout = np.dtype(list(formats.items()))
        sizes = [np.dtype(kind).itemsize for kind in formats.values()]
        offsets = np.cumsum([0, *sizes[:-1]]).tolist()
        points = np.zeros(cloud.xyz_m.shape[0], layout)
        for name, values in columns.items():
            points[name] = values
        message = _message(
            "sensor_msgs/msg/PointCloud2",
            header=_header(cloud.stamp_ns, cloud.frame_id),
            height=1,
            width=points.size,
            fields=[
                _message(
                    "sensor_msgs/msg/PointField",
                    name=name,
                    offset=offset,
                    datatype=_POINT_FIELDS[kind],
                    count=1,
                )
                for (name, kind), offset in zip(formats.items(), offsets, strict=True)
            ],
            is_bigendian=False,
            point_step=layout.itemsize,
            row_step=points.nbytes,
            data=points.view(np.uint8),
            is_dense=bool(np.isfinite(cloud.xyz_m).all()),
        )
        self._write(topic, message, cloud.stamp_ns, cloud.received_ns)

    def write_joint_state(self, topic: str, sample: JointSample) -> None:
        """sensor_msgs/JointState without effort."""
        none = np.zeros(0)
        message = _message(
            "sensor_msgs/msg/JointState",
            header=_header(sample.stamp_ns, ""),
            name=list(sample.names),
            position=none if sample.positions is None else sample.positions,
            velocity=none if sample.velocities is None else sample.velocities,
            effort=none,
        )
        self._write(topic, message, sample.stamp_ns, sample.received_ns)

    def message_type(self, topic: str) -> str:
        """The type of a topic's messages. Raises KeyError where none was written."""
        return self._channels[topic][1]

    def close(self) -> None:
        """Finish the file and give it its name."""
        self._output.close()

    def abort(self) -> None:
        """Leave nothing behind."""
        self._output.abort()

    def __enter__(self) -> "Ros2McapWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

    def _write_image(
        self,
        topic: str,
        image: DepthImage | ColorImage,
        encoding: str,
        pixels: np.ndarray[Any, Any],
    ) -> None:
        height, width = pixels.shape[:2]
        data = np.ascontiguousarray(pixels).reshape(height, -1).view(np.uint8)
        message = _message(
            "sensor_msgs/msg/Image",
            header=_header(image.stamp_ns, image.frame_id),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=0,
            step=data.shape[1],
            data=data.ravel(),
        )
        self._write(topic, message, image.stamp_ns, image.received_ns)

    def _write(self, topic: str, message: Any, stamp_ns: int, received_ns: int | None) -> None:
        message_type: str = message.__msgtype__
        log_time_ns = stamp_ns if received_ns is None else received_ns
        if log_time_ns < 0:
            raise BadMessage(
                f"its log time is {log_time_ns} ns, before 1970", "Check the clock of the log."
            )
        try:
            data = _typestore().serialize_cdr(message, message_type, little_endian=True)
        except (struct.error, OverflowError, UnicodeEncodeError) as error:
            problem = f"{message_type} cannot hold it: {error}"
            raise BadMessage(problem, "Check the values that it has.") from error
        channel, channel_type = self._channels.get(topic) or self._register(topic, message_type)
        if channel_type != message_type:
            raise ValueError(f"{topic} holds {channel_type}, not {message_type}")
        # The message can have a stamp before 1970, the file cannot.
        published_ns = stamp_ns if stamp_ns >= 0 else log_time_ns
        self._output.write(channel, data, log_time_ns=log_time_ns, publish_time_ns=published_ns)

    def _register(self, topic: str, message_type: str) -> tuple[int, str]:
        definition, _ = _typestore().generate_msgdef(message_type, ros_version=2)
        self._channels[topic] = self._output.channel(topic, message_type, definition), message_type
        return self._channels[topic]


def _message(message_type: str, **fields: Any) -> Any:
    return _typestore().types[message_type](**fields)


def _float32(values: FloatArray) -> Float32Array:
    """Infinite where float32 ends."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def _time(stamp_ns: int) -> Any:
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    return _message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)


def _header(stamp_ns: int, frame_id: str) -> Any:
    return _message("std_msgs/msg/Header", stamp=_time(stamp_ns), frame_id=frame_id)


def _vector(kind: str, xyz: FloatArray) -> Any:
    x, y, z = (float(value) for value in xyz)
    return _message(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def _quaternion(rotation: FloatArray) -> Any:
    x, y, z, w = (float(value) for value in quaternion_from_rotation(rotation))
    return _message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _pose(T_parent_child: FloatArray) -> Any:
    return _message(
        "geometry_msgs/msg/Pose",
        position=_vector("Point", T_parent_child[:3, 3]),
        orientation=_quaternion(T_parent_child[:3, :3]),
    )
