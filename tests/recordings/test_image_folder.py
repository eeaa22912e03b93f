"""Plain folders of images: names, units, camera files, and what is refused rather than guessed."""

import json
import os
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.images.camera_files import read_camera_file
from fusion_core.recordings.messages.image_headers import BadImage, read_image_size

DEPTH, COLOR = "/camera/depth/image_raw", "/camera/color/image_raw"
INFO = "/camera/depth/camera_info"
SHAPE = (12, 16)
CAMERA = {"fx": 14.0, "fy": 13.0, "cx": 7.5, "cy": 5.5, "width": 16, "height": 12}


def millimetres(seed: int = 0) -> np.ndarray:
    values = np.random.default_rng(seed).integers(400, 9000, SHAPE).astype(np.uint16)
    values[0, 0] = 0
    return values


def metres(values: np.ndarray, units_per_metre: float) -> np.ndarray:
    found = values.astype(np.float32) / np.float32(units_per_metre)
    found[values == 0] = np.nan
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """depth/0.png .. 2.png and rgb/0.png .. 2.png in millimetres, nothing else."""
    root = tmp_path / "images"
    for name in ("depth", "rgb"):
        (root / name).mkdir(parents=True)
    for n in range(3):
        assert cv2.imwrite(str(root / f"depth/{n}.png"), millimetres(n))
        assert cv2.imwrite(str(root / f"rgb/{n}.png"), np.full((*SHAPE, 3), n, np.uint8))
    return root


def only_depth(folder: Path, suffix: str) -> Path:
    """Leave one depth image, to be written by the test, and no colour."""
    shutil.rmtree(folder / "rgb")
    for file in (folder / "depth").iterdir():
        file.unlink()
    return folder / f"depth/0{suffix}"


def first_depth(folder: Path) -> Any:
    with open_recording(folder) as recording:
        return recording.read(DEPTH, 0).value


def test_millimetres_where_no_unit_is_stated(folder: Path) -> None:
    with open_recording(folder) as recording:
        assert "millimetres" in recording.warnings[0]
        image = recording.read(DEPTH, 1).value
    assert image.encoding == "16UC1"
    np.testing.assert_array_equal(image.depth_m, metres(millimetres(1), 1000))


@pytest.mark.parametrize(
    ("key", "value", "units"),
    [
        ("depth_scale", 5000, 5000),
        ("depth_scale", 0.0002, 5000),
        ("depth_factor", 6553.5, 6553.5),
        ("depth_scale", 0.001, 1000),
    ],
)
def test_the_stated_unit(folder: Path, key: str, value: float, units: float) -> None:
    (folder / "camera.json").write_text(json.dumps(CAMERA | {key: value}))
    with open_recording(folder) as recording:
        assert recording.warnings == []
    image = first_depth(folder)
    np.testing.assert_array_equal(image.depth_m, metres(millimetres(0), units))
    # Depth in a finer unit must not be labelled as millimetres.
    assert image.encoding == ("16UC1" if units == 1000 else "32FC1")


@pytest.mark.parametrize("scale", [1, 0, -1000, 1e9, "1000", True])
def test_a_unit_that_gives_no_depth(folder: Path, scale: object) -> None:
    (folder / "camera.json").write_text(json.dumps(CAMERA | {"depth_scale": scale}))
    with open_recording(folder) as recording:
        assert "depth_scale" in recording.warnings[0]
        assert "millimetres" in recording.warnings[1]


def write_npy(file: Path, values: np.ndarray) -> None:
    np.save(file, values)


def write_fortran_npy(file: Path, values: np.ndarray) -> None:
    np.save(file, np.asfortranarray(values))


def write_image(file: Path, values: np.ndarray) -> None:
    assert cv2.imwrite(str(file), values)


