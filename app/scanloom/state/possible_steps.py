"""Which steps a recording allows, and why not the others."""

from scanloom.state.open_recording import OpenRecording
from scanloom.state.slam_choices import streams_of
from scanloom.state.view import PANELS, MapMode, PanelName, View

_NO_SCANS = "The recording has neither a 2D LiDAR nor a depth camera: there is nothing to map."


def why_not(step: PanelName, open_recording: OpenRecording) -> str:
    """Why a step has nothing to work on, a sentence for people; empty where it has."""
    match step:
        case "Recording":
            return ""
        case "Map":
            has_scans = streams_of(open_recording.opened) & {"lidar", "depth"}
            return "" if has_scans else _NO_SCANS
        case "Calibrate":
            if open_recording.has_turning_lidar:
                return ""
            return open_recording.opened.why_not_fused or _why_not_calibrated(open_recording)
        case _:
            return open_recording.opened.why_not_fused


def _why_not_calibrated(open_recording: OpenRecording) -> str:
    session = open_recording.fuse_session
    if session.virtual_row is not None:
        return "The scan is cut from the depth image itself: there is nothing to calibrate."
    if not all(camera.calibrated for camera in session.rig.cameras):
        return (
            "The camera's intrinsics are not recorded: where the LiDAR's points are in its image "
            "is not known."
        )
    return ""


def reasons_by_step(open_recording: OpenRecording) -> dict[PanelName, str]:
    """The reason of each step that has nothing to work on."""
    reasons = {step: why_not(step, open_recording) for step in PANELS}
    return {step: reason for step, reason in reasons.items() if reason}


def map_mode_of(view: View, open_recording: OpenRecording) -> MapMode:
    """The mode of the Map step: SLAM is the only one of a recording that cannot be fused."""
    return view.map_mode if open_recording.can_be_fused else "SLAM"
