"""A room of Robot@Home as a recording: its topics, their values and the mounts of its sensors."""

import struct
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.errors import RecordingError
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
    depth_m_from_pixels,
    frame_of,
    laser_scan,
    most_frequent_pose,
    sensor_transform,
    stored_landscape,
    topic_root,
)
from fusion_core.recordings.robot_at_home.room import Room, RoomFiles, RoomSummary, SensorTrack
from fusion_core.recordings.stamped import StampedRecording, StampedStream

_PNG_HEAD = struct.Struct(">8s4x4sIIB")
_PNG_START = (b"\x89PNG\r\n\x1a\n", b"IHDR")
# Where the first images are missing, the format is read from one of these many.
_MAX_ATTEMPTS = 32


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
