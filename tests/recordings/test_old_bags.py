"""Bags of ROS's first years: older names of the header, other lengths in the index."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Reader

from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.rosbag1.records import OP_INDEX, read_record
from scanloom.cli import main
from tests.hostile.bags import (
    BEAMS,
    OLD_ENTRY_BYTES,
    T0_NS,
    Logged,
    bag,
    record,
    ros_time,
    scan_message,
    scans_and_transforms,
    scans_as,
    transforms_as,
    u32,
    write_old_bag,
)


@pytest.mark.parametrize("compression", [b"none", b"bz2"])
def test_an_old_bag_is_read_whole_and_without_a_warning(tmp_path: Path, compression: bytes) -> None:
    path = write_old_bag(tmp_path / "old.bag", compression=compression)
    with open_recording(path) as recording:
        counts = {topic.name: (topic.role, topic.count) for topic in recording.topics}
        assert counts == {"/clock": ("other", 1), "/scan": ("lidar", 360), "/tf": ("tf", 360)}
        scans = list(recording.messages(["/scan"]))
        transforms = list(recording.messages(["/tf"]))
        # The clock is of no use here, and that is all there is to say.
        assert recording.warnings == ["Topics of these types are left out: roslib/msg/Clock."]
    assert [scan.stamp_ns for scan in scans] == [T0_NS + step * 10**8 for step in range(360)]
    for step in (0, 100, 359):
        ranges_m = (1.0 + step / 1000 + np.arange(BEAMS) / 8).astype(np.float32)
        assert np.array_equal(scans[step].value.ranges_m, ranges_m)
        (transform,) = transforms[step].value.transforms
        assert (transform.parent, transform.child) == ("odom", "base")
        assert transform.T_parent_child[0, 3] == step / 10


@pytest.mark.parametrize("entry_bytes", [8, 20, 24])
def test_index_data_are_as_long_as_their_count(tmp_path: Path, entry_bytes: int) -> None:
    connections = [scans_as("/scan"), transforms_as("/tf")]
    logged = scans_and_transforms(9)
    right = bag(connections, logged, messages_per_chunk=4)
    other = bag(connections, logged, messages_per_chunk=4, entry_bytes=entry_bytes)
    path = tmp_path / "a.bag"
    path.write_bytes(right.content)
    with Reader(path) as reader:
        expected = [(m[0].topic, m[1], bytes(m[2])) for m in reader.messages()]
    path.write_bytes(other.content)
    with open_recording(path) as recording:
        topics = [topic.name for topic in recording.topics]
        found = [
            (recording.channels[m.channel].topic, m.received_ns, bytes(m.payload))
            for m in recording.serialized_messages(topics)
        ]
        assert recording.warnings == []
    assert found == expected


def test_a_count_that_leads_to_no_record_is_not_used() -> None:
    data = b"".join(ros_time(T0_NS + step) + u32(step) for step in range(3))
    header = {"op": b"\x04", "ver": u32(1), "conn": u32(0)}
    behind = record(b"", **header, count=u32(0))
    for size in (None, 3 * OLD_ENTRY_BYTES, 7):
        content = record(data, size, **header, count=u32(3)) + behind
        found = read_record(io.BytesIO(content), 0, len(content))
        assert found is not None
        assert (found.op, found.data_size) == (OP_INDEX, len(data))
    for count in (0, 2, 4, 1 << 31):
        content = record(data, **header, count=u32(count)) + behind
        assert read_record(io.BytesIO(content), 0, len(content)) is None


@pytest.mark.parametrize("name", ["roslib/Header", "std_msgs/Header"])
@pytest.mark.parametrize("field", ["Header header", "roslib/Header header"])
def test_the_header_is_one_type_by_all_its_names(tmp_path: Path, name: str, field: str) -> None:
    own = scans_as("/scan", name)
    changed = own.definition.replace("Header header", field, 1)
    whole = bag([replace(own, definition=changed)], [Logged(0, T0_NS, scan_message(3))])
    path = tmp_path / "a.bag"
    path.write_bytes(whole.content)
    with open_recording(path) as recording:
        assert [m.stamp_ns for m in recording.messages()] == [T0_NS + 3 * 10**8]
        assert recording.warnings == []


def test_an_old_bag_is_converted_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_old_bag(tmp_path / "old.bag", scans=20)
    output = tmp_path / "new.mcap"
    assert main(["convert", str(path), "-o", str(output)]) == 0
    shown = capsys.readouterr().out
    assert "messages  41, left out 0" in shown
    assert "rosgraph_msgs/msg/Clock" in shown
    with open_recording(output) as recording:
        assert len(list(recording.messages(["/scan", "/tf"]))) == 40
