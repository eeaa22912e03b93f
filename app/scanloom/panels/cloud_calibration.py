"""The Calibrate step of a 3D LiDAR and a camera: matches of the intensity image with the camera's,
the reprojection curve, and the cloud over the image."""

import html
import threading
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import viser

from fusion_core.model.errors import ScanLoomError
from fusion_core.model.progress import Progress
from fusion_core.workflows.calibrate.turning_rig import image_topic_of
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.jobs.build import extrinsics_in, folder_name
from scanloom.jobs.save_pose import save_cloud_calibration
from scanloom.page.bridge import PageBridge
from scanloom.page.events import PointKind
from scanloom.page.live_picture import LivePicture, PictureMark
from scanloom.page.markup import paragraph, text_box
from scanloom.page.update_widget import update_widget
from scanloom.panels.calibration_result import result_html
from scanloom.panels.command_line import calibrate_camera_command
from scanloom.panels.widgets.controls import Controls
from scanloom.panels.widgets.panel_job import PanelJob
from scanloom.panels.widgets.saved_file import send_saved_file
from scanloom.plots.cloud_overlay import cloud_overlay_picture
from scanloom.plots.line_plot import (
    PlotLabels,
    add_line_plot,
    dots,
    set_limits,
    set_theme,
)
from scanloom.plots.match_picture import MatchPicture, match_picture
from scanloom.plots.palette import color_of
from scanloom.plots.png import show_picture
from scanloom.plots.theme import Theme, theme_of
from scanloom.scene.camera_views import apply
from scanloom.scene.colored_cloud import ColoredCloudNode, view_behind

if TYPE_CHECKING:
    # It takes long to import, and most recordings are of another kind.
    from fusion_core.workflows.calibrate.recorded_camera import RecordedCalibration

_WIDTH_PX = 430
_ABOUT = (
    "The turn of the LiDAR becomes one dense cloud, and its intensities an image, in which "
    "features of the camera's image are found again (Song 2022). It takes a minute or more; a bar "
    "tells how far it is."
)
# Reasons of the matching, in words.
_REASONS = {
    "ratio": "another feature fits nearly as well",
    "RANSAC": "not where the other matches lie",
    "depth edge": "at an edge of depth",
    "no point": "no point of the cloud there",
}
# The first poses, of a few pairs, can be anywhere.
_CURVE_PERCENTILE, _CURVE_ROOM = 90.0, 1.5
# Few counts of pairs are tried: their dots may be large.
_CURVE_DOT_PX = 6.0


