"""The finished runs of SLAM: one on its map with its report and files, and two side by side."""

import threading
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import viser

from fusion_core.model.conventions import NS_PER_S, ByteArray, FloatArray
from fusion_core.model.errors import ScanLoomError
from scanloom.client_session import ClientSession
from scanloom.jobs.build import results_in, zip_folder
from scanloom.jobs.slam_run import SlamRun, keep, resampling_at
from scanloom.panels.slam_text import run_distance_text, run_report_html
from scanloom.panels.widgets.controls import update_widget
from scanloom.panels.widgets.markup import paragraph, text_box
from scanloom.plots.palette import Color, color_of
from scanloom.plots.png import show_picture
from scanloom.plots.run_comparison import WayOnMap, apart, runs_picture
from scanloom.plots.slam_progress import run_picture
from scanloom.plots.time_picture import Course, time_picture
from scanloom.state.slam_runs import SlamRuns

_WIDTH_PX, _HEIGHT_PX, _PLOT_PX = 480, 640, 220
_NONE_YET = "none yet"
_EMPTY = np.full((2, 2, 3), 255, dtype=np.uint8)
_INK: Color = (33, 37, 41)
# Of odometries that are no sensor's.
_OTHER_COLORS: tuple[Color, ...] = ((73, 80, 87), (0, 158, 115), (204, 121, 167))


class _RunChoice:
    """A dropdown of runs. ``lock`` is held by whoever calls ``offer``."""

    def __init__(
        self,
        handle: viser.GuiDropdownHandle[str],
        lock: "threading.RLock",
        change: Callable[[str], None],
    ) -> None:
        self._handle = handle
        self._known: str | None = None

        @handle.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            # Without a client it was ``offer`` that set the value.
            if event.client is None:
                return
            with lock:
                self._known = handle.value
                change(handle.value)

    def offer(self, runs: list[SlamRun], chosen: SlamRun) -> None:
        """The runs to choose from, and which is.

        What is offered again is not set: a person may have just chosen another.
        """
        names = tuple(run.name for run in runs)
        if self._handle.options != names:
            self._handle.options = names
            self._known = None
        if chosen.name != self._known:
            self._known = chosen.name
            update_widget(self._handle, value=chosen.name)


