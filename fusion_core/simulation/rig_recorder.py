"""Writes a simulated turn of Song's rig: a ROS 2 MCAP file, and its truth beside it."""

from pathlib import Path

import numpy as np

from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.progress import Progress, silent
from fusion_core.model.sensors import (
    CameraInfo,
    ColorImage,
    JointSample,
    PointCloud,
    Transform,
    TransformBatch,
)
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from fusion_core.simulation.truth import TruthWriter, simulated_errors, truth_path
from fusion_core.simulation.turning_rig import (
    T_AXIS_LIDAR_NOMINAL,
    TurningRigData,
    TurningRigSettings,
    TurningScan,
    simulate_turning_rig,
)

POINTS_TOPIC = "/lidar/points"
JOINT_TOPIC = "/joint_states"
IMAGE_TOPIC = "/camera/image_raw"
CAMERA_INFO_TOPIC = "/camera/camera_info"
JOINT_NAME = "turn_axis"
LIDAR_FRAME, AXIS_FRAME, CAMERA_FRAME = "lidar", "axis", "camera"


def record_turning_rig(
    settings: TurningRigSettings, seed: int, path: Path, progress: Progress = silent
) -> None:
    """Write a turn, and ``NAME.truth.npz`` beside it.

    /tf_static has the nominal mounting of the LiDAR on the axis; the mounting error, the axis'
    place and the camera are in the truth alone. Raises ExportError where a file cannot be written.
    """
    with TruthWriter(truth_path(path)) as truth, Ros2McapWriter(path) as writer:
        data = simulate_turning_rig(settings, seed, progress)
        truth.put(_truth(data, settings, seed))
        _write_camera(writer, data)
        # At equal log times the axis comes first.
        messages: list[JointSample | PointCloud] = [
            *_joint_samples(data),
            *(_cloud(scan) for scan in data.scans),
        ]
        for message in sorted(messages, key=lambda message: message.received_ns or 0):
            if isinstance(message, PointCloud):
                writer.write_point_cloud(POINTS_TOPIC, message)
            else:
                writer.write_joint_state(JOINT_TOPIC, message)


def _cloud(scan: TurningScan) -> PointCloud:
    # A scan is sent when its last point has been measured.
    return PointCloud(
        stamp_ns=scan.stamp_ns,
        received_ns=scan.stamp_ns + round(float(scan.offsets_s[-1]) * NS_PER_S),
        frame_id=LIDAR_FRAME,
        xyz_m=scan.points_m,
        intensity=scan.intensity,
        offsets_s=scan.offsets_s.astype(np.float64),
        rings=scan.rings.astype(np.uint16),
    )


def _joint_samples(data: TurningRigData) -> list[JointSample]:
    return [
        JointSample(
            stamp_ns=stamp_ns,
            received_ns=stamp_ns,
            names=(JOINT_NAME,),
            positions=np.array([angle_rad]),
            velocities=None,
        )
        for stamp_ns, angle_rad in zip(
            data.joint_stamps_ns.tolist(), data.joint_angles_rad.tolist(), strict=True
        )
    ]


def _truth(
    data: TurningRigData, settings: TurningRigSettings, seed: int
) -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]]:
    """The names and frames are those of TurningRigData; ``intrinsics``: fx, fy, cx, cy."""
    camera = data.intrinsics
    return {
        "theta_rad": np.array(data.theta_rad),
        "beta_rad": np.array(data.beta_rad),
        "delta_m": data.delta_m,
        "T_axis_lidar": data.T_axis_lidar,
        "T_axis_lidar_nominal": T_AXIS_LIDAR_NOMINAL,
        "T_camera_lidar": data.T_camera_lidar,
        "T_room_rig": data.T_room_rig,
        "room_size_m": np.array(data.room_size_m),
        "intrinsics": np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        "distortion": np.array(camera.distortion, dtype=np.float64),
        "seed": np.array(seed, dtype=np.int64),
        "simulated_errors": simulated_errors(lidar=settings.lidar),
    }


def _write_camera(writer: Ros2McapWriter, data: TurningRigData) -> None:
    mounting = Transform(
        stamp_ns=data.image_stamp_ns,
        parent=AXIS_FRAME,
        child=LIDAR_FRAME,
        T_parent_child=T_AXIS_LIDAR_NOMINAL,
    )
    batch = TransformBatch(received_ns=data.image_stamp_ns, transforms=(mounting,))
    writer.write_transforms("/tf_static", batch)
    stamp_ns = data.image_stamp_ns
    info = CameraInfo(
        stamp_ns=stamp_ns, received_ns=stamp_ns, frame_id=CAMERA_FRAME, intrinsics=data.intrinsics
    )
    writer.write_camera_info(CAMERA_INFO_TOPIC, info)
    image = ColorImage(stamp_ns=stamp_ns, received_ns=stamp_ns, frame_id=CAMERA_FRAME, rgb=data.rgb)
    writer.write_color(IMAGE_TOPIC, image)
