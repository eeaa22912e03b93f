"""The LiDAR's curve on an image: one line through the pixels that its beams are paired with, and
the marks of those that are not good.
"""

import cv2
import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, ByteArray, IntArray
from scanloom.plots.axes import FRACTION_BITS, Axes
from scanloom.plots.canvas import BLACK
from scanloom.plots.class_marks import MARK_PX, draw_class_marks, spread_out
from scanloom.plots.pair_pixels import PairPixels
from scanloom.plots.palette import color_of
from scanloom.plots.theme import Theme

# Boxes wider than this get larger marks.
_LARGE_PX = 480
# The line ends where the next pixel is farther away than this share of the image's height: the
# curve jumps from one surface to another there.
_JUMP_FRACTION = 0.05
# Nor does it go on across more than two pairs that are not good, which have marks of their own, or
# across as many columns as several beams are apart.
_BRIDGED_STEPS = 3
_GAP_STEPS = 3.5
# Burrs and holes on top.
_DRAWING_ORDER = (NoiseClass.GOOD, NoiseClass.CONFLICT, NoiseClass.HOLE, NoiseClass.BURR)


def draw_lidar_curve(
    axes: Axes, shape: tuple[int, int], pairs: PairPixels, visible: BoolArray
) -> None:
    """Draw the pairs that are visible, (B,), on the axes of an image of ``shape``.

    Good pairs, and pairs without a class, are a line, or a dot where they have no neighbour.
    """
    box = axes.box
    y = (2 * pairs.row + 1) * box.height // (2 * shape[0])
    x = (2 * pairs.column + 1) * box.width // (2 * shape[1])
    places = np.column_stack([x, y])
    scale = 2 if box.width >= _LARGE_PX else 1
    is_plain = visible & (pairs.noise_class <= NoiseClass.GOOD)
    lines = _lines(places, is_plain, _JUMP_FRACTION * box.height)
    for color, width_px in ((BLACK, 2 + 2 * scale), (color_of("lidar"), 1 + scale)):
        cv2.polylines(axes.inside, lines, False, color, width_px, cv2.LINE_AA, FRACTION_BITS)
    radius_px = MARK_PX + scale - 1
    for noise in _DRAWING_ORDER[1:]:
        chosen = np.flatnonzero(visible & (pairs.noise_class == noise))
        chosen = chosen[spread_out(places[chosen], 2 * radius_px + 2)]
        draw_class_marks(
            axes.inside,
            places[chosen],
            noise,
            radius_px=radius_px,
            repaired=pairs.repaired[chosen],
        )


def curve_symbol(part: ByteArray, _theme: Theme) -> None:
    """The line in a legend."""
    y = part.shape[0] // 2
    for color, width_px in ((BLACK, 4), (color_of("lidar"), 2)):
        cv2.line(part, (3, y), (part.shape[1] - 4, y), color, width_px, cv2.LINE_AA)


def _lines(places: IntArray, is_plain: BoolArray, jump_px: float) -> list[IntArray]:
    """Polylines, with FRACTION_BITS, through the (B, 2) places that are plain. Between two of them
    the line goes on below the marks of others."""
    chosen = np.flatnonzero(is_plain)
    if not chosen.size:
        return []
    steps = np.abs(np.diff(places[chosen], axis=0))
    between = np.diff(chosen)
    gap_px = _GAP_STEPS * max(1.0, float(np.median(steps[:, 0])) if len(steps) else 1.0)
    ends = (steps[:, 1] > jump_px) | (steps[:, 0] > gap_px) | (between > _BRIDGED_STEPS)
    # Beams may be much denser than pixels.
    is_new = np.concatenate([[True], ends | (steps > 0).any(axis=1)])
    starts = np.concatenate([[True], ends])[is_new]
    line = _smooth(places[chosen[is_new]], starts)
    # Its first place twice: a line of one place would not be drawn.
    line = np.repeat(line, 1 + starts, axis=0)
    first = np.flatnonzero(starts)
    return np.split(line, (first + np.arange(first.size))[1:])


def _smooth(places: IntArray, starts: BoolArray) -> IntArray:
    """(N, 2) with FRACTION_BITS: means of three places, for the line jumps between the image's
    rows. ``starts``: (N,) the first places of lines; these and the last ones stay."""
    line = places.astype(np.float64)
    is_inner = ~starts[1:-1] & ~starts[2:]
    means = (line[:-2] + line[1:-1] + line[2:]) / 3.0
    line[1:-1][is_inner] = means[is_inner]
    return np.rint(line * (1 << FRACTION_BITS)).astype(np.int32)
