"""The result of a calibration, as ``exporting/extrinsics_files.py`` writes it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import SettingsError
from fusion_core.model.extrinsics import ExtrinsicsEstimate
from fusion_core.recordings.calibration_files.document import read_document
from fusion_core.recordings.calibration_files.extrinsics import read_guess
from fusion_core.recordings.safe_yaml import require_number

_ADVICE = "Name a file that `scanloom calibrate` has written."
_NUMBERS = ("reprojection_rms_px", "reprojection_rms_used_px", "basin")


def read_estimate(path: Path) -> ExtrinsicsEstimate:
    """The estimate in a result file. Raises SettingsError for any other file."""
    T_camera_lidar = read_guess(path)
    document = read_document(path, _ADVICE)
    try:
        guess = document.get("T_guess")
        return ExtrinsicsEstimate(
            T_camera_lidar=T_camera_lidar,
            covariance=_matrix(document, "covariance", 6),
            method=_text(document, "method"),
            verdict=_text(document, "verdict"),
            improved=_flag(document, "improved"),
            T_guess=None if guess is None else _matrix(document, "T_guess", 4),
            unobservable=_texts(document, "unobservable"),
            notes=_texts(document, "notes"),
            **{
                name: None if document.get(name) is None else require_number(document, name)
                for name in _NUMBERS
            },
        )
    except (ValueError, OverflowError) as error:
        raise SettingsError(
            f"is no result of a calibration: {error}.", file=path, advice=_ADVICE
        ) from error


def _matrix(document: Mapping[str, Any], name: str, size: int) -> FloatArray:
    """(size, size); null is NaN."""
    try:
        matrix = np.array(document.get(name), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape != (size, size):
        raise ValueError(f"{name} must be {size} x {size} numbers")
    return matrix


def _text(document: Mapping[str, Any], name: str) -> str:
    value = document.get(name)
    if not isinstance(value, str):
        raise ValueError(f"{name} must be text")
    return value


def _texts(document: Mapping[str, Any], name: str) -> tuple[str, ...]:
    values = document.get(name)
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise ValueError(f"{name} must be a list of texts")
    return tuple(values)


def _flag(document: Mapping[str, Any], name: str) -> bool:
    value = document.get(name)
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be true or false")
    return value
