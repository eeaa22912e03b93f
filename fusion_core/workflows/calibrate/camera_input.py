"""What ``scanloom calibrate camera`` reads: a cloud, an image, intrinsics and a guess."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion_core.calibration.turning.turn import SELF_CALIBRATION_PARAMETERS
from fusion_core.files.regular_file import open_regular
from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.errors import CalibrationFailed, MissingStream, RecordingError
from fusion_core.model.progress import Progress
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import CameraInfo, CameraIntrinsics, ColorImage, PointCloud
from fusion_core.recordings.calibration_files.extrinsics import read_guess
from fusion_core.recordings.calibration_files.intrinsics import read_intrinsics
from fusion_core.recordings.clouds.formats import cloud_format, read_cloud
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.images.frame_files import read_rgb
from fusion_core.workflows.calibrate.camera_settings import CameraSettings
from fusion_core.workflows.calibrate.lidar import calibrate_turn, dense_cloud
from fusion_core.workflows.calibrate.turn_recording import TurnRecording
from fusion_core.workflows.source import input_files

_HEAD_BYTES = 512


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraInput:
    """``cloud``: finite or NaN, in the frame ``lidar_frame``. ``rgb``: (H, W, 3) uint8. ``files``:
    what was read. ``turn``: how the LiDAR is mounted on its axis, where the cloud is that of a
    recorded turn, ready for JSON."""

    cloud: PointCloud
    rgb: ByteArray
    intrinsics: CameraIntrinsics
    T_guess: FloatArray | None
    files: list[Path]
    lidar_frame: str
    camera_frame: str
    turn: dict[str, float] | None
    notes: list[str]


@dataclass(frozen=True, kw_only=True)
class _Camera:
    rgb: ByteArray | None
    intrinsics: CameraIntrinsics | None
    frame: str


def read_camera_input(
    source: Path,
    image: Path,
    *,
    intrinsics_file: Path | None,
    guess_file: Path | None,
    points: str | None,
    joint: str | None,
    settings: CameraSettings,
    progress: Progress,
) -> CameraInput:
    """Raises ScanLoomError for what cannot be read or lacks something."""
    notes: list[str] = []
    files = [path for path in (image, intrinsics_file, guess_file) if path is not None]
    turn = None
    recorded = _Camera(rgb=None, intrinsics=None, frame="camera")
    if _is_cloud(source):
        cloud = read_cloud(source, notes)
        files.append(source)
        lidar_frame = cloud.frame_id or "lidar"
    else:
        with open_recording(source) as recording:
            files += input_files(recording)
            recorded = _recorded_camera(recording, image)
            cloud, turn, turn_notes = _turned_cloud(recording, points, joint, settings, progress)
            notes += turn_notes
        lidar_frame = cloud.frame_id
    if recorded.rgb is not None:
        rgb = recorded.rgb
        files.remove(image)
    else:
        rgb = read_rgb(image)
    height, width = rgb.shape[:2]
    if intrinsics_file is not None:
        intrinsics = read_intrinsics(intrinsics_file, (width, height), notes)
    elif recorded.intrinsics is not None:
        intrinsics = recorded.intrinsics
    else:
        raise MissingStream(
            "the intrinsics of the camera are not known.",
            file=image,
            advice="Give them with --intrinsics FILE; `scanloom calibrate intrinsics` finds them.",
        )
    return CameraInput(
        cloud=cloud,
        rgb=rgb,
        intrinsics=intrinsics,
        T_guess=None if guess_file is None else read_guess(guess_file),
        files=files,
        lidar_frame=lidar_frame,
        camera_frame=recorded.frame,
        turn=turn,
        notes=notes,
    )


def _is_cloud(path: Path) -> bool:
    if not path.is_file():
        return False
    try:
        with open_regular(path) as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}.", file=path) from error
    return cloud_format(path, head, path.stat().st_size) is not None


def _recorded_camera(recording: Recording, image: Path) -> _Camera:
    """The first image of the topic that ``image`` names, if it is no file, and the first intrinsics
    in the recording, those of its own camera before others'."""
    rgb, stated, frame = None, [], "camera"
    infos = [topic.name for topic in recording.topics if topic.type.endswith("CameraInfo")]
    for name in infos:
        for message in recording.messages([name]):
            if isinstance(message.value, CameraInfo) and message.value.intrinsics is not None:
                stated.append((name, message.value))
                break
    topics = {topic.name for topic in recording.topics}
    if not image.exists() and str(image) in topics:
        for message in recording.messages([str(image)]):
            if isinstance(message.value, ColorImage):
                rgb, frame = message.value.rgb, message.value.frame_id
                break
        else:
            raise MissingStream(
                f"{image} holds no colour image.",
                file=recording.path,
                advice="Name a topic of colour images, or give an image file.",
            )
    own = [info for _, info in stated if rgb is None or info.frame_id == frame]
    chosen = own[0] if len({info.frame_id for info in own}) == 1 else None
    return _Camera(
        rgb=rgb,
        intrinsics=None if chosen is None else chosen.intrinsics,
        frame=frame if chosen is None else chosen.frame_id,
    )


def _turned_cloud(
    recording: Recording,
    points: str | None,
    joint: str | None,
    settings: CameraSettings,
    progress: Progress,
) -> tuple[PointCloud, dict[str, float], list[str]]:
    """The dense cloud of a recorded turn, by the mounting that it shows itself."""
    source = TurnRecording(recording, points, joint)
    try:
        _, mounting, notes = calibrate_turn(source, settings, progress)
    except CalibrationFailed as error:
        raise CalibrationFailed(
            f"the turn cannot be calibrated: {error.problem}",
            file=error.file or recording.path,
            advice=error.advice,
        ) from error
    xyz_m, intensity, left_out = dense_cloud(source, mounting.T_axis_lidar, settings, progress)
    cloud = PointCloud(
        stamp_ns=0,
        received_ns=None,
        frame_id="rig",
        xyz_m=xyz_m,
        intensity=None if intensity is None else intensity.astype(np.float32),
    )
    turn = dict(zip(SELF_CALIBRATION_PARAMETERS, map(float, mounting.parameters), strict=True))
    return cloud, turn, [*notes, *left_out]
