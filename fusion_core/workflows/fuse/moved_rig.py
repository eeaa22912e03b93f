"""A rig whose camera a person moves against the LiDAR, and the alignment there, without a pass over
the recording.

Fields and offsets do not depend on where the camera is, and the noise scale belongs to the sensors:
they stay. What depends on the pose is every frame's pairs, which are made when they are asked for.
"""

from dataclasses import replace

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
)
from fusion_core.model.given_extrinsics import CameraPose
from fusion_core.model.rig import MOUNT_PARAMETERS, Mount
from fusion_core.workflows.fuse.align import RecordingAlignment, make_panorama, peak_of_mount
from fusion_core.workflows.fuse.camera_rig import CameraRig, GivenMount
from fusion_core.workflows.fuse.session import Session

SOURCE = "the pose set by hand"
"""How the extrinsics are called in texts for people."""

_CLOCK = MOUNT_PARAMETERS.index("clock_offset_ms")


def camera_pose_of(rig: CameraRig, mount: Mount, camera: int = 0) -> FloatArray:
    """(4, 4) T_lidar_camera of a camera's stored images, by a mount."""
    view_to_lidar = mount.T_lidar_rig @ rig.cameras[camera].T_rig_camera
    T_lidar_camera: FloatArray = view_to_lidar @ _T_view_stored(rig, camera)
    return T_lidar_camera


def move_rig(rig: CameraRig, T_lidar_camera: FloatArray) -> tuple[CameraRig, Mount]:
    """The rig with its first camera's stored images at this pose (4, 4), and its mount there; the
    other cameras move with the first."""
    T_rig_stored = rig.cameras[0].T_rig_camera @ _T_view_stored(rig, 0)
    T_lidar_rig = T_lidar_camera @ invert_transform(T_rig_stored)
    pitch_rad = 0.0
    if len(rig.cameras) == 1:
        # It looks along the rig's x.
        ahead = (T_lidar_rig @ rig.cameras[0].T_rig_camera)[:3, 2]
        pitch_rad = float(-np.arcsin(np.clip(ahead[2], -1.0, 1.0)))
    else:
        ahead = T_lidar_rig[:3, 0]
    forward_m, left_m, delta_z_m = map(float, T_lidar_rig[:3, 3])
    mount = Mount(
        yaw_rad=float(np.arctan2(ahead[1], ahead[0])),
        pitch_rad=pitch_rad,
        forward_m=forward_m,
        left_m=left_m,
        delta_z_m=delta_z_m,
    )
    # What a mount has no number for is in the cameras' own poses.
    T_new_old = invert_transform(mount.T_lidar_rig) @ T_lidar_rig
    cameras = tuple(
        replace(camera, T_rig_camera=T_new_old @ camera.T_rig_camera) for camera in rig.cameras
    )
    moved = replace(rig, cameras=cameras, recorded_mount=None)
    poses = tuple(
        CameraPose(T_camera_lidar=invert_transform(camera_pose_of(moved, mount, camera)))
        for camera in range(len(cameras))
    )
    return replace(moved, given=GivenMount(source=SOURCE, mount=mount, poses=poses)), mount


def move_session(session: Session, T_lidar_camera: FloatArray) -> Session:
    """The session with its rig moved: ``move_rig``."""
    return replace(session, rig=move_rig(session.rig, T_lidar_camera)[0])


def align_moved(
    alignment: RecordingAlignment, session: Session, T_lidar_camera: FloatArray
) -> tuple[Session, RecordingAlignment]:
    """The session with its rig moved, and the recording's alignment there.

    The mount is taken as it is given, and pairs lie along the projected curve; the clock offset is
    the alignment's.
    """
    rig, given = move_rig(session.rig, T_lidar_camera)
    before, estimate = alignment.mount, alignment.estimate
    mount = replace(
        given,
        clock_offset_ms=before.clock_offset_ms,
        sd=(*(None,) * _CLOCK, before.sd[_CLOCK]),
    )
    if estimate is not None:
        estimate = replace(
            estimate,
            mount=mount,
            # Of this pose nothing is known yet.
            agreement=float("nan"),
            visible=float("nan"),
            is_confident=True,
            is_from_recorded=False,
            refusal="",
            yaw_per_delay_rad_s=0.0,
            is_given=True,
            is_confirmed=True,
            contradictions=(),
            moved_from_given="",
            tilt=None,
        )
    panorama = alignment.panorama
    if panorama is not None:
        panorama = make_panorama(rig.cameras, session.settings)
    moved = replace(
        alignment,
        mount=mount,
        estimate=estimate,
        peak=peak_of_mount(alignment, mount, session.settings.search),
        panorama=panorama,
    )
    return replace(session, rig=rig), moved


def _T_view_stored(rig: CameraRig, camera: int) -> FloatArray:
    """(4, 4): the axes of the stored images to those of the upright view."""
    return make_transform(rig.views[camera].R_stored_view.T, np.zeros(3))
