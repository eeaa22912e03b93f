"""The Match step: the offset of the best fit, and the two curves laid on each other there."""

import numpy as np
import viser

from fusion_core.workflows.fuse.cached_chain import CachedChain
from fusion_core.workflows.fuse.frame_match import FrameMatch, curves_at
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView, missing_result_text
from scanloom.page.markup import escape_markdown
from scanloom.page.update_widget import update_widget
from scanloom.page_parts import Panel
from scanloom.panels.mount_text import given_text, mount_text
from scanloom.panels.widgets.controls import Controls
from scanloom.plots.line_plot import (
    PlotLabels,
    add_line_plot,
    dots,
    set_limits,
    set_theme,
    whole_limits,
)
from scanloom.plots.palette import color_of
from scanloom.plots.theme import theme_of
from scanloom.state.calibration_view import pose_of
from scanloom.state.view import Scope

# What the similarity is of, by the view's name for it.
_SCOPES: dict[Scope, str] = {
    "frame": "this frame",
    "window": "frames around it",
    "recording": "whole recording",
}
_SCOPE_OF = {words: scope for scope, words in _SCOPES.items()}
_METRICS = ("euclidean", "pearson", "cosine", "inverse_cosine")


class MatchPanel(Panel):
    """The offset, the two curves at it, and the mount."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._session = session
        controls = Controls(gui, session)
        scope = gui.add_dropdown(
            "Similarity of",
            tuple(_SCOPE_OF),
            initial_value=_SCOPES[session.view.field_scope],
            hint="Which frames the similarity picture averages",
        )
        controls.bind_field(scope, "field_scope", _SCOPE_OF.__getitem__, _SCOPES.__getitem__)
        controls.dropdown("search", "metric", "Measured by", _METRICS)
        self._curves = add_line_plot(
            gui,
            PlotLabels(
                title="The two curves at this offset",
                x="sample of the row, from the left",
                x_short="sample",
                y="range (m)",
            ),
            (dots("depth row", color_of("depth")), dots("LiDAR curve", color_of("lidar"))),
        )
        with gui.add_folder("Pick by hand", expand_by_default=False):
            self._summary = gui.add_markdown("")
            self._u = gui.add_number(
                "u (samples)",
                0.0,
                step=0.25,
                hint="Sample of the LiDAR curve, from its left end, that the image begins at",
            )
            self._v = gui.add_number(
                "v (row)", 0.0, step=1.0, hint="Row of the depth image, from the top"
            )
            buttons = gui.add_button_group(
                "Offset",
                ("Use", "Clear"),
                hint="Use: pair the sensors at this u and v; clear: at the best fit",
            )
            lock = gui.add_checkbox(
                "Lock u",
                session.view.lock_picked_offset,
                hint="Keep the picked offset in other frames",
            )
            controls.bind_field(lock, "lock_picked_offset", bool)
        with gui.add_folder("Sampling and masks", expand_by_default=False):
            controls.slider("sampling", "step_deg", "Sampling step (°)", 0.25, 4.0, 0.25)
            controls.slider("sampling", "row_band", "Rows used, from the bottom", 0.1, 1.0, 0.05)
            controls.slider("search", "min_overlap", "Minimum overlap", 0.1, 1.0, 0.05)
            controls.checkbox("search", "mask_holes", "Leave holes out")
            controls.checkbox("search", "allow_partial", "Row may reach beyond the curve")
            controls.checkbox("search", "use_prior", "Search around the recording's offset")
        with gui.add_folder("Where the camera sits on the LiDAR", expand_by_default=False):
            self._mount = gui.add_markdown("")
        self._controls = controls

        @buttons.on_click
        def _(_: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            use = buttons.value == "Use"
            picked = (float(self._u.value), float(self._v.value)) if use else None
            session.change(picked_offset=picked)

    def show(self, frame_view: FrameView) -> None:
        """Draw the field, the curves and the summary of this view."""
        self._controls.show(frame_view.view)
        match = frame_view.match
        set_theme(self._curves, theme_of(is_dark=frame_view.is_dark))
        update_widget(self._curves, visible=match is not None)
        if match is None or frame_view.chain is None:
            update_widget(self._summary, content=escape_markdown(missing_result_text(frame_view)))
            return
        if frame_view.view.panel == "Match":
            update_widget(self._summary, content=_peak_text(frame_view, match))
            self._show_curves(frame_view, match)
            update_widget(self._mount, content=_mount_text(frame_view.chain))

    def _show_curves(self, frame_view: FrameView, match: FrameMatch) -> None:
        place = _place(frame_view, match)
        if place is None:
            return
        lidar_m, depth_m = curves_at(
            match, place, masked=frame_view.view.settings.search.mask_holes
        )
        self._curves.data = np.arange(lidar_m.size, dtype=np.float64), depth_m, lidar_m
        set_limits(self._curves, *whole_limits(lidar_m, depth_m))
        update_widget(self._u, value=round(place[0], 2))
        update_widget(self._v, value=round(place[1], 1))


def _mount_text(chain: CachedChain) -> str:
    alignment, given = chain.alignment, chain.session.rig.given
    if given is not None:
        return given_text(pose_of(chain), given.source, alignment.notes)
    estimate = alignment.estimate
    tilt = None if estimate is None else estimate.tilt
    return mount_text(
        alignment.mount,
        alignment.notes,
        seen_roll_rad=None if tilt is None else (tilt.roll_rad, tilt.roll_sd_rad),
        roll_used_rad=0.0 if estimate is None else estimate.roll_rad,
        is_roll_known=estimate is None or chain.session.rig.recorded_mount is not None,
    )


def _place(frame_view: FrameView, match: FrameMatch) -> tuple[float, float] | None:
    """The displayed offset: the picked one, else the frame's peak."""
    if frame_view.view.picked_offset is not None:
        return frame_view.view.picked_offset
    peak = match.search.peaks.get(frame_view.view.settings.search.metric)
    return None if peak is None else (peak.u, peak.v)


def _peak_text(frame_view: FrameView, match: FrameMatch) -> str:
    metric = frame_view.view.settings.search.metric
    peak = match.search.peaks.get(metric)
    if peak is None:
        return "No offset has enough samples valid on both sides: lower the minimum overlap."
    lines = [
        f"Best fit: **u = {peak.u:.2f}**, **v = {peak.v:.1f}**, with a similarity of "
        f"{peak.score:.2f} over {100.0 * peak.overlap:.0f} % of the samples. "
        f"{_second_best(peak.ratio)}"
    ]
    alone = match.search.peaks_without_prior.get(metric)
    if alone is not None and abs(alone.u - peak.u) > 0.5:
        lines.append(f"This frame alone would lie at u = {alone.u:.2f}.")
    if frame_view.view.picked_offset is not None:
        u, v = frame_view.view.picked_offset
        lines.append(
            f"Picked by hand: u = {u:.2f}, v = {v:.1f}; beams are paired with row {v:.0f}."
        )
    else:
        along = "the LiDAR's projected curve" if match.row_model == "curve" else "the row"
        lines.append(f"Beams are paired with pixels along {along}.")
    return "  \n".join(lines)


def _second_best(ratio: float) -> str:
    """``ratio``: score of the best fit over that of the second best."""
    if not np.isfinite(ratio) or ratio <= 0.0:
        return "There is no second best."
    if ratio < 1.0:
        return "It is held near the recording's offset; elsewhere scores more."
    return f"The second best scores {100.0 / ratio:.0f} % of that."
