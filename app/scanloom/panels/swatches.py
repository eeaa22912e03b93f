"""The shapes that stand for the scene's layers and for the noise classes, as small SVGs."""

from typing import Literal

from fusion_core.model.classes import NoiseClass
from scanloom.plots.palette import Color, class_color
from scanloom.scene.stage_colors import OUTLINE

Shape = Literal["line", "thin", "dot", "ring", "cross", "diamond", "square", "arrow"]

# In a box of 16 x 16, in the colours {fill} and {edge}.
_SVG: dict[Shape, str] = {
    "line": '<path d="M1 8H15" stroke="{edge}" stroke-width="7"/>'
    '<path d="M1 8H15" stroke="{fill}" stroke-width="4"/>',
    "thin": '<path d="M1 8H15" stroke="{fill}" stroke-width="1.5"/>',
    "dot": '<circle cx="8" cy="8" r="4" fill="{fill}" stroke="{edge}" stroke-width="1.5"/>',
    "ring": '<circle cx="8" cy="8" r="5" fill="none" stroke="{edge}" stroke-width="5"/>'
    '<circle cx="8" cy="8" r="5" fill="none" stroke="{fill}" stroke-width="2.6"/>',
    "cross": '<path d="M3 3L13 13M3 13L13 3" stroke="{edge}" stroke-width="5"/>'
    '<path d="M3 3L13 13M3 13L13 3" stroke="{fill}" stroke-width="2.6"/>',
    "diamond": '<path d="M8 2L14 8L8 14L2 8Z" fill="{fill}" stroke="{edge}" stroke-width="1.5"/>',
    "square": '<rect x="2" y="2" width="12" height="12" fill="{fill}"/>',
    "arrow": '<path d="M1 8H14M9 3L14 8L9 13" fill="none" stroke="{fill}" stroke-width="2"/>',
}
# As in the pictures (``scanloom.plots.class_marks``) and in the scene (``scanloom.scene.glyphs``).
_CLASS_SHAPES: dict[NoiseClass, Shape] = {
    NoiseClass.GOOD: "dot",
    NoiseClass.HOLE: "ring",
    NoiseClass.BURR: "cross",
    NoiseClass.CONFLICT: "diamond",
}


def swatch(shape: Shape, color: Color) -> str:
    """A shape in a colour, with a dark edge, as SVG."""
    drawn = _SVG[shape].format(fill=css_color(color), edge=css_color(OUTLINE))
    return f'<svg width="16" height="16" viewBox="0 0 16 16" aria-hidden="true">{drawn}</svg>'


def class_swatch(noise: NoiseClass) -> str:
    """The mark of a class, as SVG."""
    return swatch(_CLASS_SHAPES[noise], class_color(noise))


def css_color(color: Color) -> str:
    """#rrggbb."""
    return "#{:02x}{:02x}{:02x}".format(*color)
