"""A room of Robot@Home, in either version: the observations of one session's visit to it."""

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.geometry import POSITION_MAX_M
from fusion_core.recordings.robot_at_home.rig import (
    RawScan,
    is_camera,
    is_lidar,
    stamp_ns_of_ticks,
)

MAX_OBSERVATIONS: Final = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class RoomKey:
    """Names a recording: session "alma-s1", room "bedroom1"; subsessions count from 1."""

    session: str
    room: str
    subsession: int

    def __str__(self) -> str:
        return f"{self.session} {self.room}" + (
            f" (subsession {self.subsession})" if self.subsession != 1 else ""
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomSummary:
    """What a room holds. ``images`` counts RGB-D images of all cameras; ``depth_bits`` is None
    where none of them could be read."""

    home: str
    session: str
    subsession: int
    room: str
    scans: int
    images: int
    depth_bits: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorTrack:
    """The observations of one sensor in the order of their stamps.

    ``ids``, ``stamp_ns``: (n,). ``poses``: (n, 6) x y z yaw pitch roll, metres and radians.
    ``sequences``: (n,) the sequence that an observation belongs to.
    """

    label: str
    ids: IntArray
    stamp_ns: IntArray
    poses: FloatArray
    sequences: IntArray


class SensorTrackBuilder:
    """Collects observations as they are read, some 70 bytes each."""

    def __init__(self, label: str) -> None:
        self.label = label
        self._ids, self._stamps, self._sequences = array("q"), array("q"), array("q")
        self._poses = array("d")

    def __len__(self) -> int:
        return len(self._ids)

    def add(self, identifier: Any, ticks: Any, pose: Sequence[Any], sequence: int) -> None:
        """Add an observation, text or numbers. Raises ValueError, TypeError or OverflowError, and
        adds nothing, where it is invalid."""
        number, stamp_ns = int(identifier), stamp_ns_of_ticks(int(ticks))
        values = [float(value) for value in pose]
        if len(values) != 6 or not np.isfinite(values).all():
            raise ValueError(f"a pose is six finite numbers, not {values}")
        if max(map(abs, values[:3])) > POSITION_MAX_M:
            raise ValueError(
                f"a pose lies no farther than {POSITION_MAX_M:g} m, not at {values[:3]}"
            )
        self._ids.append(number)
        self._stamps.append(stamp_ns)
        self._sequences.append(sequence)
        self._poses.extend(values)

    def track(self) -> SensorTrack:
        ids, stamp_ns, sequences = (
            np.array(values, dtype=np.int64)
            for values in (self._ids, self._stamps, self._sequences)
        )
        poses = np.array(self._poses, dtype=np.float64).reshape(-1, 6)
        order = np.lexsort((ids, sequences, stamp_ns))
        return SensorTrack(
            label=self.label,
            ids=ids[order],
            stamp_ns=stamp_ns[order],
            poses=poses[order],
            sequences=sequences[order],
        )


class RoomFiles(Protocol):
    """Reads single observations. Every method raises RecordingError naming file or row."""

    def depth_file(self, track: SensorTrack, index: int) -> Path: ...

    def color_file(self, track: SensorTrack, index: int) -> Path: ...

    def scan(self, track: SensorTrack, index: int) -> RawScan:
        """Raises ValueError too, saying what is wrong with the numbers."""
        ...

    def scan_name(self, track: SensorTrack, index: int) -> str: ...

    def raw_poses(self) -> Mapping[str, FloatArray]:
        """(n, 6) poses of each sensor in the raw data, where there are any: always mounts."""
        ...

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Room:
    """A room's observations. ``path`` names it; ``warnings`` say what could not be read."""

    key: RoomKey
    path: Path
    format: str
    cameras: tuple[SensorTrack, ...]
    lidar: SensorTrack | None
    files: RoomFiles = field(repr=False)
    warnings: tuple[str, ...] = ()


def select_lidar_scans(
    sequences: Mapping[str, SensorTrack], cameras: Sequence[SensorTrack], warnings: list[str]
) -> SensorTrack | None:
    """The scans of the sequences that ran while the cameras did; all where there are no images.

    A room's first sequence is usually of an earlier visit. ``warnings`` names what is left out.
    """
    chosen = {name: track for name, track in sequences.items() if len(track.ids)}
    if cameras and chosen:
        start_ns = min(int(track.stamp_ns[0]) for track in cameras)
        end_ns = max(int(track.stamp_ns[-1]) for track in cameras)
        overlapping = {
            name: track
            for name, track in chosen.items()
            if track.stamp_ns[0] <= end_ns and track.stamp_ns[-1] >= start_ns
        }
        apart = ", ".join(name for name in chosen if name not in overlapping)
        if apart:
            warnings.append(
                f"Laser sequences read: {', '.join(overlapping) or 'none'}; not read, since they "
                f"ran at other times than the cameras: {apart}."
            )
        chosen = overlapping
    if not chosen:
        return None
    tracks = list(chosen.values())
    stamp_ns = np.concatenate([track.stamp_ns for track in tracks])
    order = np.argsort(stamp_ns, kind="stable")
    return SensorTrack(
        label=tracks[0].label,
        ids=np.concatenate([track.ids for track in tracks])[order],
        stamp_ns=stamp_ns[order],
        poses=np.concatenate([track.poses for track in tracks])[order],
        sequences=np.concatenate([track.sequences for track in tracks])[order],
    )


def get_track_builder(builders: dict[str, SensorTrackBuilder], label: str) -> SensorTrackBuilder:
    """The builder of a sensor of this data set. Raises ValueError for any other label."""
    if not is_camera(label) and not is_lidar(label):
        raise ValueError(f"{label!r} is no sensor of Robot@Home")
    return builders.setdefault(label, SensorTrackBuilder(label))
