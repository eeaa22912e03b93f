"""A room of Robot@Home as a recording: one session's passage through it, in either version."""

import struct
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray, IntArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.geometry import POSITION_MAX_M
from fusion_core.model.recording import Recording, Role
from fusion_core.model.sensors import (
    CameraInfo,
    ColorImage,
    DepthImage,
    LaserScan,
    PoseSample,
    SensorValue,
    Transform,
    TransformBatch,
)
from fusion_core.recordings.images.frame_files import read_image, read_rgb
from fusion_core.recordings.robot_at_home.rig import (
    BASE_FRAME,
    COARSE_QUANTUM_M,
    INTRINSICS,
    MAP_FRAME,
    BeamSpacing,
    RawScan,
    depth_m_from_pixels,
    frame_of,
    is_camera,
    is_lidar,
    laser_scan,
    most_frequent_pose,
    sensor_transform,
    stamp_ns_of_ticks,
    stored_landscape,
    topic_root,
)
from fusion_core.recordings.stamped import StampedRecording, StampedStream

MAX_OBSERVATIONS: Final = 1_000_000
_PNG_HEAD = struct.Struct(">8s4x4sIIB")
_PNG_START = (b"\x89PNG\r\n\x1a\n", b"IHDR")
# Where the first images are missing, one of these tells what the others are.
_MAX_ATTEMPTS = 32


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
    where none of them could be looked at."""

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
        """Take an observation, text or numbers. Raises ValueError, TypeError or OverflowError for
        what is none, and takes nothing then."""
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

    A room's first sequence is usually another passage. What is left out goes into ``warnings``.
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


def summarize_room(room: Room) -> RoomSummary:
    """Counts, without decoding."""
    head = _read_depth_format(room)
    return RoomSummary(
        home=room.key.session.rpartition("-")[0] or room.key.session,
        session=room.key.session,
        subsession=room.key.subsession,
        room=room.key.room,
        scans=0 if room.lidar is None else len(room.lidar.ids),
        images=sum(len(track.ids) for track in room.cameras),
        depth_bits=None if head is None else head[2],
    )


def make_recording(room: Room, spacing: BeamSpacing) -> Recording:
    """The room as a recording; closing it closes the room's files."""
    warnings = list(room.warnings)
    streams: list[StampedStream] = []
    if room.lidar is not None:
        streams.append(
            _stream(room.lidar, "", "scan", "lidar", partial(_scan, room.files, spacing))
        )
    elif room.cameras:
        warnings.append("There are no laser scans of this room.")
    head = _read_depth_format(room)
    for track in room.cameras:
        streams += _camera_streams(room, track, head)
    if head is not None:
        warnings += _depth_warnings(*head)
    tracks = [*room.cameras, *([room.lidar] if room.lidar is not None else [])]
    mounts, located = _mounts(room, tracks, warnings)
    if mounts:
        streams.append(_static_transforms(mounts, min(int(track.stamp_ns[0]) for track in tracks)))
    streams += [_stream(track, "/pose", "pose", "pose", _map_pose) for track in located]
    return StampedRecording(room.path, room.format, streams, warnings, on_close=room.files.close)


_Value = Callable[[SensorTrack, int, int], SensorValue]


def _stream(track: SensorTrack, suffix: str, kind: str, role: Role, value: _Value) -> StampedStream:
    return StampedStream(
        name=topic_root(track.label) + suffix,
        type=kind,
        role=role,
        stamps_ns=track.stamp_ns,
        read_value=lambda index: value(track, index, int(track.stamp_ns[index])),
    )


def _camera_streams(
    room: Room, track: SensorTrack, head: tuple[int, int, int] | None
) -> list[StampedStream]:
    shape = None if head is None else (min(head[:2]), max(head[:2]))
    streams = [
        _stream(track, "/depth", "image", "depth", partial(_depth, room.files, shape)),
        _stream(track, "/color", "image", "color", partial(_color, room.files)),
    ]
    if shape == (INTRINSICS.height, INTRINSICS.width):
        streams.append(_stream(track, "/camera_info", "intrinsics", "camera_info", _camera_info))
    return streams


def _read_depth_format(room: Room) -> tuple[int, int, int] | None:
    """Width, height and bits of the first depth image that is there."""
    for track in room.cameras:
        for index in range(min(_MAX_ATTEMPTS, len(track.ids))):
            try:
                path = room.files.depth_file(track, index)
                if not path.is_file():
                    continue
                with path.open("rb") as file:
                    start = file.read(_PNG_HEAD.size)
            except (RecordingError, OSError):
                # Reading the image itself will say so.
                continue
            if len(start) == _PNG_HEAD.size:
                magic, kind, width, height, bits = _PNG_HEAD.unpack(start)
                if (magic, kind) == _PNG_START:
                    return width, height, bits
    return None


def _depth_warnings(width: int, height: int, bits: int) -> list[str]:
    warnings = []
    if bits == 8:
        warnings.append(
            f"Depth comes in steps of {1000.0 * COARSE_QUANTUM_M:.0f} mm: the images have 8 bits, "
            "as in Robot@Home2; the plain text of the first version has 16."
        )
    if {width, height} != {INTRINSICS.width, INTRINSICS.height}:
        warnings.append(
            f"There are no intrinsics: they are known for {INTRINSICS.width} x {INTRINSICS.height} "
            f"pixels, the images are {width} x {height}."
        )
    return warnings


