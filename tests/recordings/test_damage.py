"""Truncated and mutated files: what can be read, or an error of one line, never anything else."""

import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.containers import Channel, ChunkCache, make_entries
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.indexed import IndexedRecording

SINGLE_FILES = ["rosbag1", "rosbag1 lz4", "mcap zstd", "mcap plain", "mcap without summary", "db3"]


def read_all(path: Path) -> int | None:
    """How many messages can be read; None where the file is refused."""
    refusal = None
    try:
        with open_recording(path) as recording:
            return sum(1 for _ in recording.messages())
    except RecordingError as error:
        refusal = error
    assert "\n" not in str(refusal)
    assert refusal.advice
    return None


def mutations(content: bytes, count: int, seed: int) -> Iterator[bytes]:
    """Flipped bits, huge and zero counts, repeated pieces."""
    rng = random.Random(seed)
    for _ in range(count):
        data = bytearray(content)
        at = rng.randrange(len(data) - 8)
        kind = rng.randrange(3)
        if kind == 0:
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            data[at : at + 4] = rng.choice([b"\xff\xff\xff\xff", bytes(4), b"\xff\xff\xff\x7f"])
        else:
            data[at:at] = data[at : at + rng.randrange(200)]
        yield bytes(data)


@pytest.mark.parametrize("name", SINGLE_FILES)
def test_mutated_files_are_read_or_refused(build: Callable[[str], Any], name: str) -> None:
    sample = build(name)
    content = sample.path.read_bytes()
    for data in mutations(content, 60, seed=3):
        sample.path.write_bytes(data)
        found = read_all(sample.path)
        # A repeated piece may be a whole message.
        assert found is None or 0 <= found <= len(sample.written) + 1


@pytest.mark.parametrize("name", ["mcap zstd", "rosbag1 lz4"])
def test_a_damaged_chunk_loses_its_messages_with_a_warning(
    build: Callable[[str], Any], name: str
) -> None:
    sample = build(name)
    content = bytearray(sample.path.read_bytes())
    # The magic number of a compressed frame, the last but one in the file.
    magic = b"\x28\xb5\x2f\xfd" if "zstd" in name else b"\x04\x22\x4d\x18"
    last = content.rfind(magic)
    at = content.rfind(magic, 0, last)
    content[at : at + 4] = b"\0\0\0\0"
    sample.path.write_bytes(content)
    with open_recording(sample.path) as recording:
        found = list(recording.messages())
        lost = len(sample.written) - len(found)
        assert 0 < lost < len(sample.written)
        reported = [int(warning.split(": ")[1].split(" of ")[0]) for warning in recording.warnings]
        assert sum(reported) == lost
        # Iterating again gives the same warnings; random access refuses what iteration left out.
        assert len(list(recording.messages())) == len(found)
        assert len(recording.warnings) == len(reported)
        kept = {(m.topic, m.index) for m in found}
        counts = {t.name: t.count for t in recording.topics}
        missing = [(t, i) for t, n in counts.items() for i in range(n) if (t, i) not in kept]
        assert len(missing) == lost
        with pytest.raises(RecordingError, match="chunk"):
            recording.read(*missing[0])


class Zeros:
    """A container of bytes that are no message."""

    path = Path("zeros")

    def __init__(self, message_type: str, definition: str, payload: bytes = bytes(3)) -> None:
        self.warnings: list[str] = []
        self.channels = [
            Channel(
                topic="/broken",
                message_type=message_type,
                serialization="cdr",
                definition=definition,
            ),
            Channel(topic="/pose", message_type="geometry_msgs/msg/PoseStamped", serialization="x"),
        ]
        self._payload = payload

    def index(self) -> Any:
        return make_entries(np.arange(4), 0, 0, 0)

    def payload(self, block: int, offset: int) -> bytes:
        return self._payload

    def close(self) -> None:
        pass


def test_messages_that_are_too_short_are_left_out() -> None:
    recording = IndexedRecording(
        Path("zeros"), "test", [Zeros("geometry_msgs/msg/PoseStamped", "")]
    )
    assert list(recording.messages(["/broken"])) == []
    assert any("4 of 4 messages" in warning for warning in recording.warnings)


def test_a_definition_that_does_not_parse_loses_only_its_topic() -> None:
    recording = IndexedRecording(
        Path("zeros"), "test", [Zeros("nav_msgs/msg/Odometry", "int32 a\n---\n???")]
    )
    assert {t.name: (t.role, t.count) for t in recording.topics} == {
        "/broken": ("other", 4),
        "/pose": ("other", 0),
    }
    assert any("/broken" in w and "does not parse" in w for w in recording.warnings)
    assert any("/pose" in w and "neither CDR" in w for w in recording.warnings)
    assert list(recording.messages()) == []
    with pytest.raises(RecordingError, match="does not parse"):
        recording.read("/broken", 0)


def test_a_definition_without_the_fields_of_its_type() -> None:
    recording = IndexedRecording(
        Path("zeros"), "test", [Zeros("sensor_msgs/msg/Image", "uint8 a", b"\0\1\0\0\7")]
    )
    assert recording.topics[0].role == "other"
    assert list(recording.messages()) == []
    assert any("/broken is left out" in warning for warning in recording.warnings)


def test_unknown_types_keep_their_count() -> None:
    recording = IndexedRecording(Path("zeros"), "test", [Zeros("my_msgs/msg/Own", "int32 a")])
    assert recording.topics[0].role == "other"
    assert recording.topics[0].count == 4
    assert any("my_msgs/msg/Own" in warning for warning in recording.warnings)


def test_the_chunk_cache_is_bounded() -> None:
    unpacked: list[int] = []

    def unpack(block: int) -> bytes:
        unpacked.append(block)
        return bytes(7 << 20)

    cache = ChunkCache(unpack)
    for block in (1, 2, 1, 3, 1, 2):
        assert len(cache[block]) == 7 << 20
    # Two chunks fit: 3 drops 2, the least used, and not 1.
    assert unpacked == [1, 2, 3, 2]
