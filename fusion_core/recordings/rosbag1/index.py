"""Index of the messages of a ROS 1 bag, and warnings about lost parts of a damaged one."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from fusion_core.model.conventions import NS_PER_S, BoolArray, IntArray
from fusion_core.recordings.containers import Channel, Entries, make_entries, merge_in_file_order
from fusion_core.recordings.rosbag1.records import (
    OP_CHUNK_INFO,
    OP_CONNECTION,
)
from fusion_core.recordings.rosbag1.walk import BagWalk, Lost

_INDEX_ENTRY = np.dtype([("seconds", "<u4"), ("nanoseconds", "<u4"), ("offset", "<u4")])
_NAMED_LOSSES = 5
_AT_THE_END = (OP_CONNECTION, OP_CHUNK_INFO)


@dataclass(frozen=True, slots=True)
class BagContents:
    """Contents of a bag.

    ``channel_of``: index into ``channels`` by connection number. ``chunk_ends``: end of the data
    of truncated chunks in the file, by chunk position. ``unpacked``: content of chunks that were
    decompressed already, by chunk position. ``encryptor``: the encryption plugin, or empty.
    """

    channels: list[Channel]
    channel_of: dict[int, int]
    entries: Entries
    warnings: list[str]
    chunk_ends: dict[int, int]
    unpacked: dict[int, bytes]
    encryptor: str


def read_contents(file: BinaryIO, size: int) -> BagContents:
    """All readable contents of a bag of ``size`` bytes."""
    walk = BagWalk(file, size)
    walk.walk_file()
    indexed, trusted = _trusted_index(walk)
    unpacked: dict[int, bytes] = {}
    restored, unconfirmed = _check_connections(walk, indexed, unpacked)
    for chunk in sorted(walk.unindexed):
        walk.walk_chunk(chunk)
    rows = np.concatenate([walk.messages, indexed[trusted]])
    connections, place = np.unique(rows[:, 1], return_inverse=True)
    if restored:
        # A connection in the index without messages is there because its number is damaged.
        walk.connections.remove(unconfirmed.difference(connections.tolist()))
    channels, channel_of, contradictions = walk.connections.resolve()
    numbers = [channel_of.get(connection, -1) for connection in connections.tolist()]
    channel = np.array(numbers, dtype=np.int64)[place]
    entries = merge_in_file_order([make_entries(rows[:, 0], channel, rows[:, 2], rows[:, 3])])
    warnings = [*_structure_warnings(walk, size), *_lost_bytes(walk.lost, entries, size)]
    warnings += _lost_messages(walk, entries)
    warnings += contradictions
    if restored and _is_finished(walk, size):
        names = ", ".join(sorted({channels[channel_of[lacking]].topic for lacking in restored}))
        warnings.append(f"Damaged: the index at its end lacks {names}, found in the chunks.")
    homeless = int(np.count_nonzero(channel < 0))
    if homeless:
        warnings.append(f"{homeless} messages are left out: the records of their topics are lost.")
    entries = entries[entries["channel"] >= 0]
    encryptor = b"" if walk.header is None else walk.header.fields.get(b"encryptor", b"")
    return BagContents(
        channels=channels,
        channel_of=channel_of,
        entries=entries,
        warnings=warnings,
        chunk_ends=walk.chunk_ends,
        unpacked=unpacked,
        encryptor=encryptor.decode(errors="replace"),
    )


def _trusted_index(walk: BagWalk) -> tuple[IntArray, BoolArray]:
    """(N, 4) log time, connection, block, offset from the index data, and which rows are reliable.

    Chunks whose index data are missing or unreliable are added to ``walk.unindexed``.
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
    """Chunks whose message counts differ between the index at the end and their index data."""
    infos = infos[infos[:, 2] > 0]
    own = index[np.isin(index[:, 0], infos[:, 0]) & (index[:, 2] > 0)]
    found, times = np.unique(np.concatenate([own, infos]), axis=0, return_counts=True)
    contradicted: IntArray = found[times != 2, 0]
    return contradicted