class CloudCalibration:
    """The button, the job and its evidence. ``lock``: the panel's own."""

    def __init__(
        self,
        client: viser.ClientHandle,
        bridge: PageBridge,
        session: ClientSession,
        lock: threading.RLock,
        root: Path,
    ) -> None:
        self._session, self._lock, self._root = session, lock, root
        gui, self._camera = client.gui, client.camera
        self._node = ColoredCloudNode(client.scene)
        self._frame_view: FrameView | None = None
        self._drawn: tuple[object, ...] = ()
        # What the scene shows.
        self._staged: object = None
        self._matches: MatchPicture | None = None
        self._saved: Path | None = None
        gui.add_html(paragraph(_ABOUT))
        self._button = gui.add_button("Calibrate")
        self._job = PanelJob(gui, session, lock, self._show_working)
        self._result = gui.add_html("")
        self._evidence = gui.add_folder("Evidence", visible=False)
        with self._evidence:
            self._picture = LivePicture(gui, bridge, "matches")
            self._counts = gui.add_html("")
            self._curve = add_line_plot(
                gui,
                PlotLabels(
                    title="Reprojection error by the pairs used",
                    x="pairs used",
                    x_short="pairs",
                    y="error (px)",
                ),
                (
                    dots("all pairs", color_of("conflict"), _CURVE_DOT_PX),
                    dots("after the filter", color_of("good"), _CURVE_DOT_PX),
                ),
            )
        self._overlay = gui.add_folder("The cloud over the image", visible=False)
        with self._overlay:
            empty = np.full((2, 2, 3), 255, dtype=np.uint8)
            self._clouds = [gui.add_image(empty, format="png", visible=False) for _ in range(2)]
            opacity = gui.add_slider(
                "Opacity of the cloud",
                min=0.0,
                max=1.0,
                step=0.05,
                initial_value=session.view.overlay_opacity,
                hint="What the image shows under the points",
            )
        self._controls = Controls(gui, session)
        self._controls.bind_field(opacity, "overlay_opacity", float)
        with gui.add_folder("The result as a file"):
            self._save = gui.add_button("Save the result")
            self._download = gui.add_button("Download the result", color="gray")
            self._command = gui.add_html("")
        self._button.on_click(lambda _: self._begin())

        @self._save.on_click
        def _(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            self._write()

        self._download.on_click(lambda _: self._send())
        self._picture.on_point(self._pointed)

    def show(self, frame_view: FrameView) -> None:
        """Display the result of the view's recording, if there is one. Hold the lock."""
        self._frame_view = frame_view
        self._controls.show(frame_view.view)
        found = self._own()
        self._node.show(is_visible=found is not None)
        for folder in (self._evidence, self._overlay):
            update_widget(folder, visible=found is not None)
        for button in (self._save, self._download):
            update_widget(button, disabled=found is None)
        recording = self._session.recording_path(frame_view.view.recording)
        topic = image_topic_of(frame_view.open_recording.recording)
        output = self._saved or extrinsics_in(self._root / folder_name(recording.stem))
        command = calibrate_camera_command(recording, topic, output)
        saved = "" if self._saved is None else text_box(str(self._saved))
        note = paragraph("On the command line")
        update_widget(self._command, content=f"{saved}{note}{text_box(command)}")
        if found is None:
            update_widget(self._result, content="")
            return
        theme = theme_of(is_dark=frame_view.is_dark)
        inputs = found, theme, frame_view.view.overlay_opacity
        if inputs == self._drawn:
            return
        is_new = self._drawn[:2] != inputs[:2]
        self._drawn = inputs
        self._show_clouds(found, frame_view.view.overlay_opacity, theme)
        if is_new:
            self._show_evidence(found, theme)
        if self._staged is not found:
            self._staged = found
            colored, estimate = found.colored, found.calibration.estimate
            self._node.draw(colored.points_m, colored.rgb)
            apply(self._camera, view_behind(estimate.T_camera_lidar, colored.points_m))

    def hide(self) -> None:
        """Take the cloud out of the scene, while another step or recording is shown."""
        self._node.show(is_visible=False)

    def close(self) -> None:
        """Cancel the job: the browser has disconnected."""
        self._job.close()

    def _own(self) -> "RecordedCalibration | None":
        return self._session.found_of(self._session.view.recording)

    def _begin(self) -> None:
        frame_view = self._frame_view
        if frame_view is None:
            return
        opened, name = frame_view.open_recording.recording, frame_view.view.recording
        topic = image_topic_of(opened)

        def work(progress: Progress) -> "RecordedCalibration":
            from fusion_core.workflows.calibrate.recorded_camera import calibrate_recorded_camera

            return calibrate_recorded_camera(opened.path, topic, None, progress)

        def done(found: "RecordedCalibration") -> None:
            with self._lock:
                self._session.keep_found(name, found)
                self._saved = None
            self._job.end()

        self._job.begin("camera calibration", work, done)

    def _show_working(self, is_at_work: bool) -> None:
        update_widget(self._button, disabled=is_at_work)

    def _show_evidence(self, found: "RecordedCalibration", theme: Theme) -> None:
        calibration = found.calibration
        estimate, features = calibration.estimate, calibration.features
        error = ""
        if estimate.reprojection_rms_px is not None:
            error = f"{estimate.reprojection_rms_px:.2f} px on pairs that were held out"
            if estimate.reprojection_rms_used_px is not None:
                error += f", {estimate.reprojection_rms_used_px:.2f} px on those used"
            error = f"Reprojection error: {error}."
        update_widget(self._result, content=result_html(estimate, error))
        self._matches = match_picture(
            found.grey,
            calibration.feature_image.picture,
            features.image_px,
            features.intensity_px,
            features.accepted,
            width_px=_WIDTH_PX,
            theme=theme,
        )
        self._picture.show(self._matches.rgb)
        self._picture.mark([])
        update_widget(self._counts, content=_counts_html(features.reasons))
        curve = calibration.curve
        set_theme(self._curve, theme)
        self._curve.data = (
            curve.pairs.astype(np.float64),
            curve.unfiltered_px.copy(),
            curve.filtered_px.copy(),
        )
        errors = np.concatenate([curve.unfiltered_px, curve.filtered_px])
        errors = errors[np.isfinite(errors)]
        top = float(np.percentile(errors, _CURVE_PERCENTILE)) if errors.size else 1.0
        set_limits(self._curve, 0.0, round(_CURVE_ROOM * top, 1) or 1.0)
        update_widget(self._curve, visible=errors.size > 0)

    def _show_clouds(self, found: "RecordedCalibration", opacity: float, theme: Theme) -> None:
        is_kept = not found.calibration.estimate.improved
        clouds = [("The guess, kept" if is_kept else "Now: by the result", found.now)]
        if found.before is not None:
            clouds.insert(0, ("Before: by the guess", found.before))
        for handle, place in zip(self._clouds, range(2), strict=True):
            update_widget(handle, visible=place < len(clouds))
        for handle, (title, cloud) in zip(self._clouds, clouds, strict=False):
            drawn = cloud_overlay_picture(
                found.grey,
                cloud,
                title=title,
                width_px=_WIDTH_PX,
                opacity=opacity,
                theme=theme,
            )
            show_picture(handle, drawn)

    def _pointed(self, kind: PointKind, x_px: float, y_px: float) -> None:
        """Mark the match under the pointer, and say what became of it."""
        found, drawn = self._own(), self._matches
        if found is None or drawn is None:
            return
        place = None if kind == "leave" else drawn.pair_at(x_px, y_px)
        if place is None:
            self._picture.mark([])
            return
        ends = drawn.upper_px[place], drawn.lower_px[place]
        reason = found.calibration.features.reasons[int(drawn.pairs[place])]
        marks = [PictureMark("cross", float(x), float(y)) for x, y in ends]
        self._picture.mark(marks, _reason_text(reason))

    def _write(self) -> Path | None:
        found, frame_view = self._own(), self._frame_view
        if found is None or frame_view is None:
            return None
        if self._saved is None or not self._saved.exists():
            recording = frame_view.open_recording.recording.path
            try:
                self._saved = save_cloud_calibration(found, recording, self._root)
            except ScanLoomError as error:
                self._session.show_failure(error)
                return None
        self._session.refresh()
        return self._saved

    def _send(self) -> None:
        path = self._write()
        if path is not None:
            send_saved_file(self._session, path)


def _reason_text(reason: str) -> str:
    """What became of a match."""
    return f"rejected: {_REASONS.get(reason, reason)}" if reason else "accepted"


def _counts_html(reasons: tuple[str, ...]) -> str:
    """How many matches are accepted, and how many are rejected for each reason."""
    counts = Counter(reasons)
    rows = [("accepted", counts.pop("", 0)), *counts.most_common()]
    cells = "".join(
        f"<tr><td>{html.escape(_REASONS.get(reason, reason))}</td><td>{count}</td></tr>"
        for reason, count in rows
    )
    return (
        '<div class="scanloom-result"><table><caption>Matches of features; some are drawn, '
        f"rejected ones grey</caption>{cells}</table></div>"
    )
