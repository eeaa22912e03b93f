"""Recordings of a small simulated turn, whole and with something wrong."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.sensors import JointSample, PointCloud, Transform, TransformBatch
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from fusion_core.simulation.spinning_lidar import SpinningLidarSettings
from fusion_core.simulation.turning_rig import (
    T_AXIS_LIDAR_NOMINAL,
    TurningRigData,
    TurningRigSettings,
    simulate_turning_rig,
)


@cache
def small_turn(*, steps: bool = False, turn_deg: float = 360.0) -> TurningRigData:
    """A turn of few beams."""
    lidar = SpinningLidarSettings(columns=200, range_sigma_m=0.01)
    settings = TurningRigSettings(
        lidar=lidar, turn_s=9.3, steps=steps, turn_deg=turn_deg, image_scale=0.05
    )
    return simulate_turning_rig(settings, 5)


@dataclass(frozen=True, kw_only=True)
class TurnFile:
    """A turn and how it is written. ``mounting``: in /tf_static, None for none. ``axis``: what
    tells its angle: joint, tf or none. ``change_points``: of the (N, 3) points of one cloud.
    ``instants``: whether points have their own."""

    turn_deg: float = 360.0
    steps: bool = False
    mounting: np.ndarray | None = field(default_factory=lambda: T_AXIS_LIDAR_NOMINAL)
    axis: str = "joint"
    angle_scale: float = 1.0
    change_points: Callable[[np.ndarray], np.ndarray] | None = None
    instants: bool = True

    @property
    def data(self) -> TurningRigData:
        return small_turn(steps=self.steps, turn_deg=self.turn_deg)

    def write(self, path: Path) -> Path:
        with Ros2McapWriter(path) as writer:
            self._write_axis(writer)
            for scan in self.data.scans:
                xyz_m = scan.points_m
                if self.change_points is not None:
                    xyz_m = self.change_points(xyz_m).astype(np.float32)
                cloud = PointCloud(
                    stamp_ns=scan.stamp_ns,
                    received_ns=scan.stamp_ns + NS_PER_S // 10,
                    frame_id="lidar",
                    xyz_m=xyz_m,
                    intensity=scan.intensity,
                    offsets_s=scan.offsets_s.astype(np.float64) if self.instants else None,
                )
                writer.write_point_cloud("/points", cloud)
        return path

    def _write_axis(self, writer: Ros2McapWriter) -> None:
        stamps_ns = self.data.joint_stamps_ns.tolist()
        if self.mounting is not None:
            mounted = Transform(
                stamp_ns=stamps_ns[0], parent="axis", child="lidar", T_parent_child=self.mounting
            )
            batch = TransformBatch(received_ns=stamps_ns[0], transforms=(mounted,))
            writer.write_transforms("/tf_static", batch)
        angles_rad = (self.angle_scale * self.data.joint_angles_rad).tolist()
        for stamp_ns, angle_rad in zip(stamps_ns, angles_rad, strict=True):
            if self.axis == "joint":
                # A driver's angles go round, and a robot has other joints.
                wrapped = np.array([np.mod(angle_rad + np.pi, 2.0 * np.pi) - np.pi, 0.1])
                joint = JointSample(
                    stamp_ns=stamp_ns,
                    received_ns=stamp_ns,
                    names=("turn", "still"),
                    positions=wrapped,
                    velocities=None,
                )
                writer.write_joint_state("/joint_states", joint)
            elif self.axis == "tf":
                turned = make_transform(
                    rotation_from_yaw_pitch_roll(angle_rad, 0.0, 0.0), np.array([1.0, 2.0, 3.0])
                )
                pose = Transform(
                    stamp_ns=stamp_ns, parent="base", child="axis", T_parent_child=turned
                )
                batch = TransformBatch(received_ns=stamp_ns, transforms=(pose,))
                writer.write_transforms("/tf", batch)