@pytest.mark.parametrize(
    ("suffix", "write", "dtype"),
    [
        (".npy", write_npy, "<f4"),
        (".npy", write_npy, ">f4"),
        (".npy", write_npy, "<f8"),
        (".npy", write_fortran_npy, "<f4"),
        (".npy", write_npy, "<u2"),
        (".tiff", write_image, "<f4"),
        (".tif", write_image, "<u2"),
        (".pgm", write_image, "<u2"),
    ],
)
def test_other_files_of_depth(
    folder: Path, suffix: str, write: Callable[[Path, np.ndarray], None], dtype: str
) -> None:
    file = only_depth(folder, suffix)
    values = millimetres()
    counts_units = dtype.endswith("u2")
    write(file, values if counts_units else (values / 1000).astype(dtype))
    with open_recording(folder) as recording:
        assert bool(recording.warnings) is counts_units
        image = recording.read(DEPTH, 0).value
    np.testing.assert_allclose(image.depth_m, metres(values, 1000), rtol=1e-6)
    assert image.encoding == ("16UC1" if counts_units else "32FC1")


def test_floats_that_are_no_distance_are_missing(folder: Path) -> None:
    values = np.full(SHAPE, 1.5)
    values[0, :5] = np.nan, np.inf, 0.0, -1.0, 1e300
    np.save(only_depth(folder, ".npy"), values)
    depth_m = first_depth(folder).depth_m
    assert np.isnan(depth_m[0, :5]).all()
    assert (depth_m.ravel()[5:] == 1.5).all()


def npy(header: str, body: bytes = b"\0" * 64) -> bytes:
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(text)) + text + body


@pytest.mark.parametrize(
    "content",
    [
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (99999, 99999), }"),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (4, 5), }"),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (0, 4), }"),
        npy("{'descr': '|O', 'fortran_order': False, 'shape': (1, 1), }", b"cos\nsystem\n"),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (4,), }"),
        npy("(" * 5000),
        b"\x93NUMPY",
    ],
)
def test_npy_headers_are_not_trusted(folder: Path, content: bytes) -> None:
    only_depth(folder, ".npy").write_bytes(content)
    with open_recording(folder) as recording, pytest.raises(RecordingError, match=r"0\.npy"):
        recording.read(DEPTH, 0)


def png_claiming(width: int, height: int, bits: int, color_type: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        crc = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + crc

    header = struct.pack(">IIBBBBB", width, height, bits, color_type, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IEND", b"")


def tiff_claiming(**tags: int) -> bytes:
    codes = {"width": 256, "height": 257, "channels": 277, "strip_rows": 278, "tile_width": 322}
    entries = [struct.pack("<HHII", codes[name], 4, 1, value) for name, value in tags.items()]
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + b"".join(entries) + b"\0" * 4


JPEG = cv2.imencode(".jpg", np.full((*SHAPE, 3), 9, np.uint8))[1].tobytes()
JPEG_SIZE_AT = JPEG.index(b"\xff\xc0") + 5


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (png_claiming(1 << 30, 1 << 30, 16, 0), "claims 1073741824 x"),
        (png_claiming(4096, 4096, 16, 6), "claims 4096 x 4096"),
        (png_claiming(0, 4, 16, 0), "claims 0 x 4"),
        (png_claiming(4, 4, 16, 0)[:-6], "cut short"),
        (b"\x89PNG\r\n\x1a\n", "cut short"),
        (JPEG[:JPEG_SIZE_AT] + b"\xff" * 4 + JPEG[JPEG_SIZE_AT + 4 :], "claims 65535 x 65535"),
        (JPEG[:-2], "cut short"),
        (JPEG[: len(JPEG) // 2], "cut short"),
        (b"\xff\xd8" + b"\xff" * 100_000, "segments"),
        (b"P5 60000 60000 65535\n", "cut short"),
        (b"P6 -4 4 255\n", "without width"),
        (b"P5 #" + b"x" * 9000, "without width"),
        (tiff_claiming(width=1 << 20, height=1 << 20), "claims 1048576 x"),
        (tiff_claiming(width=4, height=4, tile_width=1 << 28), "claims 268435456 x"),
        (tiff_claiming(width=4000, height=4, strip_rows=1 << 20), "x 1048576"),
        (tiff_claiming(width=4, height=4, channels=9), "9 channels"),
        (b"II*\0\xff\xff\xff\xff", "cut short"),
        (b"GIF89a", "is no PNG"),
        (b"", "is no PNG"),
    ],
)
def test_a_claim_is_checked_before_decoding(content: bytes, said: str) -> None:
    with pytest.raises(BadImage, match=said):
        read_image_size(content)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".ppm", ".pgm", ".tiff"])
