"""Maps as ROS's map_server and nav2 write them: a YAML file and a greyscale image.

Source: the documentation of map_server. p = (255 - grey) / 255, or grey / 255 where negated; a
cell is occupied where p > occupied_thresh, free where p < free_thresh.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, read_only
from fusion_core.model.errors import RecordingError
from fusion_core.recordings.images.frame_files import read_image, read_text
from fusion_core.recordings.safe_yaml import load_yaml, require_number

_MAX_TEXT_BYTES = 64 << 10
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
        """(N, 2) centres of the occupied cells in the map's frame, row by row."""
        return self._centres_m(self.occupied)

    def free_m(self) -> FloatArray:
        """(M, 2) centres of the free cells, in the same way."""
        return self._centres_m(self.free)

    def _centres_m(self, cells: BoolArray) -> FloatArray:
        rows, columns = np.nonzero(cells)
        x = (columns + 0.5) * self.resolution_m
        y = (rows + 0.5) * self.resolution_m
        x0, y0, yaw = self.origin
        c, s = np.cos(yaw), np.sin(yaw)
        return np.stack([x0 + c * x - s * y, y0 + s * x + c * y], axis=1)


def read_ros_map(file: Path) -> RosMap:
    """Read a map by its YAML file; the image's path is relative to it.

    Raises RecordingError for what is no such map, and where one of the two cannot be read.
    """
    mapping = _load_mapping(file)
    try:
        image = mapping.get("image")
        if not isinstance(image, str) or not image:
            raise ValueError("image is missing or no name of a file")
        resolution_m = require_number(mapping, "resolution")
        if not 1e-6 <= resolution_m <= 1e3:
            raise ValueError(f"resolution {resolution_m:g} is no size of a cell in metres")
        origin = mapping.get("origin")
        if not isinstance(origin, list) or len(origin) != 3:
            raise ValueError("origin is missing or no list of x, y, yaw")
        x, y, yaw = (require_number({"origin": value}, "origin") for value in origin)
        if max(abs(x), abs(y)) > 1e6:
            raise ValueError(f"origin {x:g}, {y:g} is no place within 1000 km")
        negated = _is_negated(mapping)
        occupied_above = require_number(mapping, "occupied_thresh", 0.65)
        free_below = require_number(mapping, "free_thresh", 0.196)
        if not 0.0 <= free_below <= occupied_above <= 1.0:
            raise ValueError(f"the thresholds {free_below:g}, {occupied_above:g} do not ascend")
    except (ValueError, OverflowError) as error:
        raise RecordingError(f"{error}.", file=file, advice=_ADVICE) from error
    grey = read_image(file.parent / image, cv2.IMREAD_GRAYSCALE).astype(np.float64)
    probability = (grey if negated else 255.0 - grey) / 255.0
    # An image's first row is the map's largest y.
    probability = np.flipud(probability)
    return RosMap(
        resolution_m=resolution_m,
        origin=(x, y, yaw),
        occupied=probability > occupied_above,
        free=probability < free_below,
    )


def _load_mapping(file: Path) -> dict[Any, Any]:
    try:
        loaded = load_yaml(read_text(file, _MAX_TEXT_BYTES))
    except (ValueError, OverflowError) as error:
        raise RecordingError(f"cannot be read: {error}.", file=file, advice=_ADVICE) from error
    if not isinstance(loaded, dict):
        raise RecordingError("holds no keys.", file=file, advice=_ADVICE)
    return loaded


def _is_negated(mapping: dict[Any, Any]) -> bool:
    # Written by hand, it may be true or false.
    value = mapping.get("negate")
    return value if isinstance(value, bool) else require_number(mapping, "negate", 0.0) != 0.0
