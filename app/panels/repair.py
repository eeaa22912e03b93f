"""The Repair panel: depth and curve before and after, classes, conflicts, and why of each beam."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import viser
import viser.uplot

from app.desk import Desk
from app.panels.beam_words import beam_words
from app.panels.class_table import class_table
from app.panels.controls import Controls, put
from app.scene.depth_picture import depth_limits_m, depth_picture
from app.scene.findings import ConflictRun, conflict_runs
from app.scene.pair_pixels import pixels_of_match, repaired_depth_m
from app.scene.palette import css_color
from app.scene.range_curves import range_curves
from app.shown import Shown
from app.state.view import View
from fusion_core.model.classes import NoiseClass
from fusion_core.workflows.frame import FusedFrame

# A picture in these pixels is shrunk a little by the panel, and sharp when it is enlarged.
_WIDTH_PX, _HEIGHT_PX = 480, 420
# Ends and step of epsilon's slider in each of its units.
_EPSILON = {"sigma": (0.5, 8.0, 0.1), "E": (0.5, 4.0, 0.05), "m": (0.01, 0.5, 0.01)}
_EPSILON_LABEL = {"sigma": "ε (σ)", "E": "ε (E)", "m": "ε (m)"}
_NO_BEAM = -1


class RepairPanel:
    """Depth image and curve before and after, a filter of classes, conflicts, one beam's story."""

    def __init__(self, gui: viser.GuiApi, desk: Desk) -> None:
        self._desk = desk
        self._drawn: tuple[FusedFrame | None, object] = None, None
        self._runs: list[ConflictRun] = []
        self._controls = Controls(gui, desk)
        self._words = gui.add_html("", visible=False)
        both = gui.add_checkbox(
            "Before and after", desk.view.both, hint="Show the raw depth image and the repaired one"
        )
        repaired = gui.add_checkbox(
            "Repaired", desk.view.repaired, hint="In the scene, and here where there is one image"
        )
        self._controls.bind(both, "both", bool)
        self._controls.bind(repaired, "repaired", bool)
        empty = np.full((_HEIGHT_PX, _WIDTH_PX, 3), 255, dtype=np.uint8)
        self._pictures = [gui.add_image(empty, format="png", visible=False) for _ in range(2)]
        with gui.add_folder("Classes"):
            self._classes = gui.add_html("")
            self._boxes = {
                noise: gui.add_checkbox(
                    f"Show {noise.name.lower()}",
                    noise in desk.view.classes,
                    hint="In the images, the curve and the scene",
                )
                for noise in NoiseClass
            }
        self._curve = _add_curve(gui)
        with gui.add_folder("One beam"):
            self._conflicts = gui.add_dropdown("Conflicts", ("none in this frame",))
            self._next = gui.add_button_group("Go to conflict", ("Previous", "Next"))
            self._beam = gui.add_number(
                "Beam",
                _NO_BEAM,
                min=_NO_BEAM,
                step=1,
                hint="Of the scan, from 0; -1: none. A click in the scene chooses one too",
            )
            self._story = gui.add_html("")
        with gui.add_folder("Settings", expand_by_default=False):
            self._epsilon = {
                unit: self._controls.slider("noise", "epsilon", _EPSILON_LABEL[unit], *ends)
                for unit, ends in _EPSILON.items()
            }
            controls = self._controls
            controls.slider("noise", "support_sigma", "Support (σ)", 0.5, 10.0, 0.1)
            sources = ("smaller_error", "other_sensor")
            controls.dropdown("repair", "prefer", "Prefer", sources)
            controls.slider("repair", "max_gap_deg", "Widest gap (°)", 0.0, 30.0, 0.5)
            controls.slider("repair", "max_gap_pixels", "Farthest pixel", 1, 100, 1)
            controls.slider("repair", "farther_confidence", "Sure to move farther", 0.0, 1.0, 0.05)
        self._listen()

    def show(self, shown: Shown) -> None:
        """Draw the frame of this view, while the panel is open."""
        view = shown.view
        self._controls.show(view)
        for unit, slider in self._epsilon.items():
            put(slider, visible=unit == view.settings.noise.epsilon_unit)
        for noise, box in self._boxes.items():
            put(box, value=noise in view.classes)
        put(self._beam, value=_NO_BEAM if view.beam is None else view.beam)
        if view.panel != "Repair":
            return
        put(self._words, content=_missing(shown), visible=shown.fused is None)
        if shown.fused is None:
            self._hide()
            return
        looked_at = (view.classes, view.both, view.repaired, view.beam, view.settings)
        if self._drawn[0] is shown.fused and self._drawn[1] == looked_at:
            return
        self._drawn = shown.fused, looked_at
        self._show_pictures(shown.fused, view)
        self._show_curve(shown.fused, view)
        put(self._classes, content=class_table(shown.fused))
        self._show_conflicts(shown.fused, view)
        put(self._story, content=beam_words(shown.fused, view.beam, view.settings))
