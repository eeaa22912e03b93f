"""Small plane patches of a depth image: points of upright surfaces and of the floor, with normals.

A patch is kept where its pixels are of one plane, which leaves out edges, flying pixels and bent
things alike on both sides of the true surface: what is kept does not depend on how far off an
estimate is.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import Float32Array, FloatArray, IntArray, read_only
from fusion_core.model.sensors import CameraIntrinsics

# Pixels from a patch's middle to its side, as a fraction of the image's width: one degree for a
# camera that sees 60.
_HALF_FRACTION = 1.0 / 64.0
# Pixels of a patch that have a depth.
_LEAST_VALID = 0.8
# Depths of a patch within so much of a plane, at least and as a fraction of the squared depth: the
# disparity noise of a stereo or structured-light camera, some times over.
_FLAT_M = 0.01
_FLAT_PER_M = 0.006


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthPatches:
    """Patches of one image, in the camera's optical frame.

    ``points_m``: (N, 3) on the ray of the patch's middle pixel, ``normals``: (N, 3) unit, towards
    the camera. ``pixel``: (N,) flat index of the middle pixel.
    """

    points_m: FloatArray
    normals: FloatArray
    pixel: IntArray
    cell: IntArray
    spread_m: FloatArray

    def __post_init__(self) -> None:
        for array in (self.points_m, self.normals, self.spread_m):
            read_only(array)
        read_only(self.pixel)
        read_only(self.cell)


def find_patches(depth_m: Float32Array, intrinsics: CameraIntrinsics) -> DepthPatches:
    """Patches of a (H, W) depth image without distortion, NaN for holes, on a regular grid half a
    patch wide.

    On a plane the inverse depth is linear in the pixel, so that the pixels, which are exact,
    explain the depths, which are not.
    """
    height, width = depth_m.shape
    half = max(2, round(_HALF_FRACTION * width))
    size = 2 * half + 1
    valid = np.isfinite(depth_m) & (depth_m > 0.0)
    inverse = np.where(valid, 1.0 / np.where(valid, depth_m, 1.0), 0.0)
    u = (np.arange(width) - intrinsics.cx) / intrinsics.fx
    v = (np.arange(height) - intrinsics.cy) / intrinsics.fy
    x, y = np.broadcast_arrays(u[np.newaxis], v[:, np.newaxis])
    rows = np.arange(half, height - half, half)
    columns = np.arange(half, width - half, half)
    row, column = (axis.ravel() for axis in np.meshgrid(rows, columns, indexing="ij"))

    def sums(values: FloatArray) -> FloatArray:
        total: FloatArray = cv2.boxFilter(values, -1, (size, size), normalize=False)[row, column]
        return total

    weight = valid.astype(np.float64)
    count = sums(weight)
    # Moments about the middle pixel, which keeps them well conditioned.
    x0, y0 = u[column], v[row]
    m = [sums(weight * one) for one in (x, y, x * x, x * y, y * y)]
    d, dx, dy, dd = (
        sums(inverse),
        sums(inverse * x),
        sums(inverse * y),
        sums(inverse * inverse),
    )
    safe = np.maximum(count, 1.0)
    sx, sy = m[0] - count * x0, m[1] - count * y0
    sxx = m[2] - 2.0 * x0 * m[0] + count * x0 * x0
    sxy = m[3] - x0 * m[1] - y0 * m[0] + count * x0 * y0
    syy = m[4] - 2.0 * y0 * m[1] + count * y0 * y0
    bx, by = dx - x0 * d, dy - y0 * d
    normal_matrix = np.stack(
        [
            np.stack([sxx, sxy, sx], axis=-1),
            np.stack([sxy, syy, sy], axis=-1),
            np.stack([sx, sy, count], axis=-1),
        ],
        axis=-2,
    )
    right = np.stack([bx, by, d], axis=-1)
    enough = count >= _LEAST_VALID * size * size
    normal_matrix[~enough] = np.eye(3)
    slope = np.linalg.solve(normal_matrix, right[..., np.newaxis])[..., 0]
    a, b, middle = slope.T
    squares = np.maximum(dd - (slope * right).sum(axis=1), 0.0)
    enough &= middle > 0.0
    z = 1.0 / np.where(enough, middle, 1.0)
    # A small error of the inverse depth is one of the depth times its square.
    spread_m = np.sqrt(squares / safe) * z**2
    enough &= spread_m < _FLAT_M + _FLAT_PER_M * z**2
    points = np.stack([x0 * z, y0 * z, z], axis=1)
    # 1 / z = a x + b y + c with x = X / Z: the plane is a X + b Y + c Z = 1.
    plane = np.stack([a, b, middle - a * x0 - b * y0], axis=1)
    length = np.linalg.norm(plane, axis=1)
    enough &= length > 0.0
    normals = -plane / np.where(length > 0.0, length, 1.0)[:, np.newaxis]
    return DepthPatches(
        points_m=points[enough],
        normals=normals[enough],
        pixel=(row * width + column)[enough].astype(np.int64),
        cell=np.stack([row // half - 1, column // half - 1], axis=1)[enough],
        spread_m=spread_m[enough],
    )
