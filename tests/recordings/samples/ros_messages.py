"""Messages with the same values in every ROS container, and their ROS form."""

from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
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
from tests.recordings.samples.sample import MS, T0, Written

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)


def float32(value: float) -> float:
    """What is left of a number after a float32 field."""
    return float(np.float32(value))


def pose(i: int) -> np.ndarray:
    """A pose far from half turns."""
    return make_transform(
        rotation_from_yaw_pitch_roll(0.1 * i, 0.02, -0.03), np.array([i, 0.5, 0.25])
    )


def scan(i: int, received_ns: int, frame_id: str = "laser") -> LaserScan:
    ranges = np.array([1.0 + 0.25 * i, np.nan, 2.5, np.nan, 0.125], dtype=np.float64)
    return LaserScan(
        stamp_ns=received_ns - 3 * MS,
        received_ns=received_ns,
        frame_id=frame_id,
        angle_min_rad=-0.5,
        angle_increment_rad=0.25,
        range_min_m=0.0625,
        range_max_m=5.5,
        ranges_m=ranges,
        intensities=np.arange(5.0),
        scan_time_s=float32(0.1),
        time_increment_s=0.0,
    )


def depth(i: int, received_ns: int) -> DepthImage:
    mm = np.arange(12, dtype=np.uint16).reshape(3, 4) * 250 + i
    mm[0, 0] = 0
    metres = (mm.astype(np.float32) / np.float32(1000)).astype(np.float32)
    metres[0, 0] = np.nan
    return DepthImage(
        stamp_ns=received_ns - 5 * MS,
        received_ns=received_ns,
        frame_id="camera",
        depth_m=metres,
        encoding="16UC1",
    )


def color(i: int, received_ns: int) -> ColorImage:
    rgb = (np.arange(36, dtype=np.uint8) + i).reshape(3, 4, 3)
    return ColorImage(
        stamp_ns=received_ns - 4 * MS, received_ns=received_ns, frame_id="camera", rgb=rgb
    )


def camera_info(received_ns: int, calibrated: bool = True) -> CameraInfo:
    intrinsics = CameraIntrinsics(
        width=4, height=3, fx=3.5, fy=3.25, cx=1.5, cy=1.0, distortion=(0.5, 0.0, 0.0, 0.0, 0.25)
    )
    return CameraInfo(
        stamp_ns=received_ns - 5 * MS,
        received_ns=received_ns,
        frame_id="camera",
        intrinsics=intrinsics if calibrated else None,
    )


def pose_sample(i: int, received_ns: int, parent: str, child: str) -> PoseSample:
    return PoseSample(
        stamp_ns=received_ns - 1 * MS,
        received_ns=received_ns,
        parent=parent,
        child=child,
        T_parent_child=pose(i),
    )


def transforms(i: int, received_ns: int) -> TransformBatch:
    return TransformBatch(
        received_ns=received_ns,
        transforms=tuple(
            Transform(
                stamp_ns=received_ns - k * MS, parent="base", child=f"s{k}", T_parent_child=pose(i)
            )
            for k in (1, 2)
        ),
    )


def messages() -> list[Written]:
    """Twelve steps with ties in log time and one message logged late, in the order of writing."""
    written = [Written("/tf_static", T0 - MS, transforms(0, T0 - MS))]
    for i in range(12):
        at = T0 + i * 50 * MS
        written.append(Written("/scan", at, scan(i, at)))
        written.append(Written("/camera/depth/image_raw", at, depth(i, at)))
        written.append(Written("/camera/depth/camera_info", at + 1, camera_info(at + 1, i > 0)))
        written.append(Written("/camera/color/image_raw", at + 2, color(i, at + 2)))
        written.append(Written("/odom", at + 3, pose_sample(i, at + 3, "odom", "base")))
        written.append(Written("/tf", at + 3, transforms(i, at + 3)))
        written.append(Written("/tf", at + 3, transforms(i + 1, at + 3)))
        written.append(Written("/ground_truth", at + 4, pose_sample(i, at + 4, "map", "")))
    late = T0 + 75 * MS
    written.append(Written("/scan", late, scan(13, late)))
    return written


MESSAGES = messages()
TYPES = {
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/camera/depth/image_raw": "sensor_msgs/msg/Image",
    "/camera/depth/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/color/image_raw": "sensor_msgs/msg/Image",
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/ground_truth": "geometry_msgs/msg/PoseStamped",
}


