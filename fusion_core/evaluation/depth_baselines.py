"""Baselines of a depth repair: common ways to fill holes."""

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, IntArray

_MM_PER_M = 1000.0
# The radius in OpenCV's own example of Telea 2004.
_TELEA_RADIUS_PX = 3.0
_MARGIN_ROWS = 32
"""Context rows above and below, since inpainting works inwards from the edge of a hole."""

BASELINES = ("inpaint", "nearest")


def fill_by_baselines(
    depth_m: Float32Array, row: IntArray, column: IntArray
) -> dict[str, FloatArray]:
    """Depth (m) that each of BASELINES gives at pixels (row, column) of a raw image.

    ``depth_m``: (H, W), NaN for missing; ``row``, ``column`` and the results: (n,). A pixel with a
    raw value keeps it: the baselines use no labels. NaN where no pixel nearby is valid.
    """
    from scipy.ndimage import distance_transform_edt

    missing = ~np.isfinite(depth_m)
    if missing.all():
        return {name: np.full(row.shape, np.nan) for name in BASELINES}
    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return {
        "inpaint": _inpaint(depth_m, missing, row, column),
        "nearest": depth_m[tuple(nearest[:, row, column])].astype(np.float64),
    }


def _inpaint(
    depth_m: Float32Array, missing: BoolArray, row: IntArray, column: IntArray
) -> FloatArray:
    top = max(0, int(row.min()) - _MARGIN_ROWS)
    band = slice(top, int(row.max()) + 1 + _MARGIN_ROWS)
    if missing[band].all():
        return np.full(row.shape, np.nan)
    mask = missing[band].astype(np.uint8)
    # OpenCV's Telea rounds by a half whatever the type: in metres that is an error of decimetres.
    known_mm = np.where(missing[band], np.float32(0.0), depth_m[band] * np.float32(_MM_PER_M))
    filled_mm = cv2.inpaint(known_mm, mask, _TELEA_RADIUS_PX, cv2.INPAINT_TELEA)
    values_m: FloatArray = filled_mm[row - top, column].astype(np.float64) / _MM_PER_M
    return values_m
