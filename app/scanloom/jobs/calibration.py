"""A calibration of the view's LiDAR and camera from walls and floor, without a board."""

from dataclasses import dataclass
from pathlib import Path

from fusion_core.model.conventions import FloatArray
from fusion_core.model.extrinsics import ExtrinsicsEstimate
from fusion_core.model.geometry import invert_transform
from fusion_core.model.progress import Progress
from fusion_core.workflows.source import open_source
from scanloom.state.hand_pose import HandPose
from scanloom.state.view import View


@dataclass(frozen=True, kw_only=True)
class CalibrationRequest:
    """What to calibrate: the camera ``depth_topic`` of ``view`` in the file ``recording``.
    ``guess``: the pose to begin from, (4, 4) T_camera_lidar; None for the recording's own."""

    view: View
    recording: Path
    depth_topic: str
    guess: FloatArray | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class FinishedCalibration:
    """``pose``: the estimate's, as a view has it."""

    request: CalibrationRequest
    estimate: ExtrinsicsEstimate
    pose: HandPose


def calibrate(request: CalibrationRequest, progress: Progress) -> FinishedCalibration:
    """Calibrate with a file of its own, which stays open when the browser goes elsewhere. Raises as
    ``calibrate_without_board``, and RecordingError."""
    # It takes long to import, and is seldom asked for.
    from fusion_core.workflows.calibrate.natural import calibrate_without_board

    with open_source(request.recording, None) as recording:
        estimate = calibrate_without_board(
            recording,
            T_guess=request.guess,
            lidar_topic=request.view.lidar_topic,
            depth_topic=request.depth_topic,
            progress=progress,
        )
    pose = HandPose.of_transform(invert_transform(estimate.T_camera_lidar))
    return FinishedCalibration(request=request, estimate=estimate, pose=pose)
