"""Colours of what surrounds the data in a picture: canvas, text, axes, gaps; for light and for dark
pages. Colours of classes, sensors and values are in :mod:`scanloom.plots.palette`.
"""

from dataclasses import dataclass

from scanloom.plots.palette import Color, color_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Theme:
    """``background`` with its ``edge``; ``ink`` of text; ``grey`` of ticks, frames and guide lines;
    ``grid`` of the lines behind data; ``hatch``: the two colours of stripes for "no value";
    ``neutral``: of data that belongs to no sensor and no class; ``fused``: of the fused result, the
    one colour of the palette that a dark page hides; ``unknown``, ``free`` and
    ``obstacle``: of the cells of maps."""

    is_dark: bool
    background: Color
    edge: Color
    ink: Color
    grey: Color
    grid: Color
    hatch: tuple[Color, Color]
    neutral: Color
    fused: Color
    unknown: Color
    free: Color
    obstacle: Color


LIGHT = Theme(
    is_dark=False,
    background=(255, 255, 255),
    edge=(206, 212, 218),
    ink=(33, 37, 41),
    grey=(134, 142, 150),
    grid=(236, 239, 242),
    hatch=((233, 236, 239), (206, 212, 218)),
    neutral=(73, 80, 87),
    fused=color_of("fused"),
    # As in the exported pictures of maps.
    unknown=(196, 204, 214),
    free=(255, 255, 255),
    obstacle=(0, 0, 0),
)
# The background is that of a panel in the page's dark scheme.
DARK = Theme(
    is_dark=True,
    background=(36, 36, 36),
    edge=(66, 66, 66),
    ink=(222, 226, 230),
    grey=(140, 145, 150),
    grid=(58, 60, 62),
    hatch=((64, 66, 68), (84, 87, 90)),
    neutral=(173, 181, 189),
    fused=(255, 255, 255),
    unknown=(72, 79, 88),
    free=(24, 24, 24),
    obstacle=(255, 255, 255),
)


def theme_of(*, is_dark: bool) -> Theme:
    """The theme of a page in the dark or the light scheme."""
    return DARK if is_dark else LIGHT
