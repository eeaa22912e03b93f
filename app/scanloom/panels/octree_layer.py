"""The octree of a run of visual SLAM as boxes at a chosen depth, instead of its cloud."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import viser

from fusion_core.model.octree import TREE_DEPTH, OccupancyOctree
from fusion_core.workflows.map.octree_boxes import (
    OCTREE_NAME,
    OctreeBoxes,
    octree_boxes,
    read_run_octree,
)
from scanloom.client_session import ClientSession
from scanloom.jobs.build import results_in
from scanloom.jobs.latest_only_worker import LatestOnlyWorker
from scanloom.jobs.slam_run import SlamRun
from scanloom.page.markup import paragraph
from scanloom.page.update_widget import update_widget
from scanloom.panels.visual_stage import VisualStage
from scanloom.scene.visual_shapes import Boxes, height_colors

CLOUD, OCTREE = "cloud", "octree boxes"
# From boxes of the size of a room on.
_DEPTH_MIN = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Wanted:
    """Boxes of which run, at which depth; None for the cloud."""

    run: SlamRun
    depth: int | None


class OctreeLayer:
    """Chooses between cloud and boxes. ``show`` is called in the session's worker thread;
    ``on_kind`` in viser's, when a person has chosen."""

    def __init__(
        self,
        gui: viser.GuiApi,
        session: ClientSession,
        stage: VisualStage,
        on_kind: Callable[[], None] = lambda: None,
    ) -> None:
        self._session, self._stage, self._on_kind = session, stage, on_kind
        self._lock = threading.RLock()
        self._run: SlamRun | None = None
        self._octree: tuple[SlamRun, OccupancyOctree] | None = None
        self._kind = gui.add_dropdown(
            "Shown as",
            (CLOUD, OCTREE),
            visible=False,
            hint="The cloud of points, or the octree's occupied cells, coloured by their height",
        )
        self._depth = gui.add_slider(
            "Octree depth",
            min=_DEPTH_MIN,
            max=TREE_DEPTH,
            step=1,
            initial_value=TREE_DEPTH,
            visible=False,
            hint="How far the octree is followed: each step halves the edge of the boxes",
        )
        self._words = gui.add_html("", visible=False)
        self._drawing = LatestOnlyWorker("octree", self._draw, session.show_failure)
        for handle in (self._kind, self._depth):
            self._bind(handle)

    def show(self, run: SlamRun | None) -> None:
        """The octree of a run, None for none."""
        with self._lock:
            has_octree = run is not None and (results_in(run.folder) / OCTREE_NAME).is_file()
            self._update_visible(has_octree=has_octree)
            if run is self._run:
                return
            self._run, self._octree = run, None
            self._stage.draw_boxes(None)
            if has_octree:
                self._submit()

    @property
    def shows_boxes(self) -> bool:
        """Whether boxes take the place of the cloud."""
        return bool(self._kind.visible) and self._kind.value == OCTREE

    def close(self) -> None:
        """Draw nothing more."""
        self._drawing.close()

    def _bind(self, handle: Any) -> None:
        @handle.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                with self._lock:
                    self._update_visible(has_octree=True)
                    self._submit()
                self._on_kind()

    def _update_visible(self, *, has_octree: bool) -> None:
        is_octree = self._kind.value == OCTREE
        update_widget(self._kind, visible=has_octree)
        for handle in (self._depth, self._words):
            update_widget(handle, visible=has_octree and is_octree)

    def _submit(self) -> None:
        if self._run is not None:
            depth = int(self._depth.value) if self._kind.value == OCTREE else None
            self._drawing.submit(_Wanted(run=self._run, depth=depth))

    def _draw(self, wanted: _Wanted, is_newest: Callable[[], bool]) -> None:
        if wanted.depth is None:
            self._stage.draw_boxes(None)
            return
        held = self._octree
        if held is None or held[0] is not wanted.run:
            octree = read_run_octree(results_in(wanted.run.folder))
            if octree is None:
                return
            held = self._octree = wanted.run, octree
        # A browser may send any number.
        depth = min(max(wanted.depth, _DEPTH_MIN), TREE_DEPTH)
        found = octree_boxes(held[1], depth)
        boxes = Boxes(
            middles_m=found.centres_in_map_m,
            sizes_m=found.sides_m,
            rgb=height_colors(found.centres_in_map_m[:, 2]),
        )
        if not is_newest():
            return
        with self._lock, self._session.batch_updates():
            if wanted.run is self._run:
                self._stage.draw_boxes(boxes)
                update_widget(self._words, content=paragraph(boxes_text(found, depth)))


def boxes_text(found: OctreeBoxes, asked: int) -> str:
    """How many boxes are drawn, and how large they are, as text."""
    count = len(found.sides_m)
    if not count:
        return "The octree has no occupied cell."
    largest_m = float(found.sides_m.max())
    size = f"of {found.finest_side_m:.3g} m"
    # Sides are steps of two, in single precision.
    if largest_m > 1.5 * found.finest_side_m:
        size += f" to {largest_m:.3g} m"
    cut = ""
    if found.depth < asked:
        cut = f" Depth {asked} has too many to be drawn: it is cut at depth {found.depth}."
    return f"{count:,} {'box' if count == 1 else 'boxes'} {size}.{cut}"
