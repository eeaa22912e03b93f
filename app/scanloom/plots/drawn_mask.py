"""The pixels of an image that a box or a stroke of a brush covers."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray


def drawn_mask(
    shape: tuple[int, int],
    tool: Literal["box", "brush"],
    places: Sequence[tuple[float, float]],
    radius_px: int = 0,
) -> BoolArray:
    """(H, W) what is drawn at places (column, row): between the first and the last as corners, or
    along all of them within the radius of a brush."""
    if tool == "box":
        (left, top), (right, bottom) = places[0], places[-1]
        low_x, high_x = sorted((left, right))
        low_y, high_y = sorted((top, bottom))
        rows = slice(max(round(low_y), 0), max(round(high_y) + 1, 0))
        mask = np.zeros(shape, dtype=np.bool_)
        mask[rows, max(round(low_x), 0) : max(round(high_x) + 1, 0)] = True
        return mask
    points = [(round(x), round(y)) for x, y in places]
    # The way is where this is 0.
    way = np.ones(shape, dtype=np.uint8)
    for begin, end in pairwise([points[0], *points]):
        cv2.line(way, begin, end, 0)
    if way.all():
        # It passes beside the image, or the distance to it would be that to nothing.
        return np.zeros(shape, dtype=np.bool_)
    distance_px = cv2.distanceTransform(way, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    near: BoolArray = distance_px <= radius_px
    return near
