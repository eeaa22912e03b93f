"""Intrinsics as a file: YAML as ROS's camera_info_manager keeps it, or JSON with the same keys."""

import json
from pathlib import Path
from typing import Any

from fusion_core.files.atomic import write_text
from fusion_core.model.errors import ExportError
from fusion_core.model.sensors import CameraIntrinsics

SUFFIXES = (".yaml", ".yml", ".json")


def write_camera_info(
    path: Path, intrinsics: CameraIntrinsics, calibration: dict[str, Any], *, name: str = "camera"
) -> None:
    """Write intrinsics, and under ``calibration`` how far they can be trusted.

    Other readers skip that key. Raises ExportError for a name that does not end in one of SUFFIXES,
    and where the file cannot be written.
    """
    require_suffix(path)
    content = {
        "image_width": intrinsics.width,
        "image_height": intrinsics.height,
        "camera_name": name,
        "camera_matrix": _matrix(3, intrinsics.matrix.ravel().tolist()),
        "distortion_model": intrinsics.distortion_model,
        "distortion_coefficients": _matrix(1, _coefficients(intrinsics)),
        "rectification_matrix": _matrix(3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        "projection_matrix": _matrix(
            3,
            [
                *(intrinsics.fx, 0.0, intrinsics.cx, 0.0),
                *(0.0, intrinsics.fy, intrinsics.cy, 0.0),
                *(0.0, 0.0, 1.0, 0.0),
            ],
        ),
        "calibration": calibration,
    }
    if path.suffix == ".json":
        text = json.dumps(content, indent=2, allow_nan=False)
    else:
        # A value in JSON is one in YAML, too.
        text = "\n".join(_yaml_lines(content, ""))
    write_text(path, text + "\n")


def require_suffix(path: Path) -> None:
    """Raise ExportError for a name that does not say which form it is to have."""
    if path.suffix not in SUFFIXES:
        raise ExportError(
            "is no name for a camera's calibration.",
            file=path,
            advice="End it in .yaml (ROS camera_info) or .json.",
        )


def _coefficients(intrinsics: CameraIntrinsics) -> list[float]:
    """As many as readers of the model expect: plumb_bob has five, equidistant four."""
    count = {"plumb_bob": 5, "equidistant": 4}.get(
        intrinsics.distortion_model, len(intrinsics.distortion)
    )
    return [*intrinsics.distortion, *[0.0] * (count - len(intrinsics.distortion))]


def _matrix(rows: int, data: list[float]) -> dict[str, Any]:
    return {"rows": rows, "cols": len(data) // rows, "data": data}


def _yaml_lines(content: dict[str, Any], indent: str) -> list[str]:
    lines = []
    for key, value in content.items():
        if isinstance(value, dict) and value:
            lines += [f"{indent}{key}:", *_yaml_lines(value, indent + "  ")]
        elif isinstance(value, str) and value.isidentifier():
            lines.append(f"{indent}{key}: {value}")
        else:
            lines.append(f"{indent}{key}: {json.dumps(value, allow_nan=False)}")
    return lines
