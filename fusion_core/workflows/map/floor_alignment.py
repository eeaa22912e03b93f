"""The floor below the cameras, and the transform of each camera to coordinates above it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fusion_core.alignment.upright import UprightView
from fusion_core.mapping.floor_plane import FloorPlane, find_floor
from fusion_core.mapping.virtual_scan import VirtualScanSettings
from fusion_core.model.conventions import Float32Array, FloatArray, read_only
from fusion_core.model.errors import AlignmentFailed, RecordingError
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import DepthImage
from fusion_core.workflows.map.extrinsics import CameraExtrinsics, ExtrinsicsSource, MountedCamera

# Spread evenly over the recording: some of them show the floor wherever the robot drives.
_IMAGES_SAMPLED = 24
# The largest tilt between the floor and the extrinsics by how far these can be off: calibrated
# mounts, estimated ones, and a camera that is only assumed to look level.
_TILT_MAX_DEG: dict[ExtrinsicsSource, float] = {
    "file": 10.0,
    "tf": 10.0,
    "alignment": 15.0,
    "level": 45.0,
}
# Smaller contradictions between floor and extrinsics are noise of the depth, and not reported.
_TILT_REPORTED_DEG = 1.0
_HEIGHT_REPORTED_M = 0.03


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorAlignedCamera:
    """``T_floor_camera``: (3, 4), maps points in the optical frame of ``view`` to x and y in the
    scan's frame and the height above the floor."""

    topic: str
    view: UprightView
    T_floor_camera: FloatArray

    def __post_init__(self) -> None:
        read_only(self.T_floor_camera)


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorAlignment:
    """``lidar_height_m``: the LiDAR's plane above the floor, None where it is not known."""

    cameras: tuple[FloorAlignedCamera, ...]
    lidar_height_m: float | None
    notes: tuple[str, ...]


def align_to_floor(
    recording: Recording, placed: CameraExtrinsics, settings: VirtualScanSettings
) -> FloorAlignment:
    """The cameras over the floor.

    The floor comes from ``settings.lidar_height_m`` where that is given, else from the depth
    images, else from the recording's transforms.

    Raises AlignmentFailed where none of them gives it.
    """
    given_m = settings.lidar_height_m
    if given_m is not None:
        if not placed.is_height_known:
            raise AlignmentFailed(
                "the LiDAR's height is given, but not the camera's above the LiDAR.",
                file=recording.path,
                advice="Give --extrinsics FILE too, or leave virtual_scan.lidar_height_m out.",
            )
        return FloorAlignment(
            cameras=tuple(_align_to_known_height(camera, given_m) for camera in placed.cameras),
            lidar_height_m=given_m,
            notes=(f"The LiDAR is {given_m:g} m above the floor, as given.",),
        )
    floors, problem = _find_floors(recording, placed)
    notes = [_describe_floor(topic, floor) for topic, floor in floors.items()]
    lidar_heights_m = [
        floors[camera.topic].camera_height_m - float(camera.T_up_camera[2, 3])
        for camera in placed.cameras
        if camera.topic in floors
    ]
    if lidar_heights_m:
        # Between cameras of one rig the heights are known even where the LiDAR's is not.
        height_m = float(np.median(lidar_heights_m))
        notes += _describe_contradictions(placed, floors, height_m)
    elif placed.is_height_known and placed.lidar_height_m is not None:
        height_m = placed.lidar_height_m
        notes.append(f"No floor in the depth: the LiDAR's height of {height_m:.3f} m is TF's.")
    else:
        assert problem is not None, "without a floor there is a reason"
        raise problem
    cameras = tuple(
        _align_to_seen_floor(camera, floors[camera.topic])
        if camera.topic in floors
        else _align_to_known_height(camera, height_m)
        for camera in placed.cameras
    )
    lidar_height_m = height_m if placed.is_height_known and placed.source != "level" else None
    return FloorAlignment(cameras=cameras, lidar_height_m=lidar_height_m, notes=tuple(notes))


