"""CARMEN logs, plain or packed by gzip or bzip2: lasers, odometry and poses.

A laser's line gives up to three streams: its scan (``/flaser``), the robot's odometry at that
scan (``/flaser/odom``), and the logged pose of the laser (``/flaser/pose``) where it is more than
odometry and a fixed mount: logs that were corrected by SLAM keep the corrected pose there.

``stamp_ns`` is the ipc timestamp, ``received_ns`` the logger's, often seconds since its start.
"""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.geometry import transform_from_planar
from fusion_core.model.recording import Recording, Role
from fusion_core.model.sensors import (
    LaserScan,
    PoseSample,
    SensorValue,
    Transform,
    TransformBatch,
)
from fusion_core.recordings.archives import (
    decompress_to_temporary_file,
    detect_compression,
    read_decompressed_head,
)
from fusion_core.recordings.carmen.index import (
    MAX_LINE_BYTES,
    CarmenIndex,
    KeywordIndex,
    format_seconds,
    index_lines,
    is_same_pose,
)
from fusion_core.recordings.carmen.lines import (
    KINDS,
    BadLine,
    CarmenLine,
    LaserDefaults,
    laser_scan,
    parse_line,
    planar_pose,
)
from fusion_core.recordings.stamped import StampedRecording, StampedStream

BASE_FRAME = "base_link"
ODOM_FRAME = "odom"
MAP_FRAME = "map"

# Comments come first, some kilobytes of them; then one of the first lines must be a message.
_HEAD_BYTES = 64 << 10
_HEAD_LINES = 5


def is_carmen_log(path: Path) -> bool:
    """Whether one of a file's first lines, unpacked, is a message of CARMEN."""
    lines = read_decompressed_head(path, _HEAD_BYTES).split(b"\n")
    messages = (line.split(None, 3)[:3] for line in lines if not _is_comment(line))
    return any(_is_message(fields) for fields, _ in zip(messages, range(_HEAD_LINES), strict=False))


def _is_comment(line: bytes) -> bool:
    return line.isspace() or not line or line.lstrip().startswith(b"#")


def _is_message(fields: list[bytes]) -> bool:
    if len(fields) < 3:
        return False
    if fields[0] == b"PARAM":
        return b"_" in fields[1]
    try:
        return fields[0] in KINDS and bool(np.isfinite(float(fields[1])))
    except ValueError:
        return False


def open_carmen_log(path: Path) -> Recording:
    """A CARMEN log. A packed one is unpacked to a temporary file. Raises RecordingError."""
    compression = detect_compression(path)
    lost = ""
    if compression is None:
        file: BinaryIO = path.open("rb")
    else:
        unpacked = decompress_to_temporary_file(path, compression)
        file, lost = unpacked.file, unpacked.lost
    try:
        return _recording(path, file, lost)
    except BaseException:
        file.close()
        raise


def _recording(path: Path, file: BinaryIO, lost: str) -> Recording:
    try:
        index = index_lines(file)
    except OSError as error:
        raise RecordingError(
            f"cannot be read: {error.strerror or error}.",
            file=path,
            advice="Check the disk or the network that holds the file.",
        ) from error
    warnings = [*index.warnings]
    if lost:
        warnings.insert(
            0, f"What follows {format_seconds(index.end_ns)} of the log is lost: {lost}."
        )
    if not index.by_keyword:
        raise RecordingError(
            " ".join(["is a CARMEN log without messages that can be read.", *warnings]),
            file=path,
            advice="Readable are FLASER, RLASER, ROBOTLASER, RAWLASER, ODOM and TRUEPOS.",
        )
    lines = _LineReader(path, file)
    streams = list(_streams(index, lines, warnings))
    return StampedRecording(path, "CARMEN log", streams, warnings, on_close=lines.close)


