"""Recordings whose /tf_static has a wrong pose of the camera."""

import numpy as np

from fusion_core.model.geometry import rotation_from_yaw_pitch_roll
from tests.hostile.drive import T_BASE_CAMERA, write_drive


def moved_mount(
    path, *, forward_m=0.0, left_m=0.0, up_m=0.0, yaw_error_rad=0.0, pitch_error_rad=0.0, **drive
):
    """A drive whose recorded mount differs from the true one: by a translation in the base frame,
    a yaw and an upward pitch."""
    T_recorded = T_BASE_CAMERA.copy()
    turn = rotation_from_yaw_pitch_roll(yaw_error_rad, 0.0, 0.0)
    # About the optical axes' x, which points to the right.
    raised = rotation_from_yaw_pitch_roll(0.0, 0.0, pitch_error_rad)
    T_recorded[:3, :3] = turn @ T_recorded[:3, :3] @ raised
    T_recorded[:3, 3] += np.array([forward_m, left_m, up_m])
    return write_drive(path, T_recorded=T_recorded, **drive)
