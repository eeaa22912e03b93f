"""A person's labels on the depth image: their colour over each pixel, and what is selected."""

import cv2
import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, ByteArray
from fusion_core.model.labels import Label
from scanloom.plots.axes import Axes
from scanloom.plots.canvas import BLACK, WHITE
from scanloom.plots.palette import Color, class_color
from scanloom.state.review_overlay import ReviewOverlay

# How much of a label's colour covers the depth below it.
_OPACITY = 0.75
UNSURE_COLOR: Color = (128, 128, 128)
"""Of samples that were looked at and left open."""


def label_color(label: Label) -> Color:
    """The class's own colour; grey for unsure."""
    return UNSURE_COLOR if label == Label.UNSURE else class_color(NoiseClass(label))


def draw_labels(axes: Axes, overlay: ReviewOverlay) -> None:
    """Colour the labelled pixels of an image that fills the axes, and outline the selected ones."""
    part = axes.inside
    size = part.shape[1], part.shape[0]
    labels = cv2.resize(
        overlay.pixel_labels.astype(np.int16), size, interpolation=cv2.INTER_NEAREST
    )
    for label in Label:
        chosen = labels == label
        if chosen.any():
            _tint(part, chosen, label_color(label))
    selected = overlay.selected_pixels.astype(np.uint8)
    if selected.any():
        large = cv2.resize(selected, size, interpolation=cv2.INTER_NEAREST)
        lines, _ = cv2.findContours(large, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        for color, width_px in ((BLACK, 4), (WHITE, 2)):
            cv2.drawContours(part, lines, -1, color, width_px)


def _tint(part: ByteArray, chosen: BoolArray, color: Color) -> None:
    mixed = (1.0 - _OPACITY) * part[chosen] + _OPACITY * np.array(color)
    part[chosen] = mixed.astype(np.uint8)
