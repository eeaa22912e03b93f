"""Share of good pairs kept and of noise pairs found over the threshold (Xu 2024, Fig. 6)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray
from scanloom.plots import sheet as paper
from scanloom.plots.lettering import INK, write
from scanloom.plots.palette import Color, color_of
from scanloom.plots.sheet import LINE_PX, MARGIN_PX, Box, LegendEntry

_LEFT_PX, _BELOW_PX = 54, 40
_GRID: Color = (241, 243, 245)
_BAND: Color = (225, 229, 233)
_LIGHT: Color = (255, 255, 255)
_DOT_PX, _RING_PX = 2, 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecallPicture:
    """``rgb``: (H, W, 3) uint8. ``box``: where the plot lies in it; epsilon / E runs from 0 at its
    left to ``factor_max`` at its right, shares from 0 at its bottom to 1 at its top."""

    rgb: ByteArray
    box: Box
    factor_max: float

    def place_of(self, factor: float, share: float) -> tuple[int, int]:
        """The pixel of an epsilon / E and a share; what lies beyond the plot is at its edge."""
        x = self.box.left + min(max(factor / self.factor_max, 0.0), 1.0) * (self.box.width - 1)
        y = self.box.top + (1.0 - share) * (self.box.height - 1)
        return round(x), round(y)

    def with_present(self, factor: float, shares: Sequence[float]) -> ByteArray:
        """A copy with one epsilon / E marked, and rings at the shares that belong to it."""
        rgb = self.rgb.copy()
        x, _ = self.place_of(factor, 0.0)
        cv2.line(rgb, (x, self.box.top), (x, self.box.bottom - 1), INK, 1)
        for share in shares:
            place = self.place_of(factor, share)
            cv2.circle(rgb, place, _RING_PX, _LIGHT, 3, cv2.LINE_AA)
            cv2.circle(rgb, place, _RING_PX, INK, 1, cv2.LINE_AA)
        return rgb


def recall_picture(
    factors: FloatArray,
    xi: FloatArray | None,
    eta: FloatArray | None,
    *,
    band: tuple[float, float],
    width_px: int,
    height_px: int,
) -> RecallPicture:
    """Draw both recalls, each (K,) over the (K,) rising ``factors`` of E; None where there are no
    such pairs. ``band``: the ends of the paper's band. Raises ValueError for too small a picture.
    """
    rgb = paper.blank_sheet(width_px, height_px)
    curves = [
        (shares, color, words)
        for shares, color, words in (
            (xi, color_of("good"), "ξ: good pairs kept"),
            (eta, color_of("burr"), "η: noise pairs found"),
        )
        if shares is not None
    ]
    entries = [LegendEntry(_symbol_of(color), words) for _, color, words in curves]
    entries += [
        LegendEntry(paper.swatch(_BAND), "E to √2 E"),
        LegendEntry(_present_symbol, "ε of this frame"),
    ]
    legend = paper.legend_lines(entries, width_px - 2 * MARGIN_PX)
    bottom = height_px - _BELOW_PX - len(legend) * LINE_PX
    box = paper.room(_LEFT_PX, MARGIN_PX + 6, width_px - MARGIN_PX - 6, bottom)
    picture = RecallPicture(rgb=rgb, box=box, factor_max=float(factors[-1]))
    first, last = (picture.place_of(end, 0.0)[0] for end in band)
    rgb[box.top : box.bottom, first : last + 1] = _BAND
    _axes(picture)
    for shares, color, _ in curves:
        places = [picture.place_of(*pair) for pair in zip(factors, shares, strict=True)]
        cv2.polylines(rgb, [np.array(places, dtype=np.int32)], False, color, 2, cv2.LINE_AA)
        for place in places:
            cv2.circle(rgb, place, _DOT_PX, color, -1, cv2.LINE_AA)
    box.frame(rgb)
    paper.draw_legend(rgb, legend, MARGIN_PX, bottom + _BELOW_PX - 4)
    return picture


def _axes(picture: RecallPicture) -> None:
    rgb, box = picture.rgb, picture.box
    for factor in paper.ticks_between(0.0, picture.factor_max, max(2, box.width // 52)):
        paper.tick_below(rgb, box, picture.place_of(factor, 0.0)[0], paper.number(factor))
    for share in paper.ticks_between(0.0, 1.0, max(2, box.height // 30)):
        y = picture.place_of(0.0, share)[1]
        paper.tick_left(rgb, box, y, paper.number(share))
        cv2.line(rgb, (box.left, y), (box.right - 1, y), _GRID, 1)
    middle = box.left + 0.5 * box.width
    words = "threshold ε in multiples of the frame's E"
    write(rgb, words, middle, box.bottom + 27, align="middle")
    write(rgb, "share of the pairs", 12, box.top + 0.5 * box.height, align="middle", turned=True)


def _symbol_of(color: Color) -> Callable[[ByteArray], None]:
    def draw(part: ByteArray) -> None:
        middle = LINE_PX // 2
        cv2.line(part, (2, middle), (17, middle), color, 2, cv2.LINE_AA)
        cv2.circle(part, (10, middle), _DOT_PX, color, -1, cv2.LINE_AA)

    return draw


def _present_symbol(part: ByteArray) -> None:
    cv2.line(part, (10, 1), (10, LINE_PX - 2), INK, 1)
    cv2.circle(part, (10, LINE_PX // 2), _RING_PX, _LIGHT, 3, cv2.LINE_AA)
    cv2.circle(part, (10, LINE_PX // 2), _RING_PX, INK, 1, cv2.LINE_AA)
