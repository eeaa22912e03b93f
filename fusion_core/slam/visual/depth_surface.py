"""The surface that a depth image shows, in blocks of pixels: what dense alignment works on."""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.lens.straight_images import StraightImages
from fusion_core.mapping.depth_camera import depth_intrinsics
from fusion_core.model.conventions import Float32Array, FloatArray, read_only
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.slam.visual.pinhole import camera_parameters

# Blocks across an image: of 4 pixels of a VGA image, about the window in which a structured-light
# camera correlates its pattern, so that neighbouring blocks err on their own.
_BLOCKS_ACROSS = 160
# Part of a block that must have a depth.
_COVERED_MIN = 0.5
# A block whose depths differ by more than this part shows two surfaces.
_EDGE_RATIO = 0.05
# Blocks to either side over which a normal is taken: the noise of one block's depth would turn it.
_NORMAL_BLOCKS = 2
# Of the pairs of blocks on opposite sides within that reach, so many must show one surface: half.
_PAIRS_MIN = ((2 * _NORMAL_BLOCKS + 1) ** 2 - 1) // 4
# What is nearer than this before a camera, or behind it, is in no image.
_NEAREST_M = 0.01


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthSurface:
    """``points_m``, ``normals``: (h, w, 3) in the optical frame, NaN where there is no surface.
    ``camera``: (4,) fx, fy, cx, cy of the blocks."""

    points_m: FloatArray
    normals: FloatArray
    camera: FloatArray

    def __post_init__(self) -> None:
        for array in (self.points_m, self.normals, self.camera):
            read_only(array)


class SurfaceSampler:
    """Reduces a camera's depth images to blocks, and makes surfaces of them.

    ``intrinsics``: of the grey images; depth images show the same in their own size. Both methods
    raise MappingFailed where the camera cannot have images of that size.
    """

    def __init__(self, intrinsics: CameraIntrinsics) -> None:
        self._intrinsics = intrinsics
        # By the shape of depth images.
        self._straight_images: dict[tuple[int, int], StraightImages] = {}

    def reduce(self, depth_m: Float32Array) -> Float32Array:
        """(h, w) mean depth of each block; NaN where it is mostly missing or shows an edge."""
        depth_m = self._straight(depth_m.shape).depth(depth_m)
        side = max(1, round(depth_m.shape[1] / _BLOCKS_ACROSS))
        means: Float32Array = _block_means(depth_m, side, _COVERED_MIN, _EDGE_RATIO)
        return means

    def surface(self, reduced_m: Float32Array) -> DepthSurface:
        """Of depths by ``reduce``."""
        height, width = reduced_m.shape
        camera = camera_parameters(depth_intrinsics(self._intrinsics, (height, width)))
        v, u = np.mgrid[:height, :width].astype(np.float64)
        z = reduced_m.astype(np.float64)
        points_m = np.stack(
            [(u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z, z], axis=-1
        )
        return DepthSurface(
            points_m=points_m,
            normals=_block_normals(points_m, camera, _NORMAL_BLOCKS, _PAIRS_MIN, _EDGE_RATIO),
            camera=camera,
        )

    def _straight(self, shape: tuple[int, int]) -> StraightImages:
        if shape not in self._straight_images:
            self._straight_images[shape] = StraightImages(depth_intrinsics(self._intrinsics, shape))
        return self._straight_images[shape]


@compiled(nogil=True)
def find_block(
    points: FloatArray,
    k: int,
    T: FloatArray,
    camera: FloatArray,
    height: int,
    width: int,
    moved: FloatArray,
) -> tuple[int, int]:
    """Row and column of the block of another surface that shows a point, row ``k`` of (N, 3), -1
    where none does. ``moved`` becomes the point there, by ``T``, (4, 4)."""
    # No view of a single row in what is called for each block: making one takes as long as its use.
    for i in range(3):
        moved[i] = T[i, 3]
        for j in range(3):
            moved[i] += T[i, j] * points[k, j]
    if moved[2] < _NEAREST_M:
        return -1, -1
    column = int(np.rint(camera[0] * moved[0] / moved[2] + camera[2]))
    row = int(np.rint(camera[1] * moved[1] / moved[2] + camera[3]))
    if row < 0 or column < 0 or row >= height or column >= width:
        return -1, -1
    return row, column


@compiled(nogil=True)
def _block_means(
    depth_m: Float32Array, side: int, covered_min: float, edge_ratio: float
) -> Float32Array:
    height, width = depth_m.shape[0] // side, depth_m.shape[1] // side
    means = np.full((height, width), np.nan, np.float32)
    for row in range(height):
        for column in range(width):
            total, count, low, high = 0.0, 0, np.inf, 0.0
            for v in range(row * side, (row + 1) * side):
                for u in range(column * side, (column + 1) * side):
                    z = depth_m[v, u]
                    if z > 0.0:
                        total += z
                        count += 1
                        low, high = min(low, z), max(high, z)
            if count >= covered_min * side * side and high - low <= edge_ratio * low:
                means[row, column] = total / count
    return means


@compiled(nogil=True)
def _block_normals(
    points: FloatArray, camera: FloatArray, reach: int, pairs_min: int, edge_ratio: float
) -> FloatArray:
    """(h, w, 3) of the plane through the inverse depths around each block: those of a plane are
    linear in the pixel, and those of a structured-light camera err alike at any depth.

    Of pairs on opposite sides alone, so that it does not err with the block's own depth. Their mean
    is the block's on a plane of any slope, and errs independently of their difference: that they
    are of one surface is judged by it, without a choice of slopes.
    """
    height, width = points.shape[0], points.shape[1]
    normals = np.full((height, width, 3), np.nan)
    inverse = 1.0 / points[:, :, 2]
    n = np.empty(3)
    for row in range(reach, height - reach):
        for column in range(reach, width - reach):
            z = points[row, column, 2]
            pairs, middle = 0, 0.0
            # Half the difference of a pair = across x + down y.
            xx, xy, yy, x_half, y_half = 0.0, 0.0, 0.0, 0.0, 0.0
            for y in range(reach + 1):
                for x in range(-reach if y else 1, reach + 1):
                    one = inverse[row - y, column - x]
                    other = inverse[row + y, column + x]
                    mean, half = 0.5 * (one + other), 0.5 * (other - one)
                    # NaN compares false.
                    if abs(mean * z - 1.0) <= edge_ratio:
                        pairs += 1
                        middle += mean
                        xx += x * x
                        xy += x * y
                        yy += y * y
                        x_half += x * half
                        y_half += y * half
            if pairs < pairs_min:
                continue
            determinant = xx * yy - xy * xy
            across = (yy * x_half - xy * y_half) / determinant
            down = (xx * y_half - xy * x_half) / determinant
            # The plane n p = 1.
            n[0], n[1] = across * camera[0], down * camera[1]
            n[2] = middle / pairs - across * (column - camera[2]) - down * (row - camera[3])
            norm = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
            for i in range(3):
                normals[row, column, i] = n[i] / norm
    return normals
