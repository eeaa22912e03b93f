"""The Map panel: the maps of the whole recording, all results as files, and the command for it; or,
in its other mode, motion and SLAM."""

import html
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import viser

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.given_extrinsics import GivenExtrinsics
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.progress import Progress
from fusion_core.workflows.fuse.export_clouds import CloudExport
from fusion_core.workflows.map.result_folder import TrajectoryPoses
from fusion_core.workflows.recorded_poses import PoseLookup
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView, given_extrinsics
from scanloom.jobs.build import (
    Build,
    build,
    export,
    free_folder,
    fuse_options,
    results_in,
    settings_in,
    zipped,
)
from scanloom.page.markup import paragraph, report_line, text_box
from scanloom.page.update_widget import update_widget
from scanloom.page_parts import Panel
from scanloom.panels.command_line import fuse_command
from scanloom.panels.slam import SlamPanel
from scanloom.panels.visual_stage import VisualStage
from scanloom.panels.widgets.controls import Controls
from scanloom.panels.widgets.panel_job import PanelJob
from scanloom.panels.widgets.result_figures import ResultFigures
from scanloom.state.possible_steps import map_mode_of
from scanloom.state.view import MAP_MODES, MapMode, View


class MapCallback(Protocol):
    """Receives the map for the scene's floor; ``poses``: the LiDAR's, None: the recorded ones;
    ``differing_m``: (N, 2) places of cells of which two rules of fusion make different things."""

    def __call__(
        self,
        grid: OccupancyGrid | None,
        poses: PoseLookup | None = None,
        differing_m: FloatArray | None = None,
        /,
    ) -> None: ...


