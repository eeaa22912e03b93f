"""Sensor mounts: poses of LiDAR and cameras on the robot, and their models."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from fusion_core.model.conventions import R_BODY_OPTICAL, FloatArray
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_yaw_pitch_roll,
)
from fusion_core.model.sensors import CameraIntrinsics


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarMount:
    """A 2D LiDAR on the robot. Its mirror turns at ``rate_hz``; the beams cover part of a turn."""

    T_base_lidar: FloatArray
    beams: int = 682
    angle_increment_rad: float = 2.0 * np.pi / 1024.0
    rate_hz: float = 10.0
    range_min_m: float = 0.06
    range_max_m: float = 5.6
    frame_id: str = "laser"

    @property
    def angle_min_rad(self) -> float:
        """The beams lie symmetric about straight ahead."""
        return -0.5 * (self.beams - 1) * self.angle_increment_rad

    @property
    def time_increment_s(self) -> float:
        """Time between two beams of a turning mirror."""
        return self.angle_increment_rad / (2.0 * np.pi * self.rate_hz)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraMount:
    """An RGB-D camera on the robot, its topics below ``namespace``."""

    namespace: str
    frame_id: str
    intrinsics: CameraIntrinsics
    T_base_optical: FloatArray

    @property
    def depth_topic(self) -> str:
        return f"{self.namespace}/depth/image_raw"

    @property
    def color_topic(self) -> str:
        return f"{self.namespace}/color/image_raw"

    @property
    def info_topic(self) -> str:
        return f"{self.namespace}/depth/camera_info"

    def scaled(self, scale: float) -> "CameraMount":
        """The same camera with ``scale`` times as many pixels a side (integers are centres)."""
        full = self.intrinsics
        intrinsics = replace(
            full,
            width=round(full.width * scale),
            height=round(full.height * scale),
            fx=full.fx * scale,
            fy=full.fy * scale,
            cx=(full.cx + 0.5) * scale - 0.5,
            cy=(full.cy + 0.5) * scale - 0.5,
        )
        return replace(self, intrinsics=intrinsics)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorMounts:
    """A LiDAR and its cameras, leftmost first.

    ``camera_yaw_rad``: azimuth of the camera, or of the whole camera rig, positive to the left of
    the LiDAR's zero. ``T_base_rig``: the frame in which a camera rig is calibrated.
    """

    lidar: LidarMount
    cameras: tuple[CameraMount, ...]
    camera_yaw_rad: float
    T_base_rig: FloatArray

    def scaled(self, scale: float) -> "SensorMounts":
        """The same mounts with scaled images."""
        return replace(self, cameras=tuple(camera.scaled(scale) for camera in self.cameras))

    def T_lidar_camera(self) -> FloatArray:
        """(C, 4, 4) optical frames in the LiDAR's."""
        T_lidar_base = invert_transform(self.lidar.T_base_lidar)
        return np.stack([T_lidar_base @ camera.T_base_optical for camera in self.cameras])


def _lidar(height_m: float, forward_m: float = 0.0) -> LidarMount:
    return LidarMount(T_base_lidar=make_transform(np.eye(3), np.array([forward_m, 0.0, height_m])))


def _single_camera(
    *,
    lidar_height_m: float,
    position_m: Sequence[float],
    yaw_deg: float,
    focal_px: float,
) -> SensorMounts:
    yaw_rad = float(np.radians(yaw_deg))
    body = rotation_from_yaw_pitch_roll(yaw_rad, 0.0, 0.0)
    T_base_optical = make_transform(body @ R_BODY_OPTICAL, np.array(position_m))
    camera = CameraMount(
        namespace="/camera",
        frame_id="camera_depth_optical_frame",
        intrinsics=CameraIntrinsics(
            width=320,
            height=240,
            fx=focal_px,
            fy=focal_px,
            cx=159.5,
            cy=119.5,
            distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
        ),
        T_base_optical=T_base_optical,
    )
    return SensorMounts(
        lidar=_lidar(lidar_height_m),
        cameras=(camera,),
        camera_yaw_rad=yaw_rad,
        T_base_rig=np.eye(4),
    )


@cache
def home_robot() -> SensorMounts:
    """A camera high above a LiDAR, turned 7° to the left, 5 cm ahead and 3 cm to the left."""
    return _single_camera(
        lidar_height_m=0.31, position_m=(0.05, 0.03, 0.92), yaw_deg=7.0, focal_px=288.0
    )


@cache
def turtlebot_high() -> SensorMounts:
    """Xu 2024 Fig. 2b: a Kinect at 0.96 m over a LiDAR at 0.25 m (structured light, half size)."""
    return _single_camera(
        lidar_height_m=0.25, position_m=(-0.08, -0.02, 0.96), yaw_deg=-3.0, focal_px=287.5
    )


@cache
def turtlebot_low() -> SensorMounts:
    """Xu 2024 Fig. 2c: a Kinect at 0.25 m under a LiDAR at 0.31 m (structured light, half size)."""
    return _single_camera(
        lidar_height_m=0.31, position_m=(0.06, 0.01, 0.25), yaw_deg=4.0, focal_px=287.5
    )


