"""Extrinsics as files: our own result, a ROS transform in YAML, and a joint for URDF.

The names in ``T_camera_lidar``: the LiDAR's points are mapped to the camera's optical frame. In
words of ROS the camera's frame is the parent and the LiDAR's the child.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import tomlkit

from fusion_core.files.atomic import write_text
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import ExportError
from fusion_core.model.extrinsics import POSE_PARAMETERS, ExtrinsicsEstimate
from fusion_core.model.geometry import invert_transform
from fusion_core.model.names import escape_undecodable_values
from fusion_core.model.sensors import CameraIntrinsics

RESULT_SUFFIXES = (".json", ".toml")
# cos β, below which the angles α and γ of one rotation are arbitrary: rotations are written with 16
# digits, and at this distance from 90° each of the two still has 8.
_SINGULAR_COSINE = 1e-8


def write_extrinsics(
    path: Path,
    estimate: ExtrinsicsEstimate,
    *,
    camera_frame: str,
    lidar_frame: str,
    intrinsics: CameraIntrinsics | None = None,
    more: Mapping[str, Any] | None = None,
) -> None:
    """Write an estimate as JSON or TOML, as the suffix says.

    ``map --extrinsics`` reads the file, ``read_intrinsics`` of ``recordings.calibration_files``
    where ``intrinsics`` are given, and ``read_estimate`` there all of it. ``more``: what else a
    method has to say, ready for JSON, after the other keys. What is not known is null; in TOML it
    is left out, and NaN within a matrix.

    Raises ExportError for another suffix, and where the file cannot be written.
    """
    require_result_suffix(path)
    document: dict[str, Any] = {
        "camera_frame": camera_frame,
        "lidar_frame": lidar_frame,
        **extrinsics_document(estimate),
        **({} if intrinsics is None else intrinsics_document(intrinsics)),
        **({} if more is None else more),
    }
    write_document(path, document)


def write_document(path: Path, document: Mapping[str, Any]) -> None:
    """Write the keys of a result as JSON or TOML, as the suffix says, in the form of
    ``write_extrinsics``. Raises ExportError where the file cannot be written."""
    require_result_suffix(path)
    # Notes name files, whose names may be no text.
    document = escape_undecodable_values(dict(document))
    write_text(path, _as_toml(document) if path.suffix == ".toml" else _as_json(document))


def require_result_suffix(path: Path) -> None:
    """Raise ExportError where the name of a result file ends in neither .json nor .toml."""
    if path.suffix not in RESULT_SUFFIXES:
        raise ExportError(
            f"{path.suffix!r} is no form of a result.", file=path, advice="Use .json or .toml."
        )


def extrinsics_document(estimate: ExtrinsicsEstimate) -> dict[str, Any]:
    """The keys of a result file, ready for JSON."""
    sd = dict(zip(POSE_PARAMETERS, estimate.sd, strict=True))
    return {
        "T_camera_lidar": estimate.T_camera_lidar.tolist(),
        "li_angles": li_angles(estimate.T_camera_lidar),
        "parameters": list(POSE_PARAMETERS),
        "sd": sd,
        "covariance": _with_null(estimate.covariance),
        "unobservable": list(estimate.unobservable),
        "reprojection_rms_px": estimate.reprojection_rms_px,
        "reprojection_rms_used_px": estimate.reprojection_rms_used_px,
        "basin": estimate.basin,
        "improved": estimate.improved,
        "verdict": estimate.verdict,
        "method": estimate.method,
        "notes": list(estimate.notes),
        "T_guess": None if estimate.T_guess is None else estimate.T_guess.tolist(),
    }


def intrinsics_document(intrinsics: CameraIntrinsics) -> dict[str, Any]:
    """The keys of a camera, ready for JSON."""
    return {
        "width": intrinsics.width,
        "height": intrinsics.height,
        "K": intrinsics.matrix.tolist(),
        "distortion_model": intrinsics.distortion_model,
        "distortion": list(intrinsics.distortion),
    }


def li_angles(T_camera_lidar: FloatArray) -> dict[str, float | bool | None]:
    """α, β, γ of Li 2022, eq. (3), from the rotation camera → LiDAR, the inverse's.

    At β = ±90° it is singular: α and γ turn about one axis and are not known apart (None).
    """
    r = invert_transform(T_camera_lidar)[:3, :3]
    cos_beta = float(np.hypot(r[0, 0], r[1, 0]))
    is_singular = cos_beta < _SINGULAR_COSINE
    return {
        "alpha_rad": None if is_singular else float(np.arctan2(r[1, 0], r[0, 0])),
        "beta_rad": float(np.arctan2(-r[2, 0], cos_beta)),
        "gamma_rad": None if is_singular else float(np.arctan2(r[2, 1], r[2, 2])),
        "singular": is_singular,
    }


def write_ros_transform(path: Path, T_parent_child: FloatArray, *, parent: str, child: str) -> None:
    """Write geometry_msgs/TransformStamped as YAML, without a stamp."""
    from scipy.spatial.transform import Rotation

    # Canonical: of the two quaternions of a rotation, the one with w >= 0.
    rotation = Rotation.from_matrix(T_parent_child[:3, :3]).as_quat(canonical=True)
    lines = [
        "# Maps points of the child frame to the parent frame.",
        "header:",
        f"  frame_id: {_dump(parent)}",
        f"child_frame_id: {_dump(child)}",
        "transform:",
        f"  translation: {_flow_mapping('xyz', T_parent_child[:3, 3])}",
        f"  rotation: {_flow_mapping('xyzw', rotation)}",
        "",
    ]
    write_text(path, "\n".join(lines))


def write_urdf_joint(path: Path, T_parent_child: FloatArray, *, parent: str, child: str) -> None:
    """Write a fixed joint, to be put into the description of a robot that has both links."""
    xyz, rpy = T_parent_child[:3, 3], roll_pitch_yaw(T_parent_child[:3, :3])
    lines = [
        f'<joint name={quoteattr(f"{parent}_to_{child}")} type="fixed">',
        f"  <parent link={quoteattr(parent)}/>",
        f"  <child link={quoteattr(child)}/>",
        f'  <origin xyz="{_words(xyz)}" rpy="{_words(rpy)}"/>',
        "</joint>",
        "",
    ]
    write_text(path, "\n".join(lines))


def roll_pitch_yaw(rotation: FloatArray) -> FloatArray:
    """(3,) of R = Rz(yaw) Ry(pitch) Rx(roll), as URDF has them.

    The roll is what is left when the yaw is taken off, so that the three give the rotation at
    pitch = ±90° too, where the yaw may be any.
    """
    r = rotation
    pitch = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    yaw = np.arctan2(r[1, 0], r[0, 0])
    sine, cosine = np.sin(yaw), np.cos(yaw)
    roll = np.arctan2(sine * r[0, 2] - cosine * r[1, 2], cosine * r[1, 1] - sine * r[0, 1])
    return np.array([roll, pitch, yaw])


def _with_null(matrix: FloatArray) -> list[list[float | None]]:
    return [[None if np.isnan(value) else float(value) for value in row] for row in matrix]


def _as_json(document: Mapping[str, Any]) -> str:
    """One key a line, and a matrix one row a line."""
    entries = []
    for key, value in document.items():
        is_matrix = isinstance(value, list) and value and isinstance(value[0], list)
        rows = ",\n    ".join(_dump(row) for row in value) if is_matrix else ""
        text = f"[\n    {rows}\n  ]" if is_matrix else _dump(value)
        entries.append(f"  {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(entries) + "\n}\n"


def _dump(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _as_toml(document: Mapping[str, Any]) -> str:
    """TOML has no null: such a key is left out, and a number in a matrix is NaN. Tables come last:
    what follows one belongs to it."""
    toml = tomlkit.document()
    tables = {key: value for key, value in document.items() if isinstance(value, Mapping)}
    for key, value in document.items():
        if value is not None and key not in tables:
            is_matrix = isinstance(value, list) and value and isinstance(value[0], list)
            item = tomlkit.array(_toml_array(value)) if is_matrix else tomlkit.item(value)
            toml.add(key, item)
    for key, value in tables.items():
        toml.add(tomlkit.nl())
        table = tomlkit.table()
        for name, entry in value.items():
            if entry is not None:
                table.add(name, tomlkit.item(entry))
        toml.add(key, table)
    return tomlkit.dumps(toml)


def _toml_array(rows: list[list[float | None]]) -> str:
    lines = (
        "[" + ", ".join("nan" if value is None else repr(float(value)) for value in row) + "]"
        for row in rows
    )
    return "[\n    " + ",\n    ".join(lines) + ",\n]"


def _flow_mapping(names: str, values: FloatArray) -> str:
    pairs = (f"{name}: {float(value)!r}" for name, value in zip(names, values, strict=True))
    return "{" + ", ".join(pairs) + "}"


def _words(values: FloatArray) -> str:
    return " ".join(repr(float(value)) for value in values)
