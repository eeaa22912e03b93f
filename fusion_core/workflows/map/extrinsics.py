"""Extrinsics of the depth cameras in the LiDAR's frame: from a file, TF, or the alignment."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from fusion_core.alignment.upright import UprightView, upright_view
from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.model.errors import AlignmentFailed, ScanLoomError, SettingsError
from fusion_core.model.geometry import invert_transform, make_transform
from fusion_core.model.number_text import with_deviation
from fusion_core.model.progress import Progress, silent
from fusion_core.model.recording import Recording
from fusion_core.model.rig import MOUNT_PARAMETERS, Mount
from fusion_core.recordings.calibration_files.extrinsics import read_given_extrinsics
from fusion_core.recordings.topics import Streams
from fusion_core.workflows.fuse.align import align_recording, mount_not_used
from fusion_core.workflows.fuse.camera_rig import CameraRig, build_camera_rig
from fusion_core.workflows.fuse.session import (
    Session,
    session_of,
)
from fusion_core.workflows.fuse.settings import ChainSettings
from fusion_core.workflows.map.recorded_mount_check import recorded_mount_problem
from fusion_core.workflows.recorded_transforms import RecordedTransforms, frame_name

ExtrinsicsSource = Literal["file", "tf", "alignment", "level"]

LEVEL_FRAME = "camera_level"
# REP 105: the frame that lies on the floor below the robot.
_FLOOR_FRAME = "base_footprint"
_IN_PLANE = ("yaw_rad", "forward_m", "left_m")
_OUT_OF_PLANE = ("delta_z_m", "pitch_rad")
_GIVE_FILE = "Give --extrinsics FILE, or use --scan lidar."


@dataclass(frozen=True, slots=True, kw_only=True)
class MountedCamera:
    """A depth camera in the LiDAR's frame.

    ``T_lidar_camera``: (4, 4), the optical frame of the upright ``view`` to the LiDAR's.
    ``is_upside_down``: the LiDAR's z points down.
    """

    topic: str
    view: UprightView
    T_lidar_camera: FloatArray
    is_upside_down: bool = False

    def __post_init__(self) -> None:
        if self.T_lidar_camera.shape != (4, 4):
            raise ValueError(f"T_lidar_camera must be (4, 4), got {self.T_lidar_camera.shape}")
        read_only(self.T_lidar_camera)

    @property
    def T_up_camera(self) -> FloatArray:
        """(4, 4), the optical frame to the LiDAR's, turned about its x where z points down."""
        if not self.is_upside_down:
            return self.T_lidar_camera
        turned: FloatArray = np.diag([1.0, -1.0, -1.0, 1.0]) @ self.T_lidar_camera
        return turned


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraExtrinsics:
    """The cameras around a LiDAR.

    ``frame_id``: the LiDAR's frame, or LEVEL_FRAME under the first camera where the recording has
    no LiDAR ("level"); only its orientation has a meaning before the floor is known.
    ``is_height_known``: whether heights and tilts against the LiDAR are known; an alignment may
    not observe them. ``lidar_height_m``: above the floor, where the recording's transforms say so.
    """

    source: ExtrinsicsSource
    frame_id: str
    cameras: tuple[MountedCamera, ...]
    is_height_known: bool
    lidar_height_m: float | None
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _LidarMounting:
    """The LiDAR's mounting by the static transforms. ``height_above_floor_m``: None where they have
    no frame on the floor. ``is_upside_down``: against the root of its frames."""

    height_above_floor_m: float | None
    is_upside_down: bool


def find_extrinsics(
    recording: Recording,
    streams: Streams,
    settings: ChainSettings,
    *,
    file: Path | None = None,
    progress: Progress = silent,
) -> CameraExtrinsics:
    """The most reliable extrinsics: those of ``file``, else the recording's transforms, else the
    alignment of scans and images (a pass over the recording), else, without a LiDAR, a level
    camera.

    Raises MissingStream without depth images, SettingsError for the file, AlignmentFailed where
    the camera's position in the LiDAR's plane is not observable.
    """
    if streams.lidar is None:
        if file is not None:
            raise SettingsError(
                "there is no LiDAR to which these extrinsics could apply.",
                file=file,
                advice="Leave --extrinsics out, or name the LiDAR's topic.",
            )
        return _level_extrinsics(recording, streams, settings)
    rig = build_camera_rig(recording, streams, settings.sampling)
    mounting = _read_lidar_mounting(recording, streams, rig.lidar_frame)
    if file is not None:
        return _extrinsics_from_file(file, rig, streams, mounting)
    session = session_of(recording, streams, rig, settings)
    refusal = recorded_mount_problem(session)
    if rig.recorded_mount is not None and not refusal:
        return CameraExtrinsics(
            source="tf",
            frame_id=rig.lidar_frame,
            cameras=_mounted_cameras(rig, rig.recorded_mount, mounting),
            is_height_known=True,
            lidar_height_m=mounting.height_above_floor_m,
            notes=(*rig.notes, f"Extrinsics from {streams.tf_static}."),
        )
    try:
        return _extrinsics_from_alignment(session, mounting, progress)
    except AlignmentFailed as error:
        if not refusal:
            raise
        raise AlignmentFailed(
            f"{error.problem} {mount_not_used(refusal)}", file=recording.path, advice=_GIVE_FILE
        ) from error


def _mounted_cameras(
    rig: CameraRig, mount: Mount, mounting: _LidarMounting
) -> tuple[MountedCamera, ...]:
    return tuple(
        MountedCamera(
            topic=camera.topic,
            view=view,
            T_lidar_camera=mount.T_lidar_rig @ camera.T_rig_camera,
            is_upside_down=mounting.is_upside_down,
        )
        for camera, view in zip(rig.cameras, rig.views, strict=True)
    )


