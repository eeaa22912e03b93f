"""Robot@Home2: the tables of rh.db, and the images below files/rgbd that they name.

The published images are rotated upright, and their depth has 8 bits. The poses of labelled images
are poses in a map; those of the raw data are the mounts. A laser observation's subsession is the
number of its sequence in the first version; whether a sequence belongs to the images of a room is
decided by its times, as there.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import RecordingError
from fusion_core.recordings.robot_at_home.database_file import DatabaseFile
from fusion_core.recordings.robot_at_home.rig import (
    URG_APERTURE_RAD,
    URG_MAX_RANGE_M,
    RawScan,
    checked_beam_count,
    is_camera,
    is_lidar,
)
from fusion_core.recordings.robot_at_home.room import (
    MAX_OBSERVATIONS,
    Room,
    RoomKey,
    SensorTrack,
    SensorTrackBuilder,
    get_track_builder,
    select_lidar_scans,
)

FORMAT: Final = "Robot@Home2 room"
# Of two tables that hold a room the first is read.
_CAMERA_TABLES: Final = ("rh_lblrgbd", "rh_raw")
_LIDAR_TABLES: Final = ("rh_lsrscan", "rh_raw")
_FILES: Final = "rh2_old2new_rgbd_files"
# The raw observations' numbers end below this; their beams are in rh_raw_scans.
_FIRST_PROCESSED_ID: Final = 200_000
_MAX_NAME: Final = 255
_MAX_ROOMS: Final = 100_000
_POSE: Final = ", ".join(f"sensor_pose_{name}" for name in ("x", "y", "z", "yaw", "pitch", "roll"))
_WRONG: Final = (ValueError, TypeError, OverflowError, KeyError)


class Database:
    """The rooms of rh.db, opened read-only; ``close`` frees it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.file = DatabaseFile(path)
        try:
            self._sessions = self._by_id("rh_home_sessions")
            self._rooms = self._by_id("rh_rooms")
            self._sensors = self._by_id("rh_sensors")
            self._scanners = ", ".join(
                str(number) for number, name in self._sensors.items() if is_lidar(name)
            )
            self._cameras = ", ".join(
                str(number) for number, name in self._sensors.items() if is_camera(name)
            )
        except BaseException:
            self.file.close()
            raise

    def close(self) -> None:
        """Refuse further queries."""
        self.file.close()

    def room_keys(self) -> tuple[RoomKey, ...]:
        """Every room, sorted; rooms that only the LiDAR saw have the subsession 1."""
        columns = "DISTINCT home_session_id, room_id, home_subsession_id"
        found: set[tuple[Any, Any, Any]] = set()
        for table in self._present(_CAMERA_TABLES):
            rows = self.file.query_rows(f"SELECT {columns} FROM {table} WHERE {self._is_camera}")
            # Opening a room reports what is lost.
            found |= set(self.file.until_damage(rows, table, []))
        seen = {(session, room) for session, room, _ in found}
        for table in self._present(_LIDAR_TABLES):
            rows = self.file.query_rows(f"SELECT {columns} FROM {table} WHERE {self._is_lidar}")
            found |= {
                (session, room, 0)
                for session, room, _ in self.file.until_damage(rows, table, [])
                if (session, room) not in seen
            }
        return tuple(
            sorted(
                RoomKey(
                    session=self._sessions[session],
                    room=self._room_name(session, room),
                    subsession=subsession + 1,
                )
                for session, room, subsession in found
                if session in self._sessions and room in self._rooms and isinstance(subsession, int)
            )
        )

    def room(self, key: RoomKey) -> Room:
        """The observations of a room that ``room_keys`` names. Raises RecordingError."""
        warnings: list[str] = []
        session = next(number for number, name in self._sessions.items() if name == key.session)
        room = next(n for n in self._rooms if self._room_name(session, n) == key.room)
        cameras: list[SensorTrack] = []
        for table in self._present(_CAMERA_TABLES):
            where = f"{self._is_camera} AND o.home_subsession_id = ?"
            place = (session, room, key.subsession - 1)
            cameras = self._camera_tracks(table, where, place, warnings)
            if cameras:
                break
        sequences: dict[str, SensorTrack] = {}
        for table in self._present(_LIDAR_TABLES):
            sequences = self._lidar_tracks(table, (session, room), warnings)
            if sequences:
                break
        lidar = select_lidar_scans(sequences, cameras, warnings)
        if not cameras and lidar is None:
            raise RecordingError(
                f"holds no observations of {key} that can be read.",
                file=self.path,
                advice="Unpack it again from the archive.",
            )
        files = _DatabaseFiles(self, (session, room))
        if lidar is not None and int(lidar.ids[0]) < _FIRST_PROCESSED_ID:
            warnings.append(
                f"The scans are those of the raw data; where it does not tell the scanner's angles "
                f"they are taken as {URG_APERTURE_RAD} rad and {URG_MAX_RANGE_M} m."
            )
        return Room(
            key=key,
            path=self.path,
            format=FORMAT,
            cameras=tuple(cameras),
            lidar=lidar,
            files=files,
            warnings=tuple(warnings),
        )

    @property
    def _is_camera(self) -> str:
        return f"sensor_id IN ({self._cameras})"

    @property
    def _is_lidar(self) -> str:
        return f"sensor_id IN ({self._scanners})"

    def _present(self, tables: tuple[str, ...]) -> Iterator[str]:
        return (table for table in tables if table in self.file.tables)

    def _by_id(self, table: str) -> dict[int, str]:
        rows = self.file.query_rows(f"SELECT id, name FROM {table} ORDER BY id LIMIT {_MAX_ROOMS}")
        return {
            number: name
            for number, name in rows
            if isinstance(number, int) and isinstance(name, str) and len(name) <= _MAX_NAME
        }

    def _room_name(self, session: int, room: int) -> str:
        """rh_rooms has "alma_bedroom1" where the session is "alma-s1"."""
        home = self._sessions[session].rpartition("-")[0]
        return self._rooms[room].removeprefix(f"{home}_")

    def _camera_tracks(
        self, table: str, where: str, place: tuple[int, ...], warnings: list[str]
    ) -> list[SensorTrack]:
        if _FILES not in self.file.tables:
            warnings.append(f"{self.path.name} has no {_FILES}: the images cannot be found.")
            return []
        rows = self.file.query_rows(
            f"SELECT o.id, o.time_stamp, o.sensor_id, 0, f.id IS NOT NULL, {_POSE} "
            f"FROM {table} o LEFT JOIN {_FILES} f ON f.id = o.id "
            f"WHERE o.home_session_id = ? AND o.room_id = ? AND {where}",
            place,
        )
        return list(self.read_tracks(table, rows, warnings).values())

    def _lidar_tracks(
        self, table: str, place: tuple[int, int], warnings: list[str]
    ) -> dict[str, SensorTrack]:
        """{number from 1: sequence}."""
        rows = self.file.query_rows(
            f"SELECT id, time_stamp, sensor_id, home_subsession_id, 1, {_POSE} FROM {table} "
            f"WHERE home_session_id = ? AND room_id = ? AND {self._is_lidar}",
            place,
        )
        tracks = self.read_tracks(table, rows, warnings).values()
        return {
            str(int(number) + 1): _select_sequence(track, int(number))
            for track in tracks
            for number in np.unique(track.sequences)
        }

    def read_tracks(
        self, table: str, rows: Iterator[tuple[Any, ...]], warnings: list[str]
    ) -> dict[str, SensorTrack]:
        """One track for each sensor, of rows id, ticks, sensor, sequence, has files, pose."""
        builders: dict[str, SensorTrackBuilder] = {}
        unread, without, first, count = 0, 0, "", 0
        for identifier, ticks, sensor, sequence, has_files, *pose in self.file.until_damage(
            rows, table, warnings
        ):
            count += 1
            if count > MAX_OBSERVATIONS:
                warnings.append(f"{table}: only the first {MAX_OBSERVATIONS} rows are read.")
                break
            if not has_files:
                without += 1
                continue
            try:
                builder = get_track_builder(builders, self._sensors[sensor])
                builder.add(identifier, ticks, pose, int(sequence))
            except _WRONG as error:
                unread += 1
                first = first or f"id {identifier!s:.20} ({error})"
        if unread:
            warnings.append(
                f"{table}: {unread} of {count} rows are no observations; the first: {first}."
            )
        if without:
            warnings.append(f"{table}: {without} of {count} rows have no files in {_FILES}.")
        return {
            label: builders[label].track() for label in sorted(builders) if len(builders[label])
        }


