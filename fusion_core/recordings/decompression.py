"""Decompression within limits of memory and disk: archives may be damaged or hostile."""

import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, Protocol

from fusion_core.model.errors import RecordingError

# Left free for other programs.
_DISK_RESERVE_BYTES = 256 << 20


class Decompressor(Protocol):
    """The interface that the standard library's decompressors and lz4's have in common."""

    @property
    def eof(self) -> bool: ...

    @property
    def needs_input(self) -> bool: ...

    @property
    def unused_data(self) -> bytes | None: ...

    def decompress(self, data: bytes, max_length: int = -1) -> bytes: ...


def decompress_pieces(
    decompressor: Decompressor, read: Callable[[], bytes], piece_bytes: int
) -> Iterator[bytes]:
    """The content of one compressed stream, at most ``piece_bytes`` at a time.

    ``read`` returns the next compressed bytes, empty at their end. The stream is complete if the
    decompressor's ``eof`` is set after the last piece. Raises the decompressor's errors.
    """
    while not decompressor.eof:
        packed = b""
        if decompressor.needs_input:
            packed = read()
            if not packed:
                return
        yield decompressor.decompress(packed, piece_bytes)


def free_temporary_bytes() -> int:
    """Free space of the disk of temporary files, less a reserve for other programs."""
    return max(0, shutil.disk_usage(tempfile.gettempdir()).free - _DISK_RESERVE_BYTES)


class BoundedOutput:
    """Writes the content of ``archive`` to a temporary file, up to ``max_bytes``."""

    def __init__(self, file: BinaryIO, archive: Path, max_bytes: int) -> None:
        self.written_bytes = 0
        self._file = file
        self._archive = archive
        self._max_bytes = max_bytes

    def write(self, piece: bytes) -> bool:
        """Write a piece; False, and nothing is written, if it exceeds the limit.

        Raises RecordingError where the disk cannot take it.
        """
        if self.written_bytes + len(piece) > self._max_bytes:
            return False
        try:
            self._file.write(piece)
        except OSError as error:
            raise output_error(self._archive, error) from error
        self.written_bytes += len(piece)
        return True


def output_error(archive: Path, error: OSError) -> RecordingError:
    """The content of ``archive`` cannot be written: as a piece, or when the file is closed, which
    writes what is left of the last one."""
    return RecordingError(
        f"cannot be unpacked: {error.strerror or error}.",
        file=archive,
        advice=f"Free space in {tempfile.gettempdir()}, or name another folder in TMPDIR.",
    )


def describe_damage(error: Exception) -> str:
    """A decompressor's error as part of a sentence on one line."""
    return " ".join(str(error).split()).rstrip(".")
