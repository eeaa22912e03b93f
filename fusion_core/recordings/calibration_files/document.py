"""The keys of a small text file, told by its content: JSON, YAML, TOML or numbers alone."""

import json
import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.files.regular_file import read_regular
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import SettingsError
from fusion_core.recordings.quoting import quote_clipped
from fusion_core.recordings.safe_yaml import load_yaml

NUMBERS_ALONE = ""
"""The key of the numbers of a file that holds nothing else."""
# A hundred cameras take some 20 kB. YAML is read by pure Python, a megabyte of it in a minute.
_MAX_BYTES = 1 << 20
_MAX_YAML_BYTES = 1 << 16
_YAML_LINE = re.compile(r"\s*(%YAML|---|(\"[^\"]*\"|'[^']*'|[\w./ -]+):(\s|$))")
# OpenCV's own header, which is no YAML, and the tags of its matrices.
_OPENCV = re.compile(r"\A%YAML:1\.0|!!opencv-matrix|^---[ \t]*$", re.MULTILINE)


def read_document(path: Path, advice: str) -> dict[str, Any]:
    """The keys of a file and their values. Raises SettingsError, which ends with ``advice``."""
    try:
        text = read_regular(path, _MAX_BYTES).decode()
    except OSError as error:
        raise SettingsError(
            f"cannot be read: {error.strerror}.", file=path, advice=advice
        ) from error
    except UnicodeDecodeError as error:
        raise SettingsError("is no text file.", file=path, advice=advice) from error
    kind, parse = _parser(text)
    try:
        document = parse(text)
    except (ValueError, RecursionError) as error:
        reason = str(error).removeprefix("it is no YAML: ")
        raise SettingsError(f"is not {kind}: {reason}.", file=path, advice=advice) from error
    if not isinstance(document, dict):
        raise SettingsError("holds no keys.", file=path, advice=advice)
    return document


def flat_numbers(value: object) -> FloatArray:
    """(N,) the numbers of a value: a number, a list or a list of rows, OpenCV's and ROS's matrix
    (its list is under ``data``), or text with spaces between them, as in KITTI's files.

    Raises ValueError for anything else; the numbers may be infinite or NaN.
    """
    if isinstance(value, Mapping):
        value = value.get("data")
    if isinstance(value, str):
        value = value.split()
    rows: list[Any] = value if isinstance(value, list) else [value]
    flat = [number for row in rows for number in (row if isinstance(row, list) else [row])]
    try:
        if any(isinstance(number, bool) or number is None for number in flat):
            raise ValueError("no number")
        return np.array([float(number) for number in flat], dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{quote_clipped(str(value))} are no numbers") from None


def _parser(text: str) -> tuple[str, Callable[[str], Any]]:
    if text.lstrip()[:1] == "{":
        return "JSON", json.loads
    lines = (line for line in text.splitlines() if line.strip() and line.strip()[0] != "#")
    first = next(lines, "")
    if _YAML_LINE.match(first):
        return "YAML", _load_yaml
    if _is_number(first.split()[0] if first else ""):
        return "a table of numbers", lambda text: {NUMBERS_ALONE: flat_numbers(text).tolist()}
    return "TOML", tomllib.loads


def _load_yaml(text: str) -> Any:
    if len(text) > _MAX_YAML_BYTES:
        raise ValueError(f"it has {len(text)} characters, more than {_MAX_YAML_BYTES}")
    return load_yaml(_OPENCV.sub("", text))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
