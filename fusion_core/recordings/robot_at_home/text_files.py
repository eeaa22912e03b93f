"""The text files of Robot@Home (2017): sequence files and scans, and a room's files by number.

A line of a sequence file is "id label x y z yaw pitch roll ticks": metres, radians, 100 ns since
1601. Observation <id> of <sequence>.txt is in the files <sequence>/<id>_*.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from fusion_core.files.regular_file import read_head
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import RecordingError
from fusion_core.recordings.robot_at_home.rig import RawScan, checked_beam_count
from fusion_core.recordings.robot_at_home.room import (
    MAX_OBSERVATIONS,
    SensorTrack,
    SensorTrackBuilder,
    get_track_builder,
)

_MAX_SEQUENCE_BYTES: Final = 256 << 20
_MAX_SCAN_BYTES: Final = 64 << 20
_MAX_LINE: Final = 4096
_HEAD_BYTES: Final = 65536
_FIELDS: Final = 9


def is_sequence_file(file: Path) -> bool:
    """Whether the first line that is no comment is an observation."""
    if not file.is_file():
        return False
    head = read_head(file, _HEAD_BYTES)
    for line in head.decode("utf-8", errors="replace").splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                _add_observation({}, line.split(), 0)
            except (ValueError, TypeError, OverflowError):
                return False
            return True
    return False


def read_tracks(file: Path, sequence: int, warnings: list[str]) -> list[SensorTrack]:
    """One track for each sensor of a sequence file. Invalid lines are skipped with a warning.

    ``sequence``: the number that the observations get in ``SensorTrack.sequences``. Raises
    RecordingError where the file cannot be read.
    """
    builders: dict[str, SensorTrackBuilder] = {}
    unread, first, count = 0, "", 0
    try:
        if file.stat().st_size > _MAX_SEQUENCE_BYTES:
            raise RecordingError(
                "is too large for a sequence file.", file=file, advice="Check what it holds."
            )
        with file.open(encoding="utf-8", errors="replace") as stream:
            while line := stream.readline(_MAX_LINE):
                if not line.strip() or line.lstrip().startswith("#"):
                    continue
                count += 1
                if count > MAX_OBSERVATIONS:
                    warnings.append(
                        f"{file.name}: only the first {MAX_OBSERVATIONS} observations are read."
                    )
                    break
                try:
                    _add_observation(builders, line.split(), sequence)
                except (ValueError, TypeError, OverflowError) as error:
                    unread += 1
                    first = first or f"{line.strip()[:40]!r} ({error})"
    except OSError as error:
        raise RecordingError(
            f"cannot be read: {error.strerror or error}.",
            file=file,
            advice="Check the path and its permissions.",
        ) from error
    if unread:
        warnings.append(
            f"{file.name}: {unread} of {count} lines are no observations; the first: {first}."
        )
    return [builders[label].track() for label in sorted(builders) if len(builders[label])]


@dataclass(frozen=True, slots=True)
class TextFiles:
    """Reads single observations of a room.

    ``folders``: of the observations' files, by sequence number. ``raw``: the room's sequence file
    in the raw data, or None.
    """

    folders: tuple[Path, ...]
    raw: Path | None = field(default=None)

    def depth_file(self, track: SensorTrack, index: int) -> Path:
        return self._file(track, index, "depth.png")

    def color_file(self, track: SensorTrack, index: int) -> Path:
        return self._file(track, index, "intensity.png")

    def scan(self, track: SensorTrack, index: int) -> RawScan:
        return _read_scan(self._file(track, index, "scan.txt"))

    def scan_name(self, track: SensorTrack, index: int) -> str:
        return str(self._file(track, index, "scan.txt"))

    def raw_poses(self) -> Mapping[str, FloatArray]:
        if self.raw is None:
            return {}
        return {track.label: track.poses for track in read_tracks(self.raw, 0, [])}

    def close(self) -> None:
        """Nothing is held open."""

    def _file(self, track: SensorTrack, index: int, kind: str) -> Path:
        return self.folders[int(track.sequences[index])] / f"{track.ids[index]}_{kind}"


def _read_scan(file: Path) -> RawScan:
    """A scan file: comments, then aperture, maximum range, N, N ranges and N flags.

    Raises RecordingError where it cannot be read, ValueError where its numbers are wrong.
    """
    try:
        # Opening a pipe would wait for its other end.
        if not file.is_file():
            raise RecordingError(
                "is no file, or missing.", file=file, advice="Copy it again from its source."
            )
        size = file.stat().st_size
        if size > _MAX_SCAN_BYTES:
            raise ValueError(f"{size} bytes are too many")
        lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise RecordingError(
            f"cannot be read: {error.strerror or error}.",
            file=file,
            advice="Copy it again from its source.",
        ) from error
    rows = [line.split() for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if len(rows) != 5 or any(len(row) != 1 for row in rows[:3]):
        raise ValueError(
            f"{len(rows)} lines of values, not aperture, maximum range, N, ranges and flags"
        )
    count = checked_beam_count(float(rows[2][0]))
    if len(rows[3]) != count or len(rows[4]) != count:
        raise ValueError(f"{len(rows[3])} ranges and {len(rows[4])} flags for {count} beams")
    flags = np.array(rows[4], dtype=np.float64)
    return RawScan(
        aperture_rad=float(rows[0][0]),
        max_range_m=float(rows[1][0]),
        ranges_m=np.array(rows[3], dtype=np.float64),
        valid=flags == 1.0,
    )


def _add_observation(
    builders: dict[str, SensorTrackBuilder], fields: list[str], sequence: int
) -> None:
    if len(fields) != _FIELDS:
        raise ValueError(f"{len(fields)} fields, not {_FIELDS}")
    get_track_builder(builders, fields[1]).add(fields[0], fields[8], fields[2:8], sequence)
