"""Writes Robot@Home in both versions, as the data set's own exporters did.

Version 1 after CSaveAsPlainText of the Object Labeling Toolkit; version 2 after the sqlizer and
the cruncher of the Robot@Home2 toolbox. Numbers of text files have the six digits of C++ streams.
"""

import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

UNITS_PER_METRE = 65535.0 / 10.0
APERTURE_RAD, MAX_RANGE_M = 4.1847, 5.6
LABELS = ("HOKUYO1", "RGBD_1", "RGBD_2", "RGBD_3", "RGBD_4")
# The published rig: x y z yaw pitch roll on the robot.
MOUNTS = {
    "HOKUYO1": (0.205, 0.0, 0.31, 0.0, 0.0, 0.0),
    "RGBD_1": (0.271, -0.031, 1.045, -0.785398, 0.0, -1.5708),
    "RGBD_2": (0.24, -0.045, 1.045, -1.5708, 0.0, -1.5708),
    "RGBD_3": (0.271, 0.031, 1.045, 0.785398, 0.0349066, -1.5708),
    "RGBD_4": (0.285, 0.0, 1.045, 0.0, 0.0226893, -1.5708),
}


@dataclass(frozen=True)
class Sight:
    """An observation of a camera, landscape as the sensor stores it: ``depth_m`` (H, W) with NaN,
    ``rgb`` (H, W, 3)."""

    label: str
    stamp_ns: int
    depth_m: np.ndarray
    rgb: np.ndarray
    pose: tuple[float, ...]


@dataclass(frozen=True)
class Sweep:
    """An observation of the LiDAR: ``ranges_m`` (N,) with NaN."""

    stamp_ns: int
    ranges_m: np.ndarray
    pose: tuple[float, ...] = MOUNTS["HOKUYO1"]


@dataclass(frozen=True)
class RoomSource:
    """One visit to a room. ``sweeps``: by the number k of the laser sequence.

    ``mounts``: what the raw data holds, where the poses of ``sights`` are poses in a map.
    """

    session: str
    room: str
    sights: Sequence[Sight]
    sweeps: dict[int, Sequence[Sweep]]
    subsession: int = 1
    mounts: dict[str, tuple[float, ...]] = field(default_factory=dict)


def ticks(stamp_ns: int) -> int:
    """100 ns since 1601."""
    return stamp_ns // 100 + 11_644_473_600 * 10_000_000


def stored_depth(depth_m: np.ndarray) -> np.ndarray:
    """uint16 as the exporter casts it; 0 where there is nothing."""
    return np.nan_to_num(depth_m.astype(np.float64) * UNITS_PER_METRE).astype(np.uint16)


def write_plain_text(root: Path, rooms: Iterable[RoomSource]) -> Path:
    """Version 1 below ``root``."""
    for source in rooms:
        rgbd = _unit(root, "rgbd_data", source.session)
        suffix = f"_{source.subsession}" if source.subsession > 1 else ""
        if source.sights:
            _write_sights(rgbd, f"{source.room}{suffix}_rgbd", source.sights)
        for number, sweeps in source.sweeps.items():
            laser = _unit(root, "laser_scans", source.session) / source.room
            _write_sweeps(laser, f"{number}_hokuyo_processed", sweeps)
        if source.mounts:
            lines = [
                _line(i, label, pose, 10**9 * i)
                for i, (label, pose) in enumerate(source.mounts.items())
            ]
            raw = _unit(root, "raw_data", source.session)
            (raw / f"{source.room}{suffix}").mkdir()
            _write_sequence(raw, f"{source.room}{suffix}", lines)
    return root


def _unit(root: Path, unit: str, session: str) -> Path:
    name = f"Robot@Home-dataset_{unit}-plain_text"
    folder = root / f"{name}-all" / f"{name}-{session}" / session
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _write_sequence(folder: Path, name: str, lines: Sequence[str]) -> None:
    head = [
        "# This file contains information about the (sequence of) observations in the directory "
        "with the same name. ",
        "# Its format is: ",
        "# [Observation_id] [sensor_label] [sensor_pose_x] [sensor_pose_y] [sensor_pose_z] "
        "[sensor_pose_yaw] [sensor_pose_pitch] [sensor_pose_roll] [time-stamp] ",
        "# Units for the sensor pose are meters and radians. The tiem-stamp holds the the number "
        "of 100-nanosecond intervals since January 1, 1601 (UTC). ",
    ]
    (folder / f"{name}.txt").write_text("\n".join([*head, *lines]) + "\n")


