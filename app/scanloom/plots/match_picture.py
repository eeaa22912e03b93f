"""The camera's image over the cloud's intensity image, with their matches as lines."""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, IntArray
from scanloom.plots.axes import FRACTION_BITS
from scanloom.plots.canvas import LINE_PX, MARGIN_PX, blank_canvas
from scanloom.plots.palette import Color, color_of
from scanloom.plots.text import draw_text
from scanloom.plots.theme import LIGHT, Theme

# Lines hide the images: of many some are drawn, evenly spread.
_LINES_MAX = 90
_REJECTED: Color = (150, 150, 150)
_NEAR_PX = 9.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchPicture:
    """``rgb``: the picture. ``pairs``: (M,) indices of the matches that are drawn, with the places
    of their ends in the picture, ``upper_px`` (M, 2) in the camera's image and ``lower_px``."""

    rgb: ByteArray
    pairs: IntArray
    upper_px: FloatArray
    lower_px: FloatArray

    def pair_at(self, x_px: float, y_px: float) -> int | None:
        """The place, among those drawn, of the match with an end near a point."""
        if not self.pairs.size:
            return None
        away = [np.hypot(*(ends - (x_px, y_px)).T) for ends in (self.upper_px, self.lower_px)]
        nearest = np.minimum(*away)
        place = int(np.argmin(nearest))
        return place if nearest[place] < _NEAR_PX else None


def match_picture(
    camera: ByteArray,
    intensity: ByteArray,
    image_px: FloatArray,
    intensity_px: FloatArray,
    accepted: BoolArray,
    *,
    width_px: int,
    theme: Theme = LIGHT,
) -> MatchPicture:
    """``camera``, ``intensity``: (H, W) grey images of any sizes; the (N, 2) pixels of the matches
    in each. Rejected ones are grey."""
    inner_px = width_px - 2 * MARGIN_PX
    images: list[ByteArray] = []
    scales = []
    for image in (camera, intensity):
        scale = inner_px / image.shape[1]
        size = inner_px, max(1, round(scale * image.shape[0]))
        way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
        images.append(np.asarray(cv2.resize(image, size, interpolation=way), dtype=np.uint8))
        scales.append(scale)
    tops = [MARGIN_PX + LINE_PX]
    tops.append(tops[0] + images[0].shape[0] + LINE_PX + MARGIN_PX)
    rgb = blank_canvas(width_px, tops[1] + images[1].shape[0] + MARGIN_PX, theme)
    for image, top, title in zip(images, tops, ("camera", "intensity of the cloud"), strict=True):
        draw_text(rgb, title, (MARGIN_PX, top - LINE_PX // 2), color=theme.ink)
        rgb[top : top + image.shape[0], MARGIN_PX : MARGIN_PX + inner_px] = image[..., np.newaxis]
    ends = [
        (pixels + 0.5) * scale - 0.5 + (MARGIN_PX, top)
        for pixels, scale, top in zip((image_px, intensity_px), scales, tops, strict=True)
    ]
    is_placed = np.isfinite(ends[0]).all(axis=1) & np.isfinite(ends[1]).all(axis=1)
    drawn = np.concatenate(
        [_some(np.flatnonzero(is_placed & ~accepted)), _some(np.flatnonzero(is_placed & accepted))]
    )
    for pair in drawn:
        color = color_of("good") if accepted[pair] else _REJECTED
        a, b = (tuple(np.rint(end[pair] * (1 << FRACTION_BITS)).astype(int)) for end in ends)
        cv2.line(rgb, a, b, color, 1, cv2.LINE_AA, FRACTION_BITS)
        for end in (a, b):
            cv2.circle(rgb, end, 2 << FRACTION_BITS, color, cv2.FILLED, cv2.LINE_AA, FRACTION_BITS)
    return MatchPicture(rgb=rgb, pairs=drawn, upper_px=ends[0][drawn], lower_px=ends[1][drawn])


def _some(chosen: IntArray) -> IntArray:
    return chosen[:: max(1, -(-chosen.size // _LINES_MAX))]
