"""Maps of map_server: round trips, and a clear error for what is no map."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from fusion_core.exporting.ros_map import write_ros_map
from fusion_core.model.errors import RecordingError
from fusion_core.model.grids import OccupancyGrid
from fusion_core.recordings.ros_map import read_ros_map

YAML = """image: {image}
mode: trinary
resolution: {resolution}
origin: {origin}
negate: {negate}
occupied_thresh: 0.65
free_thresh: 0.196
"""


def stated(
    folder: Path,
    pixels: np.ndarray | None = None,
    *,
    image: str = "map.pgm",
    resolution: str = "0.05",
    origin: str = "[1.0, 2.0, 0.0]",
    negate: str = "0",
) -> Path:
    if pixels is not None:
        cv2.imwrite(str(folder / image), pixels)
    file = folder / "map.yaml"
    file.write_text(YAML.format(image=image, resolution=resolution, origin=origin, negate=negate))
    return file


def test_a_written_map_is_read(tmp_path: Path) -> None:
    log_odds = np.full((3, 4), np.nan)
    log_odds[0, 1] = log_odds[2, 3] = 3.0
    log_odds[1, :] = -3.0
    grid = OccupancyGrid(resolution_m=0.1, origin_m=(-1.0, 2.0), log_odds=log_odds)
    _, yaml = write_ros_map(tmp_path, "room", grid)
    read = read_ros_map(yaml)
    assert read.resolution_m == 0.1
    assert read.origin == (-1.0, 2.0, 0.0)
    np.testing.assert_array_equal(read.occupied, log_odds > 0)
    np.testing.assert_array_equal(read.free, log_odds < 0)
    np.testing.assert_allclose(read.occupied_m(), [[-0.85, 2.05], [-0.65, 2.25]])


@pytest.mark.parametrize("image", ["map.pgm", "map.png"])
def test_the_first_row_of_the_image_is_the_largest_y(tmp_path: Path, image: str) -> None:
    pixels = np.full((2, 3), 254, dtype=np.uint8)
    pixels[0, 2] = 0
    read = read_ros_map(stated(tmp_path, pixels, image=image))
    np.testing.assert_allclose(read.occupied_m(), [[1.125, 2.075]])


def test_the_origin_may_be_rotated_and_the_image_negated(tmp_path: Path) -> None:
    pixels = np.zeros((2, 3), dtype=np.uint8)
    pixels[1, 2] = 255
    file = stated(tmp_path, pixels, origin="[1.0, 2.0, 1.5707963267948966]", negate="true")
    np.testing.assert_allclose(read_ros_map(file).occupied_m(), [[1.0 - 0.025, 2.0 + 0.125]])


def test_unknown_is_neither_occupied_nor_free(tmp_path: Path) -> None:
    read = read_ros_map(stated(tmp_path, np.full((2, 2), 205, dtype=np.uint8)))
    assert not read.occupied.any()
    assert not read.free.any()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"image": "[1]"}, "image is missing"),
        ({"image": "none.pgm"}, "none.pgm"),
        ({"resolution": "0"}, "resolution 0 is no size"),
        ({"resolution": "small"}, "resolution is missing or no finite number"),
        ({"resolution": ".nan"}, "resolution is missing or no finite number"),
        ({"resolution": "1" + "0" * 400}, "map.yaml"),
        ({"origin": "[1, 2]"}, "no list of x, y, yaw"),
        ({"origin": "[1, 2, north]"}, "origin is missing or no finite number"),
        ({"origin": "[1e9, 2, 0]"}, "no place within 1000 km"),
        ({"negate": "[]"}, "negate is missing"),
        ({"origin": "[[[["}, "is no YAML"),
        ({"origin": "&a [1, 2, *a]"}, "aliases"),
        ({"origin": "[" * 50 + "]" * 50}, "nested"),
    ],
)
def test_what_is_no_map_is_named(tmp_path: Path, changes: dict[str, str], words: str) -> None:
    file = stated(tmp_path, **changes)  # type: ignore[arg-type]
    if changes.get("image") is None:
        cv2.imwrite(str(tmp_path / "map.pgm"), np.zeros((2, 2), dtype=np.uint8))
    with pytest.raises(RecordingError) as caught:
        read_ros_map(file)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_images_that_are_truncated_or_claim_too_much_are_named(tmp_path: Path) -> None:
    file = stated(tmp_path)
    for content in (b"P5\n200 200\n255\n" + bytes(9), b"P5\n99999999 99999999\n255\n", b"", b"GIF"):
        (tmp_path / "map.pgm").write_bytes(content)
        with pytest.raises(RecordingError, match=r"map\.pgm"):
            read_ros_map(file)


def test_files_that_are_not_there_or_no_text(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"none\.yaml: cannot be read"):
        read_ros_map(tmp_path / "none.yaml")
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RecordingError, match="is no text"):
        read_ros_map(tmp_path / "bytes.yaml")
    (tmp_path / "big.yaml").write_bytes(b"#" * (1 << 20))
    with pytest.raises(RecordingError, match="larger than 65536 bytes"):
        read_ros_map(tmp_path / "big.yaml")
    (tmp_path / "list.yaml").write_text("- 1\n")
    with pytest.raises(RecordingError, match="holds no keys"):
        read_ros_map(tmp_path / "list.yaml")