def _line(number: int, label: str, pose: Sequence[float], stamp_ns: int) -> str:
    numbers = " ".join(f"{value:.6g}" for value in pose)
    return f"{number} {label} {numbers} {ticks(stamp_ns)}"


def _write_sights(folder: Path, name: str, sights: Sequence[Sight]) -> None:
    (folder / name).mkdir()
    for number, sight in enumerate(sights):
        _write_png(folder / name / f"{number}_depth.png", stored_depth(sight.depth_m))
        _write_png(folder / name / f"{number}_intensity.png", sight.rgb[:, :, ::-1])
    lines = [_line(i, s.label, s.pose, s.stamp_ns) for i, s in enumerate(sights)]
    _write_sequence(folder, name, lines)


def _write_sweeps(folder: Path, name: str, sweeps: Sequence[Sweep]) -> None:
    (folder / name).mkdir(parents=True)
    for number, sweep in enumerate(sweeps):
        valid = np.isfinite(sweep.ranges_m)
        text = [
            "# This file contains a 2D laser scan observation. ",
            "# Its format is: ",
            "# [aperture] [max_range] [number_of_scans] ",
            "# [vector_of_scans] ",
            "# [vector_of_valid_scans] ",
            "# The aperture of the sensor is in radians, the maximum range ",
            "# and measurements are in meters. '1' means a valid scan, '0' otherwise.",
            f"{APERTURE_RAD:.6g}",
            f"{MAX_RANGE_M:.6g}",
            f"{sweep.ranges_m.size}",
            # The driver may write any number for an invalid beam.
            "".join(f"{r:.6g} " for r in np.where(valid, sweep.ranges_m, 1.25)),
            "".join(f"{int(flag)} " for flag in valid),
        ]
        (folder / name / f"{number}_scan.txt").write_text("\n".join(text) + "\n")
    lines = [_line(i, "HOKUYO1", s.pose, s.stamp_ns) for i, s in enumerate(sweeps)]
    _write_sequence(folder, name, lines)


def _write_png(file: Path, pixels: np.ndarray) -> None:
    assert cv2.imwrite(str(file), np.ascontiguousarray(pixels), [cv2.IMWRITE_PNG_COMPRESSION, 1])


_OBSERVATION = (
    "(id INTEGER PRIMARY KEY, room_id INTEGER, home_session_id INTEGER, home_subsession_id INTEGER,"
    " home_id INTEGER, name TEXT, sensor_id INTEGER, sensor_pose_x REAL, sensor_pose_y REAL,"
    " sensor_pose_z REAL, sensor_pose_yaw REAL, sensor_pose_pitch REAL, sensor_pose_roll REAL,"
    " laser_aperture REAL, laser_max_range REAL, laser_num_of_scans INTEGER, time_stamp INTEGER,"
    " sensor_type INTEGER, sensor_file_1 TEXT, sensor_file_2 TEXT, sensor_file_3 TEXT,"
    " files_path TEXT)"
)
_SCANS = (
    "(id INTEGER PRIMARY KEY, shot_id INTEGER, scan REAL, valid_scan INTEGER,"
    " sensor_observation_id INTEGER)"
)
_SCHEMA = f"""
CREATE TABLE rh_homes(id INTEGER PRIMARY KEY, name TEXT);
CREATE TABLE rh_home_sessions(id INTEGER PRIMARY KEY, home_id INTEGER, name TEXT);
CREATE TABLE rh_rooms(id INTEGER PRIMARY KEY, home_id INTEGER, name TEXT, room_type_id INTEGER);
CREATE TABLE rh_sensors(id INTEGER PRIMARY KEY, sensor_type_id INTEGER, name TEXT);
CREATE TABLE rh_sensor_types(id INTEGER PRIMARY KEY, name TEXT);
INSERT INTO rh_sensor_types VALUES (0, 'LASER SCANNER'), (1, 'RGBD CAMERA');
CREATE TABLE rh_raw{_OBSERVATION};
CREATE TABLE rh_lblrgbd{_OBSERVATION};
CREATE TABLE rh_lsrscan{_OBSERVATION};
CREATE TABLE rh_raw_scans{_SCANS};
CREATE TABLE rh_lsrscan_scans{_SCANS};
CREATE INDEX idx_raw_scans ON rh_raw_scans(sensor_observation_id);
CREATE INDEX idx_lsrscan_scans ON rh_lsrscan_scans(sensor_observation_id);
CREATE TABLE rh2_old2new_rgbd_files(id INT NOT NULL UNIQUE, old_path TEXT, old_file_1 TEXT,
  old_file_2 TEXT, old_file_3 TEXT, new_path TEXT, new_file_1 TEXT, new_file_2 TEXT,
  new_file_3 TEXT, PRIMARY KEY(id));
"""


