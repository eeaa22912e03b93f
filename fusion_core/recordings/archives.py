"""Text files compressed by gzip or bzip2, decompressed once: neither has random access."""

import bz2
import gzip
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from fusion_core.files.regular_file import read_head
from fusion_core.recordings.decompression import (
    BoundedOutput,
    describe_damage,
    free_temporary_bytes,
    output_error,
)

# Where an archive is damaged, at most one step is lost.
_STEP_BYTES = 4 << 10
# A log is about ten times its compressed size; more than this is no log.
_MAX_DECOMPRESSED_BYTES = 8 << 30
_MAX_RATIO = 100
_SMALLEST_LIMIT_BYTES = 256 << 20
# gzip and bz2 raise OSError for damage, EOFError for truncation; zlib has its own error.
_DAMAGE = (OSError, EOFError, zlib.error)


@dataclass(frozen=True, slots=True)
class Compression:
    """A compression of single files. ``open`` gives a stream that has ``read1``."""

    name: str
    magic: bytes
    open: Callable[[Path], gzip.GzipFile | bz2.BZ2File]


@dataclass(frozen=True, slots=True, kw_only=True)
class DecompressedFile:
    """``file`` is deleted when closed. ``lost`` says why its text is incomplete, or is empty."""

    file: BinaryIO
    lost: str


_COMPRESSIONS = (
    Compression("gzip", b"\x1f\x8b\x08", gzip.GzipFile),
    Compression("bzip2", b"BZh", bz2.BZ2File),
)


def detect_compression(path: Path) -> Compression | None:
    """The compression of a file by its first bytes; None if it is neither gzip nor bzip2."""
    head = read_head(path, max(len(compression.magic) for compression in _COMPRESSIONS))
    return next(
        (compression for compression in _COMPRESSIONS if head.startswith(compression.magic)), None
    )


def read_decompressed_head(path: Path, count: int) -> bytes:
    """Up to ``count`` bytes from the beginning of a file, decompressed if it is compressed.

    The part of an archive that cannot be decompressed is left out.
    """
    compression = detect_compression(path)
    if compression is None:
        return read_head(path, count)
    head = b""
    with compression.open(path) as packed:
        while len(head) < count:
            try:
                piece = packed.read1(min(_STEP_BYTES, count - len(head)))
            except _DAMAGE:
                break
            if not piece:
                break
            head += piece
    return head


def decompress_to_temporary_file(path: Path, compression: Compression) -> DecompressedFile:
    """Decompress to a temporary file, as far as the archive can be read and the limits allow.

    The limits are 8 GiB, 100 times the compressed size and the free space of the disk.
    Raises RecordingError where the temporary file cannot be written.
    """
    max_bytes, reason = _size_limit(path)
    file = tempfile.TemporaryFile()  # noqa: SIM115  # The caller closes it.
    try:
        try:
            lost = _decompress(path, compression, BoundedOutput(file, path, max_bytes), reason)
            file.seek(0)
        except BaseException:
            file.close()
            raise
    except OSError as error:
        raise output_error(path, error) from error
    return DecompressedFile(file=file, lost=lost)


def _size_limit(path: Path) -> tuple[int, str]:
    """The limit of the decompressed size, and the warning where the archive holds more."""
    most = min(
        _MAX_DECOMPRESSED_BYTES, max(_SMALLEST_LIMIT_BYTES, _MAX_RATIO * path.stat().st_size)
    )
    room = free_temporary_bytes()
    if room < most:
        return room, f"the disk of temporary files has room for no more than {room} bytes of it"
    return most, f"the archive unpacks to more than {most} bytes"


def _decompress(path: Path, compression: Compression, output: BoundedOutput, reason: str) -> str:
    """Decompress into ``output``; returns why that is incomplete, or an empty text.

    ``reason``: the text where the archive exceeds the limit.
    """
    with compression.open(path) as packed:
        while True:
            try:
                piece = packed.read1(_STEP_BYTES)
            except _DAMAGE as error:
                return (
                    f"the {compression.name} archive breaks off after {output.written_bytes} "
                    f"unpacked bytes ({describe_damage(error)})"
                )
            if not piece:
                return ""
            if not output.write(piece):
                return reason
