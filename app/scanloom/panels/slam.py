"""Motion and SLAM in the Map panel: options, live display of the run, and results."""

import shutil
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import viser

from fusion_core.model.conventions import NS_PER_S, FloatArray
from fusion_core.model.errors import ExportError
from fusion_core.model.given_extrinsics import GivenExtrinsics
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.progress import Progress
from fusion_core.model.slam_view import SlamView
from fusion_core.model.visual_slam_view import VisualSlamView
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView, clock_offset_ms, given_extrinsics
from scanloom.jobs.build import free_folder, results_in, settings_in
from scanloom.jobs.earlier_runs import earlier_folders, reopen
from scanloom.jobs.latest_only_worker import LatestOnlyWorker
from scanloom.jobs.slam_run import SlamRequest, SlamRun, map_options, resampling_at, run_slam
from scanloom.page.markup import paragraph, text_box
from scanloom.page.update_widget import update_widget
from scanloom.panels.command_line import map_command
from scanloom.panels.earlier_runs import EarlierRunsChoice
from scanloom.panels.grid_layers import GridLayers
from scanloom.panels.slam_plots import add_effective_plot, show_effective
from scanloom.panels.slam_results import SlamResults
from scanloom.panels.slam_visual import VisualSlamPanel
from scanloom.panels.visual_stage import VisualStage
from scanloom.panels.widgets.controls import Controls
from scanloom.panels.widgets.panel_job import UPDATE_INTERVAL_S, PanelJob
from scanloom.plots.line_plot import set_theme
from scanloom.plots.png import show_picture
from scanloom.plots.slam_progress import Window, slam_progress_picture, window_around
from scanloom.plots.theme import LIGHT, theme_of
from scanloom.state.possible_steps import map_mode_of
from scanloom.state.slam_choices import (
    ESTIMATORS,
    FUSIONS,
    MOTIONS,
    PARTICLES_MAX,
    PARTICLES_MIN,
    SCANS,
    Stream,
    choices_for,
    streams_of,
    supported_choices,
    unsupported_reason,
)
from scanloom.state.slam_runs import MAX_RUNS, SlamRuns
from scanloom.state.view import MapMode, View

_WIDTH_PX, _HEIGHT_PX = 480, 430
# With the particles' close-up below.
_CLOSE_UP_PX = 180
_EMPTY = np.full((2, 2, 3), 255, dtype=np.uint8)
_ABOUT = (
    "Estimates the pose of every scan or image, builds the map, and keeps the last "
    f"{MAX_RUNS} runs to compare, until this page is closed or loaded again."
)
_CHOOSE = "Choose what this recording allows"
_NO_OFFSET = "The clock offset that is to be applied is known once the recording is aligned."


