"""The rig of a recording: its cameras, and their mount by the recording's own transforms."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fusion_core.alignment.curves import SamplingSettings
from fusion_core.alignment.upright import UprightView, upright_view
from fusion_core.alignment.virtual_lidar import crop_view
from fusion_core.model.conventions import R_BODY_OPTICAL, FloatArray
from fusion_core.model.errors import MissingStream, ScanLoomError
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
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
class CameraRig:
    """Cameras in upright views on one frame. ``recorded`` is the mount by the recording's own
    transforms, None where they do not connect it with the LiDAR. ``full_views`` are not cropped
    for a virtual LiDAR. ``depth_quantum_m``: the coarsest step between depths that a camera's file
    can tell apart, None where all are fine. ``notes`` are for people."""

    cameras: tuple[Camera, ...]
    views: tuple[UprightView, ...]
    full_views: tuple[UprightView, ...]
    stored_intrinsics: tuple[CameraIntrinsics, ...]
    lidar_frame: str
    scan_geometry: ScanGeometry | None
    depth_quantum_m: float | None
    recorded_mount: Mount | None
    notes: tuple[str, ...]


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
) -> CameraRig:
    """Read what the rig needs: one image and CameraInfo of each camera, and the static transforms.

    ``virtual``: the LiDAR is cut from the depth itself, so the views are cropped. ``needs_lidar``:
    False for a rig of cameras alone.

    Raises MissingStream where the recording has no depth, or no LiDAR though one is needed and none
    is ``virtual``.
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
    T_base_camera, base = _find_camera_poses(transforms, stored, lidar_frame, notes)
    if T_base_camera is None:
        if len(stored) > 1:
            left_out = ", ".join(camera.topic for camera in stored[1:])
            notes.append(
                f"No static transforms connect the cameras: {stored[0].topic} alone is used, not "
                f"{left_out}."
            )
        stored = stored[:1]
        T_base_camera = [_T_LEVEL]
    cameras, views, recorded = _assemble(stored, T_base_camera, base == "lidar" and not virtual)
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


def _assemble(
    stored: Sequence[_StoredCamera], T_base_camera: Sequence[FloatArray], base_is_lidar: bool
) -> tuple[list[Camera], list[UprightView], Mount | None]:
    """Cameras on a rig frame whose origin is the mean optical centre. One camera looks along the
    rig's x; several keep the axes of the base that their poses share."""
    centre = np.mean([T[:3, 3] for T in T_base_camera], axis=0)
    yaw_rad = 0.0
    if len(stored) == 1:
        yaw_rad = float(np.arctan2(T_base_camera[0][1, 2], T_base_camera[0][0, 2]))
    R_rig_base = rotation_from_yaw_pitch_roll(-yaw_rad, 0.0, 0.0)
    cameras = []
    views = []
    for camera, T in zip(stored, T_base_camera, strict=True):
        R_rig_stored = R_rig_base @ T[:3, :3]
        view = upright_view(camera.intrinsics, R_rig_stored[2, :])
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
            forward_m=float(centre[0]),
            left_m=float(centre[1]),
            delta_z_m=float(centre[2]),
        )
    return cameras, views, recorded
