"""The Repair panel: classes, conflicts, one beam in detail, the depth image before and after."""

from dataclasses import replace

import numpy as np
import viser

from fusion_core.model.classes import NoiseClass
from fusion_core.workflows.fuse.frame import FusedFrame
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.page.update_widget import update_widget
from scanloom.page_parts import Panel
from scanloom.panels.epsilon import EpsilonSliders
from scanloom.panels.repair_tables import beam_table, class_table
from scanloom.panels.widgets.controls import Controls
from scanloom.plots.depth_image import PairOverlay, depth_limits_m, depth_picture
from scanloom.plots.pair_pixels import pixels_of_match, repaired_depth_m
from scanloom.plots.png import show_picture
from scanloom.plots.theme import Theme, theme_of
from scanloom.scene.frame_summary import ConflictRun, conflict_runs
from scanloom.state.view import View

# Slightly wider than the panel, so that an enlarged picture stays sharp.
_WIDTH_PX, _HEIGHT_PX = 480, 420
_NO_CONFLICTS = "none in this frame"
_UNKNOWN = "not known: the frame is not classified"
_NO_LAYER = "none: the automatic classes"


class RepairPanel(Panel):
    """Conflicts, details of one beam, class filter, depth image before and after."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._session = session
        # What the tables and the pictures were drawn from.
        self._drawn: tuple[FusedFrame | None, object] = None, None
        self._drawn_pictures: tuple[FusedFrame | None, object] = None, None
        # The runs of conflicts by their labels in the list.
        self._runs: dict[str, ConflictRun] = {}
        self._controls = Controls(gui, session)
        controls = self._controls
        self._epsilon = EpsilonSliders(gui, session, controls)
        repaired = gui.add_checkbox(
            "Repaired",
            session.view.show_repaired,
            hint="Show repaired values on the stage and in the depth image, else those recorded",
        )
        controls.bind_field(repaired, "show_repaired", bool)
        self._layers = gui.add_dropdown(
            "Labels",
            (_NO_LAYER,),
            hint="A layer of people's labels, which overrule the classes here and so the repair",
        )
        controls.bind_field(
            self._layers,
            "label_layer",
            lambda name: "" if name == _NO_LAYER else name,
            lambda name: name or _NO_LAYER,
        )
        with gui.add_folder("Why: one beam"):
            self._conflicts = gui.add_dropdown(
                "Conflicts",
                (_NO_CONFLICTS,),
                hint="Beams of this frame that see another surface than the camera",
            )
            self._step = gui.add_button_group(
                "Go to conflict", ("Previous", "Next"), hint="Among those of this frame"
            )
            controls.optional_number(
                "Beam",
                "selected_beam",
                hint="Number of a beam of the scan, from 0; empty: none. A click on a beam or a "
                "pixel chooses one, too",
            )
            self._beam_details = gui.add_html("")
        with gui.add_folder("Classes, before and after", expand_by_default=False):
            self._classes = gui.add_html("")
            for noise in NoiseClass:
                self._add_filter(gui, noise)
            both = gui.add_checkbox(
                "Before and after",
                session.view.show_raw_and_repaired,
                hint="Show the depth image as recorded and as repaired, one above the other",
            )
            controls.bind_field(both, "show_raw_and_repaired", bool)
            empty = np.full((_HEIGHT_PX, _WIDTH_PX, 3), 255, dtype=np.uint8)
            self._pictures = [gui.add_image(empty, format="png", visible=False) for _ in range(2)]
        with gui.add_folder("More settings", expand_by_default=False):
            controls.slider("noise", "support_sigma", "Support (σ)", 0.5, 10.0, 0.1)
            sources = ("smaller_error", "other_sensor")
            controls.dropdown("repair", "prefer", "Prefer", sources)
            controls.slider("repair", "max_gap_deg", "Widest gap (°)", 0.0, 30.0, 0.5)
            controls.slider("repair", "max_gap_pixels", "Farthest pixel", 1, 100, 1)
            controls.slider(
                "repair", "farther_confidence", "Confidence to move farther", 0.0, 1.0, 0.05
            )
        # The list depends on the frame, not on the view.
        controls.bind(self._conflicts, lambda _: None, self._select_conflict)

        @self._step.on_click
        def _(_: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            self._step_conflict(1 if self._step.value == "Next" else -1)

    def show(self, frame_view: FrameView) -> None:
        """Draw the frame of this view, while the panel is open."""
        view = frame_view.view
        self._show_layers(frame_view)
        self._controls.show(view)
        self._epsilon.show(view)
        if view.panel != "Repair":
            return
        update_widget(self._step, visible=frame_view.fused is not None)
        if frame_view.fused is None:
            self._hide()
            return
        fused = frame_view.fused
        self._show_pictures(fused, view, theme_of(is_dark=frame_view.is_dark))
        inputs = view.selected_beam, view.settings
        if self._drawn[0] is fused and self._drawn[1] == inputs:
            return
        self._drawn = fused, inputs
        update_widget(self._classes, content=class_table(fused))
        self._show_conflicts(fused, view)
        update_widget(
            self._beam_details, content=beam_table(fused, view.selected_beam, view.settings)
        )

    def _show_layers(self, frame_view: FrameView) -> None:
        """Offer the layers of the recording's labels, where there are any."""
        path, wanted = frame_view.open_recording.recording.path, frame_view.view.label_layer
        layers = dict.fromkeys([*self._session.library.labels(path).known_layers, wanted])
        names = [name for name in layers if name]
        update_widget(self._layers, options=(_NO_LAYER, *names), visible=bool(names))

    def _show_pictures(self, frame: FusedFrame, view: View, theme: Theme) -> None:
        """Draw the depth image before and after, only while both are wanted: each takes as long as
        the picture beside the stage."""
        for handle in self._pictures:
            update_widget(handle, visible=view.show_raw_and_repaired)
        inputs = view.visible_classes, view.selected_beam, theme
        is_drawn = self._drawn_pictures[0] is frame and self._drawn_pictures[1] == inputs
        if not view.show_raw_and_repaired or is_drawn:
            return
        self._drawn_pictures = frame, inputs
        after = pixels_of_match(frame.match, frame)
        before = replace(after, repaired=np.zeros_like(after.repaired))
        images = (
            ("Before: as recorded", frame.match.depth_m, before),
            ("After: repaired", repaired_depth_m(frame), after),
        )
        limits_m = depth_limits_m(frame.match.depth_m)
        for handle, (title, depth_m, pairs) in zip(self._pictures, images, strict=True):
            overlay = PairOverlay(
                pixels=pairs, classes=view.visible_classes, beam=view.selected_beam
            )
            drawn = depth_picture(
                title,
                depth_m,
                overlay,
                width_px=_WIDTH_PX,
                height_px=_HEIGHT_PX,
                limits_m=limits_m,
                theme=theme,
            )
            show_picture(handle, drawn.rgb)

    def _show_conflicts(self, frame: FusedFrame, view: View) -> None:
        runs = conflict_runs(frame)
        self._runs = {_conflict_label(run): run for run in runs}
        heading = f"{len(runs)} in this frame: choose one" if runs else _NO_CONFLICTS
        update_widget(self._conflicts, options=(heading, *self._runs))
        chosen = [
            label for label, run in self._runs.items() if _contains_beam(run, view.selected_beam)
        ]
        update_widget(self._conflicts, value=chosen[0] if chosen else heading)

    def _hide(self) -> None:
        """Hide the results: they belong to another frame."""
        self._drawn = self._drawn_pictures = None, None
        for handle in self._pictures:
            update_widget(handle, visible=False)
        self._runs = {}
        update_widget(self._conflicts, options=(_UNKNOWN,))
        for table in (self._classes, self._beam_details):
            update_widget(table, content="")

    def _add_filter(self, gui: viser.GuiApi, noise: NoiseClass) -> None:
        """Add a checkbox for the visibility of a class."""
        box = gui.add_checkbox(
            f"Show {noise.name.lower()}",
            noise in self._session.view.visible_classes,
            hint="On the stage and in the depth image",
        )

        def change(checked: bool) -> None:
            others = self._session.view.visible_classes - {noise}
            self._session.change(visible_classes=others | {noise} if checked else others)

        self._controls.bind(box, lambda view: noise in view.visible_classes, change)

    def _select_conflict(self, label: str) -> None:
        """Select the middle beam of a conflict; the list's heading selects none."""
        run = self._runs.get(label)
        if run is not None:
            self._session.change(selected_beam=run.middle)

    def _step_conflict(self, by: int) -> None:
        """Select the next or previous conflict, cyclically."""
        runs = list(self._runs.values())
        if not runs:
            return
        at = [
            place
            for place, run in enumerate(runs)
            if _contains_beam(run, self._session.view.selected_beam)
        ]
        place = at[0] + by if at else (by - 1) // 2
        self._session.change(selected_beam=runs[place % len(runs)].middle)


def _conflict_label(run: ConflictRun) -> str:
    beams = f"{run.first}" if run.first == run.last else f"{run.first}–{run.last}"
    return f"beam {beams}: LiDAR {run.lidar_m:.2f} m, camera {run.camera_m:.2f} m"


def _contains_beam(run: ConflictRun, beam: int | None) -> bool:
    return beam is not None and run.first <= beam <= run.last
