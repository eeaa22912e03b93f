"""A few points of an image in colour, for the display of a growing map."""

import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.slam.visual.pinhole import unproject

# Points of each keyframe that a view shows.
_POINTS_PER_VIEW = 800


def sample_cloud(frame: RgbdFrame, camera: FloatArray) -> tuple[Float32Array, ByteArray]:
    """(P, 3) points of an image in its optical frame, evenly over it, and (P, 3) their colours."""
    (height, width), (rows, columns) = frame.gray.shape, frame.depth_m.shape
    step = max(1, int(np.sqrt(rows * columns / _POINTS_PER_VIEW)))
    v, u = np.mgrid[step // 2 : rows : step, step // 2 : columns : step].reshape(2, -1)
    depths_m = frame.depth_m[v, u].astype(np.float64)
    known = np.isfinite(depths_m)
    u, v, depths_m = u[known], v[known], depths_m[known]
    pixels = np.column_stack([(u + 0.5) * width / columns - 0.5, (v + 0.5) * height / rows - 0.5])
    rows_of, columns_of = (np.floor(pixels[:, axis] + 0.5).astype(np.int64) for axis in (1, 0))
    if frame.rgb is None:
        rgb = np.repeat(frame.gray[rows_of, columns_of][:, np.newaxis], 3, axis=1)
    else:
        rgb = frame.rgb[rows_of, columns_of]
    return unproject(pixels, depths_m, camera).astype(np.float32), rgb
