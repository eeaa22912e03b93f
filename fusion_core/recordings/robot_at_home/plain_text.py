"""Robot@Home (2017) as plain text: the folders of units, sessions and rooms.

    Robot@Home-dataset_<unit>-all/Robot@Home-dataset_<unit>-<session>/<session>/
        <room>[_<subsession>]_rgbd.txt   and _rgbd/<id>_depth.png, <id>_intensity.png
        <room>/<k>_hokuyo_processed.txt  and _hokuyo_processed/<id>_scan.txt

The unit of raw data has <room>[_<subsession>].txt with all sensors in one sequence. A session's
folder may also be opened alone.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.robot_at_home.rig import is_camera, is_lidar
from fusion_core.recordings.robot_at_home.room import (
    Room,
    RoomKey,
    SensorTrack,
    select_lidar_scans,
)
from fusion_core.recordings.robot_at_home.text_files import TextFiles, is_sequence_file, read_tracks

FORMAT: Final = "Robot@Home room"
# Of two units with the same room the earlier one is read.
_UNITS: Final = (
    "Robot@Home-dataset_rgbd_data-plain_text-all",
    "Robot@Home-dataset_labelled-rgbd-data_plain-text_all",
    "Robot@Home-dataset_laser_scans-plain_text-all",
    "Robot@Home-dataset_raw_data-plain_text-all",
)
_RAW_UNIT: Final = _UNITS[3]
_SESSION = re.compile(r"(?:^|[-_])([A-Za-z0-9]+-s\d{1,3})$")
_ROOM_SEQUENCE = re.compile(r"([A-Za-z]+\d*)((?:_[A-Za-z0-9]+)*)$")
_LIDAR_SEQUENCE = re.compile(r"(\d{1,6})_hokuyo(?:_[A-Za-z0-9]+)*$")


@dataclass(frozen=True, slots=True)
class _Session:
    """The folders of one session, at most one for each unit, in the order of _UNITS."""

    name: str
    folders: tuple[Path, ...]


class PlainTextTree:
    """The rooms that a path names: those of a root, of one session, or a single one."""

    def __init__(
        self,
        sessions: tuple[_Session, ...],
        session: str | None = None,
        room: str | None = None,
        subsession: int | None = None,
    ) -> None:
        self._sessions = {session.name: session for session in sessions}
        self._named = (session, room, subsession)

    def room_keys(self) -> tuple[RoomKey, ...]:
        """Every room, sorted; rooms that only the LiDAR saw have the subsession 1."""
        return tuple(
            key
            for key in sorted(self._all_keys())
            if all(
                named is None or named == own
                for named, own in zip(
                    self._named, (key.session, key.room, key.subsession), strict=True
                )
            )
        )

    def _all_keys(self) -> set[RoomKey]:
        found = set()
        for session in self._sessions.values():
            rooms = set()
            for folder in session.folders:
                for room, subsession, _ in _room_sequences(folder):
                    rooms.add(room)
                    found.add(RoomKey(session=session.name, room=room, subsession=subsession))
            for folder in session.folders:
                for room, _ in _lidar_rooms(folder):
                    if room not in rooms:
                        found.add(RoomKey(session=session.name, room=room, subsession=1))
        return found

    def close(self) -> None:
        """Nothing is held open."""

    def room(self, key: RoomKey) -> Room:
        """The observations of a room that ``room_keys`` names. Raises RecordingError."""
        session = self._sessions[key.session]
        warnings: list[str] = []
        folders: list[Path] = []
        own = _sequence_of(session, key)
        cameras: list[SensorTrack] = []
        lidars: dict[str, SensorTrack] = {}
        if own is not None:
            tracks = read_tracks(own, _add(folders, own), warnings)
            cameras = [track for track in tracks if is_camera(track.label)]
            scans = [track for track in tracks if is_lidar(track.label)]
            lidars = {own.stem: scans[0]} if scans else {}
        sequences = _lidar_sequences(session, key.room)
        if sequences:
            lidars = {}
            for name, file in sequences:
                for track in read_tracks(file, _add(folders, file), warnings):
                    if is_lidar(track.label):
                        lidars[name] = track
        lidar = select_lidar_scans(lidars, cameras, warnings)
        path = own if own is not None else sequences[0][1].parent
        if not cameras and lidar is None:
            raise RecordingError(
                f"holds no observations of {key}.",
                file=path,
                advice="Unpack it again from the archive.",
            )
        return Room(
            key=key,
            path=path,
            format=FORMAT,
            cameras=tuple(cameras),
            lidar=lidar,
            files=TextFiles(tuple(folders), _raw_sequence(session, key, own)),
            warnings=tuple(warnings),
        )


def find_plain_text(path: Path) -> PlainTextTree | None:
    """What a path is of this data set: the root, a unit, a session, or a room's own files.

    None for anything else. Raises OSError where a folder cannot be listed.
    """
    path = path.absolute()
    if path.is_file():
        return _tree_of_sequence(path) if path.suffix == ".txt" else None
    if not path.is_dir():
        return None
    if any((path / unit).is_dir() for unit in _UNITS):
        return PlainTextTree(_sessions_below(path))
    if path.name in _UNITS:
        return PlainTextTree(_sessions_below(path.parent))
    for folder in (path, *_inner_session(path)):
        if next(_sequence_files(folder), None) is not None:
            return PlainTextTree(_sessions_around(folder), folder.name)
    # The root of a disk has no name.
    sequence = path.parent / f"{path.name}.txt"
    if is_sequence_file(sequence):
        return _tree_of_sequence(sequence)
    match = _ROOM_SEQUENCE.match(path.name)
    if match is not None and next(_lidar_files(path), None) is not None:
        return PlainTextTree(_sessions_around(path.parent), path.parent.name, match[1])
    return None


def _tree_of_sequence(file: Path) -> PlainTextTree | None:
    if not is_sequence_file(file):
        return None
    if _LIDAR_SEQUENCE.match(file.stem):
        return find_plain_text(file.parent)
    match = _ROOM_SEQUENCE.match(file.stem)
    if match is None:
        return None
    session = file.parent
    return PlainTextTree(_sessions_around(session), session.name, match[1], _subsession(match[2]))


def _sessions_below(root: Path) -> tuple[_Session, ...]:
    folders: dict[str, list[Path]] = {}
    for unit in _UNITS:
        if not (root / unit).is_dir():
            continue
        for child in sorted((root / unit).iterdir()):
            for folder in _inner_session(child):
                folders.setdefault(folder.name, []).append(folder)
    return tuple(_Session(name, tuple(found)) for name, found in sorted(folders.items()))


def _sessions_around(session: Path) -> tuple[_Session, ...]:
    """The sessions of the root that a session's folder is part of, or the folder alone."""
    for unit in list(session.parents)[:2]:
        if unit.name in _UNITS:
            return _sessions_below(unit.parent)
    return (_Session(session.name, (session,)),)


