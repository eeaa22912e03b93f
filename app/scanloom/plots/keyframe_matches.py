"""Two keyframes one above the other, and lines between what both see."""

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array, IntArray
from scanloom.plots.axes import FRACTION_BITS
from scanloom.plots.canvas import LINE_PX, MARGIN_PX, blank_canvas
from scanloom.plots.palette import color_map
from scanloom.plots.text import draw_text
from scanloom.plots.theme import LIGHT, Theme

# Lines hide the images: of many some are drawn, evenly spread.
LINES_MAX = 60
_DOT_PX = 2


def keyframe_matches_picture(
    images: tuple[ByteArray, ByteArray],
    pixels: tuple[Float32Array, Float32Array],
    titles: tuple[str, str],
    *,
    width_px: int,
    theme: Theme = LIGHT,
) -> ByteArray:
    """``images``: (H, W, 3) RGB of two keyframes; ``pixels``: (M, 2) u, v of the same landmarks in
    each. A line's colour goes with its place in the first image, from left to right, so that lines
    that run against the others stand out.

    Returns (height, width_px, 3) uint8.
    """
    inner_px = width_px - 2 * MARGIN_PX
    scaled, ends, top = [], [], MARGIN_PX
    tops = []
    for image, places in zip(images, pixels, strict=True):
        scale = inner_px / image.shape[1]
        size = inner_px, max(1, round(scale * image.shape[0]))
        way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
        scaled.append(np.asarray(cv2.resize(image, size, interpolation=way), dtype=np.uint8))
        tops.append(top + LINE_PX)
        ends.append((places + 0.5) * scale - 0.5 + (MARGIN_PX, top + LINE_PX))
        top += LINE_PX + size[1] + MARGIN_PX
    rgb = blank_canvas(width_px, top, theme)
    for image, upper, title in zip(scaled, tops, titles, strict=True):
        draw_text(rgb, title, (MARGIN_PX, upper - LINE_PX // 2), color=theme.ink)
        rgb[upper : upper + image.shape[0], MARGIN_PX : MARGIN_PX + inner_px] = image
    colors = color_map("viridis")
    one = 1 << FRACTION_BITS
    for match in drawn_matches(pixels[0]):
        begin, end = (tuple(np.rint(of_image[match] * one).astype(int)) for of_image in ends)
        share = float(np.clip(pixels[0][match, 0] / images[0].shape[1], 0.0, 1.0))
        # The darkest third is hard to see on an image.
        color = colors[round(80 + 175 * share)].tolist()
        cv2.line(rgb, begin, end, color, 1, cv2.LINE_AA, FRACTION_BITS)
        for place in (begin, end):
            radius = _DOT_PX << FRACTION_BITS
            cv2.circle(rgb, place, radius, color, cv2.FILLED, cv2.LINE_AA, FRACTION_BITS)
    return rgb


def drawn_matches(pixels: Float32Array) -> IntArray:
    """Which of (M, 2) matches are drawn: at most LINES_MAX, evenly from left to right."""
    order = np.argsort(pixels[:, 0], kind="stable")
    if order.size <= LINES_MAX:
        return order
    return order[np.linspace(0, order.size - 1, LINES_MAX).round().astype(np.intp)]
