"""The finished SLAM runs: one with its map, report and files, and a comparison of two."""

import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import viser

from fusion_core.model.errors import ScanLoomError
from scanloom.client_session import ClientSession
from scanloom.jobs.build import results_in, zip_folder
from scanloom.jobs.slam_run import SlamRun, keep, resampling_at
from scanloom.page.markup import paragraph, text_box
from scanloom.page.update_widget import update_widget
from scanloom.panels.slam_plots import (
    add_distance_plot,
    add_effective_plot,
    add_weights_plot,
    show_distance,
    show_effective_of,
    show_weights,
)
from scanloom.panels.slam_text import run_distance_text, run_report_html
from scanloom.panels.widgets.result_figures import ResultFigures
from scanloom.plots.line_plot import set_theme
from scanloom.plots.png import show_picture
from scanloom.plots.run_comparison import RunOnMap, compare_trajectories, comparison_picture
from scanloom.plots.theme import Theme
from scanloom.state.slam_runs import SlamRuns

_WIDTH_PX, _HEIGHT_PX = 480, 640
_NONE_YET = "none yet"
_EMPTY = np.full((2, 2, 3), 255, dtype=np.uint8)


class _RunChoice:
    """A dropdown of runs. Callers of ``offer`` hold ``lock``."""

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
        """Set the options and the chosen run.

        An unchanged choice is not set again: the user may just have chosen another run.
        """
        names = tuple(run.name for run in runs)
        if self._handle.options != names:
            self._handle.options = names
            self._known = None
        if chosen.name != self._known:
            self._known = chosen.name
            update_widget(self._handle, value=chosen.name)


class SlamResults:
    """Displays the runs of one session. ``show`` is called in the session's worker thread."""

    def __init__(
        self, gui: viser.GuiApi, session: ClientSession, runs: SlamRuns, output_root: Path
    ) -> None:
        self._session, self._runs, self._root = session, runs, output_root
        self._lock = threading.RLock()
        self._chosen: str | None = None
        self._compared: dict[str, str | None] = {"A": None, "B": None}
        self._saved: dict[SlamRun, Path] = {}
        # What the widgets display.
        self._displayed: SlamRun | None = None
        self._shown_pair: tuple[SlamRun, SlamRun, Theme] | None = None

        self._result = gui.add_folder("Result", visible=False)
        with self._result:
            choice = gui.add_dropdown(
                "Run shown", (_NONE_YET,), hint="One of this page's runs of this recording"
            )
            self._figures = ResultFigures(gui, ("trajectory",))
            self._effective = add_effective_plot(gui)
            self._translation = add_weights_plot(gui, "translation")
            self._rotation = add_weights_plot(gui, "rotation")
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
            sides = {
                name: gui.add_dropdown(name, (_NONE_YET,), hint=f"The {which} run that is compared")
                for name, which in zip(self._compared, ("first", "second"), strict=True)
            }
            self._both = gui.add_image(_EMPTY, format="png", visible=False)
            self._distance = add_distance_plot(gui)
            self._difference = gui.add_html("")

        self._choice = _RunChoice(choice, self._lock, self._choose)
        self._sides = {
            name: _RunChoice(handle, self._lock, partial(self._compare, name))
            for name, handle in sides.items()
        }
        self._download.on_click(lambda _: self._send())
        self._save.on_click(lambda _: self._keep())

    def chosen(self, recording: str) -> SlamRun | None:
        """The displayed run: the chosen one, else the last of the recording."""
        runs = self._runs.of(recording)
        named = [run for run in runs if run.name == self._chosen]
        return next(iter(named or runs[-1:]), None)

    def saved(self, run: SlamRun) -> Path | None:
        """The folder that a run was saved to, None if it was not."""
        return self._saved.get(run)

    def take(self, run: SlamRun) -> None:
        """Choose a new run."""
        with self._lock:
            self._chosen = run.name

    def show(self, recording: str, theme: Theme) -> None:
        """Display the runs of a recording."""
        with self._lock:
            runs = self._runs.of(recording)
            self._forget()
            update_widget(self._result, visible=bool(runs))
            update_widget(self._comparison, visible=len(runs) > 1)
            for plot in (self._effective, self._translation, self._rotation, self._distance):
                set_theme(plot, theme)
            if not runs:
                return
            run = self.chosen(recording)
            assert run is not None, "there are runs"
            self._choice.offer(runs, run)
            self._show_run(run)
            if len(runs) > 1:
                self._show_pair(runs, theme)

    def _show_run(self, run: SlamRun) -> None:
        saved = self._saved.get(run)
        update_widget(self._where, content="" if saved is None else text_box(str(saved)))
        if run is self._displayed:
            return
        self._displayed = run
        self._figures.show(results_in(run.folder))
        show_effective_of(self._effective, run, resampling_at(run.view))
        show_weights(self._translation, run, run.files.translation_weights)
        show_weights(self._rotation, run, run.files.rotation_weights)
        update_widget(self._report, content=run_report_html(run))

    def _show_pair(self, runs: list[SlamRun], theme: Theme) -> None:
        by_name = {run.name: run for run in runs}
        fallbacks = {"A": runs[-2], "B": runs[-1]}
        first, second = (
            by_name.get(name or "", fallbacks[side]) for side, name in self._compared.items()
        )
        for side, run in zip(self._sides.values(), (first, second), strict=True):
            side.offer(runs, run)
        if (first, second, theme) == self._shown_pair:
            return
        self._shown_pair = first, second, theme
        on_maps = _on_map(first), _on_map(second)
        found = compare_trajectories(*on_maps)
        update_widget(self._both, visible=found is not None)
        update_widget(self._difference, content=paragraph(run_distance_text(found)))
        show_distance(self._distance, found)
        if found is not None:
            picture = comparison_picture(
                *on_maps,
                second_in_first=found.second_in_first,
                width_px=_WIDTH_PX,
                height_px=_HEIGHT_PX,
                theme=theme,
            )
            show_picture(self._both, picture)

    def _choose(self, value: str) -> None:
        self._chosen = value
        self._session.refresh()

    def _compare(self, side: str, value: str) -> None:
        self._compared[side] = value
        self._session.refresh()

    def _send(self) -> None:
        run = self._displayed
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
            run = self._displayed
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
        """Forget the runs whose folders were deleted."""
        self._saved = {run: folder for run, folder in self._saved.items() if run.folder.exists()}


def _on_map(run: SlamRun) -> RunOnMap:
    files = run.files
    return RunOnMap(
        title=run.name,
        stamps_ns=files.trajectory.stamps_ns,
        poses=files.trajectory.planar_poses,
        grid=files.grid,
    )