def _inner_session(child: Path) -> Iterator[Path]:
    """<anything>-<session>/<session>, or the session's folder itself."""
    match = _SESSION.search(child.name)
    if match is None or not child.is_dir():
        return
    inner = child / match[1]
    if inner.is_dir():
        yield inner
    elif child.name == match[1]:
        yield child


def _sequence_files(session: Path) -> Iterator[Path]:
    """Every sequence file of a session's folder."""
    for _, _, file in _room_sequences(session):
        if is_sequence_file(file):
            yield file
    for _, folder in _lidar_rooms(session):
        yield from _lidar_files(folder)


def _room_sequences(session: Path) -> Iterator[tuple[str, int, Path]]:
    """Room, subsession and sequence file, by name: each is beside a folder of the same name."""
    for file in sorted(session.glob("*.txt")):
        match = _ROOM_SEQUENCE.match(file.stem)
        if match is not None and file.is_file() and file.with_suffix("").is_dir():
            yield match[1], _subsession(match[2]), file


def _subsession(suffixes: str) -> int:
    """Of "_2_rgbd" 2, of "_rgbd" 1."""
    return next((int(part) for part in suffixes.split("_")[:2] if part.isdecimal()), 1)


def _lidar_rooms(session: Path) -> Iterator[tuple[str, Path]]:
    for folder in sorted(session.iterdir()):
        match = _ROOM_SEQUENCE.match(folder.name)
        if match is not None and folder.is_dir() and next(_lidar_files(folder), None) is not None:
            yield match[1], folder


def _lidar_files(room: Path) -> Iterator[Path]:
    for file in room.glob("*.txt"):
        if _LIDAR_SEQUENCE.match(file.stem) and is_sequence_file(file):
            yield file


def _sequence_of(session: _Session, key: RoomKey) -> Path | None:
    for folder in session.folders:
        for room, subsession, file in _room_sequences(folder):
            if (room, subsession) == (key.room, key.subsession):
                return file
    return None


def _lidar_sequences(session: _Session, room: str) -> list[tuple[str, Path]]:
    """k and file of each laser sequence, in the order of k."""
    found = []
    for folder in session.folders:
        for name, inner in _lidar_rooms(folder):
            if name == room:
                found += [(file.stem.partition("_")[0], file) for file in _lidar_files(inner)]
    return sorted(found, key=lambda sequence: (int(sequence[0]), sequence[1]))


def _raw_sequence(session: _Session, key: RoomKey, own: Path | None) -> Path | None:
    for folder in session.folders:
        if any(parent.name == _RAW_UNIT for parent in list(folder.parents)[:2]):
            file = _sequence_of(_Session(session.name, (folder,)), key)
            return None if file == own else file
    return None


def _add(folders: list[Path], sequence: Path) -> int:
    """The number under which a sequence's folder is kept."""
    folders.append(sequence.with_suffix(""))
    return len(folders) - 1
