"""Connections of ROS 1 bags are recorded twice, and differ after damage."""

import random
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.formats import open_recording
from scanloom.cli import main
from tests.hostile.bags import (
    MAGIC,
    Bag,
    record,
    scans_as,
    small_bag,
    transforms_as,
    u32,
    write_bag_of_renamed_topic,
)

COMPRESSIONS = [b"none", b"lz4"]
# Topic, type, log time and bytes of every message; then what the warnings say.
Found = tuple[list[tuple[str, str, int, bytes]], list[str]]
Read = Callable[[bytes], Found]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def read(content: bytes) -> Found:
        path = tmp_path / "a.bag"
        path.write_bytes(content)
        with open_recording(path) as recording:
            messages = []
            for m in recording.serialized_messages([topic.name for topic in recording.topics]):
                channel = recording.channels[m.channel]
                messages.append(
                    (channel.topic, channel.message_type, m.received_ns, bytes(m.payload))
                )
            # A topic without messages would be one that the damage made up.
            assert all(topic.count for topic in recording.topics)
            return messages, list(recording.warnings)

    return read


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_topic_renamed_at_the_end_keeps_its_name_in_the_chunk(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], compression: bytes
) -> None:
    path = write_bag_of_renamed_topic(tmp_path / "a.bag", compression)
    at = record_of_tf(small_bag(compression))
    assert main(["info", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "\n/tf    tf     8 " in shown
    assert "\n/uo" not in shown
    assert (
        f"warning: Damaged: connection 1 is /uo (tf/msg/tfMessage) in the record at byte {at} and "
        "/tf (tf/msg/tfMessage) in the chunk at byte 4109; that in the chunk at byte 4109 is taken."
    ) in shown


def record_of_tf(whole: Bag) -> int:
    """Where the record of /tf begins in the index at the end."""
    return whole.index_start + len(scans_as("/scan").record(0))


def with_end(whole: Bag, changed: bytes) -> bytes:
    return whole.content[: whole.index_start] + changed


def test_a_consistent_record_is_preferred_to_an_inconsistent_one(read: Read) -> None:
    whole = small_bag()
    expected, _ = read(whole.content)
    end = whole.content[whole.index_start :]
    definition = transforms_as("/tf").definition.encode()
    type_name = b"type=tf/tfMessage"
    for reported, changed in (
        (
            "/tf, of which",
            end.replace(definition, definition.replace(b"time stamp", b"time ttamp")),
        ),
        ("tf/msg/ufMessage", end.replace(type_name, b"type=tf/ufMessage")),
        ("/\x00f", end.replace(b"topic=/tf", b"topic=/\x00f")),
    ):
        found, warnings = read(with_end(whole, changed))
        assert found == expected
        (warning,) = warnings
        assert reported in warning
        assert warning.endswith("that in the chunk at byte 4109 is taken.")
    # The same damage in the chunk: now the end is right.
    found, (warning,) = read(whole.content.replace(b"topic=/tf", b"topic=/t\xff", 1))
    assert found == expected
    assert warning.endswith(f"that in the record at byte {record_of_tf(whole)} is taken.")


def test_two_connections_of_one_number(read: Read) -> None:
    whole = small_bag()
    expected, _ = read(whole.content)
    scans, transforms = scans_as("/scan").record(0), transforms_as("/tf").record(1)
    infos = whole.content[whole.index_start + len(scans + transforms) :]
    for connections in (
        scans_as("/scan").record(1) + transforms,
        scans + transforms_as("/tf").record(0),
        scans,
        transforms,
        b"",
    ):
        found, warnings = read(with_end(whole, connections + infos))
        assert found == expected
        assert warnings


def test_a_number_without_a_message_makes_no_topic(read: Read) -> None:
    # Both the number and the definition are damaged.
    whole = small_bag()
    expected, _ = read(whole.content)
    own = transforms_as("/tf").record(1)
    broken = transforms_as("/tf").record(257).replace(b"Vector3 tr", b"Vector4 tr")
    found, warnings = read(whole.content.replace(own, broken).replace(broken, own, 1))
    assert found == expected
    assert any("the index at its end lacks /tf" in warning for warning in warnings)


@pytest.mark.parametrize("compression", COMPRESSIONS)
@settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    seed=st.integers(0, 1 << 32),
    flips=st.integers(1, 6),
    place=st.sampled_from(["end", "names of /tf", "header of the bag"]),
)
def test_flipped_bits_in_the_index_lose_or_rename_no_topic_without_a_warning(
    read: Read, compression: bytes, seed: int, flips: int, place: str
) -> None:
    whole = small_bag(compression)
    expected, _ = read(whole.content)
    names = record_of_tf(whole)
    first, end = {
        "end": (whole.index_start, len(whole.content)),
        "names of /tf": (names, names + 44),
        "header of the bag": (len(MAGIC), len(MAGIC) + 73),
    }[place]
    rng = random.Random(seed)
    content = bytearray(whole.content)
    for _ in range(flips):
        content[rng.randrange(first, end)] ^= 1 << rng.randrange(8)
    try:
        found, warnings = read(bytes(content))
    except RecordingError:
        return
    assert found == expected or warnings


@pytest.mark.parametrize("padding", [3, 4100, 4600])
def test_a_wrong_length_of_the_header_loses_no_chunk(read: Read, padding: int) -> None:
    whole = small_bag(b"lz4")
    expected, _ = read(whole.content)
    at = whole.content.index(b"    ") - 4
    found, _ = read(whole.content[:at] + u32(padding) + whole.content[at + 4 :])
    assert found == expected


def test_a_first_chunk_without_its_header_is_named(read: Read) -> None:
    whole = small_bag(b"lz4")
    content = bytearray(whole.content)
    content[whole.chunk_starts[0] + 4] ^= 0xFF
    _, warnings = read(bytes(content))
    lost = f"Bytes {whole.chunk_starts[0]} to"
    assert any(warning.startswith(lost) for warning in warnings)


@pytest.mark.parametrize("index_pos", [4200, 1 << 40])
def test_a_wrong_position_of_the_index_loses_nothing(read: Read, index_pos: int) -> None:
    whole = small_bag()
    expected, _ = read(whole.content)
    right = b"index_pos=" + whole.index_start.to_bytes(8, "little")
    wrong = b"index_pos=" + index_pos.to_bytes(8, "little")
    found, warnings = read(whole.content.replace(right, wrong))
    assert found == expected
    assert warnings == [f"Damaged: its header has its index at byte {index_pos}; it is elsewhere."]


def test_wrong_counts_at_the_end_are_no_lost_messages(read: Read) -> None:
    whole = small_bag()
    expected, _ = read(whole.content)
    counts = u32(0) + u32(3) + u32(1) + u32(2)
    assert whole.content.count(counts) == 2
    for wrong in (u32(0) + u32(9) + u32(1) + u32(2), u32(0) + u32(3) + u32(1) + u32(0)):
        found, warnings = read(whole.content.replace(counts, wrong, 1))
        assert found == expected
        (warning,) = warnings
        assert warning.startswith("Damaged: the index at its end is wrong about 1 of its 4 chunks")
    start = (whole.chunk_starts[1]).to_bytes(8, "little")
    elsewhere = (whole.chunk_starts[1] + 1).to_bytes(8, "little")
    found, warnings = read(whole.content.replace(start, elsewhere))
    assert found == expected
    assert len(warnings) == 1


def test_connections_that_no_chunk_repeats_are_used(read: Read) -> None:
    whole = small_bag()
    expected, _ = read(whole.content)
    content = whole.content
    for own in (scans_as("/scan").record(0), transforms_as("/tf").record(1)):
        # Of a connection that does not exist, the same bytes are a message without a topic.
        other = record(b" " * (len(own) - 46), op=b"\x02", conn=u32(9), time=bytes(8))
        assert len(other) == len(own)
        content = content.replace(own, other, 1)
    assert read(content) == (expected, [])
