"""Whatever a file holds, its readers give a value or one line."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.model.errors import SettingsError
from fusion_core.recordings.calibration_files.contents import describe_calibration
from fusion_core.recordings.calibration_files.estimate import read_estimate
from fusion_core.recordings.calibration_files.extrinsics import read_guess
from fusion_core.recordings.calibration_files.intrinsics import read_intrinsics

K = [900, 0, 640, 0, 900, 480, 0, 0, 1]
SAMPLES = [
    f"K: {' '.join(map(str, K))}\nD: 0.1 0.2 0 0\nT: 1 0 0 0 0 1 0 0 0 0 1 0\n",
    f"image_width: 1280\nimage_height: 960\ncamera_matrix:\n  rows: 3\n  data: {K}\n",
    "P2: 9 0 6 4 0 9 4 3 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr: 1 0 0 0 0 1 0 0 0 0 1 0",
    f"T_camera_lidar = {np.eye(4).tolist()}\nwidth = 3\nK = {K}\n",
    json.dumps({"a": {"sensor_name": "b", "param": {"cam_K": {"data": K}, "sensor_calib": 1}}}),
    '{"cameras": {"/a": {"R": [[1,0,0],[0,1,0],[0,0,1]], "t": [0, 0, 1]}}}',
    "1 0 0 0\n0 1 0 0\n0 0 1 0\n",
]
PIECES = st.sampled_from(
    [
        "nan",
        "[",
        "]",
        "{",
        "}",
        ":",
        "\n",
        " - ",
        "&a",
        "*a",
        "!!float",
        "null",
        "1e999",
        "'",
        "9" * 400,
    ]
)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3)
    ),
    max_leaves=8,
)
KEYS = st.sampled_from(
    ["K", "D", "T", "R", "t", "P2", "Tr", "width", "height", "fx", "k1", "a", "cameras", "notes"]
) | st.sampled_from(
    ["T_camera_lidar", "distortion_model", "intrinsic_matrix", "covariance", "improved", "T_guess"]
)


def read_all(path: Path) -> None:
    problems = []
    for read in (read_guess, read_estimate, read_intrinsics, lambda p: read_intrinsics(p, (9, 9))):
        try:
            read(path)
        except SettingsError as error:
            problems.append(str(error))
    assert not any("\n" in problem for problem in problems)
    describe_calibration(path)


@given(data=st.data())
@settings(max_examples=60)
def test_damaged_samples(tmp_path_factory: Any, data: st.DataObject) -> None:
    text = data.draw(st.sampled_from(SAMPLES))
    for _ in range(data.draw(st.integers(0, 3))):
        at = data.draw(st.integers(0, len(text)))
        text = text[:at] + data.draw(PIECES | st.text(max_size=3)) + text[at + 1 :]
    path = tmp_path_factory.mktemp("any") / "file"
    path.write_text(text, encoding="utf-8")
    read_all(path)


@given(document=st.dictionaries(KEYS, VALUES, max_size=5))
def test_any_values(tmp_path_factory: Any, document: dict[str, Any]) -> None:
    path = tmp_path_factory.mktemp("any") / "file"
    path.write_text(json.dumps(document), encoding="utf-8")
    read_all(path)