class _DatabaseFiles:
    """Single observations of a room, by their numbers."""

    def __init__(self, database: Database, place: tuple[int, int]) -> None:
        self._database = database
        self._place = place

    def depth_file(self, track: SensorTrack, index: int) -> Path:
        return self._file(int(track.ids[index]), "new_file_1")

    def color_file(self, track: SensorTrack, index: int) -> Path:
        return self._file(int(track.ids[index]), "new_file_2")

    def scan(self, track: SensorTrack, index: int) -> RawScan:
        number = int(track.ids[index])
        table = "rh_raw" if number < _FIRST_PROCESSED_ID else "rh_lsrscan"
        aperture_rad, max_range_m, beams = self._one(
            f"SELECT laser_aperture, laser_max_range, laser_num_of_scans FROM {table} WHERE id = ?",
            number,
        )
        if table == "rh_raw":
            aperture_rad, max_range_m = (
                aperture_rad or URG_APERTURE_RAD,
                max_range_m or URG_MAX_RANGE_M,
            )
            (beams,) = self._one(
                "SELECT COUNT(*) FROM rh_raw_scans WHERE sensor_observation_id = ?", number
            )
        count = checked_beam_count(float(beams))
        ranges, valid = np.full(count, np.nan), np.zeros(count, dtype=np.bool_)
        found = 0
        for shot, range_m, flag in self._database.file.query_rows(
            f"SELECT shot_id, scan, valid_scan FROM {table}_scans "
            "WHERE sensor_observation_id = ? ORDER BY shot_id",
            (number,),
        ):
            if found == count or shot != found:
                raise ValueError(f"beam {shot!s:.20} follows {found} of its {count} beams")
            ranges[found], valid[found] = float(range_m), flag == 1
            found += 1
        if found != count:
            raise ValueError(f"{found} of its {count} beams are there")
        return RawScan(
            aperture_rad=float(aperture_rad),
            max_range_m=float(max_range_m),
            ranges_m=ranges,
            valid=valid,
        )

    def scan_name(self, track: SensorTrack, index: int) -> str:
        return f"{self._database.path}: laser observation {track.ids[index]}"

    def raw_poses(self) -> Mapping[str, FloatArray]:
        if "rh_raw" not in self._database.file.tables:
            return {}
        rows = self._database.file.query_rows(
            f"SELECT id, time_stamp, sensor_id, 0, 1, {_POSE} FROM rh_raw "
            "WHERE home_session_id = ? AND room_id = ?",
            self._place,
        )
        tracks = self._database.read_tracks("rh_raw", rows, [])
        return {label: track.poses for label, track in tracks.items()}

    def close(self) -> None:
        self._database.close()

    def _file(self, number: int, column: str) -> Path:
        folder, name = self._one(f"SELECT new_path, {column} FROM {_FILES} WHERE id = ?", number)
        return _resolve_image_path(self._database.path, folder, name)

    def _one(self, query: str, number: int) -> tuple[Any, ...]:
        row = next(self._database.file.query_rows(query, (number,)), None)
        if row is None:
            raise RecordingError(
                f"has lost observation {number}.",
                file=self._database.path,
                advice="Unpack it again from the archive.",
            )
        return row


def _resolve_image_path(database: Path, folder: object, name: object) -> Path:
    """The path of the image that a row names. Raises RecordingError if not below files/rgbd."""
    if isinstance(folder, str) and isinstance(name, str) and folder and name:
        inner = PurePosixPath(folder, name)
        plain = not inner.is_absolute() and ".." not in inner.parts
        if plain and not set(f"{folder}{name}") & {"\\", "\0", ":"}:
            return database.parent / "files" / "rgbd" / inner
    raise RecordingError(
        f"names {folder!s:.80} {name!s:.80}, which is no path below files/rgbd.",
        file=database,
        advice="Unpack it again from the archive.",
    )


def _select_sequence(track: SensorTrack, sequence: int) -> SensorTrack:
    kept = track.sequences == sequence
    return SensorTrack(
        label=track.label,
        ids=track.ids[kept],
        stamp_ns=track.stamp_ns[kept],
        poses=track.poses[kept],
        sequences=track.sequences[kept],
    )
