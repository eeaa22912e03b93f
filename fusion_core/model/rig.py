"""The rig: cameras on one frame, and how that frame sits on the LiDAR (the mount)."""

from dataclasses import dataclass, replace

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray, read_only
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.sensors import CameraIntrinsics


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A depth camera as the stages see it: upright, without distortion.

    ``T_rig_camera``: (4, 4), optical frame of the upright view to the rig frame (x forward,
    z up). ``calibrated`` is False where the intrinsics are an assumed field of view.
    """

    topic: str
    intrinsics: CameraIntrinsics
    T_rig_camera: FloatArray
    calibrated: bool = True

    def __post_init__(self) -> None:
        if self.T_rig_camera.shape != (4, 4):
            raise ValueError(f"T_rig_camera must be (4, 4), got {self.T_rig_camera.shape}")
        read_only(self.T_rig_camera)

    @property
    def yaw_rad(self) -> float:
        """Azimuth of the optical axis in the rig frame."""
        return float(np.arctan2(self.T_rig_camera[1, 2], self.T_rig_camera[0, 2]))

    def rolled(self, roll_rad: float) -> "Camera":
        """The camera on a rig that is rolled about its x, the left side up where positive."""
        R_rig_level = rotation_from_yaw_pitch_roll(0.0, 0.0, roll_rad)
        T_rig_camera: FloatArray = make_transform(R_rig_level, np.zeros(3)) @ self.T_rig_camera
        return replace(self, T_rig_camera=T_rig_camera)

    def rays(self, rows: FloatArray | IntArray, columns: FloatArray | IntArray) -> FloatArray:
        """(..., 3) points of pixels at 1 m along the optical axis, in the optical frame."""
        intrinsics = self.intrinsics
        x, y = (columns - intrinsics.cx) / intrinsics.fx, (rows - intrinsics.cy) / intrinsics.fy
        return np.stack([x, y, np.ones(np.shape(x))], axis=-1)

    def column_azimuths_rad(self, columns: FloatArray) -> FloatArray:
        """Azimuth about the optical axis of pixel columns, positive to the left, level camera."""
        return np.arctan2(self.intrinsics.cx - columns, self.intrinsics.fx)


MOUNT_PARAMETERS = (
    "yaw_rad",
    "delta_z_m",
    "forward_m",
    "left_m",
    "pitch_rad",
    "clock_offset_ms",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mount:
    """Where the rig sits on the LiDAR, and how late its clock is.

    yaw is positive where the rig looks to the left of the LiDAR's zero, pitch where it looks
    down; the rig's origin lies ``forward_m``, ``left_m`` and ``delta_z_m`` (above) from the
    LiDAR's. ``clock_offset_ms`` = camera stamp - LiDAR stamp of the same instant.
    ``sd``: one standard deviation for each of MOUNT_PARAMETERS, None where the recording does
    not show it.
    """

    yaw_rad: float
    delta_z_m: float = 0.0
    forward_m: float = 0.0
    left_m: float = 0.0
    pitch_rad: float = 0.0
    clock_offset_ms: float = 0.0
    sd: tuple[float | None, ...] = (None,) * len(MOUNT_PARAMETERS)

    @classmethod
    def from_vector(cls, values: FloatArray, sd: tuple[float | None, ...] | None = None) -> "Mount":
        """From the values in the order of MOUNT_PARAMETERS."""
        yaw, delta_z, forward, left, pitch, clock_offset = map(float, values)
        return cls(
            yaw_rad=yaw,
            delta_z_m=delta_z,
            forward_m=forward,
            left_m=left,
            pitch_rad=pitch,
            clock_offset_ms=clock_offset,
            sd=(None,) * len(MOUNT_PARAMETERS) if sd is None else sd,
        )

    def vector(self) -> FloatArray:
        """The values in the order of MOUNT_PARAMETERS."""
        return np.array([getattr(self, name) for name in MOUNT_PARAMETERS])

    @property
    def T_lidar_rig(self) -> FloatArray:
        """(4, 4): rig coordinates to the LiDAR's."""
        return make_transform(
            rotation_from_yaw_pitch_roll(self.yaw_rad, self.pitch_rad, 0.0),
            np.array([self.forward_m, self.left_m, self.delta_z_m]),
        )