class MapPanel(Panel):
    """Builds, shows and exports the results of a whole recording, or runs SLAM over it.

    ``output_root``: results go into new folders below it. ``on_map`` gets the map of the recording
    that is shown, None where there is none, in the thread that shows views: the fused one, or that
    of a run of SLAM with its poses. ``on_cell`` gets the place of a cell that is chosen here.
    ``stage`` draws the maps of visual SLAM, which are in space.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        session: ClientSession,
        output_root: Path,
        on_map: MapCallback,
        on_cell: Callable[[FloatArray], None],
        stage: VisualStage,
    ) -> None:
        self._session = session
        # The command may be run in another working directory.
        self._root = Path(os.path.realpath(output_root))
        self._on_map = on_map
        self._lock = threading.RLock()
        self._built: Build | None = None
        self._clouds = ""
        # Of the view that is shown.
        self._given: GivenExtrinsics | None = None
        # What the widgets display; most changes of the view leave it unchanged.
        self._drawn: Build | None = None
        self._floor_grid: OccupancyGrid | None = None
        self._command_inputs: object = None

        self._mode = gui.add_dropdown(
            "Mode",
            MAP_MODES,
            initial_value=session.view.map_mode,
            hint="Maps of both sensors from recorded poses, or poses by SLAM",
        )
        self._controls = Controls(gui, session)
        self._no_fuse = gui.add_html("", visible=False)
        self._controls.bind_field(self._mode, "map_mode", str)
        self._fuse = gui.add_folder("Fuse", visible=session.view.map_mode == "Fuse")
        with self._fuse:
            self._add_build_widgets(gui)
        self._slam_folder = gui.add_folder(
            "Motion and SLAM", visible=session.view.map_mode == "SLAM"
        )
        with self._slam_folder:
            self._slam = SlamPanel(gui, session, self._root, stage, on_cell)

        self._build_button.on_click(lambda _: self._begin_build())
        self._export_button.on_click(lambda _: self._begin_export())
        self._download.on_click(lambda _: self._send())

        @self._figures.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                session.refresh()

    def _add_build_widgets(self, gui: viser.GuiApi) -> None:
        """Add the widgets of a build."""
        gui.add_html(
            paragraph(
                "Fuses the whole recording with the settings as they are, and builds the maps of "
                "the LiDAR alone, the camera alone and both, from the same recorded poses."
            )
        )
        self._figures = gui.add_checkbox(
            "Figures", True, hint="Draw each stage as a picture, too, as in Xu 2024"
        )
        self._build_button = gui.add_button("Build")
        self._job = PanelJob(gui, self._session, self._lock, self._show_working)
        self._written = ResultFigures(gui, ("fig9_maps", "map_fused"))
        self._report = gui.add_html("")
        self._files = gui.add_folder("Files", visible=False)
        with self._files:
            self._folder = gui.add_html("")
            self._download = gui.add_button(
                "Download .zip", hint="All results but fused.mcap and samples.parquet"
            )
            self._voxel = gui.add_number(
                "Voxel (m)", 0.02, min=0.005, max=1.0, step=0.005, hint="One point is kept in each"
            )
            self._export_button = gui.add_button("Export clouds (PLY, PCD)")
            self._exported = gui.add_html("")
        with gui.add_folder("On the command line"):
            self._command = gui.add_html("")

    def show(self, frame_view: FrameView) -> None:
        """Display the maps of the view's recording, and the equivalent command."""
        with self._lock:
            built = self._built
            if built is not None and built.view.recording != frame_view.view.recording:
                built = None
            opened = frame_view.open_recording
            mode = map_mode_of(frame_view.view, opened)
            self._update_floor(frame_view.view, mode, built)
            if frame_view.view.panel != "Map":
                return
            self._controls.show(frame_view.view)
            of_server = self._session.library.given_of(frame_view.view)
            self._given = given_extrinsics(frame_view, of_server)
            # SLAM is the only mode of a recording that cannot be fused.
            update_widget(self._mode, visible=opened.can_be_fused)
            update_widget(
                self._no_fuse,
                content=paragraph(f"Maps of both sensors are off. {opened.opened.why_not_fused}"),
                visible=not opened.can_be_fused,
            )
            update_widget(self._fuse, visible=mode == "Fuse")
            update_widget(self._slam_folder, visible=mode == "SLAM")
            if mode == "SLAM":
                self._slam.show(frame_view)
                return
            self._show_command(frame_view.view, built)
            self._show_built(frame_view.view, built)

    def close(self) -> None:
        """Cancel the build: the browser has disconnected."""
        self._job.close()
        self._slam.close()

    def _update_floor(self, view: View, mode: MapMode, built: Build | None) -> None:
        """Pass the map of the mode to the scene, if it has changed."""
        run = self._slam.chosen(view.recording) if mode == "SLAM" else None
        poses: PoseLookup | None = None
        differing_m: FloatArray | None = None
        if run is not None and run.visual is not None:
            # It has a stage of its own.
            grid = None
        elif run is not None:
            grid = self._slam.grid_of(run)
            poses = TrajectoryPoses(run.name, run.files.trajectory)
            differing_m = self._slam.differing_m(run)
        else:
            grid = None if built is None else built.summary.grids.get("fused")
        if grid is self._floor_grid:
            return
        self._floor_grid = grid
        self._on_map(grid, None if grid is None else poses, differing_m)

    def _begin_build(self) -> None:
        view, figures, given = self._session.view, bool(self._figures.value), self._given

        def work(progress: Progress) -> Build:
            recording = self._session.recording_path(view.recording)
            return build(view, recording, self._root, progress, figures=figures, given=given)

        def done(built: Build) -> None:
            with self._lock:
                self._built, self._clouds = built, ""
            self._job.end()

        self._job.begin("build", work, done)

    def _begin_export(self) -> None:
        built, voxel_m = self._built, float(self._voxel.value)
        if built is None:
            return

        def done(exported: CloudExport) -> None:
            with self._lock:
                if self._built is built:
                    self._clouds = _export_text(exported)
            self._job.end()

        self._job.begin("export", lambda progress: export(built, voxel_m, progress), done)

    def _show_working(self, is_at_work: bool) -> None:
        self._command_inputs = None
        update_widget(self._build_button, disabled=is_at_work)
        update_widget(self._export_button, disabled=is_at_work)

    def _show_command(self, view: View, built: Build | None) -> None:
        key = (_build_inputs(view), self._figures.value, built)
        if key == self._command_inputs:
            return
        self._command_inputs = key
        recording = self._session.recording_path(view.recording)
        if built is not None and _build_inputs(view) == _build_inputs(built.view):
            folder, options = built.folder, built.options
        else:
            folder = free_folder(self._root, recording)
            options = fuse_options(
                view, settings_in(folder), figures=bool(self._figures.value), given=self._given
            )
        command = fuse_command(recording, results_in(folder), options)
        notes = []
        if options.settings_file is not None and not options.settings_file.exists():
            notes.append("The settings file is written by Build.")
        if options.extrinsics_file is not None and not options.extrinsics_file.exists():
            notes.append("The file of the camera's pose is written by Build.")
        if view.picked_offset is not None:
            notes.append("A build does not use the offset picked by hand; it finds its own.")
        self._command.content = text_box(command) + "".join(map(paragraph, notes))

    def _show_built(self, view: View, built: Build | None) -> None:
        update_widget(self._files, visible=built is not None)
        if built is None:
            self._drawn = None
            self._written.show(None)
            update_widget(self._report, content="")
            return
        if built is not self._drawn:
            self._drawn = built
            self._written.show(built.results)
            update_widget(self._folder, content=text_box(str(built.folder)))
            for handle in (self._voxel, self._export_button):
                update_widget(handle, visible=built.summary.pose_source is not None)
        update_widget(self._exported, content=paragraph(self._clouds) if self._clouds else "")
        update_widget(
            self._report,
            content=_report(built, changed=_build_inputs(view) != _build_inputs(built.view)),
        )

    def _send(self) -> None:
        built = self._built
        if built is None:
            return
        try:
            content = zipped(built)
        except ScanLoomError as error:
            self._session.show_failure(error)
            return
        self._session.send_file(f"{built.folder.name}.zip", content)


def _build_inputs(view: View) -> tuple[object, ...]:
    """The fields of a view that a build depends on."""
    return (
        view.recording,
        view.preset,
        view.settings,
        view.lidar_topic,
        view.depth_topics,
        view.virtual_row,
        view.extrinsics,
        view.apply_clock_offset,
        view.picked_offset is None,
    )


def _report(built: Build, *, changed: bool) -> str:
    """The report of a build, as HTML."""
    notices = []
    if changed:
        notices.append("<b>Settings or streams changed since this build.</b>")
    if not built.summary.grids:
        notices.append(html.escape(_why_no_maps(built)))
    paragraphs = "".join(f"<p style='margin:0.3em 0'>{line}</p>" for line in notices)
    lines = "".join(
        # The command line prints ASCII.
        report_line(line.replace("+-", "±"))
        for line in built.summary.lines()
    )
    return f"<div style='padding:0 0.8em;font-size:0.85em'>{paragraphs}{lines}</div>"


def _why_no_maps(built: Build) -> str:
    if built.options.virtual_lidar_row is not None:
        why = "A virtual LiDAR is cut from the camera's own images, so there is nothing to compare."
    elif built.summary.pose_source is None:
        why = "The recording has no poses of the LiDAR: no TF, odometry or pose topic."
    else:
        why = "No scan could be placed."
    return f"No maps. {why} All other results were written."


def _export_text(exported: CloudExport) -> str:
    counts = ", ".join(f"{name} {count:,} points" for name, count in exported.points.items())
    return " ".join([f"Clouds: {counts}, in {exported.output}.", *exported.notes])
