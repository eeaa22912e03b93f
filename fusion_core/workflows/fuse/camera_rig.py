"""The rig of a recording: its cameras, and their mount by the recording's own transforms or by
extrinsics that a person gives instead."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fusion_core.alignment.curves import SamplingSettings
from fusion_core.alignment.upright import UprightView, upright_view
from fusion_core.alignment.virtual_lidar import crop_view
from fusion_core.model.conventions import R_BODY_OPTICAL, FloatArray
from fusion_core.model.errors import MissingStream, ScanLoomError, SettingsError
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_yaw_pitch_roll,
)
from fusion_core.model.given_extrinsics import CameraPose, GivenExtrinsics
from fusion_core.model.recording import Recording
from fusion_core.model.rig import Camera, Mount
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    DepthImage,
)
from fusion_core.recordings.topics import Streams
from fusion_core.workflows.recorded_transforms import RecordedTransforms, frame_name
from fusion_core.workflows.sensor_geometry import (
    ScanGeometry,
    first_scan,
    first_value,
    most_common_geometry,
)

# Greatest z of a viewing direction in a level base: where a camera seems to look straight up or
# down, the base is another optical frame.
_VIEW_Z_MAX = 0.95
_T_LEVEL = make_transform(R_BODY_OPTICAL, np.zeros(3))


@dataclass(frozen=True, slots=True, kw_only=True)
class GivenMount:
    """The mount by extrinsics that a person gives. ``source``: where from, for people. ``poses``:
    of the rig's cameras, in their order."""

    source: str
    mount: Mount
    poses: tuple[CameraPose, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraRig:
    """Cameras in upright views on one frame. ``recorded_mount`` is the mount by the recording's own
    transforms, None where they do not connect it with the LiDAR or where another is ``given``.
    ``full_views`` are not cropped for a virtual LiDAR. ``depth_quantum_m``: the coarsest step
    between depths that a camera's file can tell apart, None where all are fine. ``notes`` are for
    people.

    What a mount does not have of the cameras' poses, such as their roll, is in their
    ``T_rig_camera``: a known transform is kept in all six degrees of freedom."""

    cameras: tuple[Camera, ...]
    views: tuple[UprightView, ...]
    full_views: tuple[UprightView, ...]
    stored_intrinsics: tuple[CameraIntrinsics, ...]
    lidar_frame: str
    scan_geometry: ScanGeometry | None
    depth_quantum_m: float | None
    recorded_mount: Mount | None
    notes: tuple[str, ...]
    given: GivenMount | None = None

    @property
    def known_mount(self) -> Mount | None:
        """The mount that is known without scans and images."""
        return self.recorded_mount if self.given is None else self.given.mount

    def rolled(self, roll_rad: float) -> "CameraRig":
        """The rig rolled about its x: all of its cameras together."""
        return replace(self, cameras=tuple(camera.rolled(roll_rad) for camera in self.cameras))


@dataclass(frozen=True, slots=True, kw_only=True)
class _StoredCamera:
    """A camera as the recording has it, its images not yet upright."""

    topic: str
    frame_id: str
    intrinsics: CameraIntrinsics
    calibrated: bool
    quantum_m: float | None


def build_camera_rig(
    recording: Recording,
    streams: Streams,
    sampling: SamplingSettings,
    *,
    virtual: bool = False,
    needs_lidar: bool = True,
    given: GivenExtrinsics | None = None,
) -> CameraRig:
    """Read what the rig needs: one image and CameraInfo of each camera, and the static transforms.

    ``virtual``: the LiDAR is cut from the depth itself, so the views are cropped. ``needs_lidar``:
    False for a rig of cameras alone. ``given``: extrinsics that replace the recording's transforms;
    cameras that they do not place are left out.

    Raises MissingStream where the recording has no depth, or no LiDAR though one is needed and none
    is ``virtual``, and SettingsError for extrinsics that are not of these cameras.
    """
    if not streams.depth:
        raise MissingStream(
            "has no depth images.",
            file=recording.path,
            advice="Name a depth topic with --depth, or use a recording with a depth camera.",
        )
    if streams.lidar is None and needs_lidar and not virtual:
        raise MissingStream(
            "has no 2D LiDAR.",
            file=recording.path,
            advice="Inspect depth alone with --virtual-lidar ROW, or name a topic with --lidar.",
        )
    notes = list(streams.notes)
    topics = list(zip(streams.depth, streams.camera_info, strict=True))
    poses: dict[str, CameraPose] = {}
    if given is not None:
        if virtual or streams.lidar is None:
            raise SettingsError(
                "there is no LiDAR to which these extrinsics could apply.",
                file=given.file,
                advice="Leave the extrinsics out, or name the LiDAR's topic.",
            )
        poses = given.of_topics(streams.depth)
        left_out = [topic for topic in streams.depth if topic not in poses]
        notes.append(f"Extrinsics from {given.source}.")
        if left_out:
            notes.append(f"{', '.join(left_out)} left out: {given.source} does not place them.")
        topics = [(topic, info) for topic, info in topics if topic in poses]
    if virtual and len(topics) > 1:
        notes.append(f"The virtual LiDAR is cut from {topics[0][0]}; other cameras are left out.")
        topics = topics[:1]
    stored = [
        _read_stored_camera(recording, topic, info, sampling, notes) for topic, info in topics
    ]
    transforms = RecordedTransforms(recording, streams.tf_static)
    lidar_frame = ""
    geometry = None
    if streams.lidar is not None and not virtual:
        lidar_frame = first_scan(recording, streams.lidar).frame_id
        geometry = most_common_geometry(recording, streams.lidar)
    if given is None:
        T_base_camera, base = _find_camera_poses(transforms, stored, lidar_frame, notes)
    else:
        T_base_camera, base = _given_camera_poses(stored, poses, given), "lidar"
    if T_base_camera is None:
        if len(stored) > 1:
            others = ", ".join(camera.topic for camera in stored[1:])
            notes.append(
                f"No static transforms connect the cameras: {stored[0].topic} alone is used, not "
                f"{others}."
            )
        stored = stored[:1]
        T_base_camera = [_T_LEVEL]
    cameras, views, recorded = _assemble(
        stored, T_base_camera, base == "lidar" and not virtual, pitch_in_mount=given is not None
    )
    given_mount = None
    if given is not None and recorded is not None:
        own = tuple(poses[camera.topic] for camera in stored)
        given_mount = GivenMount(source=given.source, mount=recorded, poses=own)
        recorded = None
    full_views = tuple(views)
    quanta = [camera.quantum_m for camera in stored if camera.quantum_m is not None]
    if virtual:
        views = [crop_view(view) for view in views]
        cameras = [
            Camera(
                topic=camera.topic,
                intrinsics=view.intrinsics,
                T_rig_camera=camera.T_rig_camera,
                calibrated=camera.calibrated,
            )
            for camera, view in zip(cameras, views, strict=True)
        ]
    return CameraRig(
        cameras=tuple(cameras),
        views=tuple(views),
        full_views=full_views,
        stored_intrinsics=tuple(camera.intrinsics for camera in stored),
        lidar_frame=lidar_frame,
        scan_geometry=geometry,
        depth_quantum_m=max(quanta, default=None),
        recorded_mount=recorded,
        notes=tuple(notes),
        given=given_mount,
    )


def _read_stored_camera(
    recording: Recording,
    topic: str,
    info_topic: str | None,
    sampling: SamplingSettings,
    notes: list[str],
) -> _StoredCamera:
    image = first_value(recording, topic)
    if not isinstance(image, DepthImage):
        raise MissingStream(
            f"{topic} holds no depth image that can be read.",
            file=recording.path,
            advice="Name another topic with --depth.",
        )
    height, width = image.depth_m.shape
    if info_topic is not None:
        info = first_value(recording, info_topic)
        intrinsics = info.intrinsics if isinstance(info, CameraInfo) else None
        if intrinsics is not None and (intrinsics.height, intrinsics.width) == (height, width):
            return _StoredCamera(
                topic=topic,
                frame_id=image.frame_id,
                intrinsics=intrinsics,
                calibrated=True,
                quantum_m=image.quantum_m,
            )
    notes.append(
        f"{topic} has no usable intrinsics: a horizontal field of view of "
        f"{sampling.assumed_fov_deg:g} degrees is assumed, and pairs are taken in the row."
    )
    focal = 0.5 * width / np.tan(np.deg2rad(0.5 * sampling.assumed_fov_deg))
    assumed = CameraIntrinsics(
        width=width,
        height=height,
        fx=float(focal),
        fy=float(focal),
        cx=0.5 * (width - 1),
        cy=0.5 * (height - 1),
    )
    return _StoredCamera(
        topic=topic,
        frame_id=image.frame_id,
        intrinsics=assumed,
        calibrated=False,
        quantum_m=image.quantum_m,
    )


def _find_camera_poses(
    transforms: RecordedTransforms,
    cameras: Sequence[_StoredCamera],
    lidar_frame: str,
    notes: list[str],
) -> tuple[list[FloatArray] | None, str]:
    """Each camera's (4, 4) pose on a level base, and which base: the LiDAR, or a common root."""
    frames = [frame_name(camera.frame_id) for camera in cameras]
    root = transforms.root_of(frames[0])
    for base, name in ((frame_name(lidar_frame), "lidar"), (root, "root")):
        if not base or base == frames[0]:
            continue
        try:
            poses = [transforms.tree.lookup(base, frame, 0) for frame in frames]
        except ScanLoomError:
            continue
        if all(abs(T_base_camera[2, 2]) < _VIEW_Z_MAX for T_base_camera in poses):
            return poses, name
        if name == "lidar":
            notes.append(
                "The recorded mount is not used: by it a camera looks straight up or down from "
                f"{base}."
            )
    return None, ""


def _given_camera_poses(
    cameras: Sequence[_StoredCamera], poses: dict[str, CameraPose], given: GivenExtrinsics
) -> list[FloatArray]:
    """Each camera's given (4, 4) pose in the LiDAR's frame."""
    found = []
    for camera in cameras:
        if not camera.calibrated:
            raise SettingsError(
                f"{camera.topic} has no usable intrinsics, without which extrinsics do not say "
                "where a LiDAR's points are in its images.",
                file=given.file,
                advice="Record its CameraInfo, or leave the extrinsics out.",
            )
        T_lidar_camera = invert_transform(poses[camera.topic].T_camera_lidar)
        if abs(T_lidar_camera[2, 2]) >= _VIEW_Z_MAX:
            raise SettingsError(
                f"by these extrinsics {camera.topic} looks straight "
                f"{'up' if T_lidar_camera[2, 2] > 0.0 else 'down'} from the LiDAR.",
                file=given.file,
                advice="T_camera_lidar maps the LiDAR's points to the camera's optical frame (x "
                "right, y down, z ahead).",
            )
        found.append(T_lidar_camera)
    return found


def _assemble(
    stored: Sequence[_StoredCamera],
    T_base_camera: Sequence[FloatArray],
    base_is_lidar: bool,
    *,
    pitch_in_mount: bool,
) -> tuple[list[Camera], list[UprightView], Mount | None]:
    """Cameras on a rig frame whose origin is the mean optical centre. One camera looks along the
    rig's x, level unless ``pitch_in_mount``; several keep the axes of the base that their poses
    share."""
    centre = np.mean([T[:3, 3] for T in T_base_camera], axis=0)
    yaw_rad = pitch_rad = 0.0
    if len(stored) == 1:
        axis = T_base_camera[0][:3, 2]
        yaw_rad = float(np.arctan2(axis[1], axis[0]))
        if pitch_in_mount:
            pitch_rad = float(-np.arcsin(np.clip(axis[2], -1.0, 1.0)))
    R_rig_base = rotation_from_yaw_pitch_roll(0.0, -pitch_rad, 0.0) @ rotation_from_yaw_pitch_roll(
        -yaw_rad, 0.0, 0.0
    )
    cameras = []
    views = []
    for camera, T in zip(stored, T_base_camera, strict=True):
        R_rig_stored = R_rig_base @ T[:3, :3]
        view = upright_view(camera.intrinsics, T[2, :3])
        views.append(view)
        cameras.append(
            Camera(
                topic=camera.topic,
                intrinsics=view.intrinsics,
                T_rig_camera=make_transform(
                    R_rig_stored @ view.R_stored_view, R_rig_base @ (T[:3, 3] - centre)
                ),
                calibrated=camera.calibrated,
            )
        )
    recorded = None
    if base_is_lidar:
        recorded = Mount(
            yaw_rad=yaw_rad,
            pitch_rad=pitch_rad,
            forward_m=float(centre[0]),
            left_m=float(centre[1]),
            delta_z_m=float(centre[2]),
        )
    return cameras, views, recorded
