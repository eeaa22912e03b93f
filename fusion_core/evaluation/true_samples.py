"""How beams and pixels count as samples of the curve and of the row that were searched, by the true
mount."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fusion_core.evaluation.associated_truth import AssociatedTruth
from fusion_core.evaluation.fuse_folder import FuseFolder, RecordedLidar
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.geometry import invert_transform, make_transform, transform_points
from fusion_core.model.polar import unwrap_towards
from fusion_core.model.sweep import is_full_circle

# The distance at which the panorama's ends are taken: beyond a rig's baselines, within a room.
_PANORAMA_END_M = 2.0


class TrueRow(Protocol):
    """How beams and pixels count as samples of the curve and of the row that was searched."""

    def of_beams(self, angle_rad: FloatArray) -> FloatArray:
        """Samples of beams at azimuths in the LiDAR frame."""

    def of_pixels(
        self, camera: int, row: IntArray, column: IntArray, in_lidar: FloatArray
    ) -> FloatArray:
        """Samples of a camera's stored pixels, whose points are (N, 3) in the LiDAR frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _RowOfAngles:
    """Samples on equal azimuths about the rig's origin."""

    associated: AssociatedTruth
    T_lidar_rig: FloatArray
    left_rad: float
    step_rad: float

    def of_beams(self, angle_rad: FloatArray) -> FloatArray:
        left_rad = _curve_left_rad(self.associated, self.step_rad)
        return (left_rad - angle_rad) / self.step_rad

    def of_pixels(
        self, camera: int, row: IntArray, column: IntArray, in_lidar: FloatArray
    ) -> FloatArray:
        in_rig = transform_points(invert_transform(self.T_lidar_rig), in_lidar)
        azimuth_rad = np.arctan2(in_rig[:, 1], in_rig[:, 0])
        return (self.left_rad - azimuth_rad) / self.step_rad


@dataclass(frozen=True, slots=True, kw_only=True)
class _RowOfColumns:
    """Every k-th beam, and every k-th column of the images pasted beside each other.

    ``first_column``: of each camera in the wide image; ``columns`` its width. ``turn_samples``:
    samples of a full circle, infinite where the curve has ends.
    """

    associated: AssociatedTruth
    first_column: list[int]
    columns: int
    samples: int
    curve_samples: int
    turn_samples: float

    def of_beams(self, angle_rad: FloatArray) -> FloatArray:
        angles = self.associated.beam_angle_rad
        from_left_rad: FloatArray = angles.max() - angle_rad
        if np.isfinite(self.turn_samples):
            return from_left_rad * (self.turn_samples / (2.0 * np.pi))
        return from_left_rad / np.ptp(angles) * (self.curve_samples - 1)

    def of_pixels(
        self, camera: int, row: IntArray, column: IntArray, in_lidar: FloatArray
    ) -> FloatArray:
        upright = self.associated.cameras[camera].upright_column(row, column)
        step = (self.columns - 1) / (self.samples - 1)
        return (self.first_column[camera] + upright) / step


def true_row(associated: AssociatedTruth, folder: FuseFolder) -> TrueRow:
    """The row that a run searched."""
    panorama = folder.alignment.get("panorama")
    if panorama is None or panorama["sampled_by"] == "angle":
        T_lidar_rig = _true_rig(associated)
        return _RowOfAngles(
            associated=associated,
            T_lidar_rig=T_lidar_rig,
            left_rad=_row_left_rad(associated, T_lidar_rig, folder.lidar),
            step_rad=_step_rad(folder.lidar),
        )
    first_column = [0] * len(associated.cameras)
    columns = 0
    for topic in panorama["cameras"]:
        camera = folder.topics.index(topic)
        first_column[camera] = columns
        columns += associated.cameras[camera].upright_width
    return _RowOfColumns(
        associated=associated,
        first_column=first_column,
        columns=columns,
        samples=int(panorama["samples"]),
        curve_samples=folder.lidar.samples,
        turn_samples=turn_samples(folder.lidar),
    )


def _step_rad(lidar: RecordedLidar) -> float:
    """Angular width of one LiDAR sample: Psi of them cover the beams' field of view."""
    return abs(lidar.angle_increment_rad) * lidar.beams / lidar.samples


def _curve_left_rad(associated: AssociatedTruth, step_rad: float) -> float:
    """Azimuth of LiDAR sample 0: half a sample inside the left end of the field of view."""
    angles = associated.beam_angle_rad
    half_beam_rad = 0.5 * abs(angles[1] - angles[0])
    return float(angles.max() + half_beam_rad - 0.5 * step_rad)


def _true_rig(associated: AssociatedTruth) -> FloatArray:
    """(4, 4) T_lidar_rig, about whose origin the row's azimuths are taken.

    One camera is its own rig, x along its optical axis. Several have theirs at the mean optical
    centre, level, x along their mean heading.
    """
    mounts = [camera.T_lidar_camera for camera in associated.cameras]
    forward = np.sum([mount[:3, 2] for mount in mounts], axis=0)
    if len(mounts) > 1:
        forward[2] = 0.0
    forward = forward / np.linalg.norm(forward)
    left = np.array([-forward[1], forward[0], 0.0]) / np.hypot(forward[0], forward[1])
    axes = np.stack([forward, left, np.cross(forward, left)], axis=-1)
    return make_transform(axes, np.mean([mount[:3, 3] for mount in mounts], axis=0))


def _row_left_rad(
    associated: AssociatedTruth, T_lidar_rig: FloatArray, lidar: RecordedLidar
) -> float:
    """Azimuth in the rig of row sample 0: half a sample inside the image's left edge."""
    edges = []
    for camera in associated.cameras:
        _, _, cx, cy = camera.intrinsics
        _, height, width = camera.truth.depth_mm.shape
        column = np.array([-0.5, width - 0.5, cx, cx])
        row = np.array([cy, cy, -0.5, height - 0.5])
        edge = camera.back_project(row, column, np.full(4, _PANORAMA_END_M))
        in_rig = transform_points(invert_transform(T_lidar_rig) @ camera.T_lidar_camera, edge)
        edges.append(np.arctan2(in_rig[:, 1], in_rig[:, 0]).max())
    return float(max(edges)) - 0.5 * _step_rad(lidar)


def turn_samples(lidar: RecordedLidar) -> float:
    """Samples of one turn of a LiDAR that sees a full circle; infinite where its curve has ends."""
    return lidar.samples if is_full_circle(lidar.beams, lidar.angle_increment_rad) else np.inf


def around_turn(difference: FloatArray, turn: float) -> FloatArray:
    """(N,) differences of offsets, the short way around."""
    return difference if np.isinf(turn) else unwrap_towards(difference, 0.0, turn)
