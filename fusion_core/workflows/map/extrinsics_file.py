"""Extrinsics from a file: the pose of the LiDAR in a depth camera's frame.

TOML or JSON, with one key or two, in metres::

    T_camera_lidar = [[0, -1, 0, 0.02], [0, 0, -1, 0.6], [1, 0, 0, 0.05], [0, 0, 0, 1]]

    R = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    t = [0.02, 0.6, 0.05]

Both map the LiDAR's points to the camera's optical frame (x right, y down, z ahead) as its images
are stored. Several cameras have a table each, by their depth topic::

    [cameras."/camera_1/depth/image_raw"]
    T_camera_lidar = ...

Other keys are left alone, so that a calibration's result can be used as it is.
"""

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.files.regular_file import read_regular
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import SettingsError
from fusion_core.model.geometry import make_transform

_ADVICE = (
    "Write T_camera_lidar (4 x 4), or R (3 x 3) and t (3, in metres), which map the LiDAR's points "
    "to the camera's optical frame."
)
# Rotations written with four decimals are off by less.
_ROTATION_TOLERANCE = 1e-3
# No robot carries sensors this far apart: such a length is in millimetres.
_TRANSLATION_MAX_M = 10.0
# A hundred cameras take some 20 kB.
_MAX_BYTES = 1 << 20


def read_extrinsics(path: Path) -> dict[str | None, FloatArray]:
    """T_camera_lidar (4, 4) by depth topic; None is the key of the only camera.

    Raises SettingsError where the file cannot be read or holds no rigid transform.
    """
    document = _parse_document(path)
    cameras = document.get("cameras")
    if cameras is None:
        return {None: _read_transform(document, path, "")}
    if not isinstance(cameras, dict) or not all(isinstance(t, dict) for t in cameras.values()):
        raise SettingsError("cameras must hold a table for each topic.", file=path, advice=_ADVICE)
    if not cameras:
        raise SettingsError("cameras is empty.", file=path, advice=_ADVICE)
    return {topic: _read_transform(table, path, f"{topic}: ") for topic, table in cameras.items()}


def _parse_document(path: Path) -> dict[str, Any]:
    try:
        text = read_regular(path, _MAX_BYTES).decode()
    except OSError as error:
        raise SettingsError(
            f"cannot be read: {error.strerror}.", file=path, advice=_ADVICE
        ) from error
    except UnicodeDecodeError as error:
        raise SettingsError("is no text file.", file=path, advice=_ADVICE) from error
    is_json = text.lstrip()[:1] == "{"
    try:
        document = json.loads(text) if is_json else tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        kind = "JSON" if is_json else "TOML"
        raise SettingsError(f"is not {kind}: {error}.", file=path, advice=_ADVICE) from error
    if not isinstance(document, dict):
        raise SettingsError("holds no keys.", file=path, advice=_ADVICE)
    return document


def _read_transform(table: dict[str, Any], path: Path, where: str) -> FloatArray:
    if "T_camera_lidar" in table:
        name, T_camera_lidar = "T_camera_lidar", _read_matrix(table, "T_camera_lidar", (4, 4), path)
    elif "R" in table and "t" in table:
        name = "R"
        T_camera_lidar = make_transform(
            _read_matrix(table, "R", (3, 3), path), _read_matrix(table, "t", (3,), path)
        )
    else:
        lacking = "t" if "R" in table else "R" if "t" in table else "T_camera_lidar"
        raise SettingsError(f"{where}{lacking} is missing.", file=path, advice=_ADVICE)
    rotation = T_camera_lidar[:3, :3]
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    off = max(off, float(np.abs(T_camera_lidar[3] - (0.0, 0.0, 0.0, 1.0)).max()))
    if off > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
        raise SettingsError(
            f"{where}{name} is no rigid transform: it is off by {off:.2g}, its determinant is "
            f"{np.linalg.det(rotation):.3g}.",
            file=path,
            advice=_ADVICE,
        )
    farthest_m = float(np.abs(T_camera_lidar[:3, 3]).max())
    if farthest_m > _TRANSLATION_MAX_M:
        raise SettingsError(
            f"{where}the sensors are {farthest_m:g} m apart.",
            file=path,
            advice="Lengths are in metres.",
        )
    # The nearest rotation, so that what follows may invert it by its transpose.
    u, _, vt = np.linalg.svd(rotation)
    return make_transform(u @ vt, T_camera_lidar[:3, 3].copy())


def _read_matrix(
    table: dict[str, Any], name: str, shape: tuple[int, ...], path: Path
) -> FloatArray:
    wanted = " x ".join(map(str, shape))
    try:
        values = np.asarray(table[name], dtype=np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != shape or not np.isfinite(values).all():
        raise SettingsError(
            f"{name} must be {wanted} finite numbers, got {str(table[name])[:80]}.",
            file=path,
            advice=_ADVICE,
        )
    return values