def _check_connections(
    walk: BagWalk, indexed: IntArray, kept: dict[int, bytes]
) -> tuple[set[int], set[int]]:
    """Compare the connections in the index at the end with the chunks, and find missing ones.

    A recorder also writes each connection into a chunk: that of its first message, or the first
    chunk of the bag. Returns the connections missing at the end that were found in chunks, and
    those whose record at the end matches none in a chunk. ``kept`` gets the first chunk's content.
    """
    if not len(walk.chunks):
        return set(), set()
    used, rows = np.unique(indexed[:, 1], return_index=True)
    chunk_of = dict(zip(used.tolist(), indexed[rows, 2].tolist(), strict=True))
    first = int(walk.chunks[0, 0])
    unconfirmed = {number: _records(walk, number) for number in {*walk.connections, *chunk_of}}
    described: dict[int, set[int]] = {}
    for chunk in dict.fromkeys([first, *sorted(chunk_of.values())]):
        own = [n for n in unconfirmed if chunk in (first, chunk_of.get(n))]
        if not own:
            continue
        unpacked = walk.content(chunk)
        if chunk == first and not unpacked.problem:
            kept[chunk] = unpacked.content
        records = walk.connection_records(unpacked.content)
        for number in own:
            if number in records and unconfirmed[number] == [records[number]]:
                del unconfirmed[number]
        described[chunk] = records.keys() & unconfirmed.keys()
    missing = {number for number in chunk_of if number not in walk.connections}
    for chunk, numbers in described.items():
        # A later chunk may have confirmed a connection that this one did not.
        if numbers & unconfirmed.keys():
            walk.walk_chunk(chunk, take_messages=False)
    return {number for number in missing if number in walk.connections}, set(unconfirmed)


def _records(walk: BagWalk, number: int) -> list[bytes]:
    """The bytes of the records of a connection outside of chunks."""
    return [walk.bytes_of(start, end) for start, end in walk.connections.places(number)]


def _is_finished(walk: BagWalk, size: int) -> bool:
    return walk.header is not None and 0 < walk.header.number(b"index_pos") <= size


def _structure_warnings(walk: BagWalk, size: int) -> Iterator[str]:
    if walk.header is None:
        yield "The bag's own header is lost."
        return
    index_start = walk.header.number(b"index_pos")
    if index_start == 0:
        yield "Its recorder did not finish it; it is read without the index at its end."
        return
    chunks, connections = (walk.header.number(b"chunk_count"), walk.header.number(b"conn_count"))
    behind = walk.record_at(index_start)
    if index_start != size and (behind is None or behind.op not in _AT_THE_END):
        if 0 < chunks <= len(np.unique(walk.infos[:, 0])):
            yield f"Damaged: its header has its index at byte {index_start}; it is elsewhere."
        elif index_start > size:
            yield (
                f"It is cut short: it ends at byte {size}, before the index at byte {index_start}."
            )
    if walk.chunk_count < chunks or len(walk.connections) < connections:
        yield (
            f"Of {chunks} chunks and {connections} connections in its header, "
            f"{walk.chunk_count} and {len(walk.connections)} are found."
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
    """The time of a loss, from the log times of the messages before and after it in the file."""
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
    """Compare the messages found in each chunk with the counts in the index at the end."""
    infos, spans = walk.infos, walk.spans
    if not len(infos):
        return
    chunks, place = np.unique(infos[:, 0], return_inverse=True)
    counted = np.bincount(place, weights=infos[:, 2]).astype(np.int64)
    bounds = np.searchsorted(entries["block"], chunks)
    # Messages of a chunk that lost its header are found singly after its position.
    found = np.diff(bounds, append=len(entries))
    # The index itself may be damaged: it is wrong about chunks that were read completely, and about
    # chunks that it lists at another position.
    is_wrong = np.isin(chunks, np.array(sorted(walk.whole), dtype=np.int64)) & (counted != found)
    is_there = np.isin(chunks, walk.chunks[:, 0])
    unlisted = np.setdiff1d(walk.chunks[:, 0], chunks)
    if len(unlisted) >= np.count_nonzero(~is_there):
        is_wrong |= ~is_there
    if is_wrong.any():
        yield (
            f"Damaged: the index at its end is wrong about {np.count_nonzero(is_wrong)} of its "
            f"{walk.chunk_count} chunks; what they hold is read."
        )
    lost = (counted > found) & ~is_wrong
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
