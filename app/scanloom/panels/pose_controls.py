"""The camera's pose by hand: six numbers, and the poses that a person can go back to."""

from collections.abc import Mapping
from dataclasses import dataclass

import viser

from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.page.markup import paragraph
from scanloom.page.update_widget import update_widget
from scanloom.panels.mount_text import unknown_text
from scanloom.panels.widgets.controls import Controls
from scanloom.state.hand_pose import MAX_DISTANCE_M, MAX_PITCH_DEG, HandPose
from scanloom.state.view import View


@dataclass(frozen=True, slots=True, kw_only=True)
class _Number:
    """One of a pose's numbers: label, hint, bounds, and the digits that are shown."""

    label: str
    hint: str
    limit: float
    decimals: int


_NUMBERS: Mapping[str, _Number] = {
    "yaw_deg": _Number(
        label="Yaw (°)", hint="To the left of the LiDAR's zero", limit=180.0, decimals=2
    ),
    "pitch_deg": _Number(label="Pitch (°)", hint="Down", limit=MAX_PITCH_DEG, decimals=2),
    "roll_deg": _Number(
        label="Roll (°)",
        hint="About the line of sight, clockwise as the camera sees it",
        limit=180.0,
        decimals=2,
    ),
    "forward_m": _Number(
        label="Forward (m)", hint="Along the LiDAR's zero", limit=MAX_DISTANCE_M, decimals=3
    ),
    "left_m": _Number(label="Left (m)", hint="Of the LiDAR", limit=MAX_DISTANCE_M, decimals=3),
    "up_m": _Number(label="Up (m)", hint="Above the LiDAR", limit=MAX_DISTANCE_M, decimals=3),
}
# What one press of a number's arrows, or of an arrow key in it, changes: in degrees and metres.
_STEPS = {
    "fine: 0.05°, 2 mm": (0.05, 0.002),
    "medium: 0.2°, 1 cm": (0.2, 0.01),
    "coarse: 1°, 5 cm": (1.0, 0.05),
}
_FIRST_STEP = "medium: 0.2°, 1 cm"


class PoseControls:
    """Numbers with steps. Whatever sets the pose, they show it."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._session = session
        # The displayed pose, from which a first change by hand begins.
        self._pose: HandPose | None = session.view.hand_pose
        self._controls = Controls(gui, session)
        self._numbers = {name: self._add(gui, name) for name in _NUMBERS}
        self._unknown = gui.add_html("")
        self._step = gui.add_dropdown(
            "Step",
            tuple(_STEPS),
            initial_value=_FIRST_STEP,
            hint="Of the arrows beside the numbers, and of the keys ↑ and ↓ in them",
        )
        self._set_step()
        self._step.on_update(lambda _: self._set_step())

    def show(self, frame_view: FrameView) -> None:
        """Set the numbers to the view's pose."""
        if frame_view.calibration is not None:
            self._pose = frame_view.calibration.now.pose
        self._controls.show(frame_view.view)
        text = _unknown_text(frame_view)
        update_widget(self._unknown, content=paragraph(text) if text else "")

    def _add(self, gui: viser.GuiApi, name: str) -> viser.GuiInputHandle[float]:
        about = _NUMBERS[name]
        handle = gui.add_number(
            about.label,
            0.0,
            min=-about.limit,
            max=about.limit,
            step=10.0**-about.decimals,
            hint=about.hint,
        )

        def value_of(view: View) -> float | None:
            pose = view.hand_pose or self._pose
            return None if pose is None else round(getattr(pose, name), about.decimals) + 0.0

        def change(value: float) -> None:
            pose = self._session.view.hand_pose or self._pose
            if pose is not None:
                changed = pose.model_dump() | {name: float(value)}
                self._session.adjust(HandPose(**changed), name)

        self._controls.bind(handle, value_of, change)
        return handle

    def _set_step(self) -> None:
        degrees, metres = _STEPS[self._step.value]
        for name, handle in self._numbers.items():
            update_widget(handle, step=degrees if name.endswith("_deg") else metres)


def _unknown_text(frame_view: FrameView) -> str:
    """Which of the numbers are assumed. A pose that was given says nothing of that."""
    chain = frame_view.chain
    if chain is None or frame_view.calibration is None or chain.session.rig.given is not None:
        return ""
    return unknown_text(chain.alignment.mount)