class SlamPanel:
    """Runs ``map`` over the view's recording in a background thread."""

    def __init__(
        self,
        gui: viser.GuiApi,
        session: ClientSession,
        output_root: Path,
        stage: VisualStage,
        on_cell: Callable[[FloatArray], None],
    ) -> None:
        self._session, self._root = session, output_root
        self._runs = SlamRuns()
        self._lock = threading.RLock()
        self._live: LatestOnlyWorker[SlamView | VisualSlamView] | None = None
        self._folder: Path | None = None
        self._of_run = session.view
        self._window: Window | None = None
        self._theme = LIGHT
        self._submitted_s = 0.0
        self._why_not: str | None = None
        self._held: frozenset[Stream] = frozenset()
        self._mode: MapMode = session.view.map_mode
        self._clock_offset_ms = 0.0
        self._given: GivenExtrinsics | None = None
        self._command_inputs: object = None

        gui.add_html(paragraph(_ABOUT))
        choices = session.view.slam
        self._scan = gui.add_dropdown(
            "Scan",
            SCANS,
            initial_value=choices.scan,
            hint="What is mapped: the LiDAR's scans, a scan cut from the camera, the LiDAR's "
            "repaired by the camera, or both merged",
        )
        self._motion = gui.add_dropdown(
            "Motion",
            MOTIONS,
            initial_value=choices.motion,
            hint="The motion prior: recorded poses, an odometry, or none",
        )
        estimator = gui.add_dropdown(
            "SLAM",
            ESTIMATORS,
            initial_value=choices.estimator,
            hint="The estimator: the motion prior alone, a particle filter, a pose graph with "
            "loop closure, or visual SLAM by colour and depth images alone, in six degrees of "
            "freedom",
        )
        self._fusion = gui.add_dropdown(
            "Fusion",
            FUSIONS,
            initial_value=choices.fusion,
            hint="Fuse the LiDAR's own grid and the camera's own cell by cell (Fu 2024): by Table "
            "3 an obstacle of either stays; by Bayes' rule (10) their probabilities are joined",
        )
        self._particles = gui.add_slider(
            "Particles",
            min=PARTICLES_MIN,
            max=PARTICLES_MAX,
            step=1,
            initial_value=choices.particles,
            visible=choices.estimator == "particle-filter",
            hint="More particles cover more hypotheses, and take longer",
        )
        self._why = gui.add_html("", visible=False)
        self._choose_button = gui.add_button(
            _CHOOSE,
            visible=False,
            hint="What the recording's streams allow of scan, motion, SLAM and fusion",
        )
        self._run_button = gui.add_button("Run")
        self._job = PanelJob(
            gui, session, self._lock, self._show_working, cancel_label="Cancel run"
        )
        self._earlier = EarlierRunsChoice(gui, self._reopen)
        self._picture = gui.add_image(_EMPTY, format="png", visible=False)
        self._effective = add_effective_plot(gui)
        self._visual = VisualSlamPanel(gui, session, stage)
        self._grids = GridLayers(gui, session, on_cell)
        stage.on_place = self._grids.tell
        self._results = SlamResults(gui, session, self._runs, output_root)
        with gui.add_folder("On the command line"):
            self._command = gui.add_html("")

        self._controls = Controls(gui, session)
        for name, handle in (
            ("scan", self._scan),
            ("motion", self._motion),
            ("estimator", estimator),
            ("fusion", self._fusion),
            ("particles", self._particles),
        ):
            self._bind(handle, name)
        self._run_button.on_click(lambda _: self._begin())
        self._choose_button.on_click(lambda _: self._choose_supported())

    def chosen(self, recording: str) -> SlamRun | None:
        """The displayed run, None if the recording has none."""
        return self._results.chosen(recording)

    def grid_of(self, run: SlamRun | None) -> OccupancyGrid | None:
        """The grid that is to be seen of a run, None for none."""
        return None if run is None else self._grids.grid_of(run)

    def differing_m(self, run: SlamRun) -> FloatArray:
        """(N, 2) places of the cells of a run of which the two rules of fusion make different
        things."""
        return self._grids.differing_m(run)

    def show(self, frame_view: FrameView) -> None:
        """Display the options, the runs of the recording, and the equivalent command."""
        with self._lock:
            self._held = streams_of(frame_view.open_recording.opened)
            view = _with_choices_for(frame_view.view, self._held)
        self._controls.show(frame_view.view)
        update_widget(self._particles, visible=view.slam.estimator == "particle-filter")
        for choice in (self._scan, self._motion, self._fusion):
            update_widget(choice, visible=not view.slam.is_visual)
        with self._lock:
            self._mode = map_mode_of(view, frame_view.open_recording)
            self._why_not = unsupported_reason(view.slam, self._held)
            can_choose = unsupported_reason(supported_choices(view.slam, self._held), self._held)
            update_widget(
                self._choose_button, visible=self._why_not is not None and can_choose is None
            )
            of_server = self._session.library.given_of(view)
            self._given = given_extrinsics(frame_view, of_server)
            if view.slam.is_visual and "lidar" not in self._held:
                # They would say where the camera stands on a LiDAR.
                self._given = None
            self._clock_offset_ms = 0.0
            if frame_view.chain is not None:
                self._clock_offset_ms = clock_offset_ms(view, frame_view.chain)
            elif view.apply_clock_offset:
                self._why_not = self._why_not or _NO_OFFSET
            update_widget(self._why, content=paragraph(self._why_not or ""))
            update_widget(self._why, visible=self._why_not is not None)
            update_widget(
                self._run_button, disabled=self._job.is_running or self._why_not is not None
            )
            self._theme = theme_of(is_dark=frame_view.is_dark)
            set_theme(self._effective, self._theme)
            self._results.show(view.recording, self._theme)
            run = self._results.chosen(view.recording)
            self._grids.show(run)
            self._visual.show(run, self.grid_of(run), frame_view, self._theme)
            self._show_command(view)
            recording = self._session.recording_path(view.recording)
            self._earlier.offer(
                earlier_folders(self._root, recording), is_at_work=self._job.is_running
            )

    def close(self) -> None:
        """Cancel the run and delete the session's runs: the browser has disconnected."""
        self._job.close()
        self._visual.close()
        self._delete_folder()

    def _bind(self, handle: object, name: str) -> None:
        def change(value: object) -> None:
            with self._lock:
                before = choices_for(self._session.view.slam, self._held)
            self._session.change(slam=before.model_dump() | {name: value})

        def value_of(view: View) -> object:
            return getattr(choices_for(view.slam, self._held), name)

        self._controls.bind(handle, value_of, change)

    def _choose_supported(self) -> None:
        with self._lock:
            chosen = supported_choices(self._session.view.slam, self._held)
        self._session.change(slam=chosen.model_dump())

    def _begin(self) -> None:
        """Start a run unless one is running, it is not possible, or the session is closed."""
        with self._lock:
            view = _with_choices_for(self._session.view, self._held)
            if self._job.is_running or self._job.is_closed or self._why_not is not None:
                return
            if not self._make_folder():
                return
            assert self._folder is not None, "it was made"
            root, number = self._folder, self._runs.next_number()
            offset_ms, given = self._clock_offset_ms, self._given
            self._of_run, self._window = view, None
            self._submitted_s = 0.0
            live = LatestOnlyWorker(f"run {number}", self._draw, self._session.show_failure)
            self._live = live
            if view.slam.is_visual:
                self._visual.begin(view.recording)

            def work(progress: Progress) -> SlamRun:
                recording = self._session.recording_path(view.recording)
                request = SlamRequest(
                    number=number,
                    view=view,
                    recording=recording,
                    clock_offset_ms=offset_ms,
                    given=given,
                )
                return run_slam(request, root, progress, self._observe, self._observe)

            self._job.begin("slam", work, self._on_done)

    def _reopen(self, folder: Path) -> None:
        """Read results of an earlier run back, as one of this page's."""
        view = self._session.view
        with self._lock:
            if self._job.is_running or self._job.is_closed or not self._make_folder():
                return
            assert self._folder is not None, "it was made"
            root, number = self._folder, self._runs.next_number()

            def work(progress: Progress) -> SlamRun:
                progress(0, None, f"reading {folder.name}")
                return reopen(folder, root, number, view)

            self._job.begin("earlier run", work, self._on_done)

    def _make_folder(self) -> bool:
        """Whether there is a folder for the runs."""
        try:
            self._folder = self._folder or Path(tempfile.mkdtemp(prefix="scanloom-"))
        except OSError as error:
            self._job.fail(_no_folder(error))
            return False
        return True

    def _observe(self, seen: SlamView | VisualSlamView) -> None:
        now_s = time.monotonic()
        if now_s - self._submitted_s >= UPDATE_INTERVAL_S and self._live is not None:
            self._submitted_s = now_s
            self._live.submit(seen)

    def _draw(self, slam_view: SlamView | VisualSlamView, is_newest: Callable[[], bool]) -> None:
        """Draw the current state of the run, if it is visible."""
        view = self._session.view
        if view.panel != "Map" or self._mode != "SLAM":
            return
        if isinstance(slam_view, VisualSlamView):
            if view.recording == self._of_run.recording:
                self._visual.draw_live(slam_view, lambda: not self._job.is_closed)
            return
        self._window = window_around(slam_view, self._window)
        if self._window is None:
            return
        height_px = _HEIGHT_PX + (_CLOSE_UP_PX if len(slam_view.particles) else 0)
        picture = slam_progress_picture(
            slam_view, self._window, width_px=_WIDTH_PX, height_px=height_px, theme=self._theme
        )
        run = self._of_run
        times_s = (
            slam_view.stamps_ns[: slam_view.effective.size] - slam_view.stamps_ns[0]
        ) / NS_PER_S
        with self._lock:
            # The run may have ended meanwhile.
            if not self._job.is_running or self._job.is_closed:
                return
            with self._session.batch_updates():
                show_picture(self._picture, picture)
                update_widget(self._picture, visible=True)
                show_effective(
                    self._effective,
                    times_s,
                    slam_view.effective,
                    particles=run.slam.particles,
                    resampling_at=resampling_at(run),
                )

    def _on_done(self, run: SlamRun) -> None:
        oldest = self._runs.add(run)
        self._results.take(run)
        message = ""
        if oldest is not None:
            shutil.rmtree(oldest.folder, ignore_errors=True)
            message = f"Run {oldest.number} was deleted: the last {MAX_RUNS} are kept."
        self._job.end(message)
        if run.problem is not None and not self._job.is_closed:
            self._session.show_failure(run.problem)

    def _show_working(self, is_at_work: bool) -> None:
        self._command_inputs = None
        update_widget(self._run_button, disabled=is_at_work)
        for widget in (self._picture, self._effective):
            update_widget(widget, visible=False)
        if not is_at_work and self._live is not None:
            self._live.close()
            self._visual.end()
        if not is_at_work and self._job.is_closed:
            self._delete_folder()

    def _show_command(self, view: View) -> None:
        recording = self._session.recording_path(view.recording)
        run = self._results.chosen(view.recording)
        is_same = run is not None and slam_inputs(run.view) == slam_inputs(view)
        saved = self._results.saved(run) if run is not None and is_same else None
        key = (slam_inputs(view), self._clock_offset_ms, saved)
        if key == self._command_inputs:
            return
        self._command_inputs = key
        folder = saved or free_folder(self._root, recording)
        options = map_options(view, settings_in(folder), self._clock_offset_ms, self._given)
        notes = []
        if options.settings_file is not None and not options.settings_file.exists():
            notes.append("The settings file is written by “Save to the output folder”.")
        if options.extrinsics_file is not None and not options.extrinsics_file.exists():
            notes.append("So is the file of the camera's pose.")
        command = map_command(recording, results_in(folder), options)
        self._command.content = text_box(command) + "".join(map(paragraph, notes))

    def _delete_folder(self) -> None:
        with self._lock:
            folder, self._folder = self._folder, None
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def _no_folder(error: OSError) -> ExportError:
    return ExportError(
        f"no folder for the runs can be made: {error.strerror or error}.",
        file=tempfile.gettempdir(),
        advice="Free space there.",
    )


def _with_choices_for(view: View, held: frozenset[Stream]) -> View:
    return view.changed(slam=choices_for(view.slam, held).model_dump())


def slam_inputs(view: View) -> tuple[object, ...]:
    """The fields of a view that a run depends on."""
    return (
        view.recording,
        view.slam,
        view.preset,
        view.settings,
        view.lidar_topic,
        view.extrinsics,
        view.apply_clock_offset,
    )
