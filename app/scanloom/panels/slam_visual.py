"""Visual SLAM in the Map panel: the run while it works, and its map, keyframes and volumes."""

import threading
from collections.abc import Callable

import numpy as np
import viser

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import ScanLoomError, StampOutsideRange
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.number_text import counted
from fusion_core.model.visual_slam_view import VisualSlamView
from fusion_core.workflows.map.visual_result_folder import VisualResults, read_run_cloud
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.jobs.build import results_in
from scanloom.jobs.slam_run import SlamRun
from scanloom.page.markup import paragraph
from scanloom.page.update_widget import update_widget
from scanloom.panels.keyframes import KeyframesPanel
from scanloom.panels.octree_layer import OctreeLayer
from scanloom.panels.visual_stage import VisualStage
from scanloom.plots.theme import Theme
from scanloom.scene.frame_stage import pose_stamp_ns
from scanloom.scene.level_of_detail import POINTS_MAX
from scanloom.scene.map_nodes import map_plane
from scanloom.scene.visual_picture import VisualPicture, picture_of_results, picture_of_view
from scanloom.scene.visual_shapes import HalfView


class VisualSlamPanel:
    """Gives the stage a run's map. ``show`` is called in the session's worker thread, ``draw_live``
    in that of the run's display."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession, stage: VisualStage) -> None:
        self._session, self._stage = session, stage
        self._lock = threading.RLock()
        self._live_of: str | None = None
        # What the stage displays.
        self._run: SlamRun | None = None
        self._is_live = False
        self._words = gui.add_html("", visible=False)
        self._octree = OctreeLayer(gui, session, stage, self._show_words)
        self._keyframes = KeyframesPanel(gui, session, stage)
        # What is said of the run, and of its cloud.
        self._said = self._said_of_points = ""
        self._shown_grid: tuple[OccupancyGrid, Theme] | None = None
        stage.on_points = self._say_points

    def begin(self, recording: str) -> None:
        """A run of a recording begins."""
        with self._lock:
            self._live_of = recording

    def end(self) -> None:
        """It has ended: what it has written is shown by ``show``."""
        with self._lock:
            self._live_of = None

    def draw_live(self, view: VisualSlamView, check: Callable[[], bool]) -> None:
        """Draw a run as far as it is, if ``check`` still holds."""
        picture = picture_of_view(view)
        with self._lock:
            if self._live_of is None or not check():
                return
            is_new, self._is_live, self._run = not self._is_live, True, None
            self._said_of_points = "" if is_new else self._said_of_points
            self._said = live_text(view)
            with self._session.batch_updates():
                self._stage.draw(picture, is_new=is_new)
                self._show_words()
        if is_new:
            # The scene changes over to the map.
            self._session.refresh()

    def show(
        self,
        run: SlamRun | None,
        grid: OccupancyGrid | None,
        frame_view: FrameView,
        theme: Theme,
    ) -> None:
        """A finished run with one of its grids, None for none; that at work goes before."""
        with self._lock:
            if self._live_of == frame_view.view.recording and self._is_live:
                self._keyframes.show(None, frame_view.open_recording, theme)
                self._octree.show(None)
                return
            visual = None if run is None else run.visual
            if run is None or visual is None:
                if self._run is not None or self._is_live:
                    self._stage.draw(None, is_new=True)
                self._run, self._is_live = None, False
                update_widget(self._words, visible=False)
            elif run is not self._run:
                is_new = not self._is_live
                self._run, self._is_live = run, False
                self._said = self._said_of_points = ""
                picture = self._picture_of(run, visual)
                self._stage.draw(picture, _half_view(frame_view), is_new=is_new)
            self._keyframes.show(self._run, frame_view.open_recording, theme)
            self._octree.show(self._run)
            self._show_grid(grid, theme)
            if self._run is not None:
                self._stage.mark_now(_pose_now(self._run, frame_view))

    def close(self) -> None:
        """Draw nothing more."""
        self._keyframes.close()
        self._octree.close()

    def _picture_of(self, run: SlamRun, visual: VisualResults) -> VisualPicture:
        """The run's map. Of several runs the cloud of only one is in memory: it takes 15 bytes a
        point."""
        try:
            points_m, rgb = read_run_cloud(results_in(run.folder))
        except ScanLoomError as error:
            self._session.show_failure(error)
            points_m, rgb = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
        return picture_of_results(visual, points_m, rgb)

    def _show_grid(self, grid: OccupancyGrid | None, theme: Theme) -> None:
        if self._run is None or grid is None:
            self._stage.show_grid(None)
            self._shown_grid = None
        elif self._shown_grid != (grid, theme):
            self._shown_grid = grid, theme
            self._stage.show_grid(map_plane(grid, theme), _floor_m(self._run))

    def _say_points(self, sent: int, total: int) -> None:
        """Tell how much of the cloud the browser has."""
        self._said_of_points = points_text(sent, total)
        self._show_words()

    def _show_words(self) -> None:
        """Say what there is to say; of the cloud nothing while boxes take its place."""
        of_points = "" if self._octree.shows_boxes else self._said_of_points
        words = f"{self._said} {of_points}".strip()
        update_widget(self._words, content=paragraph(words))
        update_widget(self._words, visible=self._stage.has_map and bool(words))


def live_text(view: VisualSlamView) -> str:
    """How far a run is, as text."""
    keyframes, loops = len(view.keyframe_stamps_ns), len(view.loops)
    lost = " Tracking is lost: it looks for a place that it knows." if view.is_lost else ""
    return (
        f"{counted(len(view.stamps_ns), 'image')} placed, {counted(keyframes, 'keyframe')}, "
        f"{counted(loops, 'loop')} closed.{lost}"
    )


def points_text(sent: int, total: int) -> str:
    """How much of a cloud is drawn, as text."""
    if sent == total:
        return f"All {total:,} points of the cloud are drawn."
    return (
        f"{sent:,} of the {total:,} points of the cloud are drawn, most of them where you look; "
        f"at most {POINTS_MAX:,} are sent at a time."
    )


def _floor_m(run: SlamRun) -> float:
    """z of the plane that the run's grid lies on."""
    volumes = run.files.report.get("volumes", {})
    return float(volumes.get("floor_height_m", 0.0))


def _half_view(frame_view: FrameView) -> HalfView | None:
    """What the depth camera sees, None without its intrinsics."""
    session = frame_view.open_recording.opened.session
    if session is None or not session.rig.cameras:
        return None
    intrinsics = session.rig.cameras[0].intrinsics
    return HalfView(
        across=0.5 * intrinsics.width / intrinsics.fx,
        down=0.5 * intrinsics.height / intrinsics.fy,
    )


def _pose_now(run: SlamRun, frame_view: FrameView) -> FloatArray | None:
    """(4, 4) the camera in the map at the displayed frame, None where it was not tracked."""
    stamp_ns = pose_stamp_ns(frame_view)
    if run.visual is None or stamp_ns is None:
        return None
    try:
        return run.visual.trajectory.pose_at(stamp_ns)
    except StampOutsideRange:
        return None
