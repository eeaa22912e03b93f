"""Text packed by gzip or bzip2: unpacked once, since neither can be read from the middle."""

import bz2
import gzip
import shutil
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from fusion_core.files.regular_file import read_head
from fusion_core.model.errors import RecordingError

# Where an archive is damaged, the piece that is being unpacked is lost.
_STEP_BYTES = 4 << 10
# A log is some ten times its packed size; what unpacks to more than this is no log.
_MAX_DECOMPRESSED_BYTES = 8 << 30
_MAX_RATIO = 100
_SMALLEST_LIMIT_BYTES = 256 << 20
# What a full disk would take from everybody else.
_DISK_RESERVE_BYTES = 256 << 20
# gzip and bz2 tell damage by OSError, a cut by EOFError; zlib has its own error.
_DAMAGE = (OSError, EOFError, zlib.error)


@dataclass(frozen=True, slots=True)
class Compression:
    """A way to pack one file. ``open`` gives a stream that has ``read1``."""

    name: str
    magic: bytes
    open: Callable[[Path], gzip.GzipFile | bz2.BZ2File]


@dataclass(frozen=True, slots=True, kw_only=True)
class DecompressedFile:
    """``file`` is nameless and goes with its closing. ``lost`` says why it is not the whole text,
    and is empty where it is."""

    file: BinaryIO
    lost: str


_COMPRESSIONS = (
    Compression("gzip", b"\x1f\x8b\x08", gzip.GzipFile),
    Compression("bzip2", b"BZh", bz2.BZ2File),
)


def detect_compression(path: Path) -> Compression | None:
    """How a file is packed, told by its first bytes; None if it is neither gzip nor bzip2."""
    head = read_head(path, max(len(packing.magic) for packing in _COMPRESSIONS))
    return next((packing for packing in _COMPRESSIONS if head.startswith(packing.magic)), None)


def read_decompressed_head(path: Path, count: int) -> bytes:
    """Up to ``count`` bytes from the beginning of a file, unpacked if it is packed.

    What of an archive cannot be unpacked is left out.
    """
    packing = detect_compression(path)
    if packing is None:
        return read_head(path, count)
    head = b""
    with packing.open(path) as packed:
        while len(head) < count:
            try:
                piece = packed.read1(min(_STEP_BYTES, count - len(head)))
            except _DAMAGE:
                break
            if not piece:
                break
            head += piece
    return head


def decompress_to_temporary_file(path: Path, packing: Compression) -> DecompressedFile:
    """Unpack to a temporary file, as far as the archive can be read and the limits allow.

    The limits are 8 GiB, 100 times the packed size and the free space of the disk.
    Raises RecordingError where the temporary file cannot be written.
    """
    limit, reason = _size_limit(path)
    file = tempfile.TemporaryFile()  # noqa: SIM115  # The caller closes it.
    try:
        lost = _decompress(path, packing, file, limit, reason)
        file.seek(0)
    except BaseException:
        file.close()
        raise
    return DecompressedFile(file=file, lost=lost)


def _size_limit(path: Path) -> tuple[int, str]:
    """The most bytes to unpack, and what to say where the archive holds more."""
    most = min(
        _MAX_DECOMPRESSED_BYTES, max(_SMALLEST_LIMIT_BYTES, _MAX_RATIO * path.stat().st_size)
    )
    room = max(0, shutil.disk_usage(tempfile.gettempdir()).free - _DISK_RESERVE_BYTES)
    if room < most:
        return room, f"the disk of temporary files has room for no more than {room} bytes of it"
    return most, f"the archive unpacks to more than {most} bytes"


def _decompress(path: Path, packing: Compression, file: BinaryIO, limit: int, reason: str) -> str:
    """Unpack into ``file``; why it is not the whole archive, or nothing if it is."""
    size = 0
    with packing.open(path) as packed:
        while True:
            try:
                piece = packed.read1(_STEP_BYTES)
            except _DAMAGE as error:
                said = " ".join(str(error).split()).rstrip(".")
                return f"the {packing.name} archive breaks off after {size} unpacked bytes ({said})"
            if not piece:
                return ""
            if size + len(piece) > limit:
                return reason
            try:
                file.write(piece)
            except OSError as error:
                raise RecordingError(
                    f"cannot be unpacked: {error.strerror or error}.",
                    file=path,
                    advice="Free space for temporary files, or name another folder in TMPDIR.",
                ) from error
            size += len(piece)
