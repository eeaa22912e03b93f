"""The interface of message containers (ROS 1 bag, MCAP, SQLite): channels, index, payloads."""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from fusion_core.model.errors import RecordingError

Payload = bytes | memoryview

# One message of a container: its log time, its channel (the place in ``Container.channels``), the
# block that holds it (the file position of a chunk) and its place in that block.
ENTRY = np.dtype([("received_ns", "<i8"), ("channel", "<i4"), ("block", "<i8"), ("offset", "<i8")])
Entries = npt.NDArray[np.void]

# Set by hand, above what recorders write; a damaged or hostile file may claim more.
MAX_CHUNK_BYTES = 128 << 20
# Set by hand: enough to read forward and to step back once.
_CACHED_CHUNK_BYTES = 16 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    """Messages of one topic with one type and one definition.

    ``message_type`` is spelled as in ROS 2 (``sensor_msgs/msg/Image``). ``definition`` is empty
    where the file has none.
    """

    topic: str
    message_type: str
    serialization: str
    definition: str = ""
    definition_format: Literal["msg", "idl"] = "msg"


@dataclass(slots=True)
class ChecksumReport:
    """Result of checking a whole container.

    ``checksums``: how many were right. ``unguarded``: how many parts have none: chunks, and as one
    part all that is in no chunk. ``damage``: a line for each defect other than unreadable messages.
    """

    checksums: int = 0
    unguarded: int = 0
    damage: list[str] = field(default_factory=list)

    def add(self, other: "ChecksumReport") -> None:
        self.checksums += other.checksums
        self.unguarded += other.unguarded
        self.damage += other.damage


class Container(Protocol):
    """One file, opened read-only. Not safe for threads: the caller takes turns.

    ``warnings`` name the lost parts of a damaged file; they are complete after ``index``.
    """

    path: Path
    channels: list[Channel]
    warnings: list[str]

    def index(self) -> Entries:
        """(N,) ENTRY of every message, in file order."""
        ...

    def payload(self, block: int, offset: int) -> Payload:
        """The serialised message at an entry's place. Raises RecordingError."""
        ...

    def published_ns(self, block: int, offset: int) -> int | None:
        """The publish time of the message at an entry's place, None where the format has none.

        Only for entries whose payload can be read.
        """
        ...

    def verify(self, entries: Entries) -> ChecksumReport:
        """Compare the content of the file with its checksums and with its index.

        ``entries`` are those that ``index`` gave, in any order. A chunk that cannot be read is
        skipped: its messages are reported when they are read.
        """
        ...

    def close(self) -> None: ...


class ChunkCache:
    """The last decompressed chunks, at most 16 MiB of them but always one."""

    def __init__(self, unpack: Callable[[int], bytes]) -> None:
        self._unpack = unpack
        self._chunks: OrderedDict[int, bytes] = OrderedDict()
        self._size = 0

    def __getitem__(self, block: int) -> bytes:
        chunk = self._chunks.get(block)
        if chunk is not None:
            self._chunks.move_to_end(block)
            return chunk
        if self._size > _CACHED_CHUNK_BYTES:
            # An oversized chunk is freed before the next one is decompressed.
            self._chunks.clear()
            self._size = 0
        chunk = self._unpack(block)
        self.keep(block, chunk)
        return chunk

    def keep(self, block: int, chunk: bytes) -> None:
        """Add a chunk that is already decompressed."""
        self._chunks[block] = chunk
        self._size += len(chunk)
        while self._size > _CACHED_CHUNK_BYTES and len(self._chunks) > 1:
            _, oldest = self._chunks.popitem(last=False)
            self._size -= len(oldest)


def ros2_type_name(name: str) -> str:
    """A type's name as ROS 2 spells it: ROS 1 and old ROS 2 files leave out the middle part."""
    package, separator, rest = name.partition("/")
    return f"{package}/msg/{rest}" if separator and "/" not in rest else name


def make_entries(
    received_ns: npt.ArrayLike, channel: npt.ArrayLike, block: npt.ArrayLike, offset: npt.ArrayLike
) -> Entries:
    """(N,) ENTRY from columns, each an array or one value for all."""
    columns = np.broadcast_arrays(received_ns, channel, block, offset)
    entries = np.empty(columns[0].shape, dtype=ENTRY)
    for name, column in zip(ENTRY.names or (), columns, strict=True):
        entries[name] = column
    return entries


def merge_in_file_order(parts: list[Entries]) -> Entries:
    """All entries merged in file order."""
    entries = np.concatenate([np.empty(0, dtype=ENTRY), *parts])
    return entries[np.lexsort((entries["offset"], entries["block"]))]


def find_index_problem(held: Entries, indexed: Entries) -> str:
    """How the index of a chunk contradicts the messages that it holds, both in order of offset.

    Empty where it does not.
    """
    if len(held) != len(indexed):
        return f"it holds {len(held)} messages, of which its index has {len(indexed)}"
    names = ["received_ns", "channel", "offset"]
    wrong = np.count_nonzero(held[names] != indexed[names])
    return f"its index is wrong about {wrong} of its {len(held)} messages" if wrong else ""


def damaged_file_error(path: Path, what: str) -> RecordingError:
    """The error for a file that breaks off or contradicts its format."""
    one_line = " ".join(what.split())
    return RecordingError(
        f"is cut short or damaged: {one_line}.",
        file=path,
        advice="Copy it again from its source, or repair it with the tools of its format.",
    )
