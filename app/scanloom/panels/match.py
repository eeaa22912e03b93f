"""The Match panel: the similarity field, its peak, and the two curves laid on each other."""

from collections.abc import Callable
from functools import partial
from typing import get_args

import numpy as np
import viser

from fusion_core.workflows.fuse.cached_chain import mean_field_around
from fusion_core.workflows.fuse.frame_match import FrameMatch, curves_at
from scanloom.client_session import ClientSession, Panel
from scanloom.frame_view import FrameView, missing_result_text
from scanloom.panels.mount_text import mount_text
from scanloom.panels.widgets.controls import Controls, update_widget
from scanloom.panels.widgets.markup import escape_markdown
from scanloom.plots.heatmap import Heatmap, heatmap
from scanloom.plots.line_plot import PlotLabels, add_line_plot, dots, set_y_limits, whole_limits
from scanloom.plots.palette import color_of
from scanloom.plots.png import show_picture
from scanloom.plots.score_field import AzimuthAxis, Mark, ScoreField
from scanloom.state.view import Scope

_WIDTH_PX, _HEIGHT_PX = 500, 420
_METRICS = ("euclidean", "pearson", "cosine", "inverse_cosine")
# Frames on either side that the field of a window averages; set by hand.
_WINDOW_FRAMES = 2