def ros_message(store: Any, value: SensorValue) -> Any:
    """The ROS message of a value, put together field by field (the tests' own writer)."""
    types = store.types
    is_ros1 = store is ROS1

    def time(ns: int) -> Any:
        return types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)

    def header(ns: int, frame: str) -> Any:
        seq = {"seq": 7} if is_ros1 else {}
        return types["std_msgs/msg/Header"](stamp=time(ns), frame_id=frame, **seq)

    def vector(kind: str, xyz: np.ndarray) -> Any:
        return types[f"geometry_msgs/msg/{kind}"](x=xyz[0], y=xyz[1], z=xyz[2])

    def quaternion(T: np.ndarray) -> Any:
        # From the trace: all test rotations are far from half turns. Twice the length, since
        # readers must not rely on unit length.
        w = np.sqrt(1.0 + np.trace(T[:3, :3])) / 2.0
        x, y, z = (T[a, b] - T[b, a] for a, b in ((2, 1), (0, 2), (1, 0)))
        scale = 2.0 / (4.0 * w)
        return types["geometry_msgs/msg/Quaternion"](
            x=x * scale, y=y * scale, z=z * scale, w=2.0 * w
        )

    def ros_pose(T: np.ndarray) -> Any:
        return types["geometry_msgs/msg/Pose"](
            position=vector("Point", T[:3, 3]), orientation=quaternion(T)
        )

    def image(head: Any, encoding: str, pixels: np.ndarray) -> Any:
        # Two bytes of padding at the end of each row, which readers must drop.
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(pixels.shape[0], -1)
        padded = np.pad(rows, ((0, 0), (0, 2)), constant_values=255)
        return types["sensor_msgs/msg/Image"](
            header=head,
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=padded.shape[1],
            data=padded.ravel(),
        )

    match value:
        case LaserScan():
            ranges = value.ranges_m.astype(np.float32)
            ranges[1], ranges[3] = 0.0, np.inf
            return types["sensor_msgs/msg/LaserScan"](
                header=header(value.stamp_ns, value.frame_id),
                angle_min=value.angle_min_rad,
                angle_max=0.5,
                angle_increment=value.angle_increment_rad,
                time_increment=0.0,
                scan_time=value.scan_time_s,
                range_min=value.range_min_m,
                range_max=value.range_max_m,
                ranges=ranges,
                intensities=np.arange(5, dtype=np.float32),
            )
        case DepthImage():
            mm = np.nan_to_num(np.rint(value.depth_m * 1000.0)).astype("<u2")
            return image(header(value.stamp_ns, value.frame_id), "16UC1", mm)
        case ColorImage():
            bgr = np.ascontiguousarray(value.rgb[:, :, ::-1])
            return image(header(value.stamp_ns, value.frame_id), "bgr8", bgr)
        case CameraInfo():
            c = value.intrinsics
            k = [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0] if c else [0.0] * 9
            matrices = {
                "d": np.array(c.distortion if c else (), dtype=np.float64),
                "k": np.array(k),
                "r": np.eye(3).ravel(),
                "p": np.zeros(12),
            }
            return types["sensor_msgs/msg/CameraInfo"](
                header=header(value.stamp_ns, value.frame_id),
                height=3,
                width=4,
                distortion_model="plumb_bob",
                binning_x=0,
                binning_y=0,
                roi=types["sensor_msgs/msg/RegionOfInterest"](
                    x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
                ),
                **{name.upper() if is_ros1 else name: m for name, m in matrices.items()},
            )
        case PoseSample(child=""):
            return types["geometry_msgs/msg/PoseStamped"](
                header=header(value.stamp_ns, value.parent), pose=ros_pose(value.T_parent_child)
            )
        case PoseSample():
            zero = vector("Vector3", np.zeros(3))
            return types["nav_msgs/msg/Odometry"](
                header=header(value.stamp_ns, value.parent),
                child_frame_id=value.child,
                pose=types["geometry_msgs/msg/PoseWithCovariance"](
                    pose=ros_pose(value.T_parent_child), covariance=np.zeros(36)
                ),
                twist=types["geometry_msgs/msg/TwistWithCovariance"](
                    twist=types["geometry_msgs/msg/Twist"](linear=zero, angular=zero),
                    covariance=np.zeros(36),
                ),
            )
        case TransformBatch():
            return types["tf2_msgs/msg/TFMessage"](
                transforms=[
                    types["geometry_msgs/msg/TransformStamped"](
                        header=header(t.stamp_ns, "/" + t.parent if is_ros1 else t.parent),
                        child_frame_id=t.child,
                        transform=types["geometry_msgs/msg/Transform"](
                            translation=vector("Vector3", t.T_parent_child[:3, 3]),
                            rotation=quaternion(t.T_parent_child),
                        ),
                    )
                    for t in value.transforms
                ]
            )
