"""Maps as ROS's map_server and nav2 write them: a YAML file and a grey picture beside it.

Source: the documentation of map_server. p = (255 - grey) / 255, or grey / 255 where negated; a
cell is occupied where p > occupied_thresh, free where p < free_thresh.
"""

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent

from fusion_core.model.conventions import BoolArray, FloatArray, read_only
from fusion_core.model.errors import RecordingError
from fusion_core.recordings.images.frame_files import read_image, read_text

_MAX_TEXT_BYTES = 64 << 10
_MAX_NESTING = 16
_ADVICE = (
    "It must be a map as map_server and nav2 read it: image, resolution, origin, occupied_thresh."
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RosMap:
    """A map of three states. Row 0 is the smallest y, as in OccupancyGrid.

    ``occupied``, ``free``: (rows, columns). ``origin``: (x, y, yaw) of the outer corner of cell
    (0, 0) in the map's frame, in metres and radians.
    """

    resolution_m: float
    origin: tuple[float, float, float]
    occupied: BoolArray
    free: BoolArray

    def __post_init__(self) -> None:
        read_only(self.occupied)
        read_only(self.free)

    def occupied_m(self) -> FloatArray:
        """(N, 2) middles of the occupied cells in the map's frame, row by row."""
        return self._middles_m(self.occupied)

    def free_m(self) -> FloatArray:
        """(M, 2) middles of the free cells, in the same way."""
        return self._middles_m(self.free)

    def _middles_m(self, cells: BoolArray) -> FloatArray:
        rows, columns = np.nonzero(cells)
        x = (columns + 0.5) * self.resolution_m
        y = (rows + 0.5) * self.resolution_m
        x0, y0, yaw = self.origin
        c, s = np.cos(yaw), np.sin(yaw)
        return np.stack([x0 + c * x - s * y, y0 + s * x + c * y], axis=1)


def read_ros_map(file: Path) -> RosMap:
    """Read a map by its YAML file; the picture's path is relative to it.

    Raises RecordingError for what is no such map, and where one of the two cannot be read.
    """
    stated = _mapping(file)
    try:
        image = stated.get("image")
        if not isinstance(image, str) or not image:
            raise ValueError("image is missing or no name of a file")
        resolution_m = _number(stated, "resolution")
        if not 1e-6 <= resolution_m <= 1e3:
            raise ValueError(f"resolution {resolution_m:g} is no size of a cell in metres")
        origin = stated.get("origin")
        if not isinstance(origin, list) or len(origin) != 3:
            raise ValueError("origin is missing or no list of x, y, yaw")
        x, y, yaw = (_number({"origin": value}, "origin") for value in origin)
        if max(abs(x), abs(y)) > 1e6:
            raise ValueError(f"origin {x:g}, {y:g} is no place within 1000 km")
        negated = _number(stated, "negate", 0.0) != 0.0
        occupied_above = _number(stated, "occupied_thresh", 0.65)
        free_below = _number(stated, "free_thresh", 0.196)
        if not 0.0 <= free_below <= occupied_above <= 1.0:
            raise ValueError(f"the thresholds {free_below:g}, {occupied_above:g} do not ascend")
    except (ValueError, OverflowError) as error:
        raise RecordingError(f"{error}.", file=file, advice=_ADVICE) from error
    grey = read_image(file.parent / image, cv2.IMREAD_GRAYSCALE).astype(np.float64)
    probability = (grey if negated else 255.0 - grey) / 255.0
    # A picture's first row is the map's largest y.
    probability = np.flipud(probability)
    return RosMap(
        resolution_m=resolution_m,
        origin=(x, y, yaw),
        occupied=probability > occupied_above,
        free=probability < free_below,
    )


def _mapping(file: Path) -> dict[Any, Any]:
    text = read_text(file, _MAX_TEXT_BYTES)
    yaml = YAML(typ="safe", pure=True)
    try:
        # Events come without recursion and without following aliases, which could multiply.
        depth = 0
        for event in yaml.parse(text):
            depth += isinstance(event, CollectionStartEvent)
            depth -= isinstance(event, CollectionEndEvent)
            if isinstance(event, AliasEvent) or depth > _MAX_NESTING:
                raise RecordingError("uses aliases or deep nesting.", file=file, advice=_ADVICE)
        loaded = yaml.load(text)
    except (YAMLError, ValueError, OverflowError) as error:
        problem = " ".join(str(error).split())
        raise RecordingError(f"is no YAML: {problem}.", file=file, advice=_ADVICE) from error
    if not isinstance(loaded, dict):
        raise RecordingError("holds no keys.", file=file, advice=_ADVICE)
    return loaded


def _number(stated: dict[Any, Any], key: str, default: float | None = None) -> float:
    value = stated.get(key, default)
    # Written by hand, negate may be true or false.
    if key == "negate" and isinstance(value, bool):
        return float(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise ValueError(f"{key} is missing or no finite number")
    return float(value)
