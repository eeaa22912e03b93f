"""Where the messages of a ROS 1 bag are, and what of a damaged one is lost."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from fusion_core.model.conventions import NS_PER_S, BoolArray, IntArray
from fusion_core.recordings.containers import Channel, Entries, entries_from, in_file_order
from fusion_core.recordings.rosbag1.walk import BagWalk, Lost

_INDEX_ENTRY = np.dtype([("seconds", "<u4"), ("nanoseconds", "<u4"), ("offset", "<u4")])
_NAMED_LOSSES = 5


@dataclass(frozen=True, slots=True)
class BagContents:
    """``chunk_ends`` tells where the data of cut chunks end in the file, by their place.

    ``encryptor`` names what the bag is encrypted with, if it is.
    """

    channels: list[Channel]
    entries: Entries
    warnings: list[str]
    chunk_ends: dict[int, int]
    encryptor: str


def read_contents(file: BinaryIO, size: int) -> BagContents:
    """Everything that a bag of ``size`` bytes has, as far as it can be read."""
    walk = BagWalk(file, size)
    walk.walk_file()
    indexed, trusted = _trusted_index(walk)
    _find_connections(walk, indexed)
    for chunk in sorted(walk.unindexed):
        walk.walk_chunk(chunk)
    rows = np.concatenate([walk.messages, indexed[trusted]])
    connections, place = np.unique(rows[:, 1], return_inverse=True)
    numbers = [walk.numbers.get(connection, -1) for connection in connections.tolist()]
    channel = np.array(numbers, dtype=np.int64)[place]
    entries = in_file_order([entries_from(rows[:, 0], channel, rows[:, 2], rows[:, 3])])
    warnings = [*_structure_warnings(walk, size), *_lost_bytes(walk.lost, entries, size)]
    warnings += _lost_messages(walk, entries)
    homeless = int(np.count_nonzero(channel < 0))
    if homeless:
        warnings.append(f"{homeless} messages are left out: the records of their topics are lost.")
    entries = entries[entries["channel"] >= 0]
    encryptor = b"" if walk.header is None else walk.header.fields.get(b"encryptor", b"")
    return BagContents(
        channels=list(walk.channels),
        entries=entries,
        warnings=warnings,
        chunk_ends=walk.chunk_ends,
        encryptor=encryptor.decode(errors="replace"),
    )


def _trusted_index(walk: BagWalk) -> tuple[IntArray, BoolArray]:
    """(N, 4) log time, connection, block, offset by the index data, and which to believe.

    Chunks whose index data are missing or not believed are added to ``walk.unindexed``.
    """
    data = np.frombuffer(walk.index_data, dtype=_INDEX_ENTRY)
    chunks, index = walk.chunks, walk.index
    rows = np.empty((len(data), 4), dtype=np.int64)
    rows[:, 0] = data["seconds"].astype(np.int64) * NS_PER_S + data["nanoseconds"]
    rows[:, 1] = np.repeat(index[:, 1], index[:, 2])
    rows[:, 2] = np.repeat(index[:, 0], index[:, 2])
    rows[:, 3] = data["offset"]
    if not len(chunks):
        return rows, np.zeros(0, dtype=np.bool_)
    content_bytes = chunks[np.searchsorted(chunks[:, 0], rows[:, 2]), 1]
    doubted = [rows[rows[:, 3] >= content_bytes, 2], np.setdiff1d(chunks[:, 0], index[:, 0])]
    doubted.append(_contradicted_counts(index, walk.infos))
    if len(spans := walk.spans):
        spans = spans[np.argsort(spans[:, 0])]
        at = np.minimum(np.searchsorted(spans[:, 0], rows[:, 2]), len(spans) - 1)
        _, first, last = spans[at].T
        outside = (rows[:, 0] < first) | (rows[:, 0] > last)
        doubted.append(rows[outside & (spans[at, 0] == rows[:, 2]), 2])
    walk.unindexed.update(np.intersect1d(np.concatenate(doubted), chunks[:, 0]).tolist())
    unindexed = np.array(sorted(walk.unindexed), dtype=np.int64)
    return rows, ~np.isin(rows[:, 2], unindexed)


def _contradicted_counts(index: IntArray, infos: IntArray) -> IntArray:
    """The chunks for which the index at the end counts other messages than their index data."""
    infos = infos[infos[:, 2] > 0]
    own = index[np.isin(index[:, 0], infos[:, 0]) & (index[:, 2] > 0)]
    found, times = np.unique(np.concatenate([own, infos]), axis=0, return_counts=True)
    contradicted: IntArray = found[times != 2, 0]
    return contradicted


def _find_connections(walk: BagWalk, indexed: IntArray) -> None:
    """Look for the records of connections in chunks, where those at the end are missing.

    They stand before the first message of the connection, or all in the first chunk.
    """
    missing = ~np.isin(indexed[:, 1], list(walk.numbers))
    if not missing.any():
        return
    rows = indexed[missing]
    _, first = np.unique(rows[:, 1], return_index=True)
    for chunk in sorted({int(walk.chunks[0, 0]), *rows[first, 2].tolist()}):
        walk.walk_chunk(chunk, take_messages=False)


def _structure_warnings(walk: BagWalk, size: int) -> Iterator[str]:
    if walk.header is None:
        yield "The bag's own header is lost."
        return
    index_start = walk.header.number(b"index_pos")
    if index_start == 0:
        yield "Its recorder did not finish it; it is read without the index at its end."
        return
    if index_start > size:
        yield f"It is cut short: it ends at byte {size}, before the index at byte {index_start}."
    chunks, connections = (walk.header.number(b"chunk_count"), walk.header.number(b"conn_count"))
    if walk.chunk_count < chunks or len(walk.numbers) < connections:
        yield (
            f"Of {chunks} chunks and {connections} connections in its header, "
            f"{walk.chunk_count} and {len(walk.numbers)} are found."
        )


def _lost_bytes(lost: list[Lost], entries: Entries, size: int) -> Iterator[str]:
    lost = sorted(lost, key=lambda loss: loss.start)
    for loss in lost[:_NAMED_LOSSES]:
        logged = _logged_around(loss, entries)
        yield f"Bytes {loss.start} to {loss.end} of {size} are lost{logged}: {loss.why}."
    rest = lost[_NAMED_LOSSES:]
    if rest:
        lost_bytes = sum(loss.end - loss.start for loss in rest)
        yield (
            f"{lost_bytes} bytes are lost at {len(rest)} more places, "
            f"from byte {rest[0].start} to {rest[-1].end}."
        )


def _logged_around(loss: Lost, entries: Entries) -> str:
    """By the log times of the messages before and behind in the file."""
    times = entries["received_ns"]
    before = int(np.searchsorted(entries["block"], loss.start, side="right")) - 1
    behind = int(np.searchsorted(entries["block"], loss.end))
    if before >= 0 and behind < len(times):
        first, last = sorted((times[before], times[behind]))
        return f", logged between {_seconds(first)} and {_seconds(last)}"
    if before >= 0:
        return f", logged after {_seconds(times[before])}"
    return f", logged before {_seconds(times[behind])}" if behind < len(times) else ""


def _lost_messages(walk: BagWalk, entries: Entries) -> Iterator[str]:
    """By the index at the end, which counts the messages of each chunk."""
    infos, spans = walk.infos, walk.spans
    if not len(infos):
        return
    chunks, place = np.unique(infos[:, 0], return_inverse=True)
    counted = np.bincount(place, weights=infos[:, 2]).astype(np.int64)
    bounds = np.searchsorted(entries["block"], chunks)
    found = np.diff(bounds, append=len(entries))
    lost = counted > found
    if lost.any():
        within = spans[np.isin(spans[:, 0], chunks[lost])]
        logged = (
            f", logged from {_seconds(within[:, 1].min())} to {_seconds(within[:, 2].max())}"
            if len(within)
            else ""
        )
        missing = int((counted - found)[lost].sum())
        yield f"{missing} of the {counted.sum()} messages in its index are lost{logged}."


def _seconds(time_ns: int) -> str:
    return f"{time_ns / NS_PER_S:.3f} s"
