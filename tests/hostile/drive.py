"""A short drive through a room of boxes, each value of which may be changed before it is logged."""

from dataclasses import replace

import numpy as np

from fusion_core.model.conventions import NS_PER_MS, NS_PER_S
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    ColorImage,
    DepthImage,
    PoseSample,
    Transform,
    TransformBatch,
)
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from tests.mapping.box_room import LIDAR_HEIGHT_M, BoxRoom, camera_pose

START_NS = 1_700_000_000 * NS_PER_S
STEP_MS = 100
SCANS = 20
LENS = CameraIntrinsics(width=80, height=60, fx=72.0, fy=72.0, cx=39.5, cy=29.5)
SCAN, ODOMETRY, TF, TF_STATIC = "/scan", "/odom", "/tf", "/tf_static"
DEPTH, INFO = "/camera/depth/image_raw", "/camera/depth/camera_info"
COLOR = "/camera/color/image_raw"
_ROOM = BoxRoom(
    size_m=(5.5, 5.0, 2.5),
    boxes=((4.0, 0.8, 0.0, 4.6, 1.6, 1.5), (3.0, 3.9, 0.0, 3.4, 4.4, 1.8)),
)
T_BASE_CAMERA = camera_pose(0.8)


def pose_of(number):
    """(3,) x, y, yaw of the robot at a scan."""
    return np.array([1.0 + 0.03 * number, 2.4, 0.05 * number])


def unchanged(topic, number, value):
    """Leave every value as it is."""
    return value


def restamped(value, stamp_ns):
    """The value with another stamp; the log keeps its time."""
    if isinstance(value, TransformBatch):
        moved = tuple(replace(entry, stamp_ns=stamp_ns) for entry in value.transforms)
        return replace(value, transforms=moved)
    return replace(value, stamp_ns=stamp_ns)


def write_drive(
    path,
    change=unchanged,
    *,
    tf=False,
    camera=True,
    color=False,
    odometry=True,
    T_recorded=T_BASE_CAMERA,
):
    """Write ``SCANS`` scans, images and poses of odometry, one of each in ``STEP_MS``.

    ``change``: (topic, number on the topic, value) to the value that is logged in its place, or
    None for none. ``tf``: poses from /tf and not from /odom. ``T_recorded``: (4, 4) T_base_camera
    in /tf_static. Returns ``path``.
    """
    with Ros2McapWriter(path) as writer:
        for topic, number, value in _values(tf, camera, color, odometry, T_recorded):
            logged = change(topic, number, value)
            if logged is not None:
                writer.write(topic, logged)
    return path


def _values(tf, camera, color, odometry, T_recorded):
    T_base_lidar = make_transform(np.eye(3), np.array([0.0, 0.0, LIDAR_HEIGHT_M]))
    mounts = {"laser": T_base_lidar, "camera_optical": T_recorded}
    static = tuple(
        Transform(stamp_ns=START_NS, parent="base", child=child, T_parent_child=T.copy())
        for child, T in mounts.items()
    )
    yield TF_STATIC, 0, TransformBatch(received_ns=START_NS, transforms=static)
    if camera:
        yield (
            INFO,
            0,
            CameraInfo(
                stamp_ns=START_NS, received_ns=START_NS, frame_id="camera_optical", intrinsics=LENS
            ),
        )
    for number in range(SCANS):
        stamp_ns, pose = START_NS + number * STEP_MS * NS_PER_MS, pose_of(number)
        T_odom_base = make_transform(
            rotation_from_yaw_pitch_roll(pose[2], 0.0, 0.0), np.array([*pose[:2], 0.0])
        )
        if odometry:
            named = {"stamp_ns": stamp_ns, "parent": "odom", "child": "base"}
            if tf:
                entry = Transform(**named, T_parent_child=T_odom_base)
                yield TF, number, TransformBatch(received_ns=stamp_ns, transforms=(entry,))
            else:
                sample = PoseSample(**named, received_ns=stamp_ns, T_parent_child=T_odom_base)
                yield ODOMETRY, number, sample
        yield SCAN, number, _ROOM.scan(pose, stamp_ns=stamp_ns)
        if camera:
            depth_m = _ROOM.depth(
                pose, T_BASE_CAMERA, intrinsics=LENS, noise=np.random.default_rng(number)
            )
            image = DepthImage(
                stamp_ns=stamp_ns,
                received_ns=stamp_ns,
                frame_id="camera_optical",
                depth_m=depth_m,
            )
            yield DEPTH, number, image
        if color:
            rgb = np.zeros((LENS.height, LENS.width, 3), dtype=np.uint8)
            named = {"stamp_ns": stamp_ns, "received_ns": stamp_ns, "frame_id": "camera_optical"}
            yield COLOR, number, ColorImage(**named, rgb=rgb)