def _mounts(
    room: Room, tracks: Sequence[SensorTrack], warnings: list[str]
) -> tuple[dict[str, FloatArray], list[SensorTrack]]:
    """{label: (6,) pose on the robot}, and the tracks whose poses move with the robot."""
    mounts: dict[str, FloatArray] = {}
    located = []
    for track in tracks:
        found = most_frequent_pose(track.poses)
        if found is None:
            located.append(track)
            continue
        mounts[track.label], count = found
        if count < len(track.poses):
            warnings.append(_describe_mount_change(track, *found))
    if located:
        raw = room.files.raw_poses()
        for track in located:
            found = most_frequent_pose(raw.get(track.label, np.empty((0, 6))))
            if found is not None:
                mounts[track.label] = found[0]
        names = ", ".join(track.label for track in located)
        unknown = ", ".join(track.label for track in located if track.label not in mounts)
        warnings.append(
            f"The poses of {names} move with the robot: they are places in a map, given as "
            f"{', '.join(topic_root(track.label) + '/pose' for track in located)}. "
            + (
                f"The mounts of {unknown} are not known: they are in the raw data, which is not "
                "there."
                if unknown
                else "The mounts are those of the raw data."
            )
        )
    return mounts, located


def _describe_mount_change(track: SensorTrack, pose: FloatArray, count: int) -> str:
    away = np.abs(track.poses - pose)
    away[:, 3:] = np.minimum(away[:, 3:], np.abs(2.0 * np.pi - away[:, 3:]))
    return (
        f"The mount of {track.label} changes: {len(track.poses) - count} of {len(track.poses)} "
        f"observations differ by up to {away[:, :3].max():.3g} m and "
        f"{np.rad2deg(away[:, 3:].max()):.3g} degrees from the pose that is taken."
    )


def _static_transforms(mounts: Mapping[str, FloatArray], stamp_ns: int) -> StampedStream:
    batch = TransformBatch(
        received_ns=None,
        transforms=tuple(
            Transform(
                stamp_ns=stamp_ns,
                parent=BASE_FRAME,
                child=frame_of(label),
                T_parent_child=sensor_transform(label, pose),
            )
            for label, pose in sorted(mounts.items())
        ),
    )
    return StampedStream(
        name="/tf_static",
        type="transforms",
        role="tf_static",
        stamps_ns=np.array([stamp_ns], dtype=np.int64),
        read_value=lambda index: batch,
    )


def _scan(
    files: RoomFiles, spacing: BeamSpacing, track: SensorTrack, index: int, stamp_ns: int
) -> LaserScan:
    try:
        return laser_scan(files.scan(track, index), stamp_ns, spacing)
    except (ValueError, TypeError, OverflowError) as error:
        raise RecordingError(
            f"{files.scan_name(track, index)} is no scan: {error}.",
            advice="Copy it again from its source.",
        ) from error


def _depth(
    files: RoomFiles, shape: tuple[int, int] | None, track: SensorTrack, index: int, stamp_ns: int
) -> DepthImage:
    file = files.depth_file(track, index)
    depth_m, quantum_m = depth_m_from_pixels(read_image(file, cv2.IMREAD_UNCHANGED), file)
    if depth_m.shape != shape:
        raise RecordingError(
            f"has {depth_m.shape} pixels, the room's other images {shape}.",
            file=file,
            advice="Copy it again from its source.",
        )
    return DepthImage(
        stamp_ns=stamp_ns,
        received_ns=None,
        frame_id=frame_of(track.label),
        depth_m=depth_m,
        quantum_m=quantum_m,
    )


def _color(files: RoomFiles, track: SensorTrack, index: int, stamp_ns: int) -> ColorImage:
    rgb: ByteArray = stored_landscape(read_rgb(files.color_file(track, index)))
    return ColorImage(stamp_ns=stamp_ns, received_ns=None, frame_id=frame_of(track.label), rgb=rgb)


def _camera_info(track: SensorTrack, index: int, stamp_ns: int) -> CameraInfo:
    return CameraInfo(
        stamp_ns=stamp_ns,
        received_ns=None,
        frame_id=frame_of(track.label),
        intrinsics=INTRINSICS,
    )


def _map_pose(track: SensorTrack, index: int, stamp_ns: int) -> PoseSample:
    return PoseSample(
        stamp_ns=stamp_ns,
        received_ns=None,
        parent=MAP_FRAME,
        child=frame_of(track.label),
        T_parent_child=sensor_transform(track.label, track.poses[index]),
    )


def get_track_builder(builders: dict[str, SensorTrackBuilder], label: str) -> SensorTrackBuilder:
    """The builder of a sensor of this data set. Raises ValueError for any other label."""
    if not is_camera(label) and not is_lidar(label):
        raise ValueError(f"{label!r} is no sensor of Robot@Home")
    return builders.setdefault(label, SensorTrackBuilder(label))
