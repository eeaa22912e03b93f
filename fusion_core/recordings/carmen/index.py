"""Index of a CARMEN log in one pass: position and both times of each message; parameters."""

import re
from array import array
from collections import Counter
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

from fusion_core.model.conventions import NS_PER_S, FloatArray, IntArray, wrap_angle
from fusion_core.model.planar_poses import relative_pose
from fusion_core.recordings.carmen.lines import (
    KINDS,
    SICK_RESOLUTIONS_DEG,
    BadLine,
    CarmenLine,
    parse_line,
    planar_pose,
)

MAX_LINE_BYTES = 1 << 20
# Below any time: a log may begin before its zero.
_NO_STAMP = -(1 << 63)
# Keywords of messages that are not read. A log with more kinds than this is damaged.
_KEYWORD = re.compile(rb"[A-Z][A-Z0-9_-]{1,31}")
_MAX_OTHER_KINDS = 20
# Counts of readings for which the angles are a guess: the first few are named.
_MAX_UNUSUAL_COUNTS = 5
# x, y (m) and yaw (rad) of a fixed laser may differ by this much, from the log's rounding.
_RIGID_TOLERANCE = np.array([0.01, 0.01, 0.01])

PARAMETERS = (
    b"laser_front_laser_resolution",
    b"laser_rear_laser_resolution",
    b"robot_front_laser_max",
    b"robot_frontlaser_max",
    b"robot_rear_laser_max",
    b"robot_frontlaser_offset",
    b"robot_frontlaser_side_offset",
    b"robot_frontlaser_angular_offset",
)


@dataclass(slots=True)
class KeywordIndex:
    """The messages of one keyword, in the order of their log time once the index is complete.

    ``byte_offsets``: (N,) where each line begins. ``stamp_ns``, ``received_ns``: (N,); without a
    logger's clock the two are equal. ``with_poses``: (K,) indices of the messages that hold a laser
    pose and a robot pose. ``laser_on_robot``: the first laser pose (x, y, yaw) in the robot's
    frame, or None; ``is_rigid``: whether all others equal it.
    """

    byte_offsets: IntArray
    stamp_ns: IntArray
    received_ns: IntArray
    with_poses: IntArray
    laser_on_robot: FloatArray | None
    is_rigid: bool


@dataclass(frozen=True, slots=True)
class CarmenIndex:
    """The index of a whole log.

    ``parameters``: values of those PARAMETERS that it sets. ``unusual_counts``: by keyword the
    numbers of readings that no SICK has, of lasers whose lines give no angles. ``has_log``: whether
    any line has a logger's timestamp.
    """

    by_keyword: dict[str, KeywordIndex]
    parameters: dict[str, float]
    unusual_counts: dict[str, list[int]]
    has_log: bool
    end_ns: int
    warnings: list[str]


def index_lines(file: BinaryIO) -> CarmenIndex:
    """Read a log from its beginning, a line at a time. Unreadable lines give a warning."""
    indexer = _Indexer()
    place = 0
    while line := file.readline(MAX_LINE_BYTES + 1):
        size = len(line)
        if size > MAX_LINE_BYTES:
            size += _skip_rest_of_line(line, file)
            line = b""
        indexer.add(line, place, size)
        place += size
    return indexer.finish()


def _skip_rest_of_line(line: bytes, file: BinaryIO) -> int:
    """How many bytes follow until the line's end."""
    size = 0
    while line and not line.endswith(b"\n"):
        line = file.readline(MAX_LINE_BYTES + 1)
        size += len(line)
    return size


@dataclass(slots=True)
class _KeywordColumns:
    byte_offsets: "array[int]" = field(default_factory=lambda: array("q"))
    stamps: "array[int]" = field(default_factory=lambda: array("q"))
    received: "array[int]" = field(default_factory=lambda: array("q"))
    has_poses: "array[int]" = field(default_factory=lambda: array("b"))
    laser_on_robot: FloatArray | None = None
    is_rigid: bool = True
    unusual_counts: list[int] = field(default_factory=list)


