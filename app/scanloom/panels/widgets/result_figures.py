"""The figures that a build or a run wrote, shown as the files are."""

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import viser

from scanloom.page.update_widget import update_widget
from scanloom.plots.png import show_png

_TITLES = {
    "fig3_aligned": "Fig. 3: aligned in time",
    "fig4_similarity": "Fig. 4: similarity",
    "fig4_similarity_cosine": "Fig. 4: similarity by cosine",
    "fig5_pairs": "Fig. 5: pairs before and after RANSAC",
    "fig6_recall": "Fig. 6: recall over the threshold",
    "fig7_repair": "Fig. 7: before and after denoising",
    "fig8_fused_depth": "Fig. 8: fused depth image",
    "fig9_maps": "Fig. 9: maps from the same poses",
    "maps": "maps side by side",
    "map_difference": "difference of the maps",
    "map_lidar": "LiDAR map",
    "map_camera": "camera map",
    "map_fused": "fused map",
    "map_repaired": "map of repaired scans",
    "map_merged": "map of merged scans",
    "trajectory": "trajectory on the map",
    "cloud": "dense cloud",
    "mesh": "surface",
    "fusion": "both grids, fused by both rules",
    "misalignment": "how the two grids lie on each other",
    "effective": "effective number of particles",
    "odometry_weights": "weights of the odometries",
}
_NONE = "none"


class ResultFigures:
    """One of the figures in a folder of results, chosen by its title; a click enlarges it.

    ``preferred``: names without ``.png``, of which the first that exists is shown until another is
    chosen.
    """

    def __init__(self, gui: viser.GuiApi, preferred: Sequence[str]) -> None:
        self._preferred = preferred
        self._lock = threading.RLock()
        self._folder: Path | None = None
        self._files: dict[str, Path] = {}
        self._chosen: str | None = None
        self._displayed: Path | None = None
        empty = np.full((2, 2, 3), 255, dtype=np.uint8)
        self._choice = gui.add_dropdown(
            "Figure",
            (_NONE,),
            hint="A file of the results; a click enlarges it",
            visible=False,
        )
        self.picture = gui.add_image(empty, format="png", visible=False)

        @self._choice.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            # Without a client it was ``show`` that set the value.
            if event.client is not None:
                with self._lock:
                    self._chosen = self._choice.value
                    self._show_chosen()

    def show(self, folder: Path | None) -> None:
        """The figures of a folder of results, None for none."""
        with self._lock:
            if folder != self._folder:
                self._folder = folder
                self._files = {} if folder is None else figures_in(folder)
                update_widget(self._choice, options=tuple(self._files) or (_NONE,))
            self._show_chosen()

    def _show_chosen(self) -> None:
        """A figure that vanished since is not shown: its folder was cleared away."""
        wanted = [self._chosen, *map(title_of, self._preferred), *self._files]
        title = next((title for title in wanted if title in self._files), None)
        for widget in (self._choice, self.picture):
            update_widget(widget, visible=title is not None)
        if title is None:
            return
        update_widget(self._choice, value=title)
        file = self._files[title]
        if file != self._displayed:
            try:
                show_png(self.picture, file.read_bytes())
            except (OSError, ValueError):
                update_widget(self.picture, visible=False)
            else:
                self._displayed = file


def figures_in(folder: Path) -> dict[str, Path]:
    """The PNG files below a folder by title, in the order of the files' names."""
    return {title_of(file.stem): file for file in sorted(folder.rglob("*.png"))}


def title_of(name: str) -> str:
    """What a figure shows; ``name``: its file's without ``.png``."""
    return _TITLES.get(name, name.replace("_", " "))
