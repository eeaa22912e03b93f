"""Every format as MCAP, seen by our own reader, by rosbags and by the mcap package."""

import json
import sqlite3
from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer as McapLibraryWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.errors import ExportError, MissingStream, RecordingError, ScanLoomError
from fusion_core.model.progress import silent
from fusion_core.model.sensors import DepthImage, LaserScan, PoseSample, SensorValue
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.convert import ConvertOptions, convert
from fusion_core.workflows.source import RoomChoice, open_source
from tests.recordings import robot_at_home_trees
from tests.recordings.samples.formats import SAMPLE_BUILDERS
from tests.recordings.samples.ros_containers import build_mcap, build_old_sqlite
from tests.recordings.samples.ros_messages import TYPES
from tests.recordings.samples.sample import T0, same

S = NS_PER_S


def to_mcap(path: Path, output: Path, **options: Any) -> dict[str, Any]:
    return convert(path, output, ConvertOptions(**options), silent)


@pytest.fixture
def output(tmp_path: Path) -> Path:
    folder = tmp_path / "converted"
    folder.mkdir()
    return folder / "out.mcap"


@pytest.fixture(params=list(SAMPLE_BUILDERS))
def sample(request: pytest.FixtureRequest, tmp_path: Path) -> Any:
    """One recording in each format."""
    folder = tmp_path / "source"
    folder.mkdir()
    return SAMPLE_BUILDERS[request.param](folder)


def build(name: str, folder: Path) -> Any:
    folder.mkdir(exist_ok=True)
    return SAMPLE_BUILDERS[name](folder)


def by_rosbags(path: Path, *topics: str) -> Iterator[tuple[str, int, Any]]:
    """Topic, log time and message of these topics, or of all."""
    with AnyReader([path]) as reader:
        chosen = [c for c in reader.connections if not topics or c.topic in topics]
        for connection, log_time, raw in reader.messages(chosen):
            yield connection.topic, log_time, reader.deserialize(raw, connection.msgtype)


