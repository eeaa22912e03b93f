"""Wheel odometry that drifts."""

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import (
    invert_transform,
    planar_from_transform,
    transform_from_planar,
)
from fusion_core.settings import StageSettings, setting


class OdometryNoise(StageSettings):
    """Errors of wheel odometry. The defaults fit a small robot on a hard floor."""

    distance_scale: float = setting(
        1.02, "Reported over true distance: error of the wheel radius", ge=1e-6, le=10.0
    )
    yaw_drift_rad_per_s: float = setting(
        0.004,
        "Constant drift of the heading: unequal wheel radii",
        unit="rad/s",
        ge=-10.0,
        le=10.0,
    )
    relative_distance_sigma: float = setting(
        0.02, "Standard deviation of a step, per metre of it", ge=0.0, le=10.0
    )
    relative_yaw_sigma: float = setting(
        0.03, "Standard deviation of a turn, per radian of it", ge=0.0, le=10.0
    )


class DriftingOdometry:
    """Accumulates noisy steps between true poses, starting at the identity."""

    def __init__(self, noise: OdometryNoise, rng: np.random.Generator) -> None:
        self._noise = noise
        self._rng = rng
        self._before: tuple[float, FloatArray] | None = None
        self._T_odom_base = np.eye(4)

    def kidnap(self, time_s: float, pose: FloatArray) -> None:
        """Move the robot to ``pose`` without a step of its odometry."""
        self._before = (time_s, transform_from_planar(pose))

    def step(self, time_s: float, pose: FloatArray, slip: float = 1.0) -> FloatArray:
        """(4, 4) T_odom_base at ``time_s``, from the true (x, y, yaw); times must increase.

        ``slip``: ratio of the distance by the wheels' rotation to the true one, 1 without slip.
        """
        T_map_base = transform_from_planar(pose)
        if self._before is not None:
            time_before_s, T_map_before = self._before
            moved = planar_from_transform(invert_transform(T_map_before) @ T_map_base)
            draw = self._rng.standard_normal(2)
            scale = self._noise.distance_scale + self._noise.relative_distance_sigma * draw[0]
            turn = moved[2] * (1.0 + self._noise.relative_yaw_sigma * draw[1])
            turn += self._noise.yaw_drift_rad_per_s * (time_s - time_before_s)
            reported = np.array([moved[0] * scale * slip, moved[1] * scale * slip, turn])
            self._T_odom_base = self._T_odom_base @ transform_from_planar(reported)
        self._before = (time_s, T_map_base)
        return self._T_odom_base.copy()
