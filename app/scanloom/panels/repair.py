"""The Repair panel: depth and curve before and after, classes, conflicts, one beam in detail."""

import html
from dataclasses import replace

import numpy as np
import viser

from fusion_core.model.classes import NoiseClass
from fusion_core.workflows.fuse.frame import FusedFrame
from scanloom.client_session import ClientSession, Panel
from scanloom.frame_view import FrameView, missing_result_text
from scanloom.panels.epsilon import EpsilonSliders
from scanloom.panels.repair_tables import beam_table, class_table
from scanloom.panels.widgets.controls import Controls, update_widget
from scanloom.plots.depth_image import PairOverlay, depth_limits_m, depth_picture
from scanloom.plots.line_plot import PlotLabels, add_line_plot, dots, set_y_limits
from scanloom.plots.pair_pixels import pixels_of_match, repaired_depth_m
from scanloom.plots.palette import color_of
from scanloom.plots.png import show_picture
from scanloom.scene.frame_summary import ConflictRun, conflict_runs
from scanloom.scene.range_curves import range_curves
from scanloom.state.view import View

# Slightly wider than the panel, so that an enlarged picture stays sharp.
_WIDTH_PX, _HEIGHT_PX = 480, 420
_NO_BEAM = -1
_NO_CONFLICTS = "none in this frame"


