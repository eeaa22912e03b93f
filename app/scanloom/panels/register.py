"""The Register panel: the transform A, its draws, the residuals and the threshold epsilon."""

import numpy as np
import viser

from fusion_core.model.conventions import ByteArray
from fusion_core.workflows.fuse.frame_match import FrameMatch
from fusion_core.workflows.fuse.registration_details import (
    PlanarPairs,
    Registration,
    consensus_probabilities,
    decompose_registration,
    draw_at,
    planar_pairs,
)
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView, missing_result_text
from scanloom.page.markup import escape_markdown
from scanloom.page.update_widget import update_widget
from scanloom.page_parts import Panel
from scanloom.panels import registration_text
from scanloom.panels.epsilon import EpsilonControls
from scanloom.panels.recall import RecallPanel
from scanloom.panels.residual_plot import ResidualPlot
from scanloom.panels.widgets.controls import Controls
from scanloom.plots.pair_plot import PairPlot, pair_picture
from scanloom.plots.png import show_picture
from scanloom.plots.theme import LIGHT, Theme, theme_of

_WIDTH_PX, _PAIRS_PX, _DRAW_PX = 480, 590, 330
_MODELS = ("auto", "rigid", "similarity", "affine", "homography")
_STOPPINGS = ("fixed", "adaptive")
# In the paper's pairs x is an index, not a length.
_AXES_BY_SAMPLE = ("x: sample times its width (m)", "z: value (m)")
_AXES = ("x to the right (m)", "z ahead (m)")


