"""The depth of an image's features."""

import numpy as np

from fusion_core.model.conventions import Float32Array, FloatArray
from fusion_core.model.rgbd_frame import RgbdFrame

# Offsets (row, column) of the pixels whose depth must agree with a feature's: itself and its four
# neighbours.
_DEPTH_NEIGHBOURS = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
# Several times the depth noise at 8 m (0.003 · 8 = 2.4 %), below most steps between surfaces.
# Set by hand.
_DEPTH_EDGE_RATIO = 0.05


def sample_depths_m(frame: RgbdFrame, pixels: Float32Array) -> FloatArray:
    """(M,) depth at (M, 2) pixels of the grey image; NaN where missing or at a depth edge."""
    (height, width), (rows, columns) = frame.gray.shape, frame.depth_m.shape
    column = np.floor((pixels[:, 0].astype(np.float64) + 0.5) * columns / width).astype(np.int64)
    row = np.floor((pixels[:, 1].astype(np.float64) + 0.5) * rows / height).astype(np.int64)
    beside = np.stack(
        [
            frame.depth_m[np.clip(row + down, 0, rows - 1), np.clip(column + right, 0, columns - 1)]
            for down, right in _DEPTH_NEIGHBOURS
        ]
    ).astype(np.float64)
    # A corner at a depth edge may be given the depth of the surface behind it. NaN compares false.
    is_flat = (np.abs(beside - beside[0]) < _DEPTH_EDGE_RATIO * beside[0]).all(axis=0)
    return np.where(is_flat, beside.mean(axis=0), np.nan)
