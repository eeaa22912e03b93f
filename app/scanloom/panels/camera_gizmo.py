"""The handles by which the camera is moved against the LiDAR in the 3D scene."""

import itertools
from functools import partial

import numpy as np
import viser

from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.errors import SettingsError
from fusion_core.model.geometry import make_transform, rotation_from_quaternion
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.jobs.ordered_calls import OrderedCalls
from scanloom.page_parts import Panel
from scanloom.scene.geometry import quaternion
from scanloom.state.hand_pose import HandPose
from scanloom.state.history import GESTURE

_NAME = "/camera_handles"
# Handles that begin beside the camera's frustum and do not cover the room.
_SCALE_M = 0.45
# What a hand on a screen can mean: links and files stay readable.
_DECIMALS_DEG, _DECIMALS_M = 2, 3


class CameraGizmo(Panel):
    """Arrows and rings at the first camera, in the Calibrate step. A gesture is one step of undo.

    While a person holds them, they are where the hand is, and the view follows.
    """

    def __init__(self, client: viser.ClientHandle, session: ClientSession) -> None:
        self._session = session
        self._handles = client.scene.add_transform_controls(
            _NAME, _SCALE_M, line_width=3.0, disable_sliders=True, depth_test=False, visible=False
        )
        self._numbers = itertools.count()
        self._gesture, self._is_held = 0, False
        self._shown: HandPose | None = None
        self._moves = OrderedCalls(lambda run: client.gui._thread_executor.submit(run))

        # viser runs other functions in any order, but waits for this one.
        async def moved(event: viser.TransformControlsEvent) -> None:
            if event.phase == "start":
                self._gesture, self._is_held = next(self._numbers), True
                return
            self._is_held = event.phase == "update"
            pose = tuple(map(float, (*event.target.wxyz, *event.target.position)))
            self._moves.add(partial(self._move, f"{GESTURE} {self._gesture}", pose))

        self._handles.on_update(moved)

    def show(self, frame_view: FrameView) -> None:
        """Put the handles where the view's camera is."""
        view, calibration = frame_view.view, frame_view.calibration
        is_shown = calibration is not None and view.show_gizmo
        if self._handles.visible != is_shown:
            self._handles.visible = is_shown
        if calibration is None or self._is_held or calibration.now.pose == self._shown:
            return
        self._shown = calibration.now.pose
        T = self._shown.T_lidar_camera
        self._handles.wxyz = quaternion(T[:3, :3] @ R_BODY_OPTICAL.T)
        self._handles.position = T[:3, 3]

    def _move(self, gesture: str, pose: tuple[float, ...]) -> None:
        w, x, y, z, *position_m = pose
        try:
            R = rotation_from_quaternion(x, y, z, w) @ R_BODY_OPTICAL
            exact = HandPose.of_transform(make_transform(R, np.array(position_m)))
        except (ValueError, SettingsError):
            # A browser may send any numbers; and a hand may reach beyond the bounds.
            return
        rounded = {
            name: round(value, _DECIMALS_DEG if name.endswith("_deg") else _DECIMALS_M)
            for name, value in exact.model_dump().items()
        }
        self._shown = None
        self._session.adjust(HandPose(**rounded), gesture)