@cache
def turtlebot2() -> SensorMounts:
    """Li 2022, section 4.1: an RPLIDAR A1 at 0.30 m and an Astra Pro at 0.45 m on a Turtlebot2.

    From Tables 1 and 2: 360° at 5.5 Hz, a beam a degree, 0.15-12 m; 58.4° x 45.5° (here 320 x
    240 pixels). The camera looks down by 10°, so that it sees the floor from 0.7 m on.
    """
    pitch_rad = float(np.radians(10.0))
    body = rotation_from_yaw_pitch_roll(0.0, pitch_rad, 0.0)
    camera = CameraMount(
        namespace="/camera",
        frame_id="camera_depth_optical_frame",
        intrinsics=CameraIntrinsics(
            width=320,
            height=240,
            fx=160.0 / float(np.tan(np.radians(29.2))),
            fy=120.0 / float(np.tan(np.radians(22.75))),
            cx=159.5,
            cy=119.5,
            distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
        ),
        T_base_optical=make_transform(body @ R_BODY_OPTICAL, np.array([0.08, 0.0, 0.45])),
    )
    lidar = LidarMount(
        T_base_lidar=make_transform(np.eye(3), np.array([0.0, 0.0, 0.3])),
        beams=360,
        angle_increment_rad=2.0 * np.pi / 360.0,
        rate_hz=5.5,
        range_min_m=0.15,
        range_max_m=12.0,
    )
    return SensorMounts(lidar=lidar, cameras=(camera,), camera_yaw_rad=0.0, T_base_rig=np.eye(4))


@cache
def turtlebot2_short() -> SensorMounts:
    """The same with a LiDAR that reaches 5.6 m only: of a larger room it never sees all walls."""
    mounts = turtlebot2()
    return replace(mounts, lidar=replace(mounts.lidar, range_max_m=5.6))


@cache
def office_robot() -> SensorMounts:
    """Fu 2024, section 4.1: an RPLIDAR A1 and an Orbbec camera on a small vehicle.

    From the text: 400 beams of 0.9°, 15 turns a second, up to 12 m (beyond, no error is stated);
    a field of view of 58.4° x 45.5°. 640 x 480 pixels are the usual setting of that camera. The
    camera's place is the paper's Table 2, P_camera = R P_lidar + t, with R made a rotation: its
    second row says that the LiDAR's z points down, so that LiDAR was mounted upside down (our
    reading). In our axes the camera is 10 cm ahead of the LiDAR, 17 cm to its left and 2 cm below
    it, and looks down by 20°, to the left by 3°. The LiDAR's height, 0.40 m, is ours.
    """
    printed = np.array(
        [[0.0405, 0.9981, 0.0478], [-0.3506, -0.0305, 0.9361], [0.9356, -0.0548, 0.3485]]
    )
    u, _, vt = np.linalg.svd(printed)
    T_camera_printed = make_transform(u @ vt, np.array([0.1672, 0.0152, -0.1108]))
    T_printed_lidar = make_transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    T_base_lidar = make_transform(np.eye(3), np.array([0.0, 0.0, 0.4]))
    T_base_optical = T_base_lidar @ invert_transform(T_camera_printed @ T_printed_lidar)
    camera = CameraMount(
        namespace="/camera",
        frame_id="camera_depth_optical_frame",
        intrinsics=CameraIntrinsics(
            width=640,
            height=480,
            fx=320.0 / float(np.tan(np.radians(29.2))),
            fy=240.0 / float(np.tan(np.radians(22.75))),
            cx=319.5,
            cy=239.5,
            distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
        ),
        T_base_optical=T_base_optical,
    )
    lidar = LidarMount(
        T_base_lidar=T_base_lidar,
        beams=400,
        angle_increment_rad=2.0 * np.pi / 400.0,
        rate_hz=15.0,
        range_min_m=0.15,
        range_max_m=12.0,
    )
    yaw_rad = float(np.arctan2(T_base_optical[1, 2], T_base_optical[0, 2]))
    return SensorMounts(
        lidar=lidar, cameras=(camera,), camera_yaw_rad=yaw_rad, T_base_rig=np.eye(4)
    )


@cache
def robot_at_home() -> SensorMounts:
    """The rig of Robot@Home: four Xtions in portrait over a LiDAR at 0.31 m.

    Each camera is rolled by -90°: a stored image is landscape, its columns run upwards. The whole
    rig is turned by 2.5° against the LiDAR, which the published calibration does not contain.
    """
    yaw_rad = float(np.radians(2.5))
    middle_m = np.array([0.26, 0.0, 1.045])
    T_base_rig = make_transform(rotation_from_yaw_pitch_roll(yaw_rad, 0.0, 0.0), middle_m)
    # From the robot's base, as published, with the LiDAR at (0.205, 0, 0.31).
    places = [
        ((0.271, 0.031, 1.045), 45.0),
        ((0.285, 0.0, 1.045), 0.0),
        ((0.271, -0.031, 1.045), -45.0),
        ((0.240, -0.045, 1.045), -90.0),
    ]
    intrinsics = CameraIntrinsics(
        width=320,
        height=240,
        fx=286.441384,
        fy=271.36999,
        cx=157.3245865,
        cy=120.0802295,
        distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
    )
    cameras = []
    for number, (position_m, yaw_deg) in enumerate(places, start=1):
        body = rotation_from_yaw_pitch_roll(float(np.radians(yaw_deg)), 0.0, -0.5 * np.pi)
        T_rig_optical = make_transform(body @ R_BODY_OPTICAL, np.array(position_m) - middle_m)
        cameras.append(
            CameraMount(
                namespace=f"/camera_{number}",
                frame_id=f"camera_{number}_depth_optical_frame",
                intrinsics=intrinsics,
                T_base_optical=T_base_rig @ T_rig_optical,
            )
        )
    return SensorMounts(
        lidar=_lidar(0.31, forward_m=0.205),
        cameras=tuple(cameras),
        camera_yaw_rad=yaw_rad,
        T_base_rig=T_base_rig,
    )
