"""The single files of a folder of frames: images, poses and intrinsics as text.

Every function raises RecordingError naming its file.
"""

import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.geometry import rotation_from_quaternion, transform
from fusion_core.model.sensors import CameraIntrinsics

_MAX_TEXT_BYTES = 256 << 20
# A damaged PNG may claim any size, and OpenCV takes the memory before it reads on.
_MAX_PIXELS = 1 << 26
_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
_PNG_CHUNK = struct.Struct(">I4s")
_PNG_CRC_BYTES = 4
_PNG_SIZE = struct.Struct(">II")


def read_image(file: Path, flags: int) -> np.ndarray[Any, Any]:
    """The pixels of an image file; ``flags`` are OpenCV's IMREAD flags."""
    try:
        packed = file.read_bytes()
        if packed.startswith(_PNG_MAGIC):
            _check_png(file, packed)
        pixels = cv2.imdecode(np.frombuffer(packed, np.uint8), flags) if packed else None
    except (OSError, cv2.error) as error:
        problem = " ".join(str(error).split())
        raise RecordingError(
            f"cannot be read: {problem}.", file=file, advice="Copy it again from its source."
        ) from error
    if pixels is None:
        raise RecordingError(
            "is no image, or cut short.", file=file, advice="Copy it again from its source."
        )
    return np.asarray(pixels)


def _check_png(file: Path, packed: bytes) -> None:
    """Refuse a PNG whose chunks do not fit into the file, or of a size that nobody records."""
    again = "Copy it again from its source."
    position, kind = len(_PNG_MAGIC), b""
    while kind != b"IEND":
        if position + _PNG_CHUNK.size > len(packed):
            raise RecordingError("is a PNG image that is cut short.", file=file, advice=again)
        size, kind = _PNG_CHUNK.unpack_from(packed, position)
        content = position + _PNG_CHUNK.size
        if kind == b"IHDR" and size >= _PNG_SIZE.size <= len(packed) - content:
            width, height = _PNG_SIZE.unpack_from(packed, content)
            if width * height > _MAX_PIXELS:
                raise RecordingError(
                    f"claims {width} x {height} pixels, more than {_MAX_PIXELS}.",
                    file=file,
                    advice=again,
                )
        position = content + size + _PNG_CRC_BYTES


def read_intrinsics(file: Path, shape: tuple[int, ...]) -> CameraIntrinsics:
    """Intrinsics for images of ``shape`` (rows, columns): Open3D's JSON, or a 3 x 3 text file."""
    if file.suffix == ".json":
        k, size = _read_open3d_camera(file)
        if size != shape:
            raise RecordingError(
                f"is for images of {size[::-1]}, the depth images are {shape[::-1]}.",
                file=file,
                advice="Put the depth camera's own file there.",
            )
    else:
        k = read_matrix(file, (3, 3))
    try:
        return CameraIntrinsics(
            width=shape[1], height=shape[0], fx=k[0, 0], fy=k[1, 1], cx=k[0, 2], cy=k[1, 2]
        )
    except ValueError as error:
        raise RecordingError(
            f"{error}.", file=file, advice="Calibrate the camera, or remove the file."
        ) from error


def _read_open3d_camera(file: Path) -> tuple[FloatArray, tuple[int, int]]:
    try:
        camera = json.loads(_read_text(file))
        # Open3D writes the matrix by columns.
        k = np.array(camera["intrinsic_matrix"], dtype=np.float64).reshape(3, 3).T
        return k, (int(camera["height"]), int(camera["width"]))
    except (ValueError, KeyError, TypeError) as error:
        raise RecordingError(
            f"is no camera of Open3D: {error}.",
            file=file,
            advice="It needs width, height and intrinsic_matrix.",
        ) from error


def read_trajectory_log(file: Path) -> dict[int, FloatArray]:
    """{place of the frame: (4, 4)}: blocks of a line "place id next" and four rows."""
    values = _read_numbers(file)
    if values.size == 0 or values.size % 19:
        raise RecordingError(
            f"holds {values.size} numbers, not 19 for each pose.",
            file=file,
            advice="A block is one line of three numbers and four rows of four.",
        )
    blocks = values.reshape(-1, 19)
    if not np.isfinite(blocks[:, 0]).all():
        raise RecordingError(
            "has a block without a frame number.", file=file, advice="Write the file again."
        )
    return {int(block[0]): block[3:].reshape(4, 4) for block in blocks}


def read_pose_lines(file: Path) -> dict[int, FloatArray]:
    """{place of the frame: (4, 4)}: one line tx ty tz qx qy qz qw for each frame."""
    values = _read_numbers(file)
    if values.size == 0 or values.size % 7:
        raise RecordingError(
            f"holds {values.size} numbers, not 7 for each pose.",
            file=file,
            advice="A line is tx ty tz qx qy qz qw.",
        )
    try:
        return {
            place: transform(rotation_from_quaternion(*row[3:]), row[:3])
            for place, row in enumerate(values.reshape(-1, 7))
        }
    except ValueError as error:
        raise RecordingError(
            f"{error}.", file=file, advice="A line is tx ty tz qx qy qz qw."
        ) from error


def read_matrix(file: Path, shape: tuple[int, int]) -> FloatArray:
    """A text file of exactly the numbers of one matrix."""
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
        return np.array(_read_text(file).split(), dtype=np.float64)
    except ValueError as error:
        raise RecordingError(
            f"is no table of numbers: {error}.", file=file, advice="Write numbers and spaces alone."
        ) from error


def _read_text(file: Path) -> str:
    try:
        if file.stat().st_size > _MAX_TEXT_BYTES:
            raise RecordingError(
                "is too large for a text file of poses.", file=file, advice="Check what it holds."
            )
        return file.read_text(encoding="utf-8")
    except OSError as error:
        raise RecordingError(
            f"cannot be read: {error.strerror or error}.",
            file=file,
            advice="Check the path and its permissions.",
        ) from error
