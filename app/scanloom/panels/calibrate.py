"""The Calibrate panel: the LiDAR's points over the camera's image, the pose by hand, before and
after, and the pose as a file."""

import os
import threading
from pathlib import Path

import numpy as np
import viser

from fusion_core.model.conventions import ByteArray, Float32Array
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.extrinsics import ExtrinsicsEstimate
from fusion_core.workflows.fuse.color_of_frame import remap_color
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.jobs.save_pose import estimate_of, save_pose
from scanloom.page.bridge import PageBridge
from scanloom.page.markup import paragraph, text_box
from scanloom.page.update_widget import update_widget
from scanloom.page_parts import Panel
from scanloom.panels.cloud_calibration import CloudCalibration
from scanloom.panels.command_line import view_command
from scanloom.panels.natural_calibration import NaturalCalibration
from scanloom.panels.pose_controls import PoseControls
from scanloom.panels.pose_sources import PoseSources
from scanloom.panels.widgets.controls import Controls
from scanloom.panels.widgets.saved_file import send_saved_file
from scanloom.plots.curve_overlay import curve_overlay_picture, range_limits_m
from scanloom.plots.png import show_picture
from scanloom.plots.theme import theme_of
from scanloom.scene.depth_surface import is_registered
from scanloom.state.calibration_view import CalibrationView, PoseView
from scanloom.state.hand_pose import HandPose
from scanloom.state.view import CalibrationPictures

# Slightly wider than the panel, so that an enlarged picture stays sharp, and its letters legible.
_WIDTH_PX, _HEIGHT_PX = 430, 420
_PICTURES: dict[CalibrationPictures, str] = {
    "now": "as it is now",
    "before": "before the adjustment",
    "both": "before and now",
}
_PICTURES_OF = {words: name for name, words in _PICTURES.items()}