@dataclass(slots=True)
class _DamagedLines:
    """Lines that are left out: how many, and between which times of the log."""

    lines: int = 0
    bytes: int = 0
    first_problem: str = ""
    after_ns: int | None = None
    before_ns: int | None = None
    is_last: bool = False

    def add(self, number: int, size: int, problem: str, now_ns: int | None) -> None:
        if self.lines == 0:
            self.first_problem = f"line {number} {problem}"
            self.after_ns = now_ns
        self.lines += 1
        self.bytes += size
        self.is_last = True

    def note_readable(self, now_ns: int) -> None:
        if self.is_last:
            self.before_ns = now_ns
            self.is_last = False

    def warning(self) -> str:
        start = "the start" if self.after_ns is None else format_seconds(self.after_ns)
        end = (
            "the end" if self.is_last or self.before_ns is None else format_seconds(self.before_ns)
        )
        return (
            f"Damaged lines left out: {self.lines} ({self.bytes} bytes), from {start} to {end} of "
            f"the log; the first: {self.first_problem}."
        )


@dataclass(slots=True)
class _BackwardSteps:
    count: int = 0
    first_line: int = 0
    largest_ns: int = 0


class _Indexer:
    def __init__(self) -> None:
        self._rows: dict[bytes, _KeywordColumns] = {}
        self._parameters: dict[str, float] = {}
        self._others: Counter[str] = Counter()
        self._damaged = _DamagedLines()
        self._backward_steps = _BackwardSteps()
        self._warnings: list[str] = []
        self._number = 0
        self._now_ns: int | None = None
        self._has_log = False

    def add(self, line: bytes, place: int, size: int) -> None:
        """The next line; empty if it was too long."""
        self._number += 1
        try:
            self._add(line, place)
        except BadLine as error:
            self._damaged.add(self._number, size, str(error), self._now_ns)

    def finish(self) -> CarmenIndex:
        unlogged = sum(rows.received.count(_NO_STAMP) for rows in self._rows.values())
        shift_ns = self._shift_ns() if self._has_log else 0
        rows = {
            keyword.decode(): _sort_by_log_time(columns, shift_ns)
            for keyword, columns in sorted(self._rows.items())
        }
        self._warn(unlogged, shift_ns)
        return CarmenIndex(
            by_keyword=rows,
            parameters=self._parameters,
            unusual_counts={
                keyword.decode(): columns.unusual_counts for keyword, columns in self._rows.items()
            },
            has_log=self._has_log,
            end_ns=max((int(r.received_ns[-1]) for r in rows.values()), default=0),
            warnings=self._warnings,
        )

    def _add(self, line: bytes, place: int) -> None:
        if not line:
            raise BadLine(f"is longer than {MAX_LINE_BYTES} bytes")
        keyword = line.split(None, 1)[0] if not line.isspace() else b"#"
        if keyword in KINDS:
            self._add_message(keyword, parse_line(line), place, line.endswith(b"\n"))
        elif keyword == b"PARAM":
            self._add_parameter(line)
        elif not keyword.startswith(b"#") and keyword != b"SYNC":
            self._add_other(keyword)

    def _add_message(self, keyword: bytes, line: CarmenLine, place: int, ended: bool) -> None:
        now_ns = line.stamp_ns if line.received_ns is None else line.received_ns
        # The text of a cut number is a smaller number, or leaves the line without its last field.
        if not ended and (
            (self._has_log and line.received_ns is None)
            or (self._now_ns is not None and now_ns < self._now_ns)
        ):
            raise BadLine("breaks off at the end of the file")
        rows = self._rows.get(keyword) or _KeywordColumns()
        has_poses = line.readings != [] and len(line.body) >= 6
        if has_poses:
            _compare_mount(rows, laser=planar_pose(line), robot=planar_pose(line, 3))
        elif KINDS[keyword].body_fields and not KINDS[keyword].has_readings:
            planar_pose(line)
        if KINDS[keyword].has_readings and not line.config:
            _note_unusual_count(rows, len(line.readings))
        self._rows[keyword] = rows
        rows.byte_offsets.append(place)
        rows.stamps.append(line.stamp_ns)
        rows.received.append(_NO_STAMP if line.received_ns is None else line.received_ns)
        rows.has_poses.append(has_poses)
        self._damaged.note_readable(now_ns)
        self._has_log = self._has_log or line.received_ns is not None
        self._note_log_time(now_ns)

    def _note_log_time(self, now_ns: int) -> None:
        """Count steps back. One line's jump ahead is one step back, not one for each after it."""
        if self._now_ns is not None and now_ns < self._now_ns:
            steps = self._backward_steps
            steps.first_line = steps.first_line or self._number
            steps.count += 1
            steps.largest_ns = max(steps.largest_ns, self._now_ns - now_ns)
        self._now_ns = now_ns

    def _add_parameter(self, line: bytes) -> None:
        fields = line.split(None, 3)
        if len(fields) < 3 or fields[1] not in PARAMETERS:
            return
        name = fields[1].decode()
        try:
            value = float(fields[2])
        except ValueError:
            value = float("nan")
        if not np.isfinite(value):
            raise BadLine(f"gives no number for {name}")
        self._parameters[name] = value

    def _add_other(self, keyword: bytes) -> None:
        if _KEYWORD.fullmatch(keyword) is None:
            raise BadLine("begins with no message of CARMEN")
        name = keyword.decode()
        if name not in self._others and len(self._others) >= _MAX_OTHER_KINDS:
            raise BadLine(f"is one more kind of message, {name}, that is not read")
        self._others[name] += 1

    def _shift_ns(self) -> int:
        """From the ipc clock to the logger's: the median over the lines that have both."""
        parts = []
        for rows in self._rows.values():
            received = np.array(rows.received, dtype=np.int64)
            differences = received - np.array(rows.stamps, dtype=np.int64)
            parts.append(differences[received != _NO_STAMP])
        return int(np.median(np.concatenate(parts)))

    def _warn(self, unlogged: int, shift_ns: int) -> None:
        if self._damaged.lines:
            self._warnings.append(self._damaged.warning())
        if self._others:
            listed = ", ".join(f"{name} ({count})" for name, count in sorted(self._others.items()))
            self._warnings.append(f"Messages of these kinds are left out: {listed}.")
        if unlogged and not self._has_log:
            self._warnings.append("There are no logger timestamps: the ipc timestamps order it.")
        elif unlogged:
            self._warnings.append(
                f"Lines without a logger timestamp: {unlogged}; theirs is the ipc timestamp moved "
                f"by {format_seconds(shift_ns)}, the median difference of the two clocks."
            )
        steps = self._backward_steps
        if steps.count:
            self._warnings.append(
                f"Steps back in log time: {steps.count}, first at line {steps.first_line}, by "
                f"{format_seconds(steps.largest_ns)} at most; messages are in the order of their "
                "log time, not of their lines."
            )