class MatchPanel(Panel):
    """Heatmap, curves and mount. ``on_heatmap`` gets what draws each heatmap, for the scene's
    image_plane, and None where there is none."""

    def __init__(
        self,
        gui: viser.GuiApi,
        session: ClientSession,
        on_heatmap: Callable[[Callable[[], Heatmap] | None], None],
    ) -> None:
        self._session = session
        self._on_heatmap = on_heatmap
        self._drawn: Heatmap | None = None
        # The frame, chain and options of the last drawing.
        self._drawn_of: tuple[object, object, object] = None, None, None
        controls = Controls(gui, session)
        scope = gui.add_dropdown(
            "Field of",
            get_args(Scope),
            initial_value=session.view.field_scope,
            hint="What is averaged",
        )
        controls.bind_field(scope, "field_scope", str)
        controls.dropdown("search", "metric", "Score", _METRICS)
        self._picture = gui.add_image(
            np.full((_HEIGHT_PX, _WIDTH_PX, 3), 255, np.uint8), format="png", visible=False
        )
        self._summary = gui.add_markdown("")
        with gui.add_folder("Pick by hand"):
            self._u = gui.add_number("u (samples)", 0.0, step=0.25)
            self._v = gui.add_number("v (row)", 0.0, step=1.0)
            buttons = gui.add_button_group("Offset", ("Use", "Clear"))
            lock = gui.add_checkbox(
                "Lock u",
                session.view.lock_picked_offset,
                hint="Keep the picked offset in other frames",
            )
            controls.bind_field(lock, "lock_picked_offset", bool)
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
        with gui.add_folder("Sampling and masks"):
            controls.slider("sampling", "step_deg", "Sampling step (°)", 0.25, 4.0, 0.25)
            controls.slider("sampling", "row_band", "Rows used, from the bottom", 0.1, 1.0, 0.05)
            controls.slider("search", "min_overlap", "Minimum overlap", 0.1, 1.0, 0.05)
            controls.checkbox("search", "mask_holes", "Mask holes")
            controls.checkbox("search", "allow_partial", "Row may reach beyond the curve")
            controls.checkbox("search", "use_prior", "Search around the recording's u")
        with gui.add_folder("Mount"):
            self._mount = gui.add_markdown("")
        self._controls = controls

        @buttons.on_click
        def _(_: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            use = buttons.value == "Use"
            picked = (float(self._u.value), float(self._v.value)) if use else None
            session.change_settings(picked_offset=picked)

    def show(self, frame_view: FrameView) -> None:
        """Draw the field, the curves and the summary of this view."""
        self._controls.show(frame_view.view)
        match = frame_view.match
        for picture in (self._picture, self._curves):
            update_widget(picture, visible=match is not None)
        if match is None or frame_view.chain is None:
            self._on_heatmap(None)
            update_widget(self._summary, content=escape_markdown(missing_result_text(frame_view)))
            return
        self._on_heatmap(partial(self._heatmap_of, frame_view, match))
        if frame_view.view.panel == "Match":
            show_picture(self._picture, self._heatmap_of(frame_view, match).rgb)
            update_widget(self._summary, content=_peak_text(frame_view, match))
            self._show_curves(frame_view, match)
            alignment = frame_view.chain.alignment
            update_widget(self._mount, content=mount_text(alignment.mount, alignment.notes))

    def _heatmap_of(self, frame_view: FrameView, match: FrameMatch) -> Heatmap:
        """The picture of this view; the last one if nothing has changed."""
        view = frame_view.view
        # A match is kept as long as its settings are: a new epsilon makes no new one.
        frame = match if view.field_scope != "recording" else None
        inputs = (view.field_scope, view.settings.search.metric, view.picked_offset)
        of, chain, before = self._drawn_of
        is_same = of is frame and chain is frame_view.chain and before == inputs
        if self._drawn is None or not is_same:
            self._drawn_of = frame, frame_view.chain, inputs
            self._drawn = self._draw(frame_view, match)
        return self._drawn

    def _draw(self, frame_view: FrameView, match: FrameMatch) -> Heatmap:
        view, chain = frame_view.view, frame_view.chain
        assert chain is not None, "a match was made by a chain"
        metric = view.settings.search.metric
        alignment = chain.alignment
        if view.field_scope == "recording":
            field: ScoreField = alignment.fields[metric]
            curve = alignment.curve
            peak = alignment.peaks.get(metric)
            prior_u, title = alignment.peak.u, f"Mean of {alignment.frames} frames"
        else:
            field, curve = match.search.fields[metric], match.curve
            peak = match.search.peaks.get(metric)
            prior_u, title = alignment.peak.u - match.u_of_rig, f"Frame {view.frame_index}"
            if view.field_scope == "window":
                field, count = mean_field_around(
                    chain, view.frame_index, view.settings, _WINDOW_FRAMES
                )
                title = f"Mean of {count} frames around {view.frame_index}"
        marks = [Mark("prior", prior_u)]
        if peak is not None:
            marks += [Mark("runner_up", peak.runner_up_u, peak.runner_up_v)]
            marks += [Mark("peak", peak.u, peak.v)]
        if view.picked_offset is not None:
            marks += [Mark("picked", *view.picked_offset)]
        return heatmap(
            field,
            marks,
            AzimuthAxis.of_curve(curve.left_rad, curve.step_rad),
            width_px=_WIDTH_PX,
            height_px=_HEIGHT_PX,
            title=f"{title}, {metric.replace('_', ' ')}",
        )

    def _show_curves(self, frame_view: FrameView, match: FrameMatch) -> None:
        place = _place(frame_view, match)
        if place is None:
            return
        lidar_m, depth_m = curves_at(
            match, place, masked=frame_view.view.settings.search.mask_holes
        )
        self._curves.data = np.arange(lidar_m.size, dtype=np.float64), depth_m, lidar_m
        set_y_limits(self._curves, *whole_limits(lidar_m, depth_m))
        update_widget(self._u, value=round(place[0], 2))
        update_widget(self._v, value=round(place[1], 1))


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
        f"Peak **u = {peak.u:.2f}**, **v = {peak.v:.1f}**, score {peak.score:.3f}, "
        f"{_runner_up(peak.ratio)}, overlap {peak.overlap:.0%}."
    ]
    alone = match.search.peaks_without_prior.get(metric)
    if alone is not None and abs(alone.u - peak.u) > 0.5:
        lines.append(f"Without the recording's u it would be at u = {alone.u:.2f}.")
    if frame_view.view.picked_offset is not None:
        u, v = frame_view.view.picked_offset
        lines.append(f"Picked by hand: u = {u:.2f}, v = {v:.1f}; pairs are those of row {v:.0f}.")
    else:
        along = "the LiDAR's projected curve" if match.row_model == "curve" else "the row"
        lines.append(f"Pairs lie along {along}.")
    return "  \n".join(lines)


def _runner_up(ratio: float) -> str:
    return f"{ratio:.2f} times the runner-up" if np.isfinite(ratio) else "no runner-up"