class CalibratePanel(Panel):
    """Pictures of the curve over the image, and the pose's controls."""

    def __init__(
        self,
        client: viser.ClientHandle,
        bridge: PageBridge,
        session: ClientSession,
        output_root: Path,
    ) -> None:
        gui, self._session = client.gui, session
        # The command may be run in another working directory.
        self._root = Path(os.path.realpath(output_root))
        self._lock = threading.RLock()
        self._frame_view: FrameView | None = None
        # The pose that was saved last, and its file.
        self._saved: tuple[HandPose, Path] | None = None
        # What the pictures were drawn from.
        self._drawn: tuple[object, ...] = ()
        self._planar = gui.add_folder(None)
        with self._planar:
            controls = self._controls = Controls(gui, session)
            which = self._which = gui.add_dropdown(
                "Show",
                tuple(_PICTURES_OF),
                initial_value=_PICTURES[session.view.calibration_pictures],
                hint="The LiDAR's points over the image, by the pose before the adjustment or by "
                "that of now",
            )
            controls.bind_field(
                which, "calibration_pictures", _PICTURES_OF.__getitem__, _PICTURES.__getitem__
            )
            empty = np.full((2, 2, 3), 255, dtype=np.uint8)
            self._pictures = [gui.add_image(empty, format="png", visible=False) for _ in range(2)]
            opacity = gui.add_slider(
                "Opacity",
                min=0.0,
                max=1.0,
                step=0.05,
                initial_value=session.view.overlay_opacity,
                hint="Of the LiDAR's points: what the image shows under them",
            )
            controls.bind_field(opacity, "overlay_opacity", float)
            with gui.add_folder("Find the pose"):
                self._natural = NaturalCalibration(gui, session, self._lock, self._root)
            with gui.add_folder("The camera on the LiDAR, by hand"):
                self._sources = PoseSources(gui, bridge, session)
                self._numbers = PoseControls(gui, session)
                gizmo = gui.add_checkbox(
                    "3D handles",
                    session.view.show_gizmo,
                    hint="Drag the arrows and the rings at the camera in the 3D scene",
                )
                controls.bind_field(gizmo, "show_gizmo", bool)
            with gui.add_folder("The pose as a file"):
                save = gui.add_button(
                    "Save as file",
                    hint="JSON as of scanloom calibrate, with YAML, URDF and a static transform "
                    "beside it, below the output folder",
                )
                download = gui.add_button(
                    "Download",
                    color="gray",
                    hint="Save it, and keep the JSON file here",
                )
                self._file = gui.add_html("")
                self._command = gui.add_html("")
        self._of_cloud = gui.add_folder(None, visible=False)
        with self._of_cloud:
            self._cloud = CloudCalibration(client, bridge, session, self._lock, self._root)

        @save.on_click
        def _(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            self._save()

        download.on_click(lambda _: self._send())

    def show(self, frame_view: FrameView) -> None:
        """Draw the pictures of this view, while the panel is open."""
        if frame_view.view.panel != "Calibrate":
            self._cloud.hide()
            return
        with self._lock:
            has_cloud = frame_view.open_recording.has_turning_lidar
            update_widget(self._planar, visible=not has_cloud)
            update_widget(self._of_cloud, visible=has_cloud)
            if has_cloud:
                self._cloud.show(frame_view)
                return
            self._cloud.hide()
            self._controls.show(frame_view.view)
            self._frame_view = frame_view
            self._numbers.show(frame_view)
            self._sources.show(frame_view)
            self._show_file(frame_view)
            shown = frame_view.calibration
            self._show_pictures(frame_view, shown)

    def close(self) -> None:
        """Cancel a calibration: the browser has disconnected."""
        self._natural.close()
        self._cloud.close()

    def _save(self) -> Path | None:
        """Save the displayed pose, unless it is saved already; return its file."""
        frame_view = self._frame_view
        if frame_view is None or frame_view.calibration is None:
            return None
        shown = frame_view.calibration
        pose = shown.now.pose
        if self._saved is None or self._saved[0] != pose or not self._saved[1].exists():
            try:
                path = self._write(frame_view, self._estimate(shown))
            except ScanLoomError as error:
                self._session.show_failure(error)
                return None
            self._saved = pose, path
        with self._lock:
            self._show_file(frame_view)
        return self._saved[1]

    def _estimate(self, shown: CalibrationView) -> ExtrinsicsEstimate:
        """The calibration's result while it is as it was found, else a person's."""
        finished = self._natural.finished
        if finished is not None and finished.pose == shown.now.pose:
            return finished.estimate
        return estimate_of(shown)

    def _write(self, frame_view: FrameView, estimate: ExtrinsicsEstimate) -> Path:
        paired = frame_view.paired
        assert paired is not None, "a pose is shown in a frame"
        return save_pose(
            estimate,
            frame_view.open_recording.recording.path,
            frame_view.session.rig,
            paired.image.frame_id,
            self._root,
        )

    def _send(self) -> None:
        path = self._save()
        if path is not None:
            send_saved_file(self._session, path)

    def _show_file(self, frame_view: FrameView) -> None:
        """The file of the displayed pose, and the command that uses it."""
        shown, saved = frame_view.calibration, self._saved
        is_saved = shown is not None and saved is not None and saved[0] == shown.now.pose
        file = saved[1] if saved is not None and is_saved else None
        update_widget(self._file, content="" if file is None else text_box(str(file)))
        given = self._session.library.given_of(frame_view.view)
        if file is None and frame_view.view.hand_pose is None and given is not None:
            file = given.file
        self._natural.show(frame_view, file)
        command = ""
        if file is not None:
            recording = self._session.recording_path(frame_view.view.recording)
            command = paragraph("On the command line") + text_box(view_command(recording, file))
        update_widget(self._command, content=command)

    def _show_pictures(self, frame_view: FrameView, shown: CalibrationView | None) -> None:
        poses = [] if shown is None else _poses_of(shown, frame_view.view.calibration_pictures)
        for handle, place in zip(self._pictures, range(2), strict=True):
            update_widget(handle, visible=place < len(poses))
        update_widget(self._which, visible=shown is not None and shown.before is not None)
        if shown is None:
            return
        view, theme = frame_view.view, theme_of(is_dark=frame_view.is_dark)
        inputs = (shown, frame_view.paired, frame_view.color, poses, view.overlay_opacity, theme)
        if inputs == self._drawn:
            return
        self._drawn = inputs
        depth_m, color = _images_of(frame_view)
        limits_m = range_limits_m(*(pose.curve for _, pose in poses))
        for handle, (title, pose) in zip(self._pictures, poses, strict=False):
            drawn = curve_overlay_picture(
                depth_m,
                color,
                pose.curve,
                title=title,
                width_px=_WIDTH_PX,
                height_px=_HEIGHT_PX,
                opacity=view.overlay_opacity,
                limits_m=limits_m,
                theme=theme,
            )
            show_picture(handle, drawn)


def _poses_of(shown: CalibrationView, which: CalibrationPictures) -> list[tuple[str, PoseView]]:
    """The pictures' titles and poses. Without an adjustment there is one pose."""
    if shown.before is None:
        return [(_title("The pose as it is", shown.now), shown.now)]
    before = _title("Before", shown.before), shown.before
    now = _title("Now", shown.now), shown.now
    return {"now": [now], "before": [before], "both": [before, now]}[which]


def _title(name: str, pose: PoseView) -> str:
    curve = pose.curve
    if curve is None:
        return f"{name}: no scan with this image"
    on_depth = int(np.isfinite(curve.difference_m).sum())
    if not on_depth:
        return f"{name}: no point on depth"
    return f"{name}: {curve.agrees.sum() / on_depth:.0%} of {on_depth} points agree in this image"


def _images_of(frame_view: FrameView) -> tuple[Float32Array, ByteArray | None]:
    """The upright depth image, and the colour image, if it shows the same view."""
    paired, session = frame_view.paired, frame_view.session
    assert paired is not None, "a pose is shown in a frame"
    depth_m = session.depth_of(paired.camera, paired.image.depth_m)
    color = frame_view.color
    if color is None or not is_registered(color, paired.image):
        return depth_m, None
    return depth_m, remap_color(color.rgb, session.rig.views[paired.camera])
