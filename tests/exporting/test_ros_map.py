"""Maps for ROS, read back by nav2's formula."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.exporting.ros_map import write_ros_map
from fusion_core.model.grids import OccupancyGrid


def grid(probability: np.ndarray, x_m: float = 0.0, y_m: float = 0.0) -> OccupancyGrid:
    p = np.asarray(probability, dtype=np.float64)
    return OccupancyGrid(resolution_m=0.05, origin_m=(x_m, y_m), log_odds=np.log(p / (1 - p)))


def read_as_nav2(yaml: Path) -> tuple[np.ndarray, list[float], float]:
    """nav2_map_server's trinary mode: (rows, columns) 100, 0 or -1 with row 0 the smallest y."""
    keys = dict(re.findall(r"^(\w+): (.*)$", yaml.read_text(), re.MULTILINE))
    assert keys["mode"] == "trinary"
    assert keys["negate"] == "0"
    image = cv2.imread(str(yaml.parent / keys["image"]), cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.uint8
    occupancy = (255.0 - image) / 255.0
    values = np.full(image.shape, -1)
    values[occupancy > float(keys["occupied_thresh"])] = 100
    values[occupancy < float(keys["free_thresh"])] = 0
    origin = [float(value) for value in keys["origin"].strip("[]").split(",")]
    return values[::-1], origin, float(keys["resolution"])


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 9))
def test_round_trip(
    tmp_path_factory: pytest.TempPathFactory, seed: int, rows: int, columns: int
) -> None:
    rng = np.random.default_rng(seed)
    p = rng.choice([np.nan, 0.12, 0.2, 0.3, 0.5, 0.6, 0.7, 0.97], size=(rows, columns))
    _, yaml = write_ros_map(tmp_path_factory.mktemp("map"), "map", grid(p, -3.65, 12.0))
    values, origin, resolution_m = read_as_nav2(yaml)
    expected = np.where(p > 0.65, 100, np.where(p < 0.25, 0, -1))
    assert np.array_equal(values, expected)
    assert origin == [-3.65, 12.0, 0.0]
    assert resolution_m == 0.05


def test_bytes(tmp_path: Path) -> None:
    """Row 0 of the image is the largest y; the origin is the corner of the lower left pixel."""
    image, yaml = write_ros_map(
        tmp_path, "map_fused", grid([[0.9, np.nan, 0.1], [0.1, 0.1, 0.1]], -92 * 0.05, 0.0)
    )
    assert image.read_bytes() == b"P5\n3 2\n255\n" + bytes([254, 254, 254, 0, 205, 254])
    assert yaml.read_text() == (
        "image: map_fused.pgm\nmode: trinary\nresolution: 0.05\norigin: [-4.6, 0.0, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )


def test_thresholds(tmp_path: Path) -> None:
    one_pass = grid([[0.4, 0.7]])
    _, yaml = write_ros_map(tmp_path, "map", one_pass, occupied_above=0.8, free_below=0.5)
    assert read_as_nav2(yaml)[0].tolist() == [[0, -1]]
