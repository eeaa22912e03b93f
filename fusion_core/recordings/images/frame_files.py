"""The files in a folder of frames: images, and poses as text.

Every function raises RecordingError with the file's name.
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fusion_core.files.regular_file import read_regular
from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.geometry import make_transform, rotation_from_quaternion
from fusion_core.recordings.messages.image_headers import (
    MAX_DECODED_BYTES,
    BadImage,
    read_image_size,
)

# Frames are numbered with at most twelve digits.
_MAX_FRAMES = 10**12
_MAX_TEXT_BYTES = 256 << 20
# A compressed image is at most as large as its decoded pixels and a header.
_MAX_PACKED_BYTES = MAX_DECODED_BYTES + (1 << 20)
_COPY_AGAIN = "Copy it again from its source."


def read_image_bytes(file: Path) -> bytes:
    """The bytes of an image file."""
    try:
        return read_regular(file, _MAX_PACKED_BYTES)
    except OSError as error:
        raise RecordingError(
            f"cannot be read: {error.strerror or error}.", file=file, advice=_COPY_AGAIN
        ) from error


def read_image(file: Path, flags: int) -> np.ndarray[Any, Any]:
    """The pixels of an image file; ``flags`` are OpenCV's IMREAD flags."""
    return decode_image(file, read_image_bytes(file), flags)


def decode_image(file: Path, packed: bytes, flags: int) -> np.ndarray[Any, Any]:
    """The pixels of ``packed``, the bytes of an image file."""
    try:
        read_image_size(packed)
        pixels = cv2.imdecode(np.frombuffer(packed, np.uint8), flags)
    except BadImage as error:
        raise RecordingError(f"{error}.", file=file, advice=_COPY_AGAIN) from error
    except cv2.error as error:
        problem = " ".join(str(error).split())
        raise RecordingError(
            f"cannot be read: {problem}.", file=file, advice=_COPY_AGAIN
        ) from error
    if pixels is None:
        raise RecordingError("is a damaged image.", file=file, advice=_COPY_AGAIN)
    return np.asarray(pixels)


def read_rgb(file: Path) -> ByteArray:
    """(H, W, 3) uint8 of a colour or grey image, as its rows are stored."""
    bgr = read_image(file, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    rgb: ByteArray = np.ascontiguousarray(bgr[:, :, ::-1])
    return rgb


def read_trajectory_log(file: Path, warnings: list[str]) -> dict[int, FloatArray]:
    """(4, 4) poses by frame index, from blocks of a line "index id next" and four matrix rows.

    Everything after a damaged block is lost; ``warnings`` gets a line about it.
    """
    blocks = _leading_rows(file, 19, "five lines: three numbers, and four rows of four", warnings)
    named = blocks[np.isfinite(blocks[:, 0]) & (np.abs(blocks[:, 0]) < _MAX_FRAMES)]
    if len(named) < len(blocks):
        warnings.append(f"{file.name}: {len(blocks) - len(named)} poses name no frame.")
    return {int(block[0]): block[3:].reshape(4, 4) for block in named}


def read_pose_lines(file: Path, warnings: list[str]) -> dict[int, FloatArray]:
    """(4, 4) poses by frame index, from one line tx ty tz qx qy qz qw per frame.

    Damage is handled as in ``read_trajectory_log``; a pose with an invalid quaternion is skipped.
    """
    poses = {}
    rows = _leading_rows(file, 7, "a line tx ty tz qx qy qz qw", warnings)
    for place, row in enumerate(rows):
        try:
            poses[place] = make_transform(rotation_from_quaternion(*row[3:]), row[:3])
        except ValueError:
            continue
    if len(poses) < len(rows):
        warnings.append(f"{file.name}: {len(rows) - len(poses)} poses are no rotations.")
    return poses


def _leading_rows(file: Path, width: int, form: str, warnings: list[str]) -> FloatArray:
    """(n, width) complete rows of numbers before the first word that is not a number."""
    words = read_text(file).split()
    numbers: list[float] = []
    for word in words:
        try:
            numbers.append(float(word))
        except ValueError:
            break
    count = len(numbers) // width
    if count * width < len(words):
        warnings.append(
            f"{file.name} is damaged or cut short after {count} poses: a pose is {form}."
        )
    return np.array(numbers[: count * width]).reshape(count, width)


def read_matrix(file: Path, shape: tuple[int, int]) -> FloatArray:
    """The matrix in a text file that contains nothing else."""
    values = _read_numbers(file)
    if values.size != shape[0] * shape[1]:
        raise RecordingError(
            f"holds {values.size} numbers, a {shape[0]} x {shape[1]} matrix is needed.",
            file=file,
            advice="Write one row of the matrix on each line.",
        )
    return values.reshape(shape)


def _read_numbers(file: Path) -> FloatArray:
    try:
        return np.array(read_text(file).split(), dtype=np.float64)
    except ValueError as error:
        raise RecordingError(
            f"is no table of numbers: {error}.", file=file, advice="Write numbers and spaces alone."
        ) from error


def read_text(file: Path, max_bytes: int = _MAX_TEXT_BYTES) -> str:
    """The text of a file of at most ``max_bytes``."""
    try:
        # Line ends of any platform.
        return read_regular(file, max_bytes).decode().replace("\r\n", "\n").replace("\r", "\n")
    except OSError as error:
        raise RecordingError(
            f"cannot be read: {error.strerror or error}.",
            file=file,
            advice="Check the path and its permissions.",
        ) from error
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"is no text: {error}.", file=file, advice="Check what it holds."
        ) from error