class _LineReader:
    """Reads lines at their places. Safe for threads."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file
        self._lock = threading.Lock()

    def read_line_at(self, place: int) -> CarmenLine:
        """The line that begins at a byte. Raises RecordingError, also where the file changed."""
        with self._lock:
            if self._file.closed:
                raise RecordingError("is closed.", file=self._path, advice="Open it again.")
            try:
                self._file.seek(place)
                text = self._file.readline(MAX_LINE_BYTES)
            except OSError as error:
                raise RecordingError(
                    f"reading failed, {error.strerror or error}.",
                    file=self._path,
                    advice="Check the disk or the network that holds the file.",
                ) from error
        if not text.split(None, 1) or text.split(None, 1)[0] not in KINDS:
            raise self.bad_line_error(place, BadLine("is no longer what it was"))
        try:
            return parse_line(text)
        except BadLine as error:
            raise self.bad_line_error(place, error) from error

    def bad_line_error(self, place: int, error: BadLine) -> RecordingError:
        return RecordingError(
            f"the line at byte {place} {error}.",
            file=self._path,
            advice="Leave it out, or copy the log again from its source.",
        )

    def close(self) -> None:
        with self._lock:
            self._file.close()


def _streams(
    index: CarmenIndex, lines: _LineReader, warnings: list[str]
) -> Iterator[StampedStream]:
    mounts: dict[str, FloatArray] = {}
    for keyword, rows in index.by_keyword.items():
        frame = keyword.lower()
        topic = f"/{frame}"
        make_stream = _KeywordStreams(lines, keyword, rows, index.has_log).make_stream
        every = np.arange(len(rows.byte_offsets))
        if keyword == "ODOM":
            yield make_stream(topic, "odometry", every, _pose_decoder(0, ODOM_FRAME, BASE_FRAME))
            continue
        if keyword == "TRUEPOS":
            truth = f"{topic}/ground_truth"
            yield make_stream(truth, "pose", every, _pose_decoder(0, MAP_FRAME, BASE_FRAME))
            continue
        defaults = _laser_defaults(index, keyword, warnings)
        yield make_stream(topic, "lidar", every, _scan_decoder(frame, defaults))
        if rows.laser_on_robot is None:
            continue
        odometry = _pose_decoder(3, ODOM_FRAME, BASE_FRAME)
        yield make_stream(f"{topic}/odom", "odometry", rows.with_poses, odometry)
        mount = _laser_mount(index, keyword, rows)
        if mount is not None:
            mounts[frame] = mount
        # Old lasers are taken to stand on the robot's centre unless PARAM says where.
        fixed = np.zeros(3) if mount is None else mount
        if not rows.is_rigid or not is_same_pose(rows.laser_on_robot, fixed):
            corrected = _pose_decoder(0, MAP_FRAME, frame)
            yield make_stream(f"{topic}/pose", "pose", rows.with_poses, corrected)
    if mounts:
        yield _static_transforms(index, mounts)


_Decoder = Callable[[CarmenLine, int | None], SensorValue]


@dataclass(frozen=True, slots=True)
class _KeywordStreams:
    """Makes the streams that the lines of one keyword give."""

    lines: _LineReader
    keyword: str
    rows: KeywordIndex
    has_log: bool

    def make_stream(
        self, name: str, role: Role, messages: IntArray, decode: _Decoder
    ) -> StampedStream:
        """The stream of ``messages``, places in ``rows``, whose lines ``decode`` reads."""
        offsets = self.rows.byte_offsets[messages]
        received_ns = self.rows.received_ns[messages] if self.has_log else None

        def read_value(message: int) -> SensorValue:
            offset = int(offsets[message])
            logged_ns = None if received_ns is None else int(received_ns[message])
            try:
                return decode(self.lines.read_line_at(offset), logged_ns)
            except BadLine as error:
                raise self.lines.bad_line_error(offset, error) from error

        return StampedStream(
            name=name,
            type=self.keyword,
            role=role,
            stamps_ns=self.rows.stamp_ns[messages],
            received_ns=received_ns,
            read_value=read_value,
        )


def _scan_decoder(frame: str, defaults: LaserDefaults) -> _Decoder:
    def decode(line: CarmenLine, received_ns: int | None) -> LaserScan:
        return laser_scan(line, received_ns, frame, defaults)

    return decode


def _pose_decoder(first: int, parent: str, child: str) -> _Decoder:
    """The pose that begins at ``first`` in the body of a line."""

    def decode(line: CarmenLine, received_ns: int | None) -> PoseSample:
        return PoseSample(
            stamp_ns=line.stamp_ns,
            received_ns=received_ns,
            parent=parent,
            child=child,
            T_parent_child=transform_from_planar(planar_pose(line, first)),
        )

    return decode


def _laser_defaults(index: CarmenIndex, keyword: str, warnings: list[str]) -> LaserDefaults:
    """The laser's values from PARAM; a warning where the angles follow from neither PARAM nor a
    SICK's number of readings."""
    names = {
        "FLASER": ("laser_front_laser_resolution", "robot_front_laser_max", "robot_frontlaser_max"),
        "RLASER": ("laser_rear_laser_resolution", "robot_rear_laser_max"),
    }.get(keyword, ("",))
    found = [index.parameters.get(name) for name in names]
    positive = [value if value is not None and value > 0.0 else None for value in found]
    counts = index.unusual_counts[keyword]
    if positive[0] is None and counts:
        listed = ", ".join(str(count) for count in counts)
        warnings.append(
            f"/{keyword.lower()}: nothing says the angles of scans of {listed} readings; 180 "
            "degrees from first to last are assumed."
        )
    maximum = next((value for value in positive[1:] if value is not None), None)
    return LaserDefaults(resolution_deg=positive[0], range_max_m=maximum)


def _laser_mount(index: CarmenIndex, keyword: str, rows: KeywordIndex) -> FloatArray | None:
    """The laser's pose on the robot (x, y, yaw), None where the log does not give it.

    ROBOTLASER lines have both poses. For FLASER there are PARAM lines; the unit of its angular
    offset differs between loggers, so that only zero is understood.
    """
    if KINDS[keyword.encode()].has_config:
        return rows.laser_on_robot if rows.is_rigid else None
    parameters = index.parameters
    forward_m = parameters.get("robot_frontlaser_offset")
    if keyword != "FLASER" or forward_m is None:
        return None
    if parameters.get("robot_frontlaser_angular_offset", 0.0) != 0.0:
        return None
    return np.array([forward_m, parameters.get("robot_frontlaser_side_offset", 0.0), 0.0])


def _static_transforms(index: CarmenIndex, mounts: dict[str, FloatArray]) -> StampedStream:
    """One message at the first time of the log."""
    stamp_ns = min(int(rows.stamp_ns[0]) for rows in index.by_keyword.values())
    received_ns = min(int(rows.received_ns[0]) for rows in index.by_keyword.values())
    batch = TransformBatch(
        received_ns=received_ns if index.has_log else None,
        transforms=tuple(
            Transform(
                stamp_ns=stamp_ns,
                parent=BASE_FRAME,
                child=frame,
                T_parent_child=transform_from_planar(mount),
            )
            for frame, mount in mounts.items()
        ),
    )
    return StampedStream(
        name="/tf_static",
        type="laser mounts",
        role="tf_static",
        stamps_ns=np.array([stamp_ns]),
        received_ns=np.array([received_ns]) if index.has_log else None,
        read_value=lambda _: batch,
    )
