"""The range profile: what both sensors measure over the azimuth, in the displayed frame."""

import viser

from fusion_core.model.sensors import LaserScan
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.page.bridge import PageBridge
from scanloom.page.events import PointKind, Stroke
from scanloom.page.live_picture import LivePicture, PictureMark
from scanloom.page_parts import Panel
from scanloom.plots.range_profile import RangeProfile, range_profile, scan_profile
from scanloom.plots.theme import theme_of
from scanloom.scene.sample_readout import readout_text
from scanloom.state.hover import Hover

# Until the browser has told its size.
_FIRST_SIZE_PX = (740, 130)


class ProfilePanel(Panel):
    """Ranges over azimuth. A click selects the beam there."""

    def __init__(self, gui: viser.GuiApi, bridge: PageBridge, session: ClientSession) -> None:
        self._session = session
        self._picture = LivePicture(gui, bridge, "profile")
        self._size_px = _FIRST_SIZE_PX
        self._drawn: RangeProfile | None = None
        self._drawn_of: tuple[object, object] = None, None
        self._picture.on_point(self._pointed)
        self._picture.on_stroke(self._drawn_on)

    def set_size(self, width_px: int, height_px: int) -> None:
        """Draw it this large, in CSS pixels, from the next view on."""
        self._size_px = width_px, height_px

    def show(self, frame_view: FrameView) -> None:
        """Draw the profile of this view."""
        frame = frame_view.frame or frame_view.paired or frame_view.lone
        view, review = frame_view.view, frame_view.review
        inputs = view.selected_beam, frame_view.is_dark, self._size_px, review
        if self._drawn_of[0] is not frame or self._drawn_of[1] != inputs:
            self._drawn_of = frame, inputs
            self._drawn = self._draw(frame_view)
        self._picture.show(None if self._drawn is None else self._drawn.rgb)
        # A brush is for images: on the profile both tools mark what lies between two azimuths.
        is_drawn_on = review is not None and view.review.tool != "point"
        self._picture.set_tool("box" if is_drawn_on else None)

    def show_hover(self, frame_view: FrameView, hover: Hover) -> None:
        """Mark the beam under the pointer."""
        place = None
        if self._drawn is not None and hover.beam is not None:
            place = self._drawn.place_of(hover.beam)
        marks = [] if place is None else [PictureMark("column", *place)]
        is_here = hover.source == "profile"
        self._picture.mark(marks, readout_text(frame_view, hover) if is_here else "")

    def _draw(self, frame_view: FrameView) -> RangeProfile | None:
        width_px, height_px = self._size_px
        theme, beam = theme_of(is_dark=frame_view.is_dark), frame_view.view.selected_beam
        if frame_view.frame is not None:
            return range_profile(
                frame_view.frame,
                width_px=width_px,
                height_px=height_px,
                beam=beam,
                review=frame_view.review,
                theme=theme,
            )
        scan = _scan_of(frame_view)
        if scan is None:
            return None
        return scan_profile(
            scan,
            width_px=width_px,
            height_px=height_px,
            beam=beam,
            theme=theme,
        )

    def _pointed(self, kind: PointKind, x_px: float, y_px: float) -> None:
        beam = None if self._drawn is None else self._drawn.beam_at(x_px, y_px)
        if kind == "leave" or beam is None:
            self._session.hover(Hover())
        elif kind == "click":
            self._session.change(selected_beam=beam)
        else:
            self._session.hover(Hover(source="profile", beam=beam))

    def _drawn_on(self, stroke: Stroke) -> None:
        drawn, review = self._drawn, self._session.active_review
        if drawn is None or review is None:
            return
        ends_px = sorted((stroke.places[0][0], stroke.places[-1][0]))
        x_px = [drawn.axes.to_pixel(azimuth, 0.0)[0] for azimuth in drawn.azimuth_deg.tolist()]
        chosen = [
            beam
            for beam, at_px in zip(drawn.beam.tolist(), x_px, strict=True)
            if ends_px[0] <= at_px <= ends_px[1]
        ]
        review.mark_beams(chosen, is_added=stroke.is_added)


def _scan_of(frame_view: FrameView) -> LaserScan | None:
    """The scan of a frame that is not matched, or of a recording without depth images."""
    if frame_view.lone is not None:
        return frame_view.lone.scan
    paired = frame_view.paired
    return None if paired is None or paired.window is None else paired.window.scan
