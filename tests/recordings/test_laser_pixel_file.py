"""Pairs of laser points and pixels: files as people write them, and damaged ones."""

import numpy as np
import pytest

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.laser_pixel_file import read_laser_pixels


def written(folder, text):
    file = folder / "pairs.txt"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file


def test_lines_become_points_and_pixels(tmp_path):
    points, pixels = read_laser_pixels(
        written(tmp_path, "# x y u v\n2.712 -2.958 312.596 301.265\r\n\n1e0\t2 3 4\n")
    )
    np.testing.assert_array_equal(points, [[2.712, -2.958], [1.0, 2.0]])
    np.testing.assert_array_equal(pixels, [[312.596, 301.265], [3.0, 4.0]])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("1 2 3\n", "line 1: has 3 fields, not 4"),
        ("1 2 3 4\n1 2 three 4\n", "line 2: 'three' is no number"),
        ("1 2 3 nan\n", "line 1: 'nan' is not between"),
        ("1 2 inf 4\n", "line 1: 'inf' is not between"),
        ("1 2 3 1e300\n", "line 1: '1e300' is not between"),
        ("# nothing\n", "holds no lines"),
        ("", "holds no lines"),
        (b"\x00\xff\xfe 2 3 4\n", "line 1:"),
        (b"1 " * 5000, "line 1:"),
    ],
)
def test_a_bad_line_is_one_clear_error(tmp_path, text, problem):
    with pytest.raises(RecordingError, match="Each line holds x y u v") as error:
        read_laser_pixels(written(tmp_path, text))
    assert problem in str(error.value)
    assert "\n" not in str(error.value)
    assert "pairs.txt" in str(error.value)
