"""Storage files of rosbag2 as they are on disk: plain, compressed, or with compressed messages.

rosbag2 compresses by file (each storage file is one zstd frame) or by message (the data of each
message is). Both are recognised by the magic number of a frame, with which no storage file and no
CDR or ROS 1 message begins. A compressed file is unpacked to a temporary one that has no name.
"""

import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import lz4.frame  # type: ignore[import-untyped]  # Ships no type information.

from fusion_core.files.regular_file import read_head
from fusion_core.model.errors import RecordingError
from fusion_core.recordings.containers import (
    MAX_CHUNK_BYTES,
    Channel,
    ChecksumReport,
    Entries,
    Payload,
    damaged_file_error,
)
from fusion_core.recordings.decompression import (
    BoundedOutput,
    Decompressor,
    decompress_pieces,
    describe_damage,
    free_temporary_bytes,
    output_error,
)
from fusion_core.recordings.mcap import file as mcap_file
from fusion_core.recordings.mcap.file import McapFile
from fusion_core.recordings.rosbag2 import sqlite_file
from fusion_core.recordings.rosbag2.sqlite_file import SqliteFile

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
LZ4_MAGIC = b"\x04\x22\x4d\x18"

_COMPRESSED_SUFFIXES = (".zstd", ".zst", ".lz4")
_Container = McapFile | SqliteFile
_KINDS: Mapping[str, tuple[bytes, Callable[[Path], _Container]]] = {
    "MCAP": (mcap_file.MAGIC, McapFile),
    "SQLite": (sqlite_file.MAGIC, SqliteFile),
}
_KIND_OF_SUFFIX = {".mcap": "MCAP", ".db3": "SQLite"}
_HEAD_BYTES = 16
_PIECE_BYTES = 1 << 20
# Depth images of nothing but holes pack a hundredfold, hostile files 30,000-fold.
_MAX_COMPRESSION_RATIO = 1000
_ALWAYS_DECOMPRESSED_BYTES = 256 << 20

_DECOMPRESSORS: Mapping[bytes, Callable[[], Decompressor]] = {
    ZSTD_MAGIC: zstd.ZstdDecompressor,
    LZ4_MAGIC: lz4.frame.LZ4FrameDecompressor,
}
_DAMAGE = (zstd.ZstdError, RuntimeError, EOFError, ValueError)


