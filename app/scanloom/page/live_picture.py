"""A picture on the page that answers to the pointer and takes marks over it."""

import html
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np
import viser

from fusion_core.model.conventions import ByteArray
from scanloom.page.bridge import OnPoint, PageBridge
from scanloom.page.events import PictureName, Stroke, ToolName
from scanloom.page.markup import paragraph
from scanloom.page.update_widget import update_widget
from scanloom.plots.png import show_picture

# Marks move with the pointer; a tenth of a pixel is not seen.
_DIGITS = 1

MarkKind = Literal["cross", "row", "column"]
"""A cross, or a line along the row or the column."""


@dataclass(frozen=True, slots=True)
class PictureMark:
    """A mark at a place in a picture's pixels, or through it. ``reach_px``: how far a column goes
    up and down."""

    kind: MarkKind
    x_px: float
    y_px: float
    reach_px: float = 10_000.0


class LivePicture:
    """An image of the page, hidden until the first picture."""

    def __init__(self, gui: viser.GuiApi, bridge: PageBridge, name: PictureName) -> None:
        self._bridge = bridge
        self._name: PictureName = name
        self._size_px = (1, 1)
        self._marks: Sequence[PictureMark] = ()
        self._readout = ""
        self._tool: ToolName | None = None
        self._brush_px = 0.0
        self._missing = gui.add_html("", visible=False)
        # The script takes the image right after this element for the picture of that name.
        self._about = gui.add_html(self._about_html(), visible=False)
        empty = np.zeros((1, 1, 3), np.uint8)
        self._image = gui.add_image(empty, format="png", visible=False)

    def on_point(self, call: OnPoint) -> None:
        """Call ``call(kind, x_px, y_px)`` for the pointer's events on it."""
        self._bridge.on_point(self._name, call)

    def on_stroke(self, call: Callable[[Stroke], None]) -> None:
        """Call ``call`` with what is drawn on it while it has a tool."""
        self._bridge.on_stroke(self._name, call)

    def set_tool(self, tool: ToolName | None, brush_px: float = 0.0) -> None:
        """What a drag draws, None for nothing. ``brush_px``: radius of the brush, in the picture's
        pixels."""
        if (tool, brush_px) != (self._tool, self._brush_px):
            self._tool, self._brush_px = tool, brush_px
            update_widget(self._about, content=self._about_html())

    def show(self, rgb: ByteArray | None, missing: str = "") -> None:
        """Show a picture, (H, W, 3) uint8, which becomes read-only; None for none, and then
        ``missing``, the reason as plain text."""
        if rgb is not None:
            if self._image._image is not rgb:
                show_picture(self._image, rgb)
            self._size_px = rgb.shape[1], rgb.shape[0]
            update_widget(self._about, content=self._about_html())
        for part in (self._about, self._image):
            update_widget(part, visible=rgb is not None)
        is_missing = rgb is None and bool(missing)
        update_widget(self._missing, content=paragraph(missing), visible=is_missing)

    def mark(self, marks: Sequence[PictureMark], readout: str = "") -> None:
        """Draw these marks instead of those before, and show a text beside the pointer while it is
        on this picture."""
        self._marks, self._readout = marks, readout
        update_widget(self._about, content=self._about_html())

    def _about_html(self) -> str:
        marks = [
            asdict(mark) | {"x_px": round(mark.x_px, _DIGITS), "y_px": round(mark.y_px, _DIGITS)}
            for mark in self._marks
        ]
        width_px, height_px = self._size_px
        tool = (
            f' data-tool="{self._tool}" data-brush-px="{self._brush_px:.1f}"' if self._tool else ""
        )
        return (
            f'<div data-picture="{self._name}"{tool} '
            f'data-width="{width_px}" data-height="{height_px}" '
            f'data-marks="{html.escape(json.dumps(marks))}" '
            f'data-readout="{html.escape(self._readout)}"></div>'
        )
