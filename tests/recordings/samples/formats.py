"""A sample of every format that is read: one line here for each, and one function to build it.

The tests of the contract, of conversion and of damage run on each of them. To add a format, write
a function that takes an empty folder, writes a file or folder into it and returns a ``Sample``,
and name it in ``SAMPLE_BUILDERS``.
"""

import bz2
import gzip
from collections.abc import Callable
from functools import partial
from pathlib import Path

from mcap.writer import CompressionType, IndexType
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from tests.recordings.samples.carmen import build_carmen
from tests.recordings.samples.image_folders import (
    build_numbered_images,
    build_redwood,
    build_seven_scenes,
    build_slambook,
    build_timed_images,
    build_tum,
)
from tests.recordings.samples.robot_at_home import (
    build_plain_text_room,
    build_robot_at_home2_room,
)
from tests.recordings.samples.ros_containers import (
    build_mcap,
    build_old_sqlite,
    build_ours,
    build_rosbag1,
    build_rosbag2,
    build_split_folder,
    lone_file,
    without_metadata,
)
from tests.recordings.samples.rosbag1_by_bytes import build_rosbag1_by_bytes
from tests.recordings.samples.sample import Sample

BagCompression = Rosbag1Writer.CompressionFormat
SAMPLE_BUILDERS: dict[str, Callable[[Path], Sample]] = {
    "rosbag1": build_rosbag1,
    "rosbag1 bz2": lambda p: build_rosbag1(p, BagCompression.BZ2),
    "rosbag1 lz4": lambda p: build_rosbag1(p, BagCompression.LZ4),
    "rosbag1 by bytes": build_rosbag1_by_bytes,
    "rosbag2 sqlite": lambda p: build_rosbag2(p, StoragePlugin.SQLITE3),
    "rosbag2 mcap": lambda p: build_rosbag2(p, StoragePlugin.MCAP),
    **{
        f"rosbag2 {storage.name.lower()} packed by {mode.name.lower()}": partial(
            build_rosbag2, storage=storage, compression=mode
        )
        for storage in (StoragePlugin.SQLITE3, StoragePlugin.MCAP)
        for mode in (CompressionMode.FILE, CompressionMode.MESSAGE)
    },
    "rosbag2 sqlite, no metadata": lambda p: without_metadata(
        build_rosbag2(p, StoragePlugin.SQLITE3)
    ),
    "rosbag2 mcap, no metadata": lambda p: without_metadata(build_rosbag2(p, StoragePlugin.MCAP)),
    "split mcap, no metadata": build_split_folder,
    "db3": lambda p: lone_file(build_rosbag2(p, StoragePlugin.SQLITE3), ".db3"),
    "db3 of the first schema": build_old_sqlite,
    "mcap zstd": lambda p: build_mcap(p / "a.mcap"),
    "mcap lz4": lambda p: build_mcap(p / "a.mcap", compression=CompressionType.LZ4),
    "mcap plain": lambda p: build_mcap(p / "a.mcap", compression=CompressionType.NONE),
    "mcap without chunks": lambda p: build_mcap(p / "a.mcap", use_chunking=False),
    "mcap without summary": lambda p: build_mcap(p / "a.mcap", summary=False),
    "mcap without message index": lambda p: build_mcap(p / "a.mcap", index_types=IndexType.CHUNK),
    "mcap of ROS 1": lambda p: build_mcap(p / "a.mcap", ros1=True),
    "mcap of this project": lambda p: build_ours(p / "a.mcap"),
    "7-Scenes": build_seven_scenes,
    "Redwood": build_redwood,
    "slambook": build_slambook,
    "TUM RGB-D": build_tum,
    "images by time": build_timed_images,
    "images by number": build_numbered_images,
    "Robot@Home": build_plain_text_room,
    "Robot@Home2": build_robot_at_home2_room,
    "CARMEN": lambda p: build_carmen(p / "log.clf"),
    "CARMEN gz": lambda p: build_carmen(p / "log.clf.gz", gzip.compress),
    "CARMEN bz2": lambda p: build_carmen(p / "packed", bz2.compress),
}
