"""CompressedImage: every compression, against other libraries and the published RVL."""

import io
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image as PillowImage

from fusion_core.model.errors import RecordingError
from fusion_core.model.sensors import ColorImage, DepthImage
from fusion_core.recordings.decode import decode_message, image_encoding
from fusion_core.recordings.messages.compressed_image import decompressed_encoding
from fusion_core.recordings.messages.rvl import decompress
from fusion_core.recordings.topics import role_from_encoding

HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=7, nanosec=5), frame_id="/camera")
RNG = np.random.default_rng(3)
RGB = np.ascontiguousarray(
    np.stack(np.meshgrid(np.arange(0, 240, 8), np.arange(250, 10, -8), [40]), axis=-1)[:, :, 0]
).astype(np.uint8)
DEPTH_MM = (1500 + 40 * RNG.normal(size=(24, 32))).astype(np.uint16)
DEPTH_MM[3:6, 4:20] = 0
DEPTH_MM[0, 0], DEPTH_MM[-1, -1] = 0, 65534
DEPTH_M = np.where(DEPTH_MM == 0, np.nan, DEPTH_MM.astype(np.float32) / np.float32(1000))
# image_transport's defaults: depth_quantization 100, depth_max 10 m.
A = 100.0 * 101.0
B = 1.0 - A / 10.0


def config(a: float = 0.0, b: float = 0.0) -> bytes:
    return struct.pack("<iff", 0, a, b)


def png(pixels: np.ndarray) -> bytes:
    if pixels.ndim == 3:
        pixels = np.ascontiguousarray(pixels[:, :, ::-1])
    return bytes(cv2.imencode(".png", pixels)[1])


def jpeg(rgb: np.ndarray, *flags: int) -> bytes:
    return bytes(cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]), flags)[1])


def zigzag(difference: int) -> int:
    return 2 * difference if difference >= 0 else -2 * difference - 1


def runs(values: list[int]) -> list[int]:
    """The numbers of an RVL stream, before they are packed."""
    numbers, place, last = [], 0, 0
    while place < len(values):
        zeros = next((k for k, v in enumerate(values[place:]) if v), len(values) - place)
        place += zeros
        others = next((k for k, v in enumerate(values[place:]) if not v), len(values) - place)
        numbers += [zeros, others]
        for value in values[place : place + others]:
            numbers.append(zigzag(value - last))
            last = value
        place += others
    return numbers


def packed_numbers(numbers: list[int]) -> bytes:
    """Nibbles of three bits, the topmost says that more follow; eight fill a word from its top."""
    text = ""
    for number in numbers:
        digits = [number >> k & 7 for k in range(0, max(number.bit_length(), 1), 3)]
        text += "".join(f"{d | 8:x}" for d in digits[:-1]) + f"{digits[-1]:x}"
    text += "0" * (-len(text) % 8)
    return b"".join(bytes.fromhex(text[k : k + 8])[::-1] for k in range(0, len(text), 8))


def rvl_stream(values: np.ndarray) -> bytes:
    return packed_numbers(runs([int(v) for v in values.ravel()]))


