"""The pictures that are always in sight: the depth image, and the similarity field."""

import viser

from fusion_core.workflows.fuse.cached_chain import mean_field_around
from fusion_core.workflows.fuse.frame_match import FrameMatch
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView, missing_result_text
from scanloom.page.bridge import PageBridge
from scanloom.page.events import PointKind, Stroke
from scanloom.page.live_picture import LivePicture, MarkKind, PictureMark
from scanloom.page.markup import caption
from scanloom.page.update_widget import update_widget
from scanloom.page_parts import Panel
from scanloom.panels.frame_readout import frame_name
from scanloom.plots.depth_image import DepthPicture, PairOverlay, dock_depth_picture
from scanloom.plots.heatmap import Heatmap, heatmap
from scanloom.plots.pair_pixels import pixels_of_match, repaired_depth_m
from scanloom.plots.score_field import Mark, ScoreField
from scanloom.plots.theme import theme_of
from scanloom.scene.sample_readout import readout_text
from scanloom.state.hover import Hover

# Until the browser has told its size.
_FIRST_SIZE_PX = (410, 360)
# Frames on either side that the field of a window averages; set by hand.
_WINDOW_FRAMES = 2


class DepthImagePanel(Panel):
    """The depth image with its pairs. A click on a pixel selects the beam paired with it."""

    def __init__(self, gui: viser.GuiApi, bridge: PageBridge, session: ClientSession) -> None:
        self._session = session
        self._caption = gui.add_html("")
        self._picture = LivePicture(gui, bridge, "depth")
        self._size_px = _FIRST_SIZE_PX
        self._drawn: DepthPicture | None = None
        self._drawn_of: tuple[object, object] = None, None
        self._picture.on_point(self._pointed)
        self._picture.on_stroke(self._drawn_on)

    def set_size(self, width_px: int, height_px: int) -> None:
        """Draw it at most this large, in CSS pixels, from the next view on."""
        self._size_px = width_px, height_px

    def show(self, frame_view: FrameView) -> None:
        """Draw the depth image of this view."""
        view = frame_view.view
        frame = frame_view.frame or frame_view.paired
        inputs = (
            view.show_repaired,
            view.visible_classes,
            view.selected_beam,
            frame_view.is_dark,
            self._size_px,
            frame_view.review,
        )
        tool = None if frame_view.review is None else view.review.tool
        if self._drawn_of[0] is not frame or self._drawn_of[1] != inputs:
            self._drawn_of = frame, inputs
            self._drawn = _depth_picture(frame_view, self._size_px)
        if self._drawn is None:
            self._picture.show(None, missing_result_text(frame_view))
        else:
            self._picture.show(self._drawn.rgb)
            zoom = self._drawn.axes.px_per_unit[0]
            brush_px = view.review.brush_px * zoom
            self._picture.set_tool(None if tool == "point" else tool, brush_px)
        update_widget(self._caption, content=_depth_caption(frame_view))

    def show_hover(self, frame_view: FrameView, hover: Hover) -> None:
        """Mark the pixel under the pointer, or that of the beam, or the row."""
        place = None
        if self._drawn is not None and hover.row is not None:
            place = self._drawn.place_of(hover.row, 0 if hover.column is None else hover.column)
        kind: MarkKind = "row" if hover.column is None else "cross"
        marks = [] if place is None else [PictureMark(kind, *place)]
        is_here = hover.source == "depth"
        self._picture.mark(marks, readout_text(frame_view, hover) if is_here else "")

    def _pointed(self, kind: PointKind, x_px: float, y_px: float) -> None:
        pixel = None if self._drawn is None else self._drawn.pixel_at(x_px, y_px)
        if kind == "leave" or pixel is None:
            self._session.hover(Hover())
            return
        row, column = pixel
        match = None if self._session.frame_view is None else self._session.frame_view.match
        beam = None if match is None else pixels_of_match(match).beam_near(row, column)
        if kind == "click":
            self._session.change(selected_beam=beam)
        else:
            self._session.hover(Hover(source="depth", row=row, column=column, beam=beam, v=row))

    def _drawn_on(self, stroke: Stroke) -> None:
        drawn, review = self._drawn, self._session.active_review
        if drawn is None or review is None:
            return
        box, (zoom_x, zoom_y) = drawn.axes.box, drawn.axes.px_per_unit
        # The centres of pixels are integers, and the image begins half a pixel before the first.
        places = [
            ((x_px + 0.5 - box.left) / zoom_x - 0.5, (y_px + 0.5 - box.top) / abs(zoom_y) - 0.5)
            for x_px, y_px in stroke.places
        ]
        review.draw(stroke.tool, places, is_added=stroke.is_added)


