"""Recordings whose /tf_static puts the camera where it is not."""

import numpy as np

from fusion_core.model.geometry import rotation_from_yaw_pitch_roll, transform
from tests.hostile.drive import T_BASE_CAMERA, write_drive


def moved_mount(path, *, forward_m=0.0, left_m=0.0, up_m=0.0, turned_rad=0.0, **drive):
    """The camera is said to be moved from where it is, and turned about the vertical."""
    T_told = T_BASE_CAMERA.copy()
    turn = rotation_from_yaw_pitch_roll(turned_rad, 0.0, 0.0)
    T_told[:3, :3] = turn @ T_told[:3, :3]
    T_told[:3, 3] += np.array([forward_m, left_m, up_m])
    return write_drive(path, T_told=T_told, **drive)


def upright_mount(path, **drive):
    """The camera is said to look straight up."""
    T_told = T_BASE_CAMERA @ transform(
        rotation_from_yaw_pitch_roll(0.0, 0.0, 0.5 * np.pi), np.zeros(3)
    )
    return write_drive(path, T_told=T_told, **drive)
