"""Calibration of a 2D LiDAR and a depth camera without a board: walls and floor that both see.

Started from a guess and from the mount that the chain of ``fuse`` finds, all six degrees of freedom
are refined (``natural_fit.py``). Frames that were held out decide whether the result is better than
the guess, and disturbed starts show from how far it is found (``natural_evidence.py``).
"""

from dataclasses import replace

from threadpoolctl import threadpool_limits

from fusion_core.calibration.planar.natural_settings import NaturalSettings
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import AlignmentFailed, CalibrationFailed, MissingStream
from fusion_core.model.extrinsics import ExtrinsicsEstimate
from fusion_core.model.geometry import invert_transform
from fusion_core.model.given_extrinsics import CameraPose, GivenExtrinsics
from fusion_core.model.progress import Progress, silent
from fusion_core.model.recording import Recording
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.calibrate.natural_evidence import judge_fit, keep_guess
from fusion_core.workflows.calibrate.natural_fit import UprightImages, find_pose
from fusion_core.workflows.fuse.camera_rig import build_camera_rig
from fusion_core.workflows.fuse.moved_rig import camera_pose_of
from fusion_core.workflows.fuse.session import Session, session_of
from fusion_core.workflows.fuse.settings import PRESETS


def calibrate_without_board(
    recording: Recording,
    settings: NaturalSettings | None = None,
    *,
    T_guess: FloatArray | None = None,
    lidar_topic: str | None = None,
    depth_topic: str | None = None,
    ignore_transforms: bool = False,
    progress: Progress = silent,
) -> ExtrinsicsEstimate:
    """T_camera_lidar of a recording's depth camera, whose stored images it is of.

    ``T_guess``: (4, 4), by default the recording's own transforms unless ``ignore_transforms``.
    A guess is kept, with the reason, where the result is not better on held-out frames or where the
    recording determines none.

    Raises MissingStream without LiDAR or depth images, SettingsError for a guess that no camera
    can have, CalibrationFailed where the recording does not determine the pose and there is no
    guess.
    """
    settings = settings or NaturalSettings()
    # Sums of several threads would depend on the number of cores.
    with threadpool_limits(1, user_api="blas"):
        session, T_guess = _open(recording, lidar_topic, depth_topic, T_guess, ignore_transforms)
        view = UprightImages.of(session.rig, T_guess)
        try:
            found = find_pose(session, view, settings, progress)
        except (CalibrationFailed, AlignmentFailed) as error:
            if T_guess is None:
                if isinstance(error, CalibrationFailed):
                    raise
                raise CalibrationFailed(
                    error.problem, file=recording.path, advice=error.advice
                ) from error
            return keep_guess(T_guess, error.problem)
        return judge_fit(found, view, settings, progress)


def _open(
    recording: Recording,
    lidar_topic: str | None,
    depth_topic: str | None,
    T_guess: FloatArray | None,
    ignore_transforms: bool,
) -> tuple[Session, FloatArray | None]:
    """The recording with the camera alone, its mount unknown to the chain; and the guess."""
    streams = choose_streams(
        recording, lidar=lidar_topic, depth=None if depth_topic is None else (depth_topic,)
    )
    if len(streams.depth) > 1:
        raise MissingStream(
            f"has {len(streams.depth)} depth cameras: {', '.join(streams.depth)}.",
            file=recording.path,
            advice="Name the one to calibrate with --depth.",
        )
    chain = PRESETS["default"]
    if ignore_transforms:
        streams = replace(streams, tf_static=None)
    rig = build_camera_rig(recording, streams, chain.sampling)
    if not rig.cameras[0].calibrated:
        raise CalibrationFailed(
            f"{rig.cameras[0].topic} has no usable intrinsics.",
            file=recording.path,
            advice="Record its CameraInfo.",
        )
    if T_guess is None and rig.recorded_mount is not None:
        T_guess = invert_transform(camera_pose_of(rig, rig.recorded_mount))
    if T_guess is not None:
        given = GivenExtrinsics(
            source="the guess", cameras={None: CameraPose(T_camera_lidar=T_guess.copy())}
        )
        rig = build_camera_rig(recording, streams, chain.sampling, given=given)
    unknown = replace(rig, recorded_mount=None, given=None)
    return session_of(recording, streams, unknown, chain), T_guess