def _level_extrinsics(
    recording: Recording, streams: Streams, settings: ChainSettings
) -> CameraExtrinsics:
    rig = build_camera_rig(recording, streams, settings.sampling, virtual=True)
    T_level_camera = rig.cameras[0].T_rig_camera.copy()
    T_level_camera[:3, 3] = 0.0
    camera = MountedCamera(
        topic=rig.cameras[0].topic, view=rig.full_views[0], T_lidar_camera=T_level_camera
    )
    others = [topic for topic in streams.depth if topic != camera.topic]
    notes = [*streams.notes, f"No LiDAR: scans lie in {LEVEL_FRAME}, level under {camera.topic}."]
    if others:
        notes.append(f"{', '.join(others)} left out: nothing joins the cameras.")
    return CameraExtrinsics(
        source="level",
        frame_id=LEVEL_FRAME,
        cameras=(camera,),
        is_height_known=False,
        lidar_height_m=None,
        notes=tuple(notes),
    )


def _extrinsics_from_file(
    file: Path, rig: CameraRig, streams: Streams, mounting: _LidarMounting
) -> CameraExtrinsics:
    given = read_given_extrinsics(file).of_topics(streams.depth)
    intrinsics = {
        camera.topic: stored
        for camera, stored in zip(rig.cameras, rig.stored_intrinsics, strict=True)
    }
    known = {t: pose.T_camera_lidar for t, pose in given.items() if t in intrinsics}
    if not known:
        raise SettingsError(
            f"names none of the depth topics {', '.join(intrinsics)}.", file=file, advice=_GIVE_FILE
        )
    cameras = []
    for topic, T_camera_lidar in known.items():
        up = -T_camera_lidar[:3, 2] if mounting.is_upside_down else T_camera_lidar[:3, 2]
        view = upright_view(intrinsics[topic], up)
        cameras.append(
            MountedCamera(
                topic=topic,
                view=view,
                T_lidar_camera=invert_transform(T_camera_lidar)
                @ make_transform(view.R_stored_view, np.zeros(3)),
                is_upside_down=mounting.is_upside_down,
            )
        )
    notes = [*rig.notes, f"Extrinsics from {file.name}."]
    left_out = [topic for topic in streams.depth if topic not in known]
    if left_out:
        notes.append(f"{', '.join(left_out)} left out: {file.name} does not place them.")
    return CameraExtrinsics(
        source="file",
        frame_id=rig.lidar_frame,
        cameras=tuple(cameras),
        is_height_known=True,
        lidar_height_m=mounting.height_above_floor_m,
        notes=tuple(notes),
    )


def _extrinsics_from_alignment(
    session: Session, mounting: _LidarMounting, progress: Progress
) -> CameraExtrinsics:
    recording = session.recording
    alignment = align_recording(session, progress)
    rig = alignment.on_rig(session).rig
    mount = alignment.mount
    if alignment.estimate is None:
        raise AlignmentFailed(
            "the alignment pairs rows only, which does not determine the camera's position.",
            file=recording.path,
            advice=_GIVE_FILE,
        )
    unseen = _unobservable(mount, _IN_PLANE)
    if unseen or not alignment.along_curve:
        what = (
            f"not show the camera's {_name_parameters(unseen)}"
            if unseen
            else "not agree on a mount"
        )
        raise AlignmentFailed(
            f"scans and images do {what}.", file=recording.path, advice=_GIVE_FILE
        )
    notes = [
        *rig.notes,
        *alignment.notes,
        f"Extrinsics from the alignment: {_describe_mount(mount)}.",
    ]
    unseen = _unobservable(mount, _OUT_OF_PLANE)
    if unseen:
        notes.append(
            f"The alignment does not show {_name_parameters(unseen)}: the floor in the depth must."
        )
    return CameraExtrinsics(
        source="alignment",
        frame_id=rig.lidar_frame,
        cameras=_mounted_cameras(rig, mount, mounting),
        is_height_known=not unseen,
        lidar_height_m=mounting.height_above_floor_m,
        notes=tuple(notes),
    )


def _unobservable(mount: Mount, names: Sequence[str]) -> list[str]:
    sd = dict(zip(MOUNT_PARAMETERS, mount.sd, strict=True))
    return [name for name in names if sd[name] is None]


def _name_parameters(names: Sequence[str]) -> str:
    return " and ".join(name.rsplit("_", 1)[0].replace("_", " ") for name in names)


def _describe_mount(mount: Mount) -> str:
    """The in-plane parameters, all of which are known."""
    sd = dict(zip(MOUNT_PARAMETERS, mount.sd, strict=True))
    described = []
    for name in _IN_PLANE:
        own_sd = sd[name]
        assert own_sd is not None, "a mount that is not observable is refused"
        label, unit = name.rsplit("_", 1)
        unit, factor = ("deg", 180.0 / np.pi) if unit == "rad" else (unit, 1.0)
        number = " +- ".join(with_deviation(getattr(mount, name) * factor, own_sd * factor))
        described.append(f"{label} {number} {unit}")
    return ", ".join(described)


def _read_lidar_mounting(
    recording: Recording, streams: Streams, lidar_frame: str
) -> _LidarMounting:
    transforms = RecordedTransforms(recording, streams.tf_static)
    lidar = frame_name(lidar_frame)
    T_root_lidar = transforms.tree.lookup(transforms.root_of(lidar), lidar, 0)
    try:
        height_m = float(transforms.tree.lookup(_FLOOR_FRAME, lidar, 0)[2, 3])
    except ScanLoomError:
        height_m = 0.0
    return _LidarMounting(
        height_above_floor_m=height_m if height_m > 0.0 else None,
        is_upside_down=bool(T_root_lidar[2, 2] < 0.0),
    )
