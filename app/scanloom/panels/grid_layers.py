"""The grids of a run as layers of the scene, and what is known of a cell that is clicked."""

import threading
from collections.abc import Mapping
from typing import Any

import viser

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.map.grid_fusion import EVIDENCE_NAME, cell_evidence, read_evidence
from scanloom.client_session import ClientSession
from scanloom.jobs.build import results_in
from scanloom.jobs.slam_run import SlamRun
from scanloom.page.markup import paragraph
from scanloom.page.update_widget import update_widget
from scanloom.panels.cell_text import CLICK, evidence_html, states_html

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


class GridLayers:
    """Chooses a grid of the displayed run. ``show`` is called in the session's worker thread."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._session = session
        self._lock = threading.RLock()
        self._run: SlamRun | None = None
        self._chosen: str | None = None
        self._evidence: Mapping[str, OccupancyGrid] | None = None
        self._folder = gui.add_folder("Grids", visible=False)
        with self._folder:
            self._choice = gui.add_dropdown(
                "Grid",
                (_NONE,),
                hint="Which of the run's occupancy grids lies on the floor of the scene",
            )
            self._cell = gui.add_html(paragraph(CLICK))

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
            self._run, self._evidence, self._chosen = run, None, None
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
        results = results_in(run.folder)
        if not (results / EVIDENCE_NAME).exists():
            named = {label_of(name): grid for name, grid in run.grids.items()}
            return states_html(named, x_m, y_m)
        if self._evidence is None:
            self._evidence = {label_of(name): grid for name, grid in read_evidence(results).items()}
        return evidence_html(cell_evidence(self._evidence, x_m, y_m))

    def _first(self, run: SlamRun) -> str:
        """The label of the grid that is shown before one is chosen."""
        own = run.files.grid
        names = [_PREFERRED, *(name for name, grid in run.grids.items() if _is_same(grid, own))]
        return next((label_of(name) for name in [*names, *run.grids] if name in run.grids), _NONE)


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