def _find_floors(
    recording: Recording, placed: CameraExtrinsics
) -> tuple[dict[str, FloorPlane], AlignmentFailed | None]:
    """The floor of each camera that sees it, by topic, and why the last other one does not."""
    floors: dict[str, FloorPlane] = {}
    problem = None
    for camera in placed.cameras:
        try:
            floors[camera.topic] = find_floor(
                _sample_images(recording, camera),
                camera.view.intrinsics,
                camera.T_up_camera[2, :3],
                tilt_max_rad=float(np.deg2rad(_TILT_MAX_DEG[placed.source])),
            )
        except AlignmentFailed as error:
            problem = AlignmentFailed(
                f"{camera.topic}: {error.problem}", file=recording.path, advice=error.advice
            )
    return floors, problem


def _sample_images(recording: Recording, camera: MountedCamera) -> list[Float32Array]:
    count = next(topic.count for topic in recording.topics if topic.name == camera.topic)
    images = []
    for index in np.unique(np.linspace(0, count - 1, min(count, _IMAGES_SAMPLED)).astype(np.int64)):
        try:
            value = recording.read(camera.topic, int(index)).value
        except RecordingError:
            # Reading it has left its own warning.
            continue
        if isinstance(value, DepthImage) and value.depth_m.shape == camera.view.stored_shape:
            images.append(camera.view.remap(value.depth_m))
    return images


def _align_to_seen_floor(camera: MountedCamera, floor: FloorPlane) -> FloorAlignedCamera:
    """The camera with the floor's tilt and height, and with the place and yaw of the extrinsics."""
    R = camera.T_up_camera[:3, :3]
    T_floor_camera = np.empty((3, 4))
    T_floor_camera[:, :3] = _rotation_to_vertical(R @ floor.up) @ R
    T_floor_camera[:2, 3] = camera.T_up_camera[:2, 3]
    T_floor_camera[2, 3] = floor.camera_height_m
    return _floor_aligned_camera(camera, T_floor_camera)


def _align_to_known_height(camera: MountedCamera, lidar_height_m: float) -> FloorAlignedCamera:
    T_floor_camera = camera.T_up_camera[:3].copy()
    T_floor_camera[2, 3] += lidar_height_m
    return _floor_aligned_camera(camera, T_floor_camera)


def _floor_aligned_camera(camera: MountedCamera, T_floor_camera: FloatArray) -> FloorAlignedCamera:
    if camera.is_upside_down:
        # Back to the LiDAR's own x and y; heights stay heights.
        T_floor_camera[1] *= -1.0
    return FloorAlignedCamera(topic=camera.topic, view=camera.view, T_floor_camera=T_floor_camera)


def _rotation_to_vertical(direction: FloatArray) -> FloatArray:
    """(3, 3) that turns a unit direction, which is not straight down, to z."""
    x, y, z = direction
    # Rodrigues' formula about direction x z, which lies in the plane.
    K = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    rotation: FloatArray = np.eye(3) + K + K @ K / (1.0 + z)
    return rotation


def _describe_floor(topic: str, floor: FloorPlane) -> str:
    return (
        f"{topic} is {floor.camera_height_m:.3f} m above the floor that {floor.images} of "
        f"its images show."
    )


def _describe_contradictions(
    placed: CameraExtrinsics, floors: dict[str, FloorPlane], height_m: float
) -> Sequence[str]:
    """Notes on where the floor in the depth contradicts the extrinsics."""
    notes = []
    for topic, floor in floors.items():
        tilt_deg = float(np.rad2deg(floor.tilt_rad))
        if placed.is_height_known and tilt_deg > _TILT_REPORTED_DEG:
            notes.append(
                f"{topic}: the floor tilts by {tilt_deg:.1f} degrees against the extrinsics "
                "and is believed."
            )
    recorded_m = placed.lidar_height_m
    if (
        placed.is_height_known
        and recorded_m is not None
        and abs(recorded_m - height_m) > _HEIGHT_REPORTED_M
    ):
        notes.append(
            f"TF has the LiDAR at {recorded_m:.3f} m above the floor, the depth at "
            f"{height_m:.3f} m, which is believed."
        )
    return notes