class StorageFile:
    """One storage file with its index, unpacked if it is compressed.

    ``kind`` is MCAP or SQLite, by content. Raises RecordingError where nothing can be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warnings: list[str] = []
        try:
            self.kind, self._inner, entries = self._open()
        except RecordingError as error:
            raise _with_file(error, path) from error
        self._entries: Entries | None = entries
        self.channels: list[Channel] = self._inner.channels
        self.warnings += self._inner.warnings

    def index(self) -> Entries:
        entries, self._entries = self._entries, None
        if entries is None:
            raise ValueError("a file is indexed once")
        return entries

    def payload(self, block: int, offset: int) -> Payload:
        try:
            payload = self._inner.payload(block, offset)
        except RecordingError as error:
            raise _with_file(error, self.path) from error
        return _decompress_message(payload, self.path) if payload[:4] == ZSTD_MAGIC else payload

    def published_ns(self, block: int, offset: int) -> int | None:
        return self._inner.published_ns(block, offset)

    def verify(self, entries: Entries) -> ChecksumReport:
        return self._inner.verify(entries)

    def close(self) -> None:
        self._inner.close()

    def _open(self) -> tuple[str, _Container, Entries]:
        with self.path.open("rb") as file:
            packing = _DECOMPRESSORS.get(file.read(len(ZSTD_MAGIC)))
        if packing is None:
            return _open_uncompressed(self.path)
        if not (_has_storage_name(self.path) or _contains_storage(self.path)):
            raise RecordingError(
                "is an archive that holds no storage file of ROS 2.",
                file=self.path,
                advice="Unpack it, and name what is in it.",
            )
        # The folder is deleted at once while the file stays open: nothing is left behind, however
        # the process ends.
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            unpacked = Path(folder) / self.path.name
            lost = _decompress_to(self.path, packing, unpacked)
            if lost:
                self.warnings.append(f"{self.path.name} is cut short or damaged: {lost}.")
            try:
                return _open_uncompressed(unpacked)
            except RecordingError as error:
                raise damaged_file_error(self.path, lost) if lost else error from error


def is_storage_file(path: Path) -> bool:
    """Whether a file of a folder is a storage file, by its name or by its decompressed content."""
    if not path.is_file():
        return False
    return _has_storage_name(path) or (
        path.suffix in _COMPRESSED_SUFFIXES and _contains_storage(path)
    )


def uncompressed_name(name: str) -> str:
    """The name of a storage file before it was packed."""
    path = Path(name)
    return path.stem if path.suffix in _COMPRESSED_SUFFIXES else path.name


def _has_storage_name(path: Path) -> bool:
    return Path(uncompressed_name(path.name)).suffix in _KIND_OF_SUFFIX


def _contains_storage(path: Path) -> bool:
    packed = read_head(path, _PIECE_BYTES)
    packing = _DECOMPRESSORS.get(packed[: len(ZSTD_MAGIC)])
    try:
        head = packing().decompress(packed, _HEAD_BYTES) if packing else b""
    except _DAMAGE:
        return False
    return any(head.startswith(magic) for magic, _ in _KINDS.values())


def _open_uncompressed(path: Path) -> tuple[str, _Container, Entries]:
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    # Where the first bytes are damaged the name decides.
    kind = _KIND_OF_SUFFIX.get(Path(uncompressed_name(path.name)).suffix, "")
    for name, (magic, _) in _KINDS.items():
        if head.startswith(magic):
            kind = name
    if not head or not kind:
        raise damaged_file_error(path, "it does not begin as a storage file of ROS 2 does")
    container = _KINDS[kind][1](path)
    try:
        return kind, container, container.index()
    except BaseException:
        container.close()
        raise


def _decompress_to(path: Path, packing: Callable[[], Decompressor], target: Path) -> str:
    """Unpack as much as can be; returns what is lost. Raises RecordingError beyond the limits."""
    free = free_temporary_bytes()
    sane = max(_MAX_COMPRESSION_RATIO * path.stat().st_size, _ALWAYS_DECOMPRESSED_BYTES)
    try:
        with target.open("wb") as plain:
            output = BoundedOutput(plain, path, min(free, sane))
            return _decompress_into(output, path, packing, _too_large_error(path, sane, free))
    except OSError as error:
        raise output_error(path, error) from error


def _decompress_into(
    output: BoundedOutput,
    path: Path,
    packing: Callable[[], Decompressor],
    too_large: RecordingError,
) -> str:
    try:
        with path.open("rb") as packed:
            for piece in _decompressed_frames(packed, packing):
                if not output.write(piece):
                    raise too_large
    except _DAMAGE as error:
        return f"{output.written_bytes} bytes could be unpacked ({describe_damage(error)})"
    except OSError as error:
        raise RecordingError(
            f"cannot be read: {error.strerror or error}.",
            file=path,
            advice="Check the disk or the network that holds the file.",
        ) from error
    return ""


def _too_large_error(path: Path, sane: int, free: int) -> RecordingError:
    if sane <= free:
        return RecordingError(
            f"unpacks to more than {sane} bytes.",
            file=path,
            advice="No recording packs so well; check where the file comes from.",
        )
    return RecordingError(
        f"unpacks to more than the {free} bytes that are free.",
        file=path,
        advice=f"Free space in {tempfile.gettempdir()}, or name another folder in TMPDIR.",
    )


def _decompressed_frames(packed: BinaryIO, packing: Callable[[], Decompressor]) -> Iterator[bytes]:
    """The content of one frame or several, a piece at a time. Raises one of _DAMAGE."""
    ahead = b""

    def read() -> bytes:
        nonlocal ahead
        content, ahead = ahead or packed.read(_PIECE_BYTES), b""
        return content

    while ahead := ahead or packed.read(_PIECE_BYTES):
        decompressor = packing()
        yield from decompress_pieces(decompressor, read, _PIECE_BYTES)
        if not decompressor.eof:
            raise EOFError("its end is missing")
        ahead = decompressor.unused_data or b""


def _decompress_message(packed: Payload, path: Path) -> Payload:
    decompressor = zstd.ZstdDecompressor()
    message = bytearray()
    content = bytes(packed)
    try:
        claimed = zstd.get_frame_info(content).decompressed_size or 0
        is_too_large = claimed > MAX_CHUNK_BYTES
        if not is_too_large:
            for piece in decompress_pieces(decompressor, BytesIO(content).read, _PIECE_BYTES):
                message += piece
                is_too_large = len(message) > MAX_CHUNK_BYTES
                if is_too_large:
                    break
        if not (decompressor.eof or is_too_large):
            raise EOFError("its end is missing")
    except _DAMAGE as error:
        raise damaged_file_error(path, f"a compressed message ({error})") from error
    if is_too_large:
        raise damaged_file_error(path, f"a message unpacks to more than {MAX_CHUNK_BYTES} bytes")
    return memoryview(message)


def _with_file(error: RecordingError, path: Path) -> RecordingError:
    """The same failure, naming the file that the user opened."""
    return RecordingError(error.problem, file=path, advice=error.advice)
