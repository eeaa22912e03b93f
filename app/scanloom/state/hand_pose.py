"""A camera's pose on the LiDAR as a person sets it: six numbers."""

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fusion_core.model.conventions import R_BODY_OPTICAL, FloatArray
from fusion_core.model.errors import SettingsError
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll

MAX_DISTANCE_M = 20.0
"""No rig is larger."""
# Beyond it the yaw would have no direction.
MAX_PITCH_DEG = 89.0
# Of what is not typed: finer than any calibration.
_DECIMALS_DEG, _DECIMALS_M = 4, 5


class HandPose(BaseModel):
    """The camera whose images are stored, seen from the LiDAR (x ahead, y left, z up): turned by
    R = Rz(yaw) Ry(pitch) Rx(roll), yaw positive to the left, pitch positive down."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    yaw_deg: float = Field(0.0, ge=-180.0, le=180.0)
    pitch_deg: float = Field(0.0, ge=-MAX_PITCH_DEG, le=MAX_PITCH_DEG)
    roll_deg: float = Field(0.0, ge=-180.0, le=180.0)
    forward_m: float = Field(0.0, ge=-MAX_DISTANCE_M, le=MAX_DISTANCE_M)
    left_m: float = Field(0.0, ge=-MAX_DISTANCE_M, le=MAX_DISTANCE_M)
    up_m: float = Field(0.0, ge=-MAX_DISTANCE_M, le=MAX_DISTANCE_M)

    @classmethod
    def of_transform(cls, T_lidar_camera: FloatArray) -> "HandPose":
        """The numbers of a pose (4, 4) of the optical frame, rounded to 0.0001° and 0.01 mm.

        Raises SettingsError for one out of bounds.
        """
        R = T_lidar_camera[:3, :3] @ R_BODY_OPTICAL.T
        yaw, roll = np.arctan2(R[1, 0], R[0, 0]), np.arctan2(R[2, 1], R[2, 2])
        pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
        degrees = np.round(np.rad2deg([yaw, pitch, roll]), _DECIMALS_DEG) + 0.0
        metres = np.round(T_lidar_camera[:3, 3], _DECIMALS_M) + 0.0
        try:
            return cls(
                yaw_deg=float(degrees[0]),
                pitch_deg=float(degrees[1]),
                roll_deg=float(degrees[2]),
                forward_m=float(metres[0]),
                left_m=float(metres[1]),
                up_m=float(metres[2]),
            )
        except ValidationError as error:
            raise SettingsError(
                "The camera is not on the LiDAR's robot by this pose: it looks straight up or "
                f"down, or sits more than {MAX_DISTANCE_M:g} m away.",
                advice="Check the transforms of the recording.",
            ) from error

    @property
    def T_lidar_camera(self) -> FloatArray:
        """(4, 4): the optical frame of the stored images to the LiDAR's frame."""
        angles_rad = np.deg2rad([self.yaw_deg, self.pitch_deg, self.roll_deg])
        R = rotation_from_yaw_pitch_roll(*map(float, angles_rad)) @ R_BODY_OPTICAL
        return make_transform(R, np.array([self.forward_m, self.left_m, self.up_m]))