class SlamResults:
    """Shows what the runs of one browser made. ``show`` is called in the thread of the views."""

    def __init__(
        self, gui: viser.GuiApi, session: ClientSession, runs: SlamRuns, output_root: Path
    ) -> None:
        self._session, self._runs, self._root = session, runs, output_root
        self._lock = threading.RLock()
        self._chosen: str | None = None
        self._compared: dict[str, str | None] = {"A": None, "B": None}
        self._saved: dict[SlamRun, Path] = {}
        # What the widgets show now.
        self._drawn: SlamRun | None = None
        self._drawn_pair: tuple[SlamRun, SlamRun] | None = None

        self._result = gui.add_folder("Result", visible=False)
        with self._result:
            choice = gui.add_dropdown("Run shown", (_NONE_YET,))
            self._picture = gui.add_image(_EMPTY, format="png")
            self._effective = gui.add_image(_EMPTY, format="png", visible=False)
            self._translation = gui.add_image(_EMPTY, format="png", visible=False)
            self._rotation = gui.add_image(_EMPTY, format="png", visible=False)
            self._report = gui.add_html("")
            self._download = gui.add_button(
                "Download run (.zip)", hint="Map, trajectory.tum, graph.g2o, report and settings"
            )
            self._save = gui.add_button(
                "Save to the output folder", hint="A copy that stays when this page is closed"
            )
            self._where = gui.add_html("")
        self._comparison = gui.add_folder("Two runs side by side", visible=False)
        with self._comparison:
            sides = {name: gui.add_dropdown(name, (_NONE_YET,)) for name in self._compared}
            self._both = gui.add_image(_EMPTY, format="png", visible=False)
            self._distance = gui.add_image(_EMPTY, format="png", visible=False)
            self._apart = gui.add_html("")

        self._choice = _RunChoice(choice, self._lock, self._choose)
        self._sides = {
            name: _RunChoice(handle, self._lock, partial(self._compare, name))
            for name, handle in sides.items()
        }
        self._download.on_click(lambda _: self._send())
        self._save.on_click(lambda _: self._keep())

    def chosen(self, recording: str) -> SlamRun | None:
        """The run that is looked at: the one chosen, else the last of the recording."""
        runs = self._runs.of(recording)
        named = [run for run in runs if run.name == self._chosen]
        return next(iter(named or runs[-1:]), None)

    def saved(self, run: SlamRun) -> Path | None:
        """Where a run was saved, None where it was not."""
        return self._saved.get(run)

    def take(self, run: SlamRun) -> None:
        """Look at a new run."""
        with self._lock:
            self._chosen = run.name

    def show(self, recording: str) -> None:
        """The runs of a recording."""
        with self._lock:
            runs = self._runs.of(recording)
            self._forget()
            update_widget(self._result, visible=bool(runs))
            update_widget(self._comparison, visible=len(runs) > 1)
            if not runs:
                return
            run = self.chosen(recording)
            assert run is not None, "there are runs"
            self._choice.offer(runs, run)
            self._show_run(run)
            if len(runs) > 1:
                self._show_pair(runs)

    def _show_run(self, run: SlamRun) -> None:
        saved = self._saved.get(run)
        update_widget(self._where, content="" if saved is None else text_box(str(saved)))
        if run is self._drawn:
            return
        self._drawn = run
        files = run.files
        drawn = run_picture(
            run.name,
            files.grid,
            files.poses_map_scan,
            files.trusted,
            files.loops_m,
            width_px=_WIDTH_PX,
            height_px=_HEIGHT_PX,
        )
        show_picture(self._picture, drawn)
        for handle, plot in (
            (self._effective, effective_plot(run)),
            (self._translation, _weights_plot(run, run.files.translation_weights, "way")),
            (self._rotation, _weights_plot(run, run.files.rotation_weights, "turn")),
        ):
            if plot is not None:
                show_picture(handle, plot)
            update_widget(handle, visible=plot is not None)
        update_widget(self._report, content=run_report_html(run))

    def _show_pair(self, runs: list[SlamRun]) -> None:
        by_name = {run.name: run for run in runs}
        fallbacks = {"A": runs[-2], "B": runs[-1]}
        first, second = (
            by_name.get(name or "", fallbacks[side]) for side, name in self._compared.items()
        )
        for side, run in zip(self._sides.values(), (first, second), strict=True):
            side.offer(runs, run)
        if (first, second) == self._drawn_pair:
            return
        self._drawn_pair = first, second
        ways = _way_of(first), _way_of(second)
        found = apart(*ways)
        update_widget(self._both, visible=found is not None)
        update_widget(self._distance, visible=found is not None)
        update_widget(self._apart, content=paragraph(run_distance_text(found)))
        if found is None:
            return
        drawn = runs_picture(
            *ways, second_in_first=found.second_in_first, width_px=_WIDTH_PX, height_px=_HEIGHT_PX
        )
        show_picture(self._both, drawn)
        course = Course(
            words="distance from A to B", color=_INK, times_s=found.times_s, values=found.away_m
        )
        show_picture(
            self._distance,
            _plot([course], "distance (m)", (0.0, 1.05 * float(found.away_m.max()))),
        )

    def _choose(self, value: str) -> None:
        self._chosen = value
        self._session.refresh()

    def _compare(self, side: str, value: str) -> None:
        self._compared[side] = value
        self._session.refresh()

    def _send(self) -> None:
        run = self._drawn
        if run is None:
            return
        try:
            name = f"{run.folder.name}-{run.choices.estimator}"
            content = zip_folder(results_in(run.folder), name)
        except ScanLoomError as error:
            self._session.show_failure(error)
            return
        self._session.send_file(f"{name}.zip", content)

    def _keep(self) -> None:
        with self._lock:
            run = self._drawn
            if run is None:
                return
            try:
                if run not in self._saved:
                    recording = self._session.recording_path(run.recording)
                    self._saved[run] = keep(run, recording, self._root)
            except ScanLoomError as error:
                self._session.show_failure(error)
                return
        self._session.refresh()

    def _forget(self) -> None:
        """What has been cleared away need not be held."""
        self._saved = {run: folder for run, folder in self._saved.items() if run.folder.exists()}


def effective_plot(run: SlamRun) -> ByteArray | None:
    """The effective number of particles over time, None without particles."""
    values = run.files.effective
    if len(values) == 0:
        return None
    times_s = values[:, 0] - run.files.trajectory.stamps_ns[0] / NS_PER_S
    return effective_picture(times_s, values[:, 1], run.choices.particles, resampling_at(run.view))


def effective_picture(
    times_s: FloatArray, effective: FloatArray, particles: int, resampling: float
) -> ByteArray:
    """The same from its numbers; ``resampling``: where new particles are drawn."""
    course = Course(
        words="effective number of particles",
        color=color_of("depth"),
        times_s=times_s,
        values=effective,
    )
    level = resampling, "drawn anew below"
    # All alike lies below the edge.
    return _plot([course], "N_eff", (0.0, 1.05 * particles), level)


def _weights_plot(run: SlamRun, weights: Mapping[str, FloatArray], what: str) -> ByteArray | None:
    """The share of each odometry over time, None where none were fused."""
    files = run.files
    if not weights or files.weight_stamps_s.size == 0:
        return None
    times_s = files.weight_stamps_s - files.trajectory.stamps_ns[0] / NS_PER_S
    colors = {"laser": color_of("lidar"), "visual": color_of("depth")}
    others = iter(_OTHER_COLORS * len(weights))
    courses = [
        Course(words=name, color=colors.get(name) or next(others), times_s=times_s, values=values)
        for name, values in weights.items()
    ]
    return _plot(courses, f"weight of the {what}", (0.0, 1.0))


def _plot(
    courses: list[Course],
    words: str,
    limits: tuple[float, float],
    level: tuple[float, str] | None = None,
) -> ByteArray:
    return time_picture(
        courses, words=words, limits=limits, level=level, width_px=_WIDTH_PX, height_px=_PLOT_PX
    )


def _way_of(run: SlamRun) -> WayOnMap:
    files = run.files
    return WayOnMap(
        title=run.name,
        stamps_ns=files.trajectory.stamps_ns,
        poses=files.poses_map_scan,
        grid=files.grid,
    )
