"""Messages a second against rosbags' plain iteration over the same topics.

    python -m tests.benchmarks.bench_reading

Ours decodes to model values, rosbags to its own messages. Two measures: with opening, where neither
has anything prepared; and iteration alone over a recording that is open and was read once. Best
of 9 rounds in which the two take turns. Reads the bags and rooms below SCANLOOM_TEST_DATA where
that is set, and a database and a split folder written here.
"""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from fusion_core.model.recording import Message, Recording
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.messages.types import find_type_deserializer
from tests.recordings.samples.ros_messages import ROS2, ros_message

SAMPLE = Path(__file__).parents[2] / "samples" / "furnished_room.mcap"
ROUNDS = 9
BAR = 0.8
_PARTS = 4


@dataclass(slots=True)
class Best:
    """Fewest seconds so far, of the processor and of the clock."""

    cpu_s: float = float("inf")
    wall_s: float = float("inf")

    def take(self, call: Callable[[], int]) -> int:
        """Time one call and pass on what it returns."""
        cpu, wall = time.process_time(), time.perf_counter()
        count = call()
        self.cpu_s = min(self.cpu_s, time.process_time() - cpu)
        self.wall_s = min(self.wall_s, time.perf_counter() - wall)
        return count


def ours(recording: Recording) -> int:
    return sum(1 for _ in recording.messages())


def theirs(reader: AnyReader, topics: set[str]) -> int:
    count = 0
    connections = [own for own in reader.connections if own.topic in topics]
    for connection, _, data in reader.messages(connections=connections):
        reader.deserialize(data, connection.msgtype)
        count += 1
    return count


def opened(path: Path) -> AnyReader:
    """Raises AnyReaderError and others for what rosbags does not open."""
    reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
    reader.open()
    return reader


def ours_with_opening(path: Path) -> int:
    find_type_deserializer.cache_clear()
    with open_recording(path) as recording:
        return ours(recording)


def theirs_with_opening(path: Path, topics: set[str]) -> int:
    with closing(opened(path)) as reader:
        return theirs(reader, topics)


@dataclass(slots=True)
class Compared:
    """``best``: ours and theirs over what is open already, then ours and theirs with opening."""

    messages: int
    best: list[Best]

    @property
    def is_enough(self) -> bool:
        """By the processor's time over what is open already: opening costs the same once."""
        return self.best[1].cpu_s >= BAR * self.best[0].cpu_s


def compare(name: str, path: Path) -> Compared:
    """Time both readers. Raises ValueError where they read different numbers of messages."""
    best = [Best() for _ in range(4)]
    with open_recording(path) as recording, closing(opened(path)) as reader:
        topics = {message.topic for message in recording.messages()}
        count, other = ours(recording), theirs(reader, topics)
        if count != other:
            raise ValueError(f"{name}: {count} messages against {other}")
        for _ in range(ROUNDS):
            best[0].take(lambda: ours(recording))
            best[1].take(lambda: theirs(reader, topics))
    for _ in range(ROUNDS):
        best[2].take(lambda: ours_with_opening(path))
        best[3].take(lambda: theirs_with_opening(path, topics))
    return Compared(count, best)


def print_row(name: str, compared: Compared) -> None:
    row = f"{name:<36}{compared.messages:>8}"
    for own, other in (compared.best[:2], compared.best[2:]):
        row += f"{compared.messages / own.cpu_s:>10.0f}{compared.messages / other.cpu_s:>10.0f}"
        row += f"{other.cpu_s / own.cpu_s:>7.2f}{other.wall_s / own.wall_s:>7.2f}"
    print(f"{row}{'' if compared.is_enough else '  missed'}", flush=True)


def total(rows: Sequence[Compared]) -> Compared:
    """All messages, and the sums of the best times."""
    sums = [
        Best(sum(one.cpu_s for one in each), sum(one.wall_s for one in each))
        for each in zip(*(row.best for row in rows), strict=True)
    ]
    return Compared(sum(row.messages for row in rows), sums)


def write_folder(path: Path, messages: Sequence[Message]) -> Path:
    """A folder with a database."""
    with Rosbag2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections: dict[str, Connection] = {}
        for message in messages:
            raw = ros_message(ROS2, message.value)
            name, topic = raw.__msgtype__, message.topic
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=ROS2)
            assert message.received_ns is not None
            data = ROS2.serialize_cdr(raw, name)
            writer.write(connections[topic], message.received_ns, data)
    return path


def write_split_folder(path: Path, whole: Path, messages: Sequence[Message]) -> Path:
    """A folder with a database in parts. rosbags does not split: the metadata is the whole's."""
    path.mkdir()
    size = -(-len(messages) // _PARTS)
    names = []
    for part in range(_PARTS):
        name = f"{path.name}_{part}"
        written = write_folder(path.with_name(name), messages[part * size : (part + 1) * size])
        names.append((written / f"{name}.db3").rename(path / f"{name}.db3").name)
    yaml = YAML(typ="safe")
    metadata = yaml.load(whole / "metadata.yaml")
    metadata["rosbag2_bagfile_information"]["relative_file_paths"] = names
    yaml.dump(metadata, path / "metadata.yaml")
    return path


def recordings(work: Path) -> Iterator[tuple[str, Path]]:
    """Name and path of each."""
    with open_recording(SAMPLE) as recording:
        messages = list(recording.messages())
    whole = write_folder(work / "whole", messages)
    yield "database (written here)", whole
    yield "split database (written here)", write_split_folder(work / "split", whole, messages)
    data = os.environ.get("SCANLOOM_TEST_DATA")
    if data is None:
        print("SCANLOOM_TEST_DATA is not set: no shared recordings.")
        return
    for path in [*(Path(data) / "real" / "bags").iterdir(), *(Path(data) / "rooms").iterdir()]:
        if path.is_dir() or path.suffix in (".bag", ".mcap", ".db3"):
            yield path.name, path


def main() -> None:
    """Print the table; exit 1 where a recording misses the bar."""
    print(f"{'':<44}{'open already':^34}{'with opening':^34}")
    columns = f"{'ours/s':>10}{'rosbags/s':>10}{'CPU':>7}{'wall':>7}"
    print(f"{'':<36}{'messages':>8}{columns}{columns}")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, path in recordings(Path(folder)):
            rows.append(compare(name, path))
            print_row(name, rows[-1])
    print_row("all", total(rows))
    print(f"bar: CPU {BAR} where it is open already")
    sys.exit(not all(row.is_enough for row in rows))


if __name__ == "__main__":
    main()
