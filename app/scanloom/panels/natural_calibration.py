"""Calibration at a press: a long job, its verdict, and the pose that it gives to all steps."""

import threading
from pathlib import Path

import viser

from fusion_core.model.geometry import invert_transform
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.jobs.build import extrinsics_in, folder_name
from scanloom.jobs.calibration import CalibrationRequest, FinishedCalibration, calibrate
from scanloom.page.markup import paragraph, text_box
from scanloom.page.update_widget import update_widget
from scanloom.panels.calibration_result import result_html
from scanloom.panels.command_line import calibrate_command
from scanloom.panels.widgets.panel_job import PanelJob
from scanloom.state.calibration_view import CalibrationView

_ABOUT = (
    "Finds the pose from walls and floor that both sensors see over the whole recording. It begins "
    "at the pose as it is, and keeps that where it finds no better one."
)


class NaturalCalibration:
    """The button, the job and its result. ``lock``: the panel's own."""

    def __init__(
        self, gui: viser.GuiApi, session: ClientSession, lock: threading.RLock, root: Path
    ) -> None:
        self._session, self._lock, self._root = session, lock, root
        self._frame_view: FrameView | None = None
        self._finished: FinishedCalibration | None = None
        gui.add_html(paragraph(_ABOUT))
        self._button = gui.add_button("Calibrate")
        self._job = PanelJob(gui, session, lock, self._show_working)
        self._result = gui.add_html("")
        self._again = gui.add_button(
            "Use this pose", color="gray", visible=False, hint="The calibration's result"
        )
        with gui.add_folder("On the command line", expand_by_default=False):
            self._command = gui.add_html("")
        self._button.on_click(lambda _: self._begin())
        self._again.on_click(lambda _: self._use())

    def show(self, frame_view: FrameView, file: Path | None) -> None:
        """Display the result of the view's recording, if there is one. ``file``: of the pose as it
        is, None without one. Hold the lock."""
        self._frame_view = frame_view
        finished, shown = self.finished, frame_view.calibration
        update_widget(self._button, disabled=self._job.is_running or shown is None)
        content, is_other = "", False
        if finished is not None and shown is not None:
            is_other = shown.now.pose != finished.pose
            content = result_html(finished.estimate, _agreement_text(shown, is_other=is_other))
        update_widget(self._result, content=content)
        update_widget(self._again, visible=is_other)
        self._show_command(frame_view, file)

    def close(self) -> None:
        """Cancel the job: the browser has disconnected."""
        self._job.close()

    @property
    def finished(self) -> FinishedCalibration | None:
        """The last calibration, None where it was of another recording."""
        finished = self._finished
        is_own = finished is not None and (
            finished.request.view.recording == self._session.view.recording
        )
        return finished if is_own else None

    def _begin(self) -> None:
        request = self._request()
        if request is None:
            return

        def done(finished: FinishedCalibration) -> None:
            with self._lock:
                self._finished = finished
            self._job.end()
            if finished.estimate.improved:
                self._use()

        self._job.begin("calibration", lambda progress: calibrate(request, progress), done)

    def _request(self) -> CalibrationRequest | None:
        frame_view = self._frame_view
        if frame_view is None or frame_view.calibration is None:
            return None
        guess = None
        # The recording's own pose is the method's to find.
        if frame_view.session.rig.given is not None:
            guess = invert_transform(frame_view.calibration.now.pose.T_lidar_camera)
        return CalibrationRequest(
            view=frame_view.view,
            recording=frame_view.open_recording.recording.path,
            depth_topic=frame_view.session.rig.cameras[0].topic,
            guess=guess,
        )

    def _use(self) -> None:
        """Give the result to all steps, as a change that can be undone."""
        finished = self.finished
        if finished is not None and not self._job.is_closed:
            self._session.adjust(finished.pose, "calibration")

    def _show_command(self, frame_view: FrameView, file: Path | None) -> None:
        recording = self._session.recording_path(frame_view.view.recording)
        folder = self._root / folder_name(recording.stem)
        is_given = frame_view.chain is not None and frame_view.session.rig.given is not None
        guess = (file or extrinsics_in(folder)) if is_given else None
        command = calibrate_command(recording, folder / "calibrated.json", guess)
        is_unsaved = guess is not None and file is None
        note = paragraph("The guess is the pose as it is: save it first.") if is_unsaved else ""
        update_widget(self._command, content=text_box(command) + note)

    def _show_working(self, is_at_work: bool) -> None:
        update_widget(self._button, disabled=is_at_work)


def _agreement_text(shown: CalibrationView, *, is_other: bool) -> str:
    """How many of the LiDAR's points agree with the camera, before and by the pose as it is."""
    now = shown.now.agreement
    text = f"{now.fraction:.1%} of the LiDAR's points agree in {now.frames} images"
    if shown.before is not None:
        text += f", {shown.before.agreement.fraction:.1%} before"
    return f"{text}. This is by the pose that was set since." if is_other else f"{text}."