class RepairPanel(Panel):
    """Depth image and curve before and after, class filter, conflicts, details of one beam."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._session = session
        self._drawn: tuple[FusedFrame | None, object] = None, None
        # The runs of conflicts by their labels in the list.
        self._runs: dict[str, ConflictRun] = {}
        self._controls = Controls(gui, session)
        self._message = gui.add_html("", visible=False)
        both = gui.add_checkbox(
            "Before and after",
            session.view.show_raw_and_repaired,
            hint="Show the raw depth image and the repaired one",
        )
        repaired = gui.add_checkbox(
            "Repaired",
            session.view.show_repaired,
            hint="In the scene, and here where there is one image",
        )
        self._controls.bind_field(both, "show_raw_and_repaired", bool)
        self._controls.bind_field(repaired, "show_repaired", bool)
        empty = np.full((_HEIGHT_PX, _WIDTH_PX, 3), 255, dtype=np.uint8)
        self._pictures = [gui.add_image(empty, format="png", visible=False) for _ in range(2)]
        with gui.add_folder("Classes"):
            self._classes = gui.add_html("")
            for noise in NoiseClass:
                self._add_filter(gui, noise)
        self._curve = _add_range_plot(gui)
        with gui.add_folder("One beam"):
            self._conflicts = gui.add_dropdown("Conflicts", (_NO_CONFLICTS,))
            self._step = gui.add_button_group("Go to conflict", ("Previous", "Next"))
            beam = gui.add_number(
                "Beam",
                _NO_BEAM,
                min=_NO_BEAM,
                step=1,
                hint="Of the scan, from 0; -1: none. A click in the scene selects one too",
            )
            self._beam_details = gui.add_html("")
        with gui.add_folder("Settings", expand_by_default=False):
            controls = self._controls
            self._epsilon = EpsilonSliders(gui, session, controls)
            controls.slider("noise", "support_sigma", "Support (σ)", 0.5, 10.0, 0.1)
            sources = ("smaller_error", "other_sensor")
            controls.dropdown("repair", "prefer", "Prefer", sources)
            controls.slider("repair", "max_gap_deg", "Widest gap (°)", 0.0, 30.0, 0.5)
            controls.slider("repair", "max_gap_pixels", "Farthest pixel", 1, 100, 1)
            controls.slider(
                "repair", "farther_confidence", "Confidence to move farther", 0.0, 1.0, 0.05
            )
        controls.bind_field(
            beam,
            "selected_beam",
            lambda value: None if value == _NO_BEAM else int(value),
            lambda value: _NO_BEAM if value is None else value,
        )
        # The list depends on the frame, not on the view.
        controls.bind(self._conflicts, lambda _: None, self._select_conflict)

        @self._step.on_click
        def _(_: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            self._step_conflict(1 if self._step.value == "Next" else -1)

    def show(self, frame_view: FrameView) -> None:
        """Draw the frame of this view, while the panel is open."""
        view = frame_view.view
        self._controls.show(view)
        self._epsilon.show(view)
        if view.panel != "Repair":
            return
        missing = f'<div style="padding:0.5em">{html.escape(missing_result_text(frame_view))}</div>'
        update_widget(self._message, content=missing, visible=frame_view.fused is None)
        if frame_view.fused is None:
            self._hide()
            return
        inputs = (
            view.visible_classes,
            view.show_raw_and_repaired,
            view.show_repaired,
            view.selected_beam,
            view.settings,
        )
        if self._drawn[0] is frame_view.fused and self._drawn[1] == inputs:
            return
        self._drawn = frame_view.fused, inputs
        self._show_pictures(frame_view.fused, view)
        self._show_curve(frame_view.fused, view)
        update_widget(self._classes, content=class_table(frame_view.fused))
        self._show_conflicts(frame_view.fused, view)
        update_widget(
            self._beam_details,
            content=beam_table(frame_view.fused, view.selected_beam, view.settings),
        )

    def _show_pictures(self, frame: FusedFrame, view: View) -> None:
        after = pixels_of_match(frame.match, frame)
        before = replace(after, repaired=np.zeros_like(after.repaired))
        images = (
            ("Before: as recorded", frame.match.depth_m, before),
            ("After: repaired", repaired_depth_m(frame), after),
        )
        limits_m = depth_limits_m(frame.match.depth_m)
        for place, (title, depth_m, pairs) in enumerate(images):
            handle = self._pictures[place]
            wanted = view.show_raw_and_repaired or place == int(view.show_repaired)
            if wanted:
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
                )
                show_picture(handle, drawn.rgb)
            update_widget(handle, visible=wanted)

    def _show_curve(self, frame: FusedFrame, view: View) -> None:
        curves = range_curves(frame, view.visible_classes, view.selected_beam)
        self._curve.data = (
            curves.azimuth_deg,
            curves.pixel_m,
            curves.repaired_m,
            curves.raw_m,
            curves.camera_m,
            curves.selected_m,
        )
        set_y_limits(self._curve, *curves.limits_m)
        update_widget(self._curve, visible=bool(curves.azimuth_deg.size))

    def _show_conflicts(self, frame: FusedFrame, view: View) -> None:
        runs = conflict_runs(frame)
        self._runs = {_conflict_label(run): run for run in runs}
        heading = f"{len(runs)}: choose one" if runs else _NO_CONFLICTS
        update_widget(self._conflicts, options=(heading, *self._runs))
        chosen = [
            label for label, run in self._runs.items() if _contains_beam(run, view.selected_beam)
        ]
        update_widget(self._conflicts, value=chosen[0] if chosen else heading)

    def _hide(self) -> None:
        """Hide the results: they belong to another frame."""
        self._drawn = None, None
        for handle in (*self._pictures, self._curve):
            update_widget(handle, visible=False)
        self._runs = {}
        update_widget(self._conflicts, options=(_NO_CONFLICTS,))
        for table in (self._classes, self._beam_details):
            update_widget(table, content="")

    def _add_filter(self, gui: viser.GuiApi, noise: NoiseClass) -> None:
        """Add a checkbox for the visibility of a class."""
        box = gui.add_checkbox(
            f"Show {noise.name.lower()}",
            noise in self._session.view.visible_classes,
            hint="In the images, the curve and the scene",
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


def _add_range_plot(gui: viser.GuiApi) -> viser.GuiUplotHandle:
    """The plot of ranges over azimuth, left to right as the camera sees it."""
    return add_line_plot(
        gui,
        PlotLabels(
            title="LiDAR curve and what the camera sees",
            x="azimuth in the LiDAR frame (°)",
            x_short="azimuth (°)",
            y="range (m)",
            x_falls=True,
        ),
        (
            dots("○ pixel", color_of("depth"), 9.0, hollow=True),
            dots("● repaired", color_of("fused"), 6.0),
            dots("● raw", color_of("lidar"), 4.0),
            dots("• camera", color_of("depth"), 2.0),
            dots("◯ chosen", color_of("fused"), 14.0, hollow=True),
        ),
    )


def _conflict_label(run: ConflictRun) -> str:
    beams = f"{run.first}" if run.first == run.last else f"{run.first}–{run.last}"
    return f"beam {beams}: LiDAR {run.lidar_m:.2f} m, camera {run.camera_m:.2f} m"


def _contains_beam(run: ConflictRun, beam: int | None) -> bool:
    return beam is not None and run.first <= beam <= run.last