class SimilarityPanel(Panel):
    """The similarity field. A click picks an offset."""

    def __init__(self, gui: viser.GuiApi, bridge: PageBridge, session: ClientSession) -> None:
        self._session = session
        self._caption = gui.add_html("")
        self._picture = LivePicture(gui, bridge, "similarity")
        self._size_px = _FIRST_SIZE_PX
        self._drawn: Heatmap | None = None
        # The frame, chain and options of the last drawing.
        self._drawn_of: tuple[object, object, object] = None, None, None
        self._picture.on_point(self._pointed)

    def set_size(self, width_px: int, height_px: int) -> None:
        """Draw it at most this large, in CSS pixels, from the next view on."""
        self._size_px = width_px, height_px

    def show(self, frame_view: FrameView) -> None:
        """Draw the field of this view; the picture stays if nothing has changed."""
        match = frame_view.match
        if match is None or frame_view.chain is None:
            self._drawn, self._drawn_of = None, (None, None, None)
            self._picture.show(None, missing_result_text(frame_view))
            update_widget(self._caption, content="")
            return
        view = frame_view.view
        # A match is kept as long as its settings are: a new epsilon makes no new one.
        frame = match if view.field_scope != "recording" else None
        inputs = (
            view.field_scope,
            view.settings.search.metric,
            view.picked_offset,
            frame_view.is_dark,
            self._size_px,
        )
        of, chain, before = self._drawn_of
        if self._drawn is None or of is not frame or (chain, before) != (frame_view.chain, inputs):
            self._drawn_of = frame, frame_view.chain, inputs
            self._drawn, field_name = _heatmap(frame_view, match, self._size_px)
            update_widget(self._caption, content=caption(field_name))
        self._picture.show(self._drawn.rgb)

    def show_hover(self, frame_view: FrameView, hover: Hover) -> None:
        """Mark the offset under the pointer, or the row of the pixel that is."""
        place = None
        if self._drawn is not None and hover.v is not None:
            u = float(self._drawn.u_first) if hover.u is None else hover.u
            place = self._drawn.place_of(u, hover.v)
        kind: MarkKind = "row" if hover.u is None else "cross"
        marks = [] if place is None else [PictureMark(kind, *place)]
        is_here = hover.source == "similarity"
        self._picture.mark(marks, readout_text(frame_view, hover) if is_here else "")

    def _pointed(self, kind: PointKind, x_px: float, y_px: float) -> None:
        offset = None if self._drawn is None else self._drawn.offset_at(x_px, y_px)
        if kind == "leave" or offset is None:
            self._session.hover(Hover())
            return
        u, v = offset
        if kind == "move":
            self._session.hover(Hover(source="similarity", u=u, v=v, row=round(v)))
        else:
            self._session.change(picked_offset=(u, v))


def _depth_caption(frame_view: FrameView) -> str:
    if frame_view.paired is None:
        return ""
    name = frame_name(frame_view.view.frame_index)
    is_repaired = frame_view.fused is not None and frame_view.view.show_repaired
    return caption(f"{name[:1].upper()}{name[1:]}, {'repaired' if is_repaired else 'as recorded'}")


def _depth_picture(frame_view: FrameView, size_px: tuple[int, int]) -> DepthPicture | None:
    """The depth image, with its pairs if the frame was matched."""
    view, paired, match = frame_view.view, frame_view.paired, frame_view.match
    if match is not None:
        depth_m, pairs = match.depth_m, pixels_of_match(match, frame_view.fused)
    elif paired is not None:
        session = frame_view.session
        depth_m, pairs = session.depth_of(paired.camera, paired.image.depth_m), None
    else:
        return None
    if frame_view.fused is not None and view.show_repaired:
        depth_m = repaired_depth_m(frame_view.fused)
    overlay = None
    if pairs is not None:
        overlay = PairOverlay(pixels=pairs, classes=view.visible_classes, beam=view.selected_beam)
    return dock_depth_picture(
        depth_m,
        overlay,
        width_px=size_px[0],
        height_px=size_px[1],
        review=frame_view.review,
        theme=theme_of(is_dark=frame_view.is_dark),
    )


def _heatmap(
    frame_view: FrameView, match: FrameMatch, size_px: tuple[int, int]
) -> tuple[Heatmap, str]:
    """The field as a picture, and what it is the field of."""
    view, chain = frame_view.view, frame_view.chain
    assert chain is not None, "a match was made by a chain"
    metric, alignment = view.settings.search.metric, chain.alignment
    if view.field_scope == "recording":
        field: ScoreField = alignment.fields[metric]
        peak = alignment.peaks.get(metric)
        prior_u, field_name = alignment.peak.u, f"Mean of {alignment.frames} frames"
    else:
        field, peak = match.search.fields[metric], match.search.peaks.get(metric)
        prior_u, field_name = alignment.peak.u - match.u_of_rig, "This frame"
        if view.field_scope == "window":
            field, count = mean_field_around(chain, view.frame_index, view.settings, _WINDOW_FRAMES)
            field_name = f"Mean of {count} frames around this one"
    marks = [Mark("prior", prior_u)]
    if peak is not None:
        marks += [Mark("runner_up", peak.runner_up_u, peak.runner_up_v)]
        marks += [Mark("peak", peak.u, peak.v)]
    if view.picked_offset is not None:
        marks += [Mark("picked", *view.picked_offset)]
    drawn = heatmap(
        field,
        marks,
        width_px=size_px[0],
        height_px=size_px[1],
        theme=theme_of(is_dark=frame_view.is_dark),
    )
    return drawn, f"{field_name}, {metric.replace('_', ' ')}"
