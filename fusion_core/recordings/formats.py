"""The table of formats, recognised by content, and the function that opens any recording."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from fusion_core.files.label_store_header import is_label_store
from fusion_core.files.regular_file import read_head
from fusion_core.model.errors import RecordingError
from fusion_core.model.recording import Recording
from fusion_core.recordings.archives import detect_compression
from fusion_core.recordings.calibration_files.contents import describe_calibration
from fusion_core.recordings.carmen.log import is_carmen_log, open_carmen_log
from fusion_core.recordings.clouds.formats import cloud_format
from fusion_core.recordings.images.frame_folder import frame_layout, open_frame_folder
from fusion_core.recordings.images.image_folder import is_image_folder, open_image_folder
from fusion_core.recordings.images.tum_folder import is_tum_folder, open_tum_folder
from fusion_core.recordings.mcap import file as mcap_file
from fusion_core.recordings.robot_at_home.rooms import is_robot_at_home, open_only_room
from fusion_core.recordings.rosbag1 import bag
from fusion_core.recordings.rosbag1.bag import open_rosbag1
from fusion_core.recordings.rosbag2 import compressed_storage, sqlite_file
from fusion_core.recordings.rosbag2.metadata import METADATA
from fusion_core.recordings.rosbag2.storage import (
    is_rosbag2_folder,
    open_rosbag2_folder,
    open_storage_file,
)

READABLE_FORMATS = (
    "Readable are ROS 1 bags (.bag), ROS 2 recordings (a folder, .mcap or .db3), CARMEN "
    "logs (plain, .gz or .bz2), roots and rooms of "
    "Robot@Home (plain text) and Robot@Home2 (rh.db), and folders of "
    "depth and colour images: TUM RGB-D, 7-Scenes, Redwood, slambook, or plain rgb/ and depth/."
)
_HEAD_BYTES = 512
# Set by hand: at most this many children of a folder are examined, as it may be a whole disk.
_MAX_CHILDREN = 500


@dataclass(frozen=True, slots=True)
class _FileFormat:
    """``matches`` is given a file and its first bytes."""

    matches: Callable[[Path, bytes], bool]
    open: Callable[[Path], Recording]


@dataclass(frozen=True, slots=True)
class _FolderFormat:
    matches: Callable[[Path], bool]
    open: Callable[[Path], Recording]


def _begins_with(magic: bytes) -> Callable[[Path, bytes], bool]:
    return lambda path, head: head.startswith(magic)


# The first that matches is taken.
_FILE_FORMATS = (
    # rh.db is a database too: its tables distinguish it from a ROS 2 recording.
    _FileFormat(lambda path, head: is_robot_at_home(path), open_only_room),
    _FileFormat(_begins_with(bag.MAGIC), open_rosbag1),
    _FileFormat(_begins_with(mcap_file.MAGIC), open_storage_file),
    _FileFormat(
        lambda path, head: head.startswith(sqlite_file.MAGIC) and not is_label_store(head),
        open_storage_file,
    ),
    _FileFormat(_begins_with(compressed_storage.ZSTD_MAGIC), open_storage_file),
    _FileFormat(_begins_with(compressed_storage.LZ4_MAGIC), open_storage_file),
    _FileFormat(lambda path, head: is_carmen_log(path), open_carmen_log),
)
_FOLDER_FORMATS = (
    _FolderFormat(is_rosbag2_folder, open_rosbag2_folder),
    _FolderFormat(is_tum_folder, open_tum_folder),
    _FolderFormat(lambda path: frame_layout(path) is not None, open_frame_folder),
    _FolderFormat(is_robot_at_home, open_only_room),
    # Last: the weakest evidence, and the unit of depth may be unknown.
    _FolderFormat(is_image_folder, open_image_folder),
)
# What people open by mistake, recognised by its first bytes.
_KNOWN_NON_RECORDINGS = (
    (b"#ROSBAG V1", "a ROS 1 bag of version 1; convert a copy with `rosbag fix`"),
    (b"\x89PNG", "a single PNG image"),
    (b"\xff\xd8\xff", "a single JPEG image"),
    (b"P5", "a single PGM image"),
    (b"PK\x03\x04", "a ZIP archive; unpack it first"),
    (b"BZh", "a bzip2 archive without a CARMEN log that can be read; unpack it first"),
    (b"\x1f\x8b", "a gzip archive without a CARMEN log that can be read; unpack it first"),
)


def open_recording(path: Path) -> Recording:
    """Open a recording of any known format, recognised by its content, not by its name.

    Raises RecordingError for what is no recording, is too damaged, or does not exist.
    """
    try:
        if path.is_dir():
            return _open_folder(path)
        if path.is_file():
            return _open_file(path)
        exists = path.exists()
    except OSError as error:
        raise RecordingError(
            f"cannot be opened: {error.strerror or error}.",
            file=path,
            advice="Check the path and its permissions.",
        ) from error
    if exists:
        raise RecordingError("is neither a file nor a folder.", file=path, advice=READABLE_FORMATS)
    raise RecordingError("does not exist.", file=path, advice="Check the path.")


def is_recording(path: Path) -> bool:
    """Whether a path looks like a recording by its first bytes, or by what the folder holds.

    It is not opened: a damaged one looks like a recording, too. What cannot be read is none.
    """
    try:
        if path.is_dir():
            return any(format.matches(path) for format in _FOLDER_FORMATS)
        head = read_head(path, _HEAD_BYTES)
        return bool(head) and any(format.matches(path, head) for format in _FILE_FORMATS)
    except OSError:
        return False


def is_packed(path: Path) -> bool:
    """Whether a file must be unpacked as a whole to be opened. Raises OSError."""
    head = read_head(path, len(compressed_storage.ZSTD_MAGIC))
    is_storage = head in (compressed_storage.ZSTD_MAGIC, compressed_storage.LZ4_MAGIC)
    return is_storage or detect_compression(path) is not None


def may_hold_recordings(folder: Path) -> bool:
    """Whether what looks like one recording may be a folder of several: files of ROS 2 without a
    common description, or rooms of a data set. Raises OSError."""
    is_described = (folder / METADATA).is_file()
    return not is_described and (is_rosbag2_folder(folder) or is_robot_at_home(folder))


def _open_file(path: Path) -> Recording:
    head = read_head(path, _HEAD_BYTES)
    if not head:
        raise RecordingError(
            "is empty.", file=path, advice="Copy it again from its source, or record again."
        )
    for format in _FILE_FORMATS:
        if format.matches(path, head):
            return format.open(path)
    raise RecordingError(
        f"is no recording: {_describe_other(path, head)}.", file=path, advice=READABLE_FORMATS
    )


def _describe_other(path: Path, head: bytes) -> str:
    """What a file without a recording is instead."""
    if is_label_store(head):
        return "labels of a recording, which lies beside them"
    for magic, kind in _KNOWN_NON_RECORDINGS:
        if head.startswith(magic):
            return kind
    if cloud := cloud_format(path, head, path.stat().st_size):
        return f"a point cloud ({cloud}), which calibrate camera and evaluate room read"
    if b"\0" in head or any(byte < 9 for byte in head):
        return "its content is of no known format"
    return describe_calibration(path) or "a text file"


def _open_folder(path: Path) -> Recording:
    for format in _FOLDER_FORMATS:
        if format.matches(path):
            return format.open(path)
    children = sorted(islice(path.iterdir(), _MAX_CHILDREN))
    inside = list(islice(filter(is_recording, children), 3))
    if inside:
        names = ", ".join(child.name for child in inside)
        problem = f"is a folder around recordings, such as {names}."
        raise RecordingError(problem, file=path, advice="Name one of them.")
    raise RecordingError("is a folder without a recording.", file=path, advice=READABLE_FORMATS)
