"""The grids of a run as layers of the scene, and what is known of a cell that is clicked."""

import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import viser

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.map.grid_fusion import (
    EVIDENCE_NAME,
    cell_evidence,
    differing_places_m,
    read_evidence,
)
from scanloom.client_session import ClientSession
from scanloom.jobs.build import results_in
from scanloom.jobs.slam_run import SlamRun
from scanloom.page.markup import paragraph
from scanloom.page.update_widget import update_widget
from scanloom.panels.cell_text import CLICK, differing_html, evidence_html, states_html

_NONE = "none"
_LABELS = {
    "lidar": "LiDAR",
    "camera": "camera",
    "merged": "merged scans",
    "repaired": "repaired scans",
    "fused": "fused",
}
# The grid that is shown at first is the result of the fusion, where there is one.
_PREFERRED = "fused"
_NOWHERE = np.empty((0, 2))


class GridLayers:
    """Chooses a grid of the displayed run. ``show`` is called in the session's worker thread.

    ``on_cell`` gets the (x, y) of a cell that is gone to, in viser's threads.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        session: ClientSession,
        on_cell: Callable[[FloatArray], None] = lambda _: None,
    ) -> None:
        self._session, self._on_cell = session, on_cell
        self._lock = threading.RLock()
        self._run: SlamRun | None = None
        self._chosen: str | None = None
        self._evidence: Mapping[str, OccupancyGrid] | None = None
        self._differing_m: FloatArray = _NOWHERE
        self._differing_of: SlamRun | None = None
        self._next = 0
        self._folder = gui.add_folder("Grids", visible=False)
        with self._folder:
            self._choice = gui.add_dropdown(
                "Grid",
                (_NONE,),
                hint="Which of the run's occupancy grids lies on the floor of the scene",
            )
            self._differing = gui.add_html("", visible=False)
            self._go_on = gui.add_button(
                "Next cell where the rules differ",
                visible=False,
                hint="Outline it on the map, and say what is known of it",
            )
            self._cell = gui.add_html(paragraph(CLICK))

        self._go_on.on_click(lambda _: self._go_to_next())

        @self._choice.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            # Without a client it was ``show`` that set the value.
            if event.client is not None:
                with self._lock:
                    self._chosen = self._choice.value
                session.refresh()

    def show(self, run: SlamRun | None) -> None:
        """The grids of a run, None for none."""
        with self._lock:
            update_widget(self._folder, visible=run is not None and bool(run.grids))
            if run is self._run:
                return
            self._run, self._chosen = run, None
            differing_m = _NOWHERE if run is None else self.differing_m(run)
            update_widget(
                self._differing,
                content=differing_html(len(differing_m)),
                visible=len(differing_m) > 0,
            )
            update_widget(self._go_on, visible=len(differing_m) > 0)
            update_widget(self._cell, content=paragraph(CLICK))
            if run is not None and run.grids:
                names = tuple(map(label_of, run.grids))
                update_widget(self._choice, options=(_NONE, *names))
                update_widget(self._choice, value=self._first(run))

    def grid_of(self, run: SlamRun) -> OccupancyGrid | None:
        """The grid that is to be seen of a run."""
        with self._lock:
            chosen = self._chosen if run is self._run else None
            wanted = chosen or self._first(run)
            return next((run.grids[name] for name in run.grids if label_of(name) == wanted), None)

    def differing_m(self, run: SlamRun) -> FloatArray:
        """(N, 2) places of the cells of a run of which the two rules of fusion make different
        things; none without a fusion."""
        with self._lock:
            if run is not self._differing_of:
                self._differing_of, self._evidence, self._next = run, None, 0
                self._differing_m = _NOWHERE
                try:
                    self._evidence = _evidence_of(run)
                    if self._evidence is not None:
                        self._differing_m = differing_places_m(self._evidence)
                except ScanLoomError as error:
                    self._session.show_failure(error)
            return self._differing_m

    def tell(self, place_m: FloatArray) -> None:
        """Say what is known of the cell at an (x, y) of the map."""
        x_m, y_m = map(float, place_m)
        with self._lock:
            run = self._run
            if run is None or not run.grids:
                return
            try:
                update_widget(self._cell, content=self._cell_html(run, x_m, y_m))
            except ScanLoomError as error:
                self._session.show_failure(error)

    def _cell_html(self, run: SlamRun, x_m: float, y_m: float) -> str:
        self.differing_m(run)
        if self._evidence is None:
            named = {label_of(name): grid for name, grid in run.grids.items()}
            return states_html(named, x_m, y_m)
        return evidence_html(cell_evidence(self._evidence, x_m, y_m))

    def _go_to_next(self) -> None:
        """Outline the next cell where the rules differ, and tell of it; after the last the first
        again."""
        with self._lock:
            if not len(self._differing_m):
                return
            place_m = self._differing_m[self._next % len(self._differing_m)]
            self._next += 1
        self._on_cell(place_m)
        self.tell(place_m)

    def _first(self, run: SlamRun) -> str:
        """The label of the grid that is shown before one is chosen."""
        own = run.files.grid
        names = [_PREFERRED, *(name for name, grid in run.grids.items() if _is_same(grid, own))]
        return next((label_of(name) for name in [*names, *run.grids] if name in run.grids), _NONE)


def _evidence_of(run: SlamRun) -> dict[str, OccupancyGrid] | None:
    """The grids that a run fused by their labels, None where it fused none. Raises ExportError for
    a file that cannot be read."""
    results = results_in(run.folder)
    if not (results / EVIDENCE_NAME).exists():
        return None
    return {label_of(name): grid for name, grid in read_evidence(results).items()}


def label_of(name: str) -> str:
    """What a grid is called on the page; ``name``: that of its file without ``map_``."""
    return _LABELS.get(name, name.replace("_", " "))


def _is_same(grid: OccupancyGrid, other: OccupancyGrid | None) -> bool:
    return (
        other is not None
        and grid.origin_m == other.origin_m
        and grid.log_odds.shape == other.log_odds.shape
        and bool(((grid.log_odds > 0.0) == (other.log_odds > 0.0)).all())
    )
