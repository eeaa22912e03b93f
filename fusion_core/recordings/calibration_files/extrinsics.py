"""Extrinsics from a file: the pose of the LiDAR in a camera's frame.

TOML, JSON or YAML, with one key or two, in metres::

    T_camera_lidar = [[0, -1, 0, 0.02], [0, 0, -1, 0.6], [1, 0, 0, 0.05], [0, 0, 0, 1]]

    R = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    t = [0.02, 0.6, 0.05]

Both map the LiDAR's points to the camera's optical frame (x right, y down, z ahead) as its images
are stored. Several cameras have a table each, by their depth topic::

    [cameras."/camera_1/depth/image_raw"]
    T_camera_lidar = ...

A ``covariance`` (6 x 6, of rotation and translation along the camera's axes, rad and m) beside a
transform says how sure it is; what is not observable has null or nan in its row and column. Other
keys are left alone, so that a calibration's result can be used as it is. Files of others:

- KITTI (``P2``, ``R0_rect``, ``Tr_velo_to_cam``, or ``P2`` and ``Tr`` of its odometry): the camera
  of ``image_2``, whose images are rectified. A point x of the scanner is
  p = R0_rect Tr_velo_to_cam x in the rectified frame of camera 0, and p + b in that of camera 2,
  where P2 = K [I | b]: the result holds the rectifying rotation and the baseline.
- OpenCalib: text with ``K``, ``D`` and ``T`` (3 x 4, row by row), and JSON with ``sensor_calib``,
  which maps points of ``sensor_name`` to ``target_sensor_name``.
- 12 or 16 numbers and nothing else: T_camera_lidar row by row.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import SettingsError
from fusion_core.model.geometry import invert_transform, make_transform, rigid_fault
from fusion_core.model.given_extrinsics import CameraPose, GivenExtrinsics
from fusion_core.model.names import printable
from fusion_core.recordings.calibration_files.document import (
    NUMBERS_ALONE,
    flat_numbers,
    read_document,
)
from fusion_core.recordings.calibration_files.opencalib import opencalib_entry

_ADVICE = (
    "Write T_camera_lidar (4 x 4), or R (3 x 3) and t (3, in metres), which map the LiDAR's points "
    "to the camera's optical frame."
)
# Covariances written with four digits are off by less.
_COVARIANCE_TOLERANCE = 1e-3
# No robot carries sensors this far apart: such a length is in millimetres.
_TRANSLATION_MAX_M = 10.0
_KITTI_TRANSFORMS = ("Tr_velo_to_cam", "Tr_velo_cam", "Tr")
_KITTI_ROTATIONS = ("R0_rect", "R_rect")


def read_extrinsics(path: Path) -> dict[str | None, FloatArray]:
    """T_camera_lidar (4, 4) by depth topic; None is the key of the only camera.

    Raises SettingsError where the file cannot be read or holds no rigid transform.
    """
    return {
        topic: pose.T_camera_lidar for topic, pose in read_given_extrinsics(path).cameras.items()
    }


def read_given_extrinsics(path: Path) -> GivenExtrinsics:
    """The same with the covariances that the file has. Raises as ``read_extrinsics``."""
    cameras = {
        topic: CameraPose(
            T_camera_lidar=_read_transform(table, path, "" if topic is None else f"{topic}: "),
            covariance=(None if table.get("covariance") is None else _read_covariance(table, path)),
        )
        for topic, table in _camera_tables(read_document(path, _ADVICE), path).items()
    }
    return GivenExtrinsics(source=path.name, cameras=cameras, file=path)


def _camera_tables(document: dict[str, Any], path: Path) -> dict[str | None, dict[str, Any]]:
    cameras = document.get("cameras")
    if cameras is None:
        return {None: document}
    if not isinstance(cameras, dict) or not all(isinstance(t, dict) for t in cameras.values()):
        raise SettingsError("cameras must hold a table for each topic.", file=path, advice=_ADVICE)
    if not cameras:
        raise SettingsError("cameras is empty.", file=path, advice=_ADVICE)
    return dict(cameras)


def read_guess(path: Path) -> FloatArray:
    """T_camera_lidar (4, 4) of the only camera in the file. Raises SettingsError."""
    found = read_extrinsics(path)
    if len(found) > 1:
        raise SettingsError(
            f"holds {len(found)} cameras: {', '.join(map(str, found))}.",
            file=path,
            advice="Give a file with one camera alone.",
        )
    return next(iter(found.values()))


def _read_transform(table: dict[str, Any], path: Path, where: str) -> FloatArray:
    where = printable(where)
    opencalib = opencalib_entry(table, "sensor_calib")
    kitti = next((key for key in _KITTI_TRANSFORMS if key in table), None)
    if "T_camera_lidar" in table:
        name, T_camera_lidar = "T_camera_lidar", _read_matrix(table, "T_camera_lidar", (4, 4), path)
    elif "R" in table and "t" in table:
        name = "R"
        T_camera_lidar = make_transform(
            _read_matrix(table, "R", (3, 3), path), _read_matrix(table, "t", (3,), path)
        )
    elif kitti is not None and "P2" in table:
        name, T_camera_lidar = kitti, _kitti_transform(table, kitti, path)
    elif opencalib is not None:
        name = "sensor_calib"
        T_camera_lidar = _read_matrix(opencalib, name, (4, 4), path)
        if _is_lidar(opencalib, "target_sensor_name") and not _is_lidar(opencalib, "sensor_name"):
            _require_rigid(T_camera_lidar, name, path, where)
            T_camera_lidar = invert_transform(T_camera_lidar)
    elif "T" in table:
        name, T_camera_lidar = "T", _read_row_by_row(table, "T", path)
    elif NUMBERS_ALONE in table:
        name, T_camera_lidar = "the matrix", _read_row_by_row(table, NUMBERS_ALONE, path)
    else:
        lacking = "t" if "R" in table else "R" if "t" in table else "T_camera_lidar"
        raise SettingsError(f"{where}{lacking} is missing.", file=path, advice=_ADVICE)
    _require_rigid(T_camera_lidar, name, path, where)
    # The nearest rotation, so that what follows may invert it by its transpose.
    u, _, vt = np.linalg.svd(T_camera_lidar[:3, :3])
    return make_transform(u @ vt, T_camera_lidar[:3, 3].copy())


def _kitti_transform(table: Mapping[str, Any], key: str, path: Path) -> FloatArray:
    P2 = _read_matrix(table, "P2", (3, 4), path)
    T_camera0_lidar = _read_row_by_row(table, key, path)
    _require_rigid(T_camera0_lidar, key, path, "")
    T_rectified_camera0 = np.eye(4)
    rectification = next((name for name in _KITTI_ROTATIONS if name in table), None)
    if rectification is not None:
        T_rectified_camera0[:3, :3] = _read_matrix(table, rectification, (3, 3), path)
        _require_rigid(T_rectified_camera0, rectification, path, "")
    try:
        baseline_m = np.asarray(np.linalg.solve(P2[:, :3], P2[:, 3]), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise SettingsError("P2 is singular.", file=path, advice=_ADVICE) from None
    return make_transform(np.eye(3), baseline_m) @ T_rectified_camera0 @ T_camera0_lidar


def _require_rigid(T: FloatArray, name: str, path: Path, where: str) -> None:
    if fault := rigid_fault(T):
        raise SettingsError(
            f"{where}{name} is no rigid transform: {fault}.",
            file=path,
            advice=_ADVICE,
        )
    farthest_m = float(np.abs(T[:3, 3]).max())
    if farthest_m > _TRANSLATION_MAX_M:
        raise SettingsError(
            f"{where}the sensors are {farthest_m:g} m apart.",
            file=path,
            advice="Lengths are in metres.",
        )


def _is_lidar(entry: Mapping[str, Any], key: str) -> bool:
    return "lidar" in str(entry.get(key)).lower()


def _read_row_by_row(table: Mapping[str, Any], name: str, path: Path) -> FloatArray:
    """(4, 4) from 12 or 16 numbers."""
    rows = 4 if _count_numbers(table[name]) == 16 else 3
    matrix = _read_matrix(table, name, (rows, 4), path)
    return matrix if rows == 4 else make_transform(matrix[:, :3], matrix[:, 3])


def _one_line(value: object) -> str:
    return " ".join(str(value).split())[:80]


def _count_numbers(value: object) -> int:
    try:
        return flat_numbers(value).size
    except ValueError:
        return 0


def _read_matrix(
    table: Mapping[str, Any], name: str, shape: tuple[int, ...], path: Path
) -> FloatArray:
    wanted = " x ".join(map(str, shape))
    try:
        values = flat_numbers(table[name])
    except ValueError:
        values = np.empty(0)
    if values.size != np.prod(shape) or not np.isfinite(values).all():
        given = _one_line(table[name])
        raise SettingsError(
            f"{name or 'the matrix'} must be {wanted} finite numbers, got {given}.",
            file=path,
            advice=_ADVICE,
        )
    return values.reshape(shape)


def _read_covariance(table: dict[str, Any], path: Path) -> FloatArray:
    """(6, 6), NaN in the rows and columns of what is not observable."""
    try:
        # None becomes NaN.
        covariance = np.asarray(table["covariance"], dtype=np.float64)
    except (TypeError, ValueError):
        covariance = np.empty(0)
    is_right = covariance.shape == (6, 6)
    if is_right:
        known = np.isfinite(np.diag(covariance))
        own = covariance[np.ix_(known, known)]
        scale = np.sqrt(np.abs(np.outer(np.diag(own), np.diag(own))))
        is_right = bool(
            np.isfinite(own).all()
            and (np.abs(own - own.T) <= _COVARIANCE_TOLERANCE * scale).all()
            and (np.linalg.eigvalsh(own) >= -_COVARIANCE_TOLERANCE * own.trace()).all()
        )
    if not is_right:
        raise SettingsError(
            "covariance must be 6 x 6, symmetric and not negative.",
            file=path,
            advice="Its order is rotation x, y, z, then x, y, z, in rad and m along the camera's "
            "axes. Leave it out where it is not known.",
        )
    return covariance