def test_the_size_is_that_of_the_decoder(suffix: str) -> None:
    pixels = np.zeros((5, 7) if suffix in (".pgm", ".tiff") else (5, 7, 3), np.uint8)
    size = read_image_size(cv2.imencode(suffix, pixels)[1].tobytes())
    assert (size.height, size.width, size.pixel_bytes) == (5, 7, pixels.nbytes // 35)


@given(st.integers(0, 10_000), st.integers(1, 255))
def test_a_changed_byte_of_a_png_is_noticed(place: int, change: int) -> None:
    content = bytearray(cv2.imencode(".png", millimetres())[1].tobytes())
    content[place % len(content)] ^= change
    with pytest.raises(BadImage):
        read_image_size(bytes(content))


def test_swapped_bytes_are_refused(folder: Path) -> None:
    for file in (folder / "depth").iterdir():
        cv2.imwrite(str(file), np.minimum(millimetres(), 2047).byteswap())
    with pytest.raises(RecordingError, match="swapped"):
        open_recording(folder)


def test_rotated_bits_are_refused_or_give_a_warning(folder: Path) -> None:
    for file in (folder / "depth").iterdir():
        values = millimetres()
        cv2.imwrite(str(file), (values << 3) | (values >> 13))
    with pytest.raises(RecordingError, match="rotated"):
        open_recording(folder)
    (folder / "camera.json").write_text('{"depth_scale": 1000}')
    with open_recording(folder) as recording:
        assert "rotated" in recording.warnings[0]


def test_depth_in_the_unit_of_tum_is_no_millimetres(folder: Path) -> None:
    for file in (folder / "depth").iterdir():
        cv2.imwrite(str(file), millimetres() * 5)
    with pytest.raises(RecordingError, match="1/5000 m"):
        open_recording(folder)
    (folder / "camera.json").write_text('{"depth_scale": 5000}')
    with open_recording(folder) as recording:
        assert recording.warnings == []
    np.testing.assert_array_equal(first_depth(folder).depth_m, metres(millimetres(), 1000))


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "said"), [("SUN_depth.png", "rotated"), ("NYU_depth.pgm", "swapped")]
)
def test_odd_encodings_are_refused(folder: Path, data_folder: Path, name: str, said: str) -> None:
    source = data_folder / "real/rgbd/redwood_and_odd_encodings/other_formats" / name
    shutil.copy(source, only_depth(folder, source.suffix))
    with pytest.raises(RecordingError, match=said):
        open_recording(folder)


@pytest.mark.data
def test_a_usual_depth_image_gives_no_warning(folder: Path, data_folder: Path) -> None:
    file = data_folder / "real/rgbd/redwood_and_odd_encodings/depth/00000.png"
    shutil.copy(file, only_depth(folder, ".png"))
    with open_recording(folder) as recording:
        (warning,) = recording.warnings
        assert warning.startswith("Depth is taken as millimetres")


ROS_YAML = """image_width: 16
image_height: 12
camera_name: depth
camera_matrix:
  rows: 3
  cols: 3
  data: [14.0, 0, 7.5, 0, 13.0, 5.5, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.25, -0.5, 0.125, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]
"""
OPEN3D = {"width": 16, "height": 12, "intrinsic_matrix": [14, 0, 0, 0, 13, 0, 7.5, 5.5, 1]}


@pytest.mark.parametrize(
    ("name", "text", "distortion"),
    [
        ("camera.json", json.dumps(CAMERA), ()),
        ("camera_info.yaml", ROS_YAML, (0.25, -0.5, 0.125, 0.0, 1.0)),
        ("intrinsics.json", json.dumps(OPEN3D), ()),
        ("camera-intrinsics.txt", "14 0 7.5\n0 13 5.5\n0 0 1\n", ()),
        ("calibration.txt", "14 13 7.5 5.5", ()),
        ("depth/camera_info.yml", ROS_YAML, (0.25, -0.5, 0.125, 0.0, 1.0)),
    ],
)
def test_camera_files(folder: Path, name: str, text: str, distortion: tuple[float, ...]) -> None:
    (folder / name).write_text(text)
    with open_recording(folder) as recording:
        intrinsics = recording.read(INFO, 2).value.intrinsics
    found = (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy)
    assert found == (14.0, 13.0, 7.5, 5.5)
    assert (intrinsics.width, intrinsics.height) == (16, 12)
    assert intrinsics.distortion == distortion