def format_seconds(time_ns: int) -> str:
    """A time as the log writes it."""
    return f"{time_ns / NS_PER_S:.6f} s"


def _compare_mount(rows: _KeywordColumns, laser: FloatArray, robot: FloatArray) -> None:
    """Compare the laser's pose on the robot with the first one."""
    on_robot = relative_pose(robot, laser)
    if rows.laser_on_robot is None:
        rows.laser_on_robot = on_robot
    elif rows.is_rigid:
        rows.is_rigid = is_same_pose(on_robot, rows.laser_on_robot)


def is_same_pose(a: FloatArray, b: FloatArray) -> bool:
    """Whether two poses (x, y, yaw) are one but for rounding: 1 cm, 0.01 rad."""
    difference = a - b
    difference[2] = wrap_angle(difference[2])
    return bool((np.abs(difference) <= _RIGID_TOLERANCE).all())


def _note_unusual_count(rows: _KeywordColumns, count: int) -> None:
    known = count in SICK_RESOLUTIONS_DEG or count in rows.unusual_counts
    if not known and len(rows.unusual_counts) < _MAX_UNUSUAL_COUNTS:
        rows.unusual_counts.append(count)


def _sort_by_log_time(columns: _KeywordColumns, shift_ns: int) -> KeywordIndex:
    stamp_ns = np.array(columns.stamps, dtype=np.int64)
    received_ns = np.array(columns.received, dtype=np.int64)
    received_ns = np.where(received_ns == _NO_STAMP, stamp_ns + shift_ns, received_ns)
    order = np.argsort(received_ns, kind="stable")
    return KeywordIndex(
        byte_offsets=np.array(columns.byte_offsets, dtype=np.int64)[order],
        stamp_ns=stamp_ns[order],
        received_ns=received_ns[order],
        with_poses=np.flatnonzero(np.array(columns.has_poses, dtype=np.bool_)[order]),
        laser_on_robot=columns.laser_on_robot,
        is_rigid=columns.is_rigid,
    )
