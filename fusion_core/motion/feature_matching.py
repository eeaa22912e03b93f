"""Features of two images that look alike, wherever they are in them."""

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, IntArray


def match_descriptors(
    first: ByteArray, second: ByteArray, *, ratio_max: float, distance_max: float = np.inf
) -> IntArray:
    """(M, 2) rows of (A, 32) and (B, 32) descriptors: of each of the second that is the nearest of
    some of the first, the one that is nearest to it; ascending by the first.

    ``ratio_max``: of the distance to that of the second nearest (Lowe 2004).
    """
    if len(first) < 2 or len(second) < 2:
        return np.empty((0, 2), np.int64)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    pairs = [
        (nearest.queryIdx, nearest.trainIdx, nearest.distance)
        for nearest, other in matcher.knnMatch(first, second, k=2)
        if nearest.distance <= distance_max and nearest.distance < ratio_max * other.distance
    ]
    if not pairs:
        return np.empty((0, 2), np.int64)
    found = np.array(pairs, dtype=np.float64)
    rows = found[:, :2].astype(np.int64)
    return rows[_is_least_of_group(rows[:, 1], found[:, 2])]


def _is_least_of_group(groups: IntArray, costs: FloatArray) -> BoolArray:
    """(N,) whether a row has the least cost of its group; the first of equal ones."""
    order = np.lexsort((np.arange(len(groups)), costs, groups))
    ordered = groups[order]
    is_first = np.ones(len(groups), dtype=np.bool_)
    is_first[1:] = ordered[1:] != ordered[:-1]
    best = np.zeros(len(groups), dtype=np.bool_)
    best[order[is_first]] = True
    return best
