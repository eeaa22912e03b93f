"""Decompression of the chunks of ROS 1 bags (none, bz2 or lz4) with bounded memory."""

import bz2
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO

import lz4.frame  # type: ignore[import-untyped]  # Ships no type information.

from fusion_core.recordings.containers import MAX_CHUNK_BYTES
from fusion_core.recordings.decompression import decompress_pieces
from fusion_core.recordings.rosbag1.records import BagRecord

# Size of input and output pieces, small because the decompressors copy unused input.
_STEP_BYTES = 1 << 16
# The magic number of a frame and its flags, of which two are for checksums of blocks and content
# (github.com/lz4/lz4, lz4_Frame_format.md).
LZ4_HEADER_BYTES = 5
_LZ4_CHECKSUMS = 0b10100
_DECOMPRESSORS = {b"bz2": bz2.BZ2Decompressor, b"lz4": lz4.frame.LZ4FrameDecompressor}


@dataclass(frozen=True, slots=True)
class DecompressedChunk:
    """The content of a chunk; ``problem`` says why it is incomplete, empty if it is complete.

    ``surplus_bytes``: bytes of the chunk's data after the end of the compressed stream.
    """

    content: bytes
    problem: str = ""
    surplus_bytes: int = 0


def find_chunk_problem(chunk: BagRecord) -> str:
    """Why a chunk cannot be decompressed, judged by its header; empty if it can."""
    compression = chunk.fields[b"compression"]
    if compression == b"none":
        return ""
    if compression not in _DECOMPRESSORS:
        return f"its compression {compression[:20].decode(errors='replace')!r} is not known"
    size = chunk.number(b"size")
    if size > MAX_CHUNK_BYTES:
        return f"it claims {size} bytes, more than {MAX_CHUNK_BYTES}"
    return ""


def has_checksum(chunk: BagRecord, data: bytes) -> bool:
    """Whether a chunk is protected by a checksum; ``data`` are the first bytes of its data."""
    compression = chunk.fields[b"compression"]
    # Every block of bz2 has one; a frame of lz4 says so in its header.
    return compression == b"bz2" or (
        compression == b"lz4" and len(data) == LZ4_HEADER_BYTES and data[4] & _LZ4_CHECKSUMS != 0
    )


def decompress_chunk(stream: BinaryIO, chunk: BagRecord, end: int) -> DecompressedChunk:
    """The content of a chunk whose data end at ``end``, which is earlier if they are truncated.

    What a truncated chunk gives is kept. Corrupt data give nothing, because it is not known where
    the corruption begins.
    """
    problem = find_chunk_problem(chunk)
    if problem:
        return DecompressedChunk(b"", problem)
    stream.seek(chunk.data_start)
    left, size = end - chunk.data_start, chunk.number(b"size")
    if chunk.fields[b"compression"] == b"none":
        return DecompressedChunk(stream.read(left), "it breaks off" if end < chunk.end else "")
    decompressor = _DECOMPRESSORS[chunk.fields[b"compression"]]()
    content = BytesIO()

    def read() -> bytes:
        nonlocal left
        packed = stream.read(min(left, _STEP_BYTES))
        left -= len(packed)
        return packed

    try:
        for piece in decompress_pieces(decompressor, read, _STEP_BYTES):
            content.write(piece)
            if content.tell() > size:
                return DecompressedChunk(b"", f"it holds more than the {size} bytes that it claims")
    except (OSError, RuntimeError, ValueError, EOFError) as error:
        return DecompressedChunk(b"", f"it does not unpack, {error}")
    if not decompressor.eof:
        problem = f"it breaks off after {content.tell()} of {size} bytes"
        return DecompressedChunk(content.getvalue(), problem)
    return DecompressedChunk(content.getvalue(), "", left + len(decompressor.unused_data or b""))
