"""A ROS 1 bag put together byte by byte, without any library."""

import struct
from pathlib import Path

from fusion_core.model.sensors import LaserScan
from tests.recordings.samples.ros_messages import scan
from tests.recordings.samples.sample import MS, T0, Sample, Written

SCAN_DEFINITION = """Header header
float32 angle_min
float32 angle_max
float32 angle_increment
float32 time_increment
float32 scan_time
float32 range_min
float32 range_max
float32[] ranges
float32[] intensities
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""


def bag_record(header: dict[str, bytes], data: bytes) -> bytes:
    packed = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
        for name, value in header.items()
    )
    return struct.pack("<I", len(packed)) + packed + struct.pack("<I", len(data)) + data


def bag_time(ns: int) -> bytes:
    return struct.pack("<II", ns // 10**9, ns % 10**9)


def scan_bytes(value: LaserScan) -> bytes:
    ranges = value.ranges_m.astype("<f4")
    ranges[[1, 3]] = 0.0, 5.5  # The second sentinel is range_max itself.
    frame = value.frame_id.encode()
    return (
        struct.pack("<I", 9)
        + bag_time(value.stamp_ns)
        + struct.pack("<I", len(frame))
        + frame
        + struct.pack("<7f", -0.5, 0.5, 0.25, 0.0, value.scan_time_s, 0.0625, 5.5)
        + struct.pack("<I", 5)
        + ranges.tobytes()
        + struct.pack("<I5f", 5, 0, 1, 2, 3, 4)
    )


def build_rosbag1_by_bytes(path: Path) -> Sample:
    """A ROS 1 bag after wiki.ros.org/Bags/Format/2.0, without any library.

    Chunks overlap in time and the second is written with the later messages first.
    """
    topics = ["/front_scan", "/rear_scan"]
    logged = [(0, 10), (1, 10), (0, 30), (1, 40), (0, 20), (0, 30), (1, 5)]
    written = [
        Written(topics[c], T0 + ms * MS, scan(i, T0 + ms * MS)) for i, (c, ms) in enumerate(logged)
    ]
    connections = [
        bag_record(
            {"op": b"\x07", "conn": struct.pack("<I", c), "topic": topic.encode()},
            b"".join(
                struct.pack("<I", len(entry)) + entry
                for entry in (
                    b"topic=" + topic.encode(),
                    b"type=sensor_msgs/LaserScan",
                    b"md5sum=90c7ef2dc6895d81024acba2ac42f369",
                    b"message_definition=" + SCAN_DEFINITION.encode(),
                )
            ),
        )
        for c, topic in enumerate(topics)
    ]
    body = b""
    infos = b""
    head_bytes = len(b"#ROSBAG V2.0\n") + 4096
    for start in (0, 4):
        chunk, offsets = b"", {0: [], 1: []}
        for (c, ms), m in list(zip(logged, written, strict=True))[start : start + 4]:
            # The index may point at the connection's record before the message.
            at = len(chunk)
            chunk += connections[c] if not offsets[c] else b""
            offsets[c].append((T0 + ms * MS, at))
            header = {"time": bag_time(m.received_ns), "conn": struct.pack("<I", c), "op": b"\x02"}
            chunk += bag_record(header, scan_bytes(m.value))
        position = head_bytes + len(body)
        body += bag_record(
            {"op": b"\x05", "compression": b"none", "size": struct.pack("<I", len(chunk))}, chunk
        )
        for c, entries in offsets.items():
            header = {"op": b"\x04", "ver": struct.pack("<I", 1), "conn": struct.pack("<I", c)}
            header["count"] = struct.pack("<I", len(entries))
            data = b"".join(bag_time(ns) + struct.pack("<I", at) for ns, at in entries)
            body += bag_record(header, data)
        stamps = [ns for entries in offsets.values() for ns, _ in entries]
        info = {
            "op": b"\x06",
            "ver": struct.pack("<I", 1),
            "chunk_pos": struct.pack("<Q", position),
        }
        info |= {"start_time": bag_time(min(stamps)), "end_time": bag_time(max(stamps))}
        info["count"] = struct.pack("<I", 2)
        counts = b"".join(struct.pack("<II", c, len(entries)) for c, entries in offsets.items())
        infos += bag_record(info, counts)
    header = {"op": b"\x03", "index_pos": struct.pack("<Q", head_bytes + len(body))}
    header |= {"conn_count": struct.pack("<I", 2), "chunk_count": struct.pack("<I", 2)}
    bare = bag_record(header, b"")
    head = bag_record(header, b" " * (4096 - len(bare)))
    file = path / "by_bytes.bag"
    file.write_bytes(b"#ROSBAG V2.0\n" + head + body + b"".join(connections) + infos)
    return Sample(file, written, types=dict.fromkeys(topics, "sensor_msgs/msg/LaserScan"))