def by_mcap(path: Path) -> list[tuple[str, int, int, bytes]]:
    """Topic, log time, publish time and bytes, by the mcap package."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        return [
            (channel.topic, message.log_time, message.publish_time, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]


def schemas(path: Path) -> dict[str, tuple[str, str, bytes]]:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    found = {}
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        found[channel.topic] = (schema.name, schema.encoding, schema.data)
    return found


def as_written(value: SensorValue, role: str, received_ns: int) -> SensorValue:
    """What is left of a value in the fields of its ROS message."""
    value = replace(value, received_ns=received_ns)
    if isinstance(value, PoseSample) and role == "pose":
        return replace(value, child="")
    if isinstance(value, DepthImage):
        return replace(value, quantum_m=None)
    if isinstance(value, LaserScan):
        scalars = ("angle_min_rad", "angle_increment_rad", "range_min_m", "range_max_m")
        scalars += ("scan_time_s", "time_increment_s")
        ranges = value.ranges_m.astype(np.float32).astype(np.float64)
        rounded = {name: float(np.float32(getattr(value, name))) for name in scalars}
        return replace(value, ranges_m=ranges, **rounded)
    return value


def test_every_reader_sees_the_same(sample: Any, output: Path) -> None:
    result = to_mcap(sample.path, output)
    with open_recording(sample.path) as source, open_recording(output) as converted:
        roles = {topic.name: topic.role for topic in source.topics}
        assert {t.name: (t.role, t.count) for t in converted.topics} == {
            t.name: (t.role, t.count) for t in source.topics
        }
        before, after = list(source.messages()), list(converted.messages())
        assert converted.warnings == []
    assert len(after) == len(before) == result["written"] > 0
    assert (result["left_out"], result["skipped"]) == (0, [])
    for old, new in zip(before, after, strict=True):
        log_time = old.stamp_ns if old.received_ns is None else old.received_ns
        assert (new.topic, new.index, new.stamp_ns) == (old.topic, old.index, old.stamp_ns)
        assert new.received_ns == log_time
        assert same(new.value, as_written(old.value, roles[old.topic], log_time)), old
    assert (result["start_ns"], result["end_ns"]) == (after[0].received_ns, after[-1].received_ns)
    assert {t["name"]: t["count"] for t in result["topics"]} == Counter(m.topic for m in before)

    expected = sorted((m.topic, m.received_ns) for m in sample.expected)
    assert sorted((topic, at) for topic, at, _ in by_rosbags(output)) == expected
    found = by_mcap(output)
    assert sorted((topic, at) for topic, at, _, _ in found) == expected
    # The order of the file is that of the log.
    assert [at for _, at, _, _ in found] == sorted(at for _, at, _, _ in found)


@pytest.mark.parametrize("name", ["rosbag1 lz4", "mcap of ROS 1", "db3", "mcap zstd", "Redwood"])
def test_messages_are_published_at_the_sensors_stamp(
    name: str, tmp_path: Path, output: Path
) -> None:
    sample = build(name, tmp_path / "source")
    to_mcap(sample.path, output)
    published = sorted((topic, at, stamp) for topic, at, stamp, _ in by_mcap(output))
    assert published == sorted((m.topic, m.received_ns, m.stamp_ns) for m in sample.expected)


def test_an_mcap_keeps_its_own_publish_times(tmp_path: Path, output: Path) -> None:
    # This writer takes the log time for both.
    sample = build("rosbag2 mcap", tmp_path / "source")
    to_mcap(sample.path, output)
    assert all(published == at for _, at, published, _ in by_mcap(output))


def serialised(path: Path) -> list[tuple[str, int, bytes]]:
    """Topic, log time and bytes of a recording in CDR, by SQLite or the mcap package."""
    found = []
    for file in [path] if path.is_file() else sorted(path.iterdir()):
        if file.suffix == ".mcap":
            found += [(topic, at, data) for topic, at, _, data in by_mcap(file)]
        elif file.suffix == ".db3":
            connection = sqlite3.connect(file)
            found += connection.execute(
                "SELECT name, timestamp, data FROM messages JOIN topics ON topic_id = topics.id"
            ).fetchall()
            connection.close()
    return sorted(found)


@pytest.mark.parametrize(
    "name",
    [
        *("rosbag2 sqlite", "rosbag2 mcap", "db3 of the first schema", "mcap lz4"),
        "mcap without chunks",
    ],
)
def test_cdr_is_copied_byte_for_byte(name: str, tmp_path: Path, output: Path) -> None:
    sample = build(name, tmp_path / "source")
    to_mcap(sample.path, output)
    before = serialised(sample.path)
    assert len(before) == len(sample.written)
    assert serialised(output) == before


def test_definitions_are_copied_as_they_are(tmp_path: Path, output: Path) -> None:
    sample = build("mcap zstd", tmp_path / "source")
    to_mcap(sample.path, output)
    assert schemas(output) == schemas(sample.path)


def same_fields(ros1: Any, ros2: Any) -> bool:
    """Equality of messages by their fields, whose names may differ in upper and lower case."""
    if is_dataclass(ros1) and is_dataclass(ros2):
        old = {f.name.lower(): getattr(ros1, f.name) for f in fields(ros1) if f.name != "seq"}
        new = {f.name.lower(): getattr(ros2, f.name) for f in fields(ros2)}
        return all(same_fields(value, new[name]) for name, value in old.items() if name[0] != "_")
    if isinstance(ros1, list):
        return len(ros1) == len(ros2) and all(map(same_fields, ros1, ros2))
    if isinstance(ros1, np.ndarray):
        return ros1.tobytes() == ros2.astype(ros1.dtype).tobytes()
    return bool(ros1 == ros2)


def in_order(path: Path) -> dict[tuple[str, int], list[Any]]:
    """Messages by topic and log time."""
    found: dict[tuple[str, int], list[Any]] = {}
    for topic, at, message in by_rosbags(path):
        found.setdefault((topic, at), []).append(message)
    return found


def assert_same_messages(bag: Path, output: Path) -> None:
    before, after = in_order(bag), in_order(output)
    assert before.keys() == after.keys()
    for key, messages in before.items():
        # Readers may give messages of one time in another order.
        left = list(after[key])
        for message in messages:
            left.remove(next(other for other in left if same_fields(message, other)))
        assert left == []


def test_ros1_keeps_the_value_of_every_field(tmp_path: Path, output: Path) -> None:
    sample = build("rosbag1", tmp_path / "source")
    to_mcap(sample.path, output)
    assert_same_messages(sample.path, output)
    humble = get_typestore(Stores.ROS2_HUMBLE)
    for topic, (name, encoding, text) in schemas(output).items():
        assert (name, encoding) == (TYPES[topic], "ros2msg")
        assert text.decode() == humble.generate_msgdef(name, ros_version=2)[0]


CUSTOM = {
    "rig_msgs/msg/Wheel": "int8 LEFT=-1\nstring UNIT=rad\nHeader header\nduration[] waits\n"
    "byte flag\nchar letter\nfloat64[3] Speeds\nstring[] names\nrig_msgs/Nothing nothing\n",
    "rig_msgs/msg/Nothing": "",
    # Not what ROS 2 knows by this name: a field has another type.
    "sensor_msgs/msg/Range": "Header header\nstring range\n",
}


def custom_messages() -> tuple[Any, dict[str, tuple[str, Any]]]:
    store = get_typestore(Stores.ROS1_NOETIC)
    del store.fielddefs["sensor_msgs/msg/Range"], store.types["sensor_msgs/msg/Range"]
    for name, text in CUSTOM.items():
        store.register(get_types_from_msg(text, name))
    t = store.types
    header = t["std_msgs/msg/Header"](
        seq=3, stamp=t["builtin_interfaces/msg/Time"](sec=5, nanosec=6), frame_id="wheel"
    )
    wheel = t["rig_msgs/msg/Wheel"](
        header=header,
        waits=[t["builtin_interfaces/msg/Duration"](sec=1, nanosec=2)],
        flag=7,
        letter=65,
        Speeds=np.array([1.0, 2.0, 4.0]),
        names=["a", "", "bcd"],
        nothing=t["rig_msgs/msg/Nothing"](structure_needs_at_least_one_member=0),
    )
    vector = t["geometry_msgs/msg/Vector3"](x=1.0, y=2.0, z=3.0)
    point = t["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=3.0)
    orientation = t["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    white = t["std_msgs/msg/ColorRGBA"](r=1.0, g=1.0, b=1.0, a=1.0)
    marker = t["visualization_msgs/msg/Marker"](
        header=header,
        ns="n",
        id=4,
        type=2,
        action=0,
        pose=t["geometry_msgs/msg/Pose"](position=point, orientation=orientation),
        scale=vector,
        color=white,
        lifetime=t["builtin_interfaces/msg/Duration"](sec=1, nanosec=0),
        frame_locked=True,
        points=[point, point],
        colors=[white],
        text="words",
        mesh_resource="",
        mesh_use_embedded_materials=False,
    )
    distance = t["sensor_msgs/msg/Range"](header=header, range="far")
    return store, {
        "/wheel": ("rig_msgs/msg/Wheel", wheel),
        "/marker": ("visualization_msgs/msg/Marker", marker),
        "/range": ("sensor_msgs/msg/Range", distance),
        "/nothing": ("rig_msgs/msg/Nothing", wheel.nothing),
        "/time": ("std_msgs/msg/Time", t["std_msgs/msg/Time"](data=header.stamp)),
    }


def write_bag(path: Path, store: Any, messages: dict[str, tuple[str, Any]]) -> Path:
    with Rosbag1Writer(path) as writer:
        for i, (topic, (name, message)) in enumerate(messages.items()):
            connection = writer.add_connection(topic, name, typestore=store)
            data = message if isinstance(message, bytes) else store.serialize_ros1(message, name)
            writer.write(connection, 10 * S + i, data)
    return path


def test_ros1_types_of_any_package(tmp_path: Path, output: Path) -> None:
    bag = write_bag(tmp_path / "custom.bag", *custom_messages())
    result = to_mcap(bag, output)
    assert (result["written"], result["skipped"]) == (5, [])
    assert_same_messages(bag, output)
    published = {topic: stamp for topic, _, stamp, _ in by_mcap(output)}
    # Without a header the stamp is the log's.
    assert published["/time"] == 10 * S + 4
    assert {published[topic] for topic in ("/wheel", "/marker", "/range")} == {5 * S + 6}
    assert [note.partition(":")[0] for note in result["notes"]] == ["/marker", "/range"]
    assert schemas(output)["/nothing"][2] == b"uint8 structure_needs_at_least_one_member\n"


def test_broken_messages_cost_themselves(tmp_path: Path, output: Path) -> None:
    store, messages = custom_messages()
    name, wheel = messages["/wheel"]
    cut = bytes(store.serialize_ros1(wheel, name))[:-3]
    result = to_mcap(
        write_bag(tmp_path / "cut.bag", store, messages | {"/wheel": (name, cut)}), output
    )
    assert (result["written"], result["left_out"]) == (4, 1)
    (wheels,) = (topic for topic in result["topics"] if topic["name"] == "/wheel")
    assert (wheels["count"], wheels["left_out"]) == (0, 1)
    (note,) = (note for note in result["notes"] if "/wheel" in note)
    assert "1 of 1 messages" in note
    assert "rig_msgs/msg/Wheel" in note


def test_a_broken_chunk_costs_its_messages(tmp_path: Path, output: Path) -> None:
    sample = build("mcap zstd", tmp_path / "source")
    content = bytearray(sample.path.read_bytes())
    with sample.path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    chunk = summary.chunk_indexes[1]
    content[chunk.chunk_start_offset + chunk.chunk_length - 9] ^= 0xFF
    sample.path.write_bytes(content)
    result = to_mcap(sample.path, output)
    with open_recording(sample.path) as source:
        readable = Counter(m.topic for m in source.messages())
        assert result["notes"] == source.warnings != []
    assert {t["name"]: t["count"] for t in result["topics"] if t["count"]} == readable
    assert Counter(topic for topic, *_ in by_mcap(output)) == readable


def test_encodings_and_types(tmp_path: Path, output: Path) -> None:
    path = tmp_path / "mixed.mcap"
    with path.open("wb") as stream:
        writer = McapLibraryWriter(stream)
        writer.start("ros2", "test")
        log = writer.register_schema("Log", "jsonschema", b"{}")
        text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        known = writer.register_schema("std_msgs/msg/Int32", "", b"")
        unknown = writer.register_schema("lab_msgs/msg/Thing", "", b"")
        for i, (topic, encoding, schema) in enumerate(
            [
                *(("/json", "json", log), ("/text", "cdr", text), ("/number", "cdr", known)),
                *(("/thing", "cdr", unknown), ("/mixed", "cdr", text), ("/mixed", "json", log)),
                ("/empty", "cdr", text),
            ]
        ):
            channel = writer.register_channel(topic, encoding, schema)
            if topic != "/empty":
                data = b"{}" if encoding == "json" else b"\0\1\0\0\2\0\0\0a\0"
                writer.add_message(channel, 100 + i, data, 50 + i)
        writer.finish()
    result = to_mcap(path, output)
    assert [(t["name"], t["reason"]) for t in result["skipped"]] == [
        ("/json", "its encoding 'json' is neither CDR nor ROS 1")
    ]
    assert {t["name"]: (t["count"], t["left_out"]) for t in result["topics"]} == {
        "/empty": (0, 0),
        "/mixed": (1, 1),
        "/number": (1, 0),
        "/text": (1, 0),
        "/thing": (1, 0),
    }
    assert len([note for note in result["notes"] if note.startswith("/mixed")]) == 2
    assert [(topic, at, published) for topic, at, published, _ in by_mcap(output)] == [
        *(("/text", 101, 51), ("/number", 102, 52), ("/thing", 103, 53), ("/mixed", 104, 54)),
    ]
    found = schemas(output)
    assert found["/text"] == ("std_msgs/msg/String", "ros2msg", b"string data")
    assert found["/number"] == ("std_msgs/msg/Int32", "ros2msg", b"int32 data\n")
    assert found["/thing"] == ("lab_msgs/msg/Thing", "", b"")
    assert "/empty" in found
    assert [message.data for _, _, message in by_rosbags(output, "/text")] == ["a"]


@pytest.mark.parametrize("name", ["rosbag1", "mcap zstd", "db3", "Redwood"])
def test_topics_and_half_open_ranges(name: str, tmp_path: Path, output: Path) -> None:
    sample = build(name, tmp_path / "source")
    first = min(m.received_ns for m in sample.written)
    moving = sorted({m.topic for m in sample.written} - {"/tf_static"})
    times = sorted({m.received_ns - first for m in sample.written})
    start, end = times[len(times) // 3], times[2 * len(times) // 3]
    for topics, bounds in (
        ((), (start, end)),
        (moving[:2], (None, None)),
        (moving[:2], (start, None)),
        ((moving[-1], moving[-1]), (None, end)),
    ):
        start_s, end_s = (None if bound is None else bound / S for bound in bounds)
        to_mcap(sample.path, output, topics=topics, start_s=start_s, end_s=end_s, overwrite=True)
        expected = [
            (m.topic, m.received_ns)
            for m in sample.written
            if m.topic in (topics or moving)
            and (bounds[0] is None or m.received_ns - first >= bounds[0])
            and (bounds[1] is None or m.received_ns - first < bounds[1])
        ]
        found = [(topic, at) for topic, at, _, _ in by_mcap(output) if topic != "/tf_static"]
        assert sorted(found) == sorted(expected)


def test_static_transforms_from_before_the_start_are_kept(tmp_path: Path, output: Path) -> None:
    sample = build("mcap zstd", tmp_path / "source")
    first = sample.expected[0].received_ns
    result = to_mcap(sample.path, output, start_s=0.2, end_s=0.3)
    with open_recording(output) as recording:
        assert recording.start_ns == first + 200_000_000
        static = recording.read("/tf_static", 0)
        assert static.received_ns == recording.start_ns
    (written,) = (m.value for m in sample.written if m.topic == "/tf_static")
    assert static.value.transforms[0].stamp_ns == written.transforms[0].stamp_ns
    assert result["left_out"] == 0
    to_mcap(sample.path, output, start_s=0.2, topics=("/scan",), overwrite=True)
    assert {topic for topic, *_ in by_mcap(output)} == {"/scan"}


def test_times_before_zero_are_logged_at_zero(tmp_path: Path, output: Path) -> None:
    file = tmp_path / "old.db3"
    source = build_old_sqlite(tmp_path)
    connection = sqlite3.connect(file)
    connection.execute("UPDATE messages SET timestamp = timestamp - ?", (T0 + 200_000_000,))
    connection.commit()
    connection.close()
    result = to_mcap(file, output)
    logged = [at for _, at, _, _ in by_mcap(output)]
    assert len(logged) == len(source.written)
    assert min(logged) == 0 < max(logged)
    assert any("before 0" in note for note in result["notes"])


REFUSED: dict[str, tuple[dict[str, Any], type[ScanLoomError], str]] = {
    "suffix": ({"output": "out.bag"}, ExportError, r"\.mcap"),
    "itself": ({"output": "source/a.mcap", "overwrite": True}, ExportError, "is read as the input"),
    "exists": ({"output": "there.mcap"}, ExportError, "--overwrite"),
    "folder": ({"output": "folder.mcap", "overwrite": True}, ExportError, "is a folder"),
    "no folder": ({"output": "none/out.mcap"}, ExportError, "cannot be written"),
    "topic": ({"topics": ("/none",)}, MissingStream, "/scan"),
    "late": ({"start_s": 1e300}, RecordingError, "ends 0.551 s"),
    "empty": ({"topics": ("/scan",), "start_s": 0.01, "end_s": 0.02}, RecordingError, "nothing"),
}


@pytest.mark.parametrize("case", [name for name in REFUSED if REFUSED[name][1]])
def test_refusals_leave_everything_as_it_was(case: str, tmp_path: Path) -> None:
    options, error, words = REFUSED[case]
    build("mcap zstd", tmp_path / "source")
    (tmp_path / "there.mcap").write_bytes(b"before")
    (tmp_path / "folder.mcap").mkdir()
    before = contents(tmp_path)
    output = tmp_path / options.get("output", "out.mcap")
    rest = {name: value for name, value in options.items() if name != "output"}
    with pytest.raises(error, match=words):
        to_mcap(tmp_path / "source" / "a.mcap", output, **rest)
    assert contents(tmp_path) == before


def contents(folder: Path) -> dict[str, bytes | None]:
    return {str(path): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def test_an_output_inside_the_recording_is_refused(tmp_path: Path) -> None:
    sample = build("rosbag2 mcap", tmp_path / "source")
    link = tmp_path / "link"
    link.symlink_to(sample.path)
    before = contents(tmp_path)
    for output in (sample.path / "out.mcap", link / "out.mcap", link / ".." / sample.path.name):
        with pytest.raises(ExportError):
            to_mcap(sample.path, output)
    assert contents(tmp_path) == before


def test_a_room_of_a_data_set(tmp_path: Path, output: Path) -> None:
    trees = robot_at_home_trees
    first = trees.small_room()
    other = replace(first, room="kitchen1")
    root = trees.write_plain_text(tmp_path / "homes", [first, other])
    before = contents(root)
    kitchen = RoomChoice(session=other.session, room=other.room)
    result = to_mcap(root, output, room=kitchen)
    with open_source(root, kitchen) as source:
        assert {t["name"]: t["count"] for t in result["topics"]} == {
            topic.name: topic.count for topic in source.topics
        }
        room = source.path
    for inside in (root, room.with_suffix("")):
        with pytest.raises(ExportError, match="inside"):
            to_mcap(root, inside / "out.mcap", room=kitchen)
    with pytest.raises(RecordingError, match="cellar"):
        to_mcap(root, output, room=replace(kitchen, room="cellar"), overwrite=True)
    assert contents(root) == before


def test_what_cannot_be_converted_at_all_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "json.mcap"
    with path.open("wb") as stream:
        writer = McapLibraryWriter(stream)
        writer.start("", "test")
        channel = writer.register_channel("/json", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(RecordingError, match="/json: its encoding 'json'"):
        to_mcap(path, tmp_path / "out.mcap")
    assert list(tmp_path.iterdir()) == [path]


def test_a_recording_without_messages_stays_one(tmp_path: Path, output: Path) -> None:
    source = build_mcap(tmp_path / "none.mcap", [])
    result = to_mcap(source.path, output)
    assert (result["written"], result["start_ns"]) == (0, None)
    with open_recording(output) as recording:
        assert {topic.name for topic in recording.topics} == set(TYPES)


@pytest.mark.parametrize("name", ["rosbag1", "Redwood"])
def test_an_interrupted_conversion_leaves_nothing_behind(
    name: str, tmp_path: Path, output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sample = build(name, tmp_path / "source")
    output.write_bytes(b"before")
    seen = []

    def interrupt(done: int, total: int | None, what: str) -> None:
        seen.append((done, total, what))
        raise KeyboardInterrupt

    monkeypatch.setattr("fusion_core.workflows.convert._PROGRESS_STEP", 5)
    with pytest.raises(KeyboardInterrupt):
        convert(sample.path, output, ConvertOptions(overwrite=True), interrupt)
    assert seen == [(5, len(sample.written), "messages")]
    assert contents(output.parent) == {str(output): b"before"}


@pytest.mark.parametrize("name", ["rosbag1", "mcap zstd", "Redwood"])
def test_the_same_input_gives_the_same_bytes(name: str, tmp_path: Path, output: Path) -> None:
    sample = build(name, tmp_path / "source")
    before = contents(sample.path.parent)
    result = to_mcap(sample.path, output)
    first = output.read_bytes()
    assert to_mcap(sample.path, output, overwrite=True) == result
    assert output.read_bytes() == first
    assert contents(sample.path.parent) == before
    assert json.loads(json.dumps(result, allow_nan=False)) == result


REAL = {
    "guardian_3.bag": 53_937,
    "jarvis_circular_path_fast.bag": 7_584,
    "nav2_turtlebot.mcap": 8_197,
    "scans_demo.bag": 661,
    "tilt_laser.bag": 4_093,
}


@pytest.mark.data
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] if REAL[n] > 10_000 else []) for n in REAL],
)
def test_recordings_of_other_people(name: str, data_folder: Path, output: Path) -> None:
    path = data_folder / "real" / "bags" / name
    result = to_mcap(path, output)
    assert (result["written"], result["left_out"], result["skipped"]) == (REAL[name], 0, [])
    if path.suffix == ".mcap":
        assert by_mcap(output) == by_mcap(path)
    else:
        assert_same_messages(path, output)


@pytest.mark.data
def test_rooms(room_path: Path, output: Path) -> None:
    to_mcap(room_path, output)
    if room_path.is_dir():
        assert serialised(output) == serialised(room_path)
    else:
        assert_same_messages(room_path, output)
