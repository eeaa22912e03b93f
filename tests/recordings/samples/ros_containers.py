"""ROS 1 bags, MCAP files and ROS 2 databases, written by the libraries of their formats."""

import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mcap.writer import IndexType
from mcap.writer import Writer as McapLibraryWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from fusion_core.recordings.ros2_writer import Ros2McapWriter
from tests.recordings.samples.ros_messages import MESSAGES, ROS1, ROS2, TYPES, ros_message
from tests.recordings.samples.sample import Sample, Written


def build_rosbag1(path: Path, compression: Any = None, chunk_bytes: int = 2000) -> Sample:
    writer = Rosbag1Writer(path / "sample.bag")
    writer.chunk_threshold = chunk_bytes
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connections = {t: writer.add_connection(t, n, typestore=ROS1) for t, n in TYPES.items()}
        for m in MESSAGES:
            data = ROS1.serialize_ros1(ros_message(ROS1, m.value), TYPES[m.topic])
            writer.write(connections[m.topic], m.received_ns, data)
    return Sample(path / "sample.bag", MESSAGES, types=TYPES)


def build_rosbag2(
    path: Path, storage: StoragePlugin, compression: CompressionMode = CompressionMode.NONE
) -> Sample:
    writer = Rosbag2Writer(path / "sample", version=9, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {t: writer.add_connection(t, n, typestore=ROS2) for t, n in TYPES.items()}
        for m in MESSAGES:
            data = ROS2.serialize_cdr(ros_message(ROS2, m.value), TYPES[m.topic])
            writer.write(connections[m.topic], m.received_ns, data)
    return Sample(path / "sample", MESSAGES, types=TYPES)


def lone_file(sample: Sample, suffix: str) -> Sample:
    return Sample(next(sample.path.glob(f"*{suffix}")), sample.written, types=sample.types)


def without_metadata(sample: Sample) -> Sample:
    (sample.path / "metadata.yaml").unlink()
    return sample


def build_mcap(
    file: Path,
    written: Sequence[Written] = MESSAGES,
    *,
    ros1: bool = False,
    summary: bool = True,
    **options: Any,
) -> Sample:
    """By the mcap package's writer."""
    store = ROS1 if ros1 else ROS2
    with file.open("wb") as stream:
        if not summary:
            options |= {"use_statistics": False, "use_summary_offsets": False}
            options |= {"repeat_channels": False, "repeat_schemas": False}
            options |= {"index_types": IndexType.NONE}
        writer = McapLibraryWriter(stream, chunk_size=2000, **options)
        writer.start(profile="ros1" if ros1 else "ros2", library="test")
        channels = {}
        for topic, name in TYPES.items():
            text, _ = store.generate_msgdef(name, ros_version=1 if ros1 else 2)
            ros1_name = name.replace("/msg/", "/")
            schema = writer.register_schema(
                ros1_name if ros1 else name, "ros1msg" if ros1 else "ros2msg", text.encode()
            )
            channels[topic] = writer.register_channel(topic, "ros1" if ros1 else "cdr", schema)
        for m in written:
            serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
            data = bytes(serialize(ros_message(store, m.value), TYPES[m.topic]))
            writer.add_message(channels[m.topic], m.received_ns, data, m.stamp_ns)
        writer.finish()
    return Sample(file, list(written), types=TYPES)


def build_split_folder(path: Path) -> Sample:
    folder = path / "split"
    folder.mkdir()
    # Ten parts and more: part 10 follows part 9, not part 1.
    for part in range(12):
        part_messages = MESSAGES[part * 9 : (part + 1) * 9 if part < 11 else None]
        build_mcap(folder / f"split_{part}.mcap", part_messages)
    return Sample(folder, MESSAGES, types=TYPES)


def build_ours(file: Path) -> Sample:
    with Ros2McapWriter(file) as writer:
        for m in MESSAGES:
            writer.write(m.topic, m.value, odometry=m.topic == "/odom")
    return Sample(file, MESSAGES, types=TYPES)


def build_old_sqlite(path: Path) -> Sample:
    """A .db3 of the first schema: no definitions, type names without their middle part."""
    file = path / "old.db3"
    connection = sqlite3.connect(file)
    connection.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
        " serialization_format TEXT NOT NULL);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
        " timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
    )
    ids = {topic: 10 * n for n, topic in enumerate(TYPES, start=1)}
    connection.executemany(
        "INSERT INTO topics VALUES (?, ?, ?, 'cdr')",
        [(ids[topic], topic, name.replace("/msg/", "/")) for topic, name in TYPES.items()],
    )
    connection.executemany(
        "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
        [
            (
                ids[m.topic],
                m.received_ns,
                bytes(ROS2.serialize_cdr(ros_message(ROS2, m.value), TYPES[m.topic])),
            )
            for m in MESSAGES
        ],
    )
    connection.commit()
    connection.close()
    return Sample(file, MESSAGES, types=TYPES)
