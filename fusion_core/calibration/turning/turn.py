"""The points of a LiDAR on a turning axis, and the dense cloud that they assemble to.

Frames: ``lidar`` is the LiDAR's own; ``axis`` turns with the axis, which is its z; ``rig`` does not
turn, and is ``axis`` at the angle 0 (O-XYZ of Song 2022, Fig. 1).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fusion_core.model.conventions import FloatArray, IntArray, read_only
from fusion_core.model.geometry import make_transform, transform_points

SELF_CALIBRATION_PARAMETERS = ("theta_rad", "beta_rad", "delta_x_m", "delta_y_m")
"""The order of Song's θ, β, Δx, Δy in vectors and covariances."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """Points of one turn. ``points_in_lidar_m``: (N, 3) finite. ``axis_angles_rad``: (N,) of the
    axis when each was measured. ``scan_indices``: (N,) which scan each belongs to.

    ``T_axis_lidar_nominal``: (4, 4) the mounting by design, from which θ, β, Δx, Δy deviate.
    """

    points_in_lidar_m: FloatArray
    axis_angles_rad: FloatArray
    scan_indices: IntArray
    T_axis_lidar_nominal: FloatArray

    def __post_init__(self) -> None:
        count = len(self.points_in_lidar_m)
        if self.axis_angles_rad.shape != (count,) or self.scan_indices.shape != (count,):
            raise ValueError(f"{count} points need as many angles and scans")
        for array in (
            self.points_in_lidar_m,
            self.axis_angles_rad,
            self.scan_indices,
            self.T_axis_lidar_nominal,
        ):
            read_only(array)

    def subset(self, chosen: IntArray) -> "Turn":
        """Some of the points."""
        return Turn(
            points_in_lidar_m=self.points_in_lidar_m[chosen],
            axis_angles_rad=self.axis_angles_rad[chosen],
            scan_indices=self.scan_indices[chosen],
            T_axis_lidar_nominal=self.T_axis_lidar_nominal,
        )

    def in_axis(self, parameters: FloatArray) -> FloatArray:
        """(N, 3) points in ``axis`` with a mounting of (θ, β, Δx, Δy)."""
        return transform_points(self.mounting(parameters), self.points_in_lidar_m)

    def in_rig(self, parameters: FloatArray) -> FloatArray:
        """(N, 3) the dense cloud with a mounting of (θ, β, Δx, Δy)."""
        return rotate_about_z(self.in_axis(parameters), self.axis_angles_rad)

    def mounting(self, parameters: FloatArray) -> FloatArray:
        """(4, 4) T_axis_lidar of (θ, β, Δx, Δy)."""
        return apply_mounting_error(self.T_axis_lidar_nominal, parameters)


def apply_mounting_error(T_axis_lidar_nominal: FloatArray, parameters: FloatArray) -> FloatArray:
    """(4, 4) T_axis_lidar by Song's (1): R' = Rx(θ) Ry(β) on the nominal rotation, and (Δx, Δy, 0).

    R'_x of (1) is Rx(θ). R'_y is printed with cosines only; by analogy it is Ry(β).
    """
    theta, beta, delta_x, delta_y = (float(value) for value in parameters)
    tilt = Rotation.from_euler("XY", [theta, beta]).as_matrix()
    return make_transform(
        tilt @ T_axis_lidar_nominal[:3, :3],
        T_axis_lidar_nominal[:3, 3] + np.array([delta_x, delta_y, 0.0]),
    )


def rotate_about_z(points_m: FloatArray, angles_rad: FloatArray | float) -> FloatArray:
    """(N, 3) each rotated by its angle."""
    c, s = np.cos(angles_rad), np.sin(angles_rad)
    x, y, z = points_m.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)