def write_robot_at_home2(root: Path, rooms: Iterable[RoomSource], *, bits: int = 8) -> Path:
    """Version 2 below ``root``: rh.db and files/. ``bits``: 8 as published, or all 16."""
    root.mkdir(parents=True, exist_ok=True)
    connection = sqlite3.connect(root / "rh.db")
    connection.executescript(_SCHEMA)
    connection.executemany(
        "INSERT INTO rh_sensors VALUES (?, ?, ?)",
        [(i, int(i > 0), label) for i, label in enumerate(LABELS)],
    )
    writer = _Tables(root, connection, bits)
    for source in rooms:
        writer.write(source)
    connection.commit()
    connection.close()
    return root


class _Tables:
    def __init__(self, root: Path, connection: sqlite3.Connection, bits: int) -> None:
        self._root, self._connection, self._bits = root, connection, bits
        self._numbers = {"rh_raw": 0, "rh_lblrgbd": 100_000, "rh_lsrscan": 200_000}

    def write(self, source: RoomSource) -> None:
        home = source.session.split("-s")[0]
        home_id = self._id("rh_homes", home)
        session_id = self._id("rh_home_sessions", source.session, home_id)
        room_id = self._id("rh_rooms", f"{home}_{source.room}", home_id, last=(0,))
        place = (room_id, session_id)
        subsession = source.subsession - 1
        for sight in source.sights:
            number = self._observe("rh_lblrgbd", place, subsession, home_id, sight.label, sight)
            path = f"session_{session_id + 1}/{home}/{source.room}/subsession_{subsession + 1}"
            names = (f"{number}_depth.png", f"{number}_intensity.png", f"{number}_labels.txt")
            self._insert("rh2_old2new_rgbd_files", (number, "", "", "", "", path, *names))
            self._write_images(self._root / "files/rgbd" / path, names, sight)
        for k, sweeps in source.sweeps.items():
            for sweep in sweeps:
                # The toolbox counts laser sequences where images have their subsession.
                self._sweep("rh_lsrscan", place, k - 1, home_id, sweep)
        for i, (label, pose) in enumerate(source.mounts.items()):
            size = np.zeros((1, 1))
            mount = Sight(label, 10**9 * i, size, size, pose)
            self._observe("rh_raw", place, subsession, home_id, label, mount)

    def _sweep(
        self, table: str, place: tuple[int, int], sequence: int, home_id: int, sweep: Sweep
    ) -> None:
        number = self._observe(table, place, sequence, home_id, "HOKUYO1", sweep)
        valid = np.isfinite(sweep.ranges_m)
        self._connection.executemany(
            f"INSERT INTO {table}_scans (shot_id, scan, valid_scan, sensor_observation_id) "
            "VALUES (?, ?, ?, ?)",
            # Tables have no order: the last beam comes first.
            [
                (i, float(f"{r:.6g}") if flag else 1.25, int(flag), number)
                for i, (r, flag) in reversed(
                    list(enumerate(zip(sweep.ranges_m, valid, strict=True)))
                )
            ],
        )

    def _observe(
        self,
        table: str,
        place: tuple[int, int],
        subsession: int,
        home_id: int,
        label: str,
        seen: Sight | Sweep,
    ) -> int:
        number = self._numbers[table]
        self._numbers[table] += 1
        is_scan = isinstance(seen, Sweep)
        laser = (APERTURE_RAD, MAX_RANGE_M, seen.ranges_m.size) if is_scan else (0, 0, 0)
        pose = [float(f"{value:.6g}") for value in seen.pose]
        row = (number, *place, subsession, home_id, label, LABELS.index(label), *pose, *laser)
        self._insert(table, (*row, ticks(seen.stamp_ns), int(not is_scan), "", "", "", ""))
        return number

    def _write_images(self, folder: Path, names: Sequence[str], sight: Sight) -> None:
        """The cruncher reads as 8-bit colour, which drops the lower byte, and rotates upright."""
        folder.mkdir(parents=True, exist_ok=True)
        depth = stored_depth(sight.depth_m)
        if self._bits == 8:
            depth = np.repeat((depth >> 8).astype(np.uint8)[:, :, np.newaxis], 3, axis=2)
        for name, pixels in ((names[0], depth), (names[1], sight.rgb[:, :, ::-1])):
            stored = np.ascontiguousarray(pixels)
            _write_png(folder / name, cv2.rotate(stored, cv2.ROTATE_90_COUNTERCLOCKWISE))

    def _id(self, table: str, name: str, *before: int, last: tuple[int, ...] = ()) -> int:
        found = self._connection.execute(f"SELECT id FROM {table} WHERE name = ?", (name,))
        row = found.fetchone()
        if row is not None:
            return int(row[0])
        (count,) = self._connection.execute(f"SELECT COUNT(*) FROM {table}").fetchone()
        self._insert(table, (count, *before, name, *last))
        return int(count)

    def _insert(self, table: str, row: Sequence[object]) -> None:
        places = ", ".join("?" * len(row))
        self._connection.execute(f"INSERT INTO {table} VALUES ({places})", tuple(row))