def slow_decompress(stream: bytes, count: int) -> list[int] | None:
    """The published decoder, number by number; None where the stream does not hold ``count``."""
    words = [stream[k : k + 4][::-1].hex() for k in range(0, len(stream) - 3, 4)]
    nibbles = iter([int(digit, 16) for word in words for digit in word])
    values: list[int] = []
    last = 0

    def number() -> int:
        result = 0
        for k in range(10):
            nibble = next(nibbles)
            result |= (nibble & 7) << 3 * k
            if nibble < 8:
                return result
        raise StopIteration

    try:
        while len(values) < count:
            zeros = number()
            if zeros > count - len(values):
                return None
            values += [0] * zeros
            if len(values) == count:
                break
            others = number()
            if others > count - len(values):
                return None
            for _ in range(others):
                packed = number()
                last += -((packed + 1) // 2) if packed % 2 else packed // 2
                values.append(last % 65536)
    except StopIteration:
        return None
    return values


def rvl(values: np.ndarray) -> bytes:
    height, width = values.shape
    return struct.pack("<II", width, height) + rvl_stream(values)


def message(format: str, data: bytes) -> SimpleNamespace:
    return SimpleNamespace(header=HEADER, format=format, data=np.frombuffer(data, np.uint8))


def read(format: str, data: bytes) -> Any:
    kind = "sensor_msgs/msg/CompressedImage"
    return decode_message(message(format, data), kind, topic="/packed", received_ns=9)


@pytest.mark.parametrize(
    "format",
    ["png", "rgb8; png compressed bgr8", "bgr8; png compressed bgr8", "rgb8; png", "PNG", "jpeg"],
)
def test_colour_as_png(format: str) -> None:
    value = read(format, png(RGB))
    assert isinstance(value, ColorImage)
    np.testing.assert_array_equal(value.rgb, RGB)
    assert (value.stamp_ns, value.received_ns, value.frame_id) == (7_000_000_005, 9, "camera")


@pytest.mark.parametrize(
    "format",
    ["jpeg", "jpg", "rgb8; jpeg compressed bgr8", "bgr8; jpeg compressed bgr8", "mono8; jpeg"],
)
@pytest.mark.parametrize("progressive", [0, 1])
def test_colour_as_jpeg_equals_pillow(format: str, progressive: int) -> None:
    packed = jpeg(RGB, cv2.IMWRITE_JPEG_PROGRESSIVE, progressive)
    expected = np.asarray(PillowImage.open(io.BytesIO(packed)).convert("RGB"))
    value = read(format, packed)
    assert np.abs(value.rgb.astype(int) - expected).max() <= 3
    assert np.abs(value.rgb.astype(int) - RGB).mean() < 6


def test_grey_becomes_three_equal_channels() -> None:
    grey = RGB[:, :, 0]
    rgb = read("mono8; png compressed ", png(grey)).rgb
    np.testing.assert_array_equal(rgb, np.stack([grey] * 3, axis=-1))


def test_a_rotation_noted_in_a_jpeg_turns_nothing() -> None:
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    packed = jpeg(RGB[:16])
    turned = packed[:2] + struct.pack(">BBH", 0xFF, 0xE1, len(exif) + 2) + exif + packed[2:]
    assert PillowImage.open(io.BytesIO(turned)).getexif()[0x0112] == 6
    np.testing.assert_array_equal(read("jpeg", turned).rgb, read("jpeg", packed).rgb)


@pytest.mark.parametrize(
    ("format", "data"),
    [
        ("16UC1; png compressed ", png(DEPTH_MM)),
        ("mono16; png compressed", png(DEPTH_MM)),
        ("png", png(DEPTH_MM)),
        ("16UC1; compressedDepth png", config() + png(DEPTH_MM)),
        ("16UC1; compressedDepth", config() + png(DEPTH_MM)),
        ("16UC1;compressedDepth png", config(A, B) + png(DEPTH_MM)),
        ("16UC1", config() + png(DEPTH_MM)),
        ("mono16; compressedDepth png", config() + png(DEPTH_MM)),
        ("16UC1; compressedDepth png", png(DEPTH_MM)),
        ("16UC1; compressedDepth png", config() + bytes(4) + png(DEPTH_MM)),
        ("16UC1; compressedDepth rvl", config() + rvl(DEPTH_MM)),
        ("16UC1;compressedDepth rvl", config(A, B) + rvl(DEPTH_MM) + bytes(5)),
    ],
)
def test_depth_in_millimetres(format: str, data: bytes) -> None:
    value = read(format, data)
    assert isinstance(value, DepthImage)
    assert value.encoding == "16UC1"
    np.testing.assert_array_equal(value.depth_m, DEPTH_M.astype(np.float32))


@pytest.mark.parametrize("codec", ["png", "rvl"])
def test_inverse_depth(codec: str) -> None:
    depth_m = RNG.uniform(0.4, 9.9, size=(24, 32))
    depth_m[5, 2:9] = np.nan
    inverse = np.nan_to_num(np.rint(A / depth_m + B)).astype(np.uint16)
    packed = png(inverse) if codec == "png" else rvl(inverse)
    value = read(f"32FC1; compressedDepth {codec}", config(A, B) + packed)
    assert value.encoding == "32FC1"
    np.testing.assert_array_equal(np.isnan(value.depth_m), np.isnan(depth_m))
    # Half a step of the inverse: d(depth) = depth² / A / 2.
    valid = ~np.isnan(depth_m)
    error = np.abs(value.depth_m - depth_m)[valid]
    assert (error <= 0.5001 * depth_m[valid] ** 2 / A + 1e-5).all()


def test_inverse_depth_beyond_its_pole_is_missing() -> None:
    inverse = np.array([[0, 1, 2, 3, 4, 65535]], np.uint16)
    value = read("32FC1; compressedDepth png", config(10.0, 2.0) + png(inverse))
    expected = np.array([[np.nan, np.nan, np.nan, 10.0, 5.0, 10.0 / 65533.0]], np.float32)
    np.testing.assert_array_equal(value.depth_m, expected)


def test_floating_depth_as_tiff() -> None:
    packed = bytes(cv2.imencode(".tiff", DEPTH_M.astype(np.float32))[1])
    value = read("32FC1; tiff compressed ", packed)
    assert value.encoding == "32FC1"
    np.testing.assert_array_equal(value.depth_m, DEPTH_M.astype(np.float32))


@given(st.lists(st.one_of(st.just(0), st.integers(0, 65535)), min_size=1, max_size=60))
def test_rvl_round_trip(values: list[int]) -> None:
    stream = packed_numbers(runs(values))
    assert slow_decompress(stream, len(values)) == values
    assert decompress(stream, len(values)).tolist() == values


@given(st.binary(max_size=60), st.integers(1, 80))
def test_rvl_of_any_bytes_as_the_published_decoder(stream: bytes, count: int) -> None:
    expected = slow_decompress(stream, count)
    if expected is None:
        with pytest.raises(ValueError, match="breaks off"):
            decompress(stream, count)
    else:
        assert decompress(stream, count).tolist() == expected


def test_an_image_without_any_depth() -> None:
    empty = np.zeros((480, 640), np.uint16)
    data = config() + rvl(empty)
    assert len(data) < 30
    assert np.isnan(read("16UC1; compressedDepth rvl", data).depth_m).all()


@pytest.mark.parametrize(
    ("encoding", "codec"), [("16UC1", "png"), ("16UC1", "rvl"), ("32FC1", "png"), ("32FC1", "rvl")]
)
def test_depth_truncated_anywhere(encoding: str, codec: str) -> None:
    data = config(A, B) + (png(DEPTH_MM) if codec == "png" else rvl(DEPTH_MM))
    for size in [*range(40), *range(40, len(data) - 3, 37), len(data) - 4, len(data) - 1]:
        with pytest.raises(RecordingError, match="/packed") as caught:
            read(f"{encoding}; compressedDepth {codec}", data[:size])
        assert caught.value.advice
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("pack", [png, jpeg])
def test_colour_truncated_anywhere(pack: Callable[[np.ndarray], bytes]) -> None:
    data = pack(RGB)
    for size in [*range(40), *range(40, len(data) - 3, 37), len(data) - 1]:
        with pytest.raises(RecordingError, match="/packed"):
            read("rgb8; jpeg compressed bgr8", data[:size])


def png_of_size(width: int, height: int) -> bytes:
    """A whole PNG whose header claims a size that its data does not have."""
    packed = bytearray(png(DEPTH_MM))
    packed[16:24] = struct.pack(">II", width, height)
    packed[29:33] = struct.pack(">I", zlib.crc32(packed[12:29]))
    return bytes(packed)


def jpeg_of_size(width: int, height: int) -> bytes:
    packed = bytearray(jpeg(RGB))
    frame = packed.index(b"\xff\xc0")
    packed[frame + 5 : frame + 9] = struct.pack(">HH", height, width)
    return bytes(packed)


@pytest.mark.parametrize(
    ("format", "data", "named"),
    [
        ("png", png_of_size(1 << 30, 1 << 30), "1073741824 x 1073741824"),
        ("16UC1; png compressed", png_of_size(5000, 5000), "5000 x 5000"),
        ("16UC1; compressedDepth png", config() + png_of_size(0, 4), "0 x 4"),
        ("16UC1; compressedDepth png", config() + png_of_size(65535, 65535), "65535 x 65535"),
        ("jpeg", jpeg_of_size(65535, 65535), "65535 x 65535"),
        ("jpeg", jpeg_of_size(0, 9), "0 x 9"),
        (
            "16UC1; compressedDepth rvl",
            config() + struct.pack("<II", 2**32 - 1, 2**32 - 1) + bytes(64),
            "4294967295 x 4294967295",
        ),
        ("16UC1; compressedDepth rvl", config() + struct.pack("<II", 0, 5) + bytes(64), "0 x 5"),
        ("16UC1; compressedDepth rvl", config() + struct.pack("<II", 9, 9) + bytes(64), "0 of 81"),
    ],
)
def test_sizes_are_checked_before_memory_is_taken(format: str, data: bytes, named: str) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(RecordingError, match=named):
            read(format, data)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("format", "data", "named"),
    [
        ("h264", b"\0\0\0\x01\x67" + bytes(50), "h264"),
        ("", b"", "format ''"),
        ("x" * 5000, b"", "xxx...'"),
        ("16UC1; compressedDepth zstd", config() + png(DEPTH_MM), "zstd"),
        ("8UC1; compressedDepth png", config() + png(DEPTH_MM), "8UC1"),
        ("16UC1; jpeg compressed", jpeg(RGB), "16UC1; jpeg"),
        ("16UC1; png compressed", png(RGB), "uint8"),
        ("16UC1; compressedDepth png", config() + jpeg(RGB), "no PNG"),
        ("32FC1; png compressed", png(DEPTH_MM), "uint16"),
        ("32FC1; compressedDepth png", png(DEPTH_MM), "A and B"),
        ("32FC1; compressedDepth png", config(np.nan, 1.0) + png(DEPTH_MM), "A = nan"),
        ("32FC1; compressedDepth rvl", config(0.0, 1.0) + rvl(DEPTH_MM), "A = 0"),
    ],
)
def test_what_is_not_read(format: str, data: bytes, named: str) -> None:
    with pytest.raises(RecordingError, match=named) as caught:
        read(format, data)
    assert caught.value.advice
    assert len(str(caught.value)) < 300
    assert "\n" not in str(caught.value)


