"""A recording of a room of boxes, whose truth has a closed form."""

import numpy as np

from fusion_core.model.conventions import NS_PER_MS, NS_PER_S
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_yaw_pitch_roll,
)
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    DepthImage,
    Transform,
    TransformBatch,
)
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from tests.mapping.box_room import LIDAR_HEIGHT_M, BoxRoom, camera_pose

START_NS = 1_700_000_000 * NS_PER_S
INTRINSICS = CameraIntrinsics(width=160, height=120, fx=144.0, fy=144.0, cx=79.5, cy=59.5)
TOPIC = "/camera/depth/image_raw"
# A box that only the camera sees, as D in Li's arena, and one that both see.
ROOM = BoxRoom(
    size_m=(5.5, 5.0, 2.5),
    boxes=((2.6, 2.2, 0.0, 2.9, 2.7, 0.2), (4.0, 0.8, 0.0, 4.6, 1.6, 1.5)),
)
START_POSE = np.array([1.0, 2.5, 0.0])


def standing(time_s):
    return START_POSE


def turning(time_s):
    return START_POSE + np.array([0.0, 0.0, 0.5 * time_s])


def T_lidar(*, upside_down=False):
    """(4, 4) T_base_lidar."""
    rotation = rotation_from_yaw_pitch_roll(0.0, 0.0, np.pi if upside_down else 0.0)
    return make_transform(rotation, np.array([0.0, 0.0, LIDAR_HEIGHT_M]))


def T_camera_lidar(T_base_camera):
    return invert_transform(T_base_camera) @ T_lidar()


def write_boxes(
    path,
    *,
    room=ROOM,
    drive=standing,
    T_base_camera=None,
    tf=("laser", "camera_optical"),
    base="base_link",
    T_told=None,
    lidar=True,
    upside_down=False,
    duration_s=1.0,
    scan_ms=100,
    image_ms=100,
    first_image_ms=0,
):
    """Write a recording; returns its path.

    ``tf``: frames that /tf_static joins to ``base``. ``T_told``: T_base_camera as it says it.
    """
    T_base_camera = camera_pose(0.8) if T_base_camera is None else T_base_camera
    T_told = T_base_camera if T_told is None else T_told
    messages = []
    frames = {"laser": T_lidar(upside_down=upside_down), "camera_optical": T_told}
    entries = tuple(
        Transform(stamp_ns=START_NS, parent=base, child=name, T_parent_child=frames[name].copy())
        for name in tf
    )
    if entries:
        batch = TransformBatch(received_ns=START_NS, transforms=entries)
        messages.append((-2, lambda writer: writer.write_transforms("/tf_static", batch)))
    for at_ms in range(0, round(1e3 * duration_s), scan_ms) if lidar else ():
        scan = room.scan(drive(1e-3 * at_ms), beams=720, stamp_ns=START_NS + at_ms * NS_PER_MS)
        if upside_down:
            # Its beams still turn counter-clockwise about its own z, which points down.
            scan = scan.with_ranges(np.roll(scan.ranges_m[::-1], 1), None)
        messages.append((at_ms, lambda writer, scan=scan: writer.write_laser_scan("/scan", scan)))
    rng = np.random.default_rng(1)
    for at_ms in range(first_image_ms, round(1e3 * duration_s), image_ms):
        depth_m = room.depth(drive(1e-3 * at_ms), T_base_camera, intrinsics=INTRINSICS, noise=rng)
        image = DepthImage(
            stamp_ns=START_NS + at_ms * NS_PER_MS,
            received_ns=None,
            frame_id="camera_optical",
            depth_m=depth_m,
        )
        messages.append((at_ms, lambda writer, image=image: writer.write_depth(TOPIC, image)))
    info = CameraInfo(
        stamp_ns=START_NS, received_ns=START_NS, frame_id="camera_optical", intrinsics=INTRINSICS
    )
    messages.append(
        (-1, lambda writer: writer.write_camera_info("/camera/depth/camera_info", info))
    )
    with Ros2McapWriter(path) as writer:
        for _, write in sorted(messages, key=lambda entry: entry[0]):
            write(writer)
    return path
