"""Recordings whose /tf_static puts the camera where it is not."""

import numpy as np

from fusion_core.model.geometry import rotation_from_yaw_pitch_roll
from tests.hostile.drive import T_BASE_CAMERA, write_drive


def moved_mount(
    path, *, forward_m=0.0, left_m=0.0, up_m=0.0, turned_rad=0.0, raised_rad=0.0, **drive
):
    """The camera is said to be moved from where it is, turned about the vertical, and to look
    higher than it does."""
    T_told = T_BASE_CAMERA.copy()
    turn = rotation_from_yaw_pitch_roll(turned_rad, 0.0, 0.0)
    # About the optical axes' x, which points to the right.
    raised = rotation_from_yaw_pitch_roll(0.0, 0.0, raised_rad)
    T_told[:3, :3] = turn @ T_told[:3, :3] @ raised
    T_told[:3, 3] += np.array([forward_m, left_m, up_m])
    return write_drive(path, T_told=T_told, **drive)