PACKED = [
    ("jpeg", jpeg(RGB)),
    ("rgb8; png compressed bgr8", png(RGB)),
    ("16UC1; png compressed", png(DEPTH_MM)),
    ("16UC1; compressedDepth png", config() + png(DEPTH_MM)),
    ("32FC1; compressedDepth rvl", config(A, B) + rvl(DEPTH_MM)),
]


@given(st.sampled_from(PACKED), st.data())
def test_damage_loses_the_message_at_most(packed: tuple[str, bytes], data: st.DataObject) -> None:
    format, content = packed
    damaged = bytearray(content)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    # Nothing but a RecordingError may come out of it.
    with suppress(RecordingError):
        assert isinstance(read(format, bytes(damaged)), ColorImage | DepthImage)


@pytest.mark.parametrize(
    ("format", "data", "name", "role"),
    [
        ("jpeg", jpeg(RGB), "/c", "color"),
        ("bayer_rggb8; jpeg compressed bgr8", jpeg(RGB), "/c", "color"),
        ("rgb8; png compressed bgr8", png(RGB), "/depth/c", "color"),
        ("16UC1; png compressed", png(DEPTH_MM), "/c", "depth"),
        ("32FC1; compressedDepth rvl", b"", "/c", "depth"),
        ("mono16; compressedDepth png", b"", "/c", "depth"),
        ("16UC1", b"", "/c", "depth"),
        # Infrared and depth of 16 bits look alike: the name decides.
        ("png", png(DEPTH_MM), "/depth/c", "depth"),
        ("png", png(DEPTH_MM), "/infrared/c", "other"),
        ("mono16; png compressed", png(DEPTH_MM), "/infrared/c", "other"),
        ("16UC1; jpeg compressed", jpeg(RGB), "/depth/c", "other"),
        ("h264", bytes(40), "/c", "other"),
        ("jpeg", b"", "/c", "other"),
    ],
)
def test_roles(format: str, data: bytes, name: str, role: str) -> None:
    raw = message(format, data)
    assert image_encoding(raw) == decompressed_encoding(format, raw.data)
    assert role_from_encoding(image_encoding(raw), name) == role