class RegisterPanel(Panel):
    """Settings of RANSAC, its draws, A before and after, residuals and epsilon."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._session = session
        # What is drawn; drawn again when the object changes.
        self._registration: Registration | None = None
        self._last_draw = 0
        self._theme = LIGHT
        self._drawn_pairs: object = None
        self._drawn_draw: tuple[Registration | None, int] = (None, -1)
        controls = Controls(gui, session)
        self._controls = controls
        controls.dropdown("registration", "model", "Transform A", _MODELS)
        self._epsilon = EpsilonControls(gui, session)
        self._pairs = gui.add_image(_blank(_PAIRS_PX), format="png")
        with gui.add_folder("What the transform does", expand_by_default=False):
            self._summary = gui.add_markdown("")
        with gui.add_folder("Residuals", expand_by_default=False):
            self._residuals = ResidualPlot(gui)
        self._recall = RecallPanel(gui, session)
        with gui.add_folder("Draws, one by one", expand_by_default=False):
            self._draw = gui.add_slider(
                "Draw",
                min=0,
                max=1,
                step=1,
                initial_value=0,
                hint="Number of a draw of RANSAC, from 0",
            )
            self._buttons = gui.add_button_group(
                "Go to",
                ("Previous", "Next", "Best"),
                hint="Best: the draw with the most inliers, which A is refined from",
            )
            self._draw_text = gui.add_markdown("")
            self._draw_picture = gui.add_image(_blank(_DRAW_PX), format="png")
            self._consensus = gui.add_markdown("")
        with gui.add_folder("RANSAC settings", expand_by_default=False):
            controls.slider("registration", "sample_size", "Pairs per draw", 2, 20, 1)
            controls.slider(
                "registration", "inlier_threshold_m", "Inlier within (m)", 0.01, 0.5, 0.01
            )
            controls.dropdown("registration", "stopping", "Stop", _STOPPINGS)
            controls.slider("registration", "draws", "Draws", 1, 500, 1)
            self._confidence = controls.slider(
                "registration", "confidence", "Confidence", 0.5, 0.999, 0.001
            )
            controls.slider("registration", "seed", "Seed", 0, 99, 1)
            controls.checkbox("registration", "guards", "Refuse implausible A")
        with gui.add_folder("Matrix of A", expand_by_default=False):
            self._matrix = gui.add_markdown("")

        controls.bind_field(self._draw, "draw_index", int, lambda draw: min(draw, self._last_draw))

        @self._buttons.on_click
        def _(_: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            self._go(self._buttons.value)

    def show(self, frame_view: FrameView) -> None:
        """Set the widgets; while the panel is open, redraw what has changed."""
        view, match = frame_view.view, frame_view.match
        self._registration = found = None if match is None else match.registration
        if found is not None:
            self._last_draw = len(found.draws) - 1
            update_widget(self._draw, max=max(self._last_draw, 1))
        self._controls.show(view)
        update_widget(self._confidence, disabled=view.settings.registration.stopping == "fixed")
        self._epsilon.show(frame_view)
        for widget in (self._draw, self._buttons, self._draw_picture, self._consensus):
            update_widget(widget, visible=found is not None)
        update_widget(self._pairs, visible=match is not None)
        if view.panel != "Register":
            return
        by_sample = view.settings.pairing == "frame"
        self._residuals.show(frame_view.fused, signed=not by_sample)
        self._recall.show(frame_view)
        axes = _AXES_BY_SAMPLE if by_sample else _AXES
        self._use_theme(theme_of(is_dark=frame_view.is_dark))
        if match is not None:
            self._show_pairs(match, axes)
        else:
            self._drawn_pairs = None
            update_widget(self._summary, content=escape_markdown(missing_result_text(frame_view)))
        if found is not None:
            self._show_draw(found, min(view.draw_index, self._last_draw), axes)
        else:
            self._drawn_draw = (None, -1)
            update_widget(self._matrix, content="There is none.")
            update_widget(self._draw_text, content="No draw to show: this frame has no A.")

    def close(self) -> None:
        """Cancel the recall computation: the browser has disconnected."""
        self._recall.close()

    def _use_theme(self, theme: Theme) -> None:
        """Draw the pictures anew where the page has another theme."""
        if theme is not self._theme:
            self._theme = theme
            self._drawn_pairs, self._drawn_draw = None, (None, -1)
        self._residuals.use_theme(theme)

    def _go(self, where: str) -> None:
        """Go to another draw, within the range."""
        found = self._registration
        if found is None:
            return
        last = self._last_draw
        draw = min(self._session.view.draw_index, last)
        places = {"Previous": max(draw - 1, 0), "Next": min(draw + 1, last)}
        self._session.change(draw_index=places.get(where, found.best_draw))

    def _show_pairs(self, match: FrameMatch, axes: tuple[str, str]) -> None:
        """Draw Fig. 5, and describe A. Neither depends on epsilon."""
        if self._drawn_pairs is match.correspondence:
            return
        self._drawn_pairs = match.correspondence
        found, pairs = match.registration, planar_pairs(match)
        plots = _before_and_after(pairs)
        height_px = _PAIRS_PX if len(plots) > 1 else _DRAW_PX
        drawn = pair_picture(
            plots,
            width_px=_WIDTH_PX,
            height_px=height_px,
            axis_labels=axes,
            theme=self._theme,
        )
        show_picture(self._pairs, drawn.rgb)
        if found is None:
            update_widget(self._summary, content=registration_text.failure_text(match.refusal))
            return
        update_widget(
            self._summary,
            content=registration_text.transform_text(found, decompose_registration(found)),
        )
        update_widget(self._matrix, content=registration_text.matrix_text(found.A))
        update_widget(
            self._consensus,
            content=registration_text.consensus_text(found, consensus_probabilities(found)),
        )

    def _show_draw(self, found: Registration, index: int, axes: tuple[str, str]) -> None:
        if self._drawn_draw[0] is found and self._drawn_draw[1] == index:
            return
        self._drawn_draw = (found, index)
        draw = draw_at(found, index)
        plot = PairPlot(
            title=f"Draw {index}: LiDAR through its own A, and depth",
            lidar_m=draw.mapped_m,
            depth_m=found.draws.depth_points_m,
            is_inlier=draw.is_inlier,
            sample=draw.pairs,
        )
        drawn = pair_picture(
            [plot],
            width_px=_WIDTH_PX,
            height_px=_DRAW_PX,
            axis_labels=axes,
            theme=self._theme,
        )
        show_picture(self._draw_picture, drawn.rgb)
        update_widget(self._draw_text, content=registration_text.draw_text(draw, found))


def _before_and_after(pairs: PlanarPairs) -> list[PairPlot]:
    """The pairs before and after A; only before if there is no A."""
    before = PairPlot(
        title="Before the transform A",
        lidar_m=pairs.lidar_m,
        depth_m=pairs.depth_m,
        is_inlier=pairs.inliers,
    )
    if pairs.mapped_m is None:
        return [before]
    after = PairPlot(
        title="After it: LiDAR through A",
        lidar_m=pairs.mapped_m,
        depth_m=pairs.depth_m,
        is_inlier=pairs.inliers,
    )
    return [before, after]


def _blank(height_px: int) -> ByteArray:
    return np.full((height_px, _WIDTH_PX, 3), 255, dtype=np.uint8)
