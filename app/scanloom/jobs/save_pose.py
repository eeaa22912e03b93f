"""The pose of a view's camera as files: those of a calibration."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion_core.model.extrinsics import ExtrinsicsEstimate
from fusion_core.model.geometry import invert_transform
from fusion_core.workflows.calibrate.by_hand import estimate_by_hand
from fusion_core.workflows.calibrate.result_files import write_result
from fusion_core.workflows.fuse.camera_rig import CameraRig
from fusion_core.workflows.fuse.moved_rig import camera_pose_of, move_rig
from scanloom.jobs.build import extrinsics_in, new_folder
from scanloom.state.calibration_view import CalibrationView

if TYPE_CHECKING:
    # It takes long to import, and most recordings are of another kind.
    from fusion_core.workflows.calibrate.recorded_camera import RecordedCalibration


def estimate_of(shown: CalibrationView) -> ExtrinsicsEstimate:
    """The displayed pose, as a result of a person's work."""
    before = shown.before
    return estimate_by_hand(
        invert_transform(shown.now.pose.T_lidar_camera),
        shown.now.agreement,
        None if before is None else invert_transform(before.pose.T_lidar_camera),
        None if before is None else before.agreement,
    )


def save_pose(
    estimate: ExtrinsicsEstimate, recording: Path, rig: CameraRig, camera_frame: str, root: Path
) -> Path:
    """Write an estimate of a recording's rig into a new folder below ``root``: as JSON, whose path
    is returned, and for ROS beside it. Raises ExportError where it cannot be written."""
    with new_folder(root, recording) as folder:
        write_result(
            extrinsics_in(folder),
            estimate,
            inputs=[recording],
            camera_frame=camera_frame or "camera",
            lidar_frame=rig.lidar_frame or "lidar",
            intrinsics=rig.stored_intrinsics[0],
            more=_by_topic(rig, estimate),
        )
    return extrinsics_in(folder)


def save_cloud_calibration(found: "RecordedCalibration", recording: Path, root: Path) -> Path:
    """The same of a 3D LiDAR and a camera."""
    given = found.given
    with new_folder(root, recording) as folder:
        write_result(
            extrinsics_in(folder),
            found.calibration.estimate,
            inputs=[recording, *given.files],
            camera_frame=given.camera_frame,
            lidar_frame=given.lidar_frame,
            intrinsics=given.intrinsics,
        )
    return extrinsics_in(folder)


def _by_topic(rig: CameraRig, estimate: ExtrinsicsEstimate) -> dict[str, Any] | None:
    """Each camera's transform by its depth topic, where there are several: they move as one."""
    if len(rig.cameras) < 2:
        return None
    moved, mount = move_rig(rig, invert_transform(estimate.T_camera_lidar))
    tables = {
        camera.topic: {
            "T_camera_lidar": invert_transform(camera_pose_of(moved, mount, number)).tolist()
        }
        for number, camera in enumerate(moved.cameras)
    }
    return {"cameras": tables}