def test_a_camera_of_another_size_still_states_its_unit(folder: Path) -> None:
    camera = CAMERA | {"width": 640, "height": 480, "depth_scale": 5000}
    (folder / "camera.json").write_text(json.dumps(camera))
    with open_recording(folder) as recording:
        assert "(640, 480)" in recording.warnings[0]
        assert INFO not in {topic.name for topic in recording.topics}
    np.testing.assert_array_equal(first_depth(folder).depth_m, metres(millimetres(), 5000))


def test_camera_files_exclude_each_other(folder: Path) -> None:
    (folder / "camera.json").write_text(json.dumps(CAMERA))
    (folder / "camera_info.yaml").write_text(ROS_YAML)
    with open_recording(folder) as recording:
        assert "camera.json, camera_info.yaml" in recording.warnings[0]
        assert INFO not in {topic.name for topic in recording.topics}


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("camera.json", "[" * 60_000),
        ("camera.json", '{"a":' * 10_000),
        ("camera.json", '{"fx": ' + "9" * 60_000 + "}"),
        ("camera.json", " " * 70_000 + "{}"),
        ("camera.json", "null"),
        ("camera.json", json.dumps(CAMERA | {"fx": float("nan")})),
        ("camera.json", json.dumps(CAMERA | {"fx": 10**400})),
        ("camera.json", json.dumps(CAMERA | {"width": 1e300})),
        ("camera.json", json.dumps(CAMERA | {"width": 4.5})),
        ("camera.json", json.dumps(CAMERA | {"distortion": [1, 2, 3]})),
        ("camera.json", json.dumps(OPEN3D | {"intrinsic_matrix": [14, 13]})),
        (
            "camera.json",
            json.dumps(OPEN3D | {"intrinsic_matrix": [14, 0, 7.5, 0, 13, 5.5, 0, 0, 1]}),
        ),
        ("camera.yaml", "[" * 60_000),
        ("camera.yaml", "a: &a [x, x]\nb: &b [*a, *a, *a]\n"),
        ("camera.yaml", ROS_YAML.replace("[14.0,", "&a [14.0,") + "a: *a\n"),
        ("camera.yaml", "a: &a {fx: 1}\nb: {<<: [*a, *a]}\n"),
        ("camera.yaml", "!!python/object:os.system {}"),
        ("camera.yaml", "fx: 2001-99-99"),
        ("camera.yaml", "a: 1\n---\nb: 1\n"),
        ("camera.yaml", "a\0b"),
        ("camera.txt", "14 0 7.5 0 13 5.5 0 0"),
        ("camera.txt", "14 13 7.5 5.5 0.1 0.2 0.3 0.4 0.5"),
        ("camera.txt", "fx fy cx cy"),
    ],
)
def test_hostile_camera_files(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(RecordingError, match=name) as caught:
        read_camera_file(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_negative_focal_lengths_lose_only_the_intrinsics(folder: Path) -> None:
    (folder / "camera.json").write_text(json.dumps(CAMERA | {"fy": -13.0}))
    with open_recording(folder) as recording:
        assert "positive focal lengths" in recording.warnings[0]
        assert INFO not in {topic.name for topic in recording.topics}


def rename(folder: Path, names: list[str]) -> None:
    for file, name in zip(sorted(folder.iterdir()), names, strict=True):
        file.rename(folder / name)


def test_numbers_keep_their_gaps(folder: Path) -> None:
    rename(folder / "depth", ["depth_0009.png", "depth_0010.png", "depth_0013.png"])
    rename(folder / "rgb", ["000008.png", "000009.png", "000010.png"])
    with open_recording(folder) as recording:
        assert recording.stamps_are_nominal
        stamps = {t: [m.stamp_ns for m in recording.messages([t])] for t in (DEPTH, COLOR)}
    assert stamps[DEPTH] == [n * 10**9 // 30 for n in (1, 2, 5)]
    assert stamps[COLOR] == [n * 10**9 // 30 for n in (0, 1, 2)]


def test_names_of_two_kinds_are_not_mixed(folder: Path) -> None:
    rename(folder / "rgb", ["1305031102.1.png", "1305031102.2.png", "1305031102.3.png"])
    with open_recording(folder) as recording:
        assert {topic.name for topic in recording.topics} == {DEPTH}
        assert "rgb/ is left out" in recording.warnings[0]
    rename(folder / "depth", ["0.png", "1.png", "1305031102.3.png"])
    with pytest.raises(RecordingError, match="by number and others by time"):
        open_recording(folder)


def test_names_without_a_number_are_counted(folder: Path) -> None:
    rename(folder / "rgb", ["7.png", "left.png", "1305031102.png"])
    cv2.imwrite(str(folder / "rgb/007.png"), np.full((*SHAPE, 3), 77, np.uint8))
    (folder / "rgb/notes.txt").write_text("no image")
    with open_recording(folder) as recording:
        assert {topic.name: topic.count for topic in recording.topics}[COLOR] == 1
        assert recording.warnings[0].startswith("rgb/: 3 images are left out")
        # Of two files with one number the first by name, however the folder is listed.
        assert (recording.read(COLOR, 0).value.rgb == 77).all()


def test_depth_alone_is_a_recording(folder: Path) -> None:
    shutil.rmtree(folder / "rgb")
    with open_recording(folder) as recording:
        assert [topic.name for topic in recording.topics] == [DEPTH]


def test_color_alone_is_none(folder: Path) -> None:
    shutil.rmtree(folder / "depth")
    with pytest.raises(RecordingError, match="without a recording"):
        open_recording(folder)


def test_a_folder_of_no_images(folder: Path) -> None:
    rename(folder / "depth", ["a.exr", "b.exr", "c.exr"])
    with pytest.raises(RecordingError, match="no depth images") as caught:
        open_recording(folder)
    assert ".npy" in caught.value.advice


def test_a_file_in_place_of_the_depth_folder(folder: Path) -> None:
    shutil.rmtree(folder / "depth")
    (folder / "depth").write_text("")
    with pytest.raises(RecordingError, match="without a recording"):
        open_recording(folder)


def test_a_folder_and_a_pipe_in_place_of_images(folder: Path) -> None:
    for file in (folder / "depth/0.png", folder / "depth/2.png"):
        file.unlink()
    (folder / "depth/0.png").mkdir()
    os.mkfifo(folder / "depth/2.png")
    (folder / "camera.json").write_text(json.dumps(CAMERA))
    with open_recording(folder) as recording:
        assert [m.index for m in recording.messages([DEPTH])] == [1]
        assert any("not a regular file" in warning for warning in recording.warnings)
        assert INFO in {topic.name for topic in recording.topics}


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_no_permission(folder: Path) -> None:
    (folder / "depth/1.png").chmod(0)
    with open_recording(folder) as recording:
        assert [m.index for m in recording.messages([DEPTH])] == [0, 2]
    (folder / "depth").chmod(0)
    with pytest.raises(RecordingError, match="Permission denied"):
        open_recording(folder)
    (folder / "depth").chmod(0o700)


def test_more_files_than_are_indexed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fusion_core.recordings.images.image_folder.MAX_FILES", 2)
    with pytest.raises(RecordingError, match="more than 2 files"):
        open_recording(folder)


def test_eight_bit_depth_loses_only_itself(folder: Path) -> None:
    cv2.imwrite(str(folder / "depth/1.png"), millimetres().astype(np.uint8))
    with open_recording(folder) as recording, pytest.raises(RecordingError, match="uint8"):
        recording.read(DEPTH, 1)


def test_an_image_file_beyond_the_limit(folder: Path) -> None:
    with (folder / "depth/1.png").open("r+b") as file:
        file.truncate(1 << 34)
    with open_recording(folder) as recording, pytest.raises(RecordingError, match="larger than"):
        recording.read(DEPTH, 1)