def pose_columns(T_base_sensor: np.ndarray) -> tuple[float, ...]:
    """x y z yaw pitch roll of a body frame, for pitches away from straight up and down."""
    r = T_base_sensor[:3, :3]
    yaw, roll = np.arctan2(r[1, 0], r[0, 0]), np.arctan2(r[2, 1], r[2, 2])
    pitch = np.arcsin(-r[2, 0])
    return (*map(float, T_base_sensor[:3, 3]), float(yaw), float(pitch), float(roll))


def room_of(
    recording: Any,
    cameras: dict[str, tuple[str, str]],
    lidar: str,
    poses: dict[str, tuple[float, ...]],
    *,
    session: str = "alma-s1",
    room: str = "bedroom1",
) -> RoomSource:
    """A recording as a room. ``cameras``: depth and colour topic by label; ``poses`` by label."""
    sights = []
    for label, (depth, color) in cameras.items():
        for a, b in zip(recording.messages([depth]), recording.messages([color]), strict=True):
            sights.append(
                Sight(label, a.stamp_ns, a.value.depth_m, b.value.rgb, poses[label]),
            )
    sights.sort(key=lambda sight: sight.stamp_ns)
    sweeps = [
        Sweep(m.stamp_ns, m.value.ranges_m, poses["HOKUYO1"]) for m in recording.messages([lidar])
    ]
    return RoomSource(session, room, sights, {2: sweeps})


T0 = 1_441_000_000_000_000_000
MS = 1_000_000


def small_room(
    *,
    session: str = "alma-s1",
    room: str = "bedroom1",
    subsession: int = 1,
    labels: Sequence[str] = ("RGBD_1", "RGBD_4"),
    start_ns: int = T0,
    shape: tuple[int, int] = (240, 320),
    seed: int = 0,
) -> RoomSource:
    """Three images of each camera and five scans within them, all values different."""
    rng = np.random.default_rng(seed)
    rows, columns = np.indices(shape)
    sights = []
    for i in range(3):
        for k, label in enumerate(labels):
            depth_m = 0.8 + 0.01 * columns + 0.02 * rows + 0.1 * i + 0.3 * k
            depth_m[rng.random(shape) < 0.1] = np.nan
            # An image of blocks, since PNG hardly compresses noise.
            rgb = np.kron(
                rng.integers(0, 256, (shape[0] // 8, shape[1] // 8, 3), dtype=np.uint8),
                np.ones((8, 8, 1), dtype=np.uint8),
            )
            stamp_ns = start_ns + i * 90 * MS + k * 7 * MS
            sights.append(Sight(label, stamp_ns, depth_m, rgb, MOUNTS[label]))
    sweeps = []
    for i in range(5):
        ranges_m = np.round(rng.uniform(0.2, 5.5, 682), 3)
        ranges_m[rng.random(682) < 0.1] = np.nan
        sweeps.append(Sweep(start_ns + 3 * MS + i * 40 * MS, ranges_m))
    return RoomSource(session, room, sights, {2: sweeps}, subsession=subsession)
