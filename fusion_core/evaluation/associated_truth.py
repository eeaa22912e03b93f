"""The truth associated with a result folder: by stamps, with the true geometry of each camera."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion_core.evaluation.fuse_folder import FuseFolder, RecordedCamera
from fusion_core.evaluation.truth import CameraTruth, Truth
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.geometry import invert_transform, transform_points

SAME_SURFACE_M = 0.10
"""True horizontal ranges that differ by less belong to one surface (a good pair)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueCamera:
    """A depth camera with its truth and its true geometry."""

    topic: str
    truth: CameraTruth
    intrinsics: tuple[float, float, float, float]
    T_lidar_camera: FloatArray

    @property
    def rows_are_level(self) -> bool:
        """Whether the image's rows, not its columns, lie along the LiDAR's plane."""
        return bool(abs(self.T_lidar_camera[2, 0]) <= abs(self.T_lidar_camera[2, 1]))

    @property
    def upright_width(self) -> int:
        """Columns of the image turned upright."""
        _, height, width = self.truth.depth_mm.shape
        return int(width if self.rows_are_level else height)

    def upright_column(self, row: IntArray, column: IntArray) -> IntArray:
        """Columns of stored pixels in the image turned upright, counted from the left."""
        ahead = self.T_lidar_camera[:3, 2]
        right = np.array([ahead[1], -ahead[0], 0.0])
        along, axis = (column, 0) if self.rows_are_level else (row, 1)
        runs_right = float(right @ self.T_lidar_camera[:3, axis]) > 0.0
        return along if runs_right else self.upright_width - 1 - along

    def back_project(
        self, row: FloatArray | IntArray, column: FloatArray | IntArray, depth_m: FloatArray
    ) -> FloatArray:
        """(..., 3) points in the optical frame of pixels with a depth."""
        fx, fy, cx, cy = self.intrinsics
        ray = np.stack([(column - cx) / fx, (row - cy) / fy, np.ones(np.shape(row))], axis=-1)
        points: FloatArray = ray * depth_m[..., np.newaxis]
        return points

    def horizontal_range_m(
        self, row: IntArray, column: IntArray, depth_m: FloatArray
    ) -> FloatArray:
        """Distance in the LiDAR's plane, from its origin, of pixels with a depth."""
        points = transform_points(self.T_lidar_camera, self.back_project(row, column, depth_m))
        return np.hypot(points[..., 0], points[..., 1])

    def project(self, points_in_lidar: FloatArray) -> tuple[IntArray, IntArray, BoolArray]:
        """Nearest row and column of (..., 3) points, and whether they lie in the image.

        Row and column are 0 where the point does not.
        """
        fx, fy, cx, cy = self.intrinsics
        x, y, z = np.moveaxis(
            transform_points(invert_transform(self.T_lidar_camera), points_in_lidar), -1, 0
        )
        ahead = z > 0.0  # NaN compares false.
        depth_m = np.where(ahead, z, 1.0)
        _, height, width = self.truth.depth_mm.shape
        column = np.rint(fx * x / depth_m + cx)
        row = np.rint(fy * y / depth_m + cy)
        inside = ahead & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return (
            np.where(inside, row, 0).astype(np.int64),
            np.where(inside, column, 0).astype(np.int64),
            inside,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class AssociatedTruth:
    """The truth of the recording behind a result folder, ``cameras`` in the folder's order.

    ``beam_angle_rad``: (N,) azimuth of each beam.
    """

    truth: Truth
    beam_angle_rad: FloatArray
    cameras: tuple[TrueCamera, ...]

    def scan_index(self, stamp_ns: IntArray) -> IntArray:
        """Positions of scans in the truth. Raises ScanLoomError for a stamp that it lacks."""
        return indices_of_stamps(self.truth.scan_stamp_ns, stamp_ns, "scan", self.truth.file)

    def image_index(self, camera: IntArray, stamp_ns: IntArray) -> IntArray:
        """Positions of depth images in their camera's truth. Raises as ``scan_index``."""
        positions = np.zeros(stamp_ns.shape, dtype=np.int64)
        for code, own in enumerate(self.cameras):
            mine = camera == code
            positions[mine] = indices_of_stamps(
                own.truth.stamp_ns, stamp_ns[mine], "depth image", self.truth.file
            )
        return positions


def associate_truth(truth: Truth, folder: FuseFolder) -> AssociatedTruth:
    """Find the truth of the folder's cameras. Angles and intrinsics that it lacks are the recorded.

    Raises ScanLoomError where the two are of different recordings, or the truth has no mount.
    """
    return AssociatedTruth(
        truth=truth,
        beam_angle_rad=beam_angles_rad(truth, folder),
        cameras=tuple(_true_camera(truth, recorded, folder) for recorded in folder.cameras),
    )


def _true_camera(truth: Truth, recorded: RecordedCamera, folder: FuseFolder) -> TrueCamera:
    own = _truth_of_camera(truth, recorded, alone=len(folder.cameras) == 1)
    if own.depth_mm.shape[1:] != (recorded.height, recorded.width):
        raise ScanLoomError(
            f"has images of {own.depth_mm.shape[2]} x {own.depth_mm.shape[1]} pixels, "
            f"{recorded.topic} has {recorded.width} x {recorded.height}.",
            file=truth.file,
            advice=_OTHER_RECORDING,
        )
    if own.T_lidar_camera is None:
        raise ScanLoomError(
            f"has no mount of the camera {recorded.topic}.",
            file=truth.file,
            advice="Give the lever arm and the heights by hand.",
        )
    intrinsics = own.intrinsics if own.intrinsics is not None else recorded.intrinsics
    if intrinsics is None:
        raise ScanLoomError(
            f"has no intrinsics of {recorded.topic}, nor has the recording.",
            file=truth.file,
            advice="Write the truth with its array 'intrinsics'.",
        )
    return TrueCamera(
        topic=recorded.topic,
        truth=own,
        intrinsics=intrinsics,
        T_lidar_camera=own.T_lidar_camera,
    )


_OTHER_RECORDING = "Give the truth of this recording."


def _truth_of_camera(truth: Truth, recorded: RecordedCamera, *, alone: bool) -> CameraTruth:
    """By topic; a truth of one camera without a topic fits a folder of one camera."""
    for own in truth.cameras:
        if own.topic == recorded.topic:
            return own
    if alone and len(truth.cameras) == 1 and truth.cameras[0].topic is None:
        return truth.cameras[0]
    raise ScanLoomError(
        f"has no camera {recorded.topic}.", file=truth.file, advice=_OTHER_RECORDING
    )


def beam_angles_rad(truth: Truth, folder: FuseFolder) -> FloatArray:
    """(N,) azimuth of each beam: the truth's, else the recording's."""
    beams = truth.range_m.shape[1]
    if beams != folder.lidar.beams:
        raise ScanLoomError(
            f"has scans of {beams} beams, the recording {folder.lidar.beams}.",
            file=truth.file,
            advice=_OTHER_RECORDING,
        )
    start_rad, step_rad = truth.angle_min_rad, truth.angle_increment_rad
    if start_rad is None or step_rad is None:
        start_rad, step_rad = folder.lidar.angle_min_rad, folder.lidar.angle_increment_rad
    return start_rad + step_rad * np.arange(beams, dtype=np.float64)


def indices_of_stamps(known_ns: IntArray, stamp_ns: IntArray, what: str, file: Path) -> IntArray:
    """Index of each stamp in ``known_ns``, which may be in any order.

    Raises ScanLoomError for a stamp without an exact match.
    """
    order = np.argsort(known_ns, kind="stable")
    place = np.searchsorted(known_ns, stamp_ns, sorter=order)
    found = place < known_ns.size
    positions = order[np.where(found, place, 0)] if known_ns.size else np.zeros_like(stamp_ns)
    found[found] = known_ns[positions[found]] == stamp_ns[found]
    if not found.all():
        raise ScanLoomError(
            f"has no {what} with stamp {stamp_ns[~found][0]} ns.",
            file=file,
            advice=_OTHER_RECORDING,
        )
    return positions
