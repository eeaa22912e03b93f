"""A camera's image as the stages take it: upright and without distortion.

Robot@Home's cameras are mounted in portrait, and some drivers publish distorted depth. One index
map corrects both, so that every stage works on an ideal upright image and every result can name
the pixel in the stored one. No depth is interpolated.
"""

from dataclasses import dataclass, replace

import numpy as np

from fusion_core.lens.straight_images import pixels_under_straight
from fusion_core.model.conventions import Float32Array, FloatArray, IntArray, read_only
from fusion_core.model.sensors import CameraIntrinsics


@dataclass(frozen=True, slots=True, kw_only=True)
class UprightView:
    """An ideal upright view (H', W') of a stored image.

    ``intrinsics``: of the view. ``stored_index``: (H', W') flat index into the stored image, -1
    where that has no pixel; None where the stored image is upright and undistorted already.
    ``R_stored_view``: (3, 3) from the view's optical axes to the stored image's.
    """

    intrinsics: CameraIntrinsics
    stored_shape: tuple[int, int]
    stored_index: IntArray | None
    R_stored_view: FloatArray

    def __post_init__(self) -> None:
        read_only(self.R_stored_view)
        if self.stored_index is not None:
            read_only(self.stored_index)

    def remap(self, stored_m: Float32Array) -> Float32Array:
        """(H', W') view of a stored (H, W) image."""
        if self.stored_index is None:
            return stored_m
        seen = stored_m.ravel()[np.maximum(self.stored_index, 0)]
        return np.where(self.stored_index >= 0, seen, np.float32(np.nan))

    def stored_pixels(self, row: IntArray, column: IntArray) -> tuple[IntArray, IntArray]:
        """Stored (row, column) of the view's pixels; -1 stays -1."""
        if self.stored_index is None:
            return row, column
        inside = row >= 0
        flat = self.stored_index[np.where(inside, row, 0), np.where(inside, column, 0)]
        inside &= flat >= 0
        width = self.stored_shape[1]
        return np.where(inside, flat // width, -1), np.where(inside, flat % width, -1)

    def stored_pixel_maps(self) -> tuple[IntArray, IntArray]:
        """(H', W') stored row and stored column of every pixel of the view, -1 where it shows none.

        Turning an image upright shows each stored pixel once; undistorting it may show one twice,
        or not at all.
        """
        row, column = np.indices((self.intrinsics.height, self.intrinsics.width), dtype=np.int64)
        return self.stored_pixels(row, column)

    def view_pixels(self, row: IntArray, column: IntArray) -> tuple[IntArray, IntArray]:
        """The view's (row, column) of stored pixels, -1 for those that it does not show.

        Of several that show one stored pixel it is the first, by row, then column.
        """
        if self.stored_index is None:
            return row, column
        shown = np.flatnonzero(self.stored_index >= 0)
        place = np.full(self.stored_shape, -1, dtype=np.int64)
        # Assigned from the last to the first, which so remains.
        place.ravel()[self.stored_index.ravel()[shown[::-1]]] = shown[::-1]
        inside = row >= 0
        flat = place[np.where(inside, row, 0), np.where(inside, column, 0)]
        inside &= flat >= 0
        width = self.intrinsics.width
        return np.where(inside, flat // width, -1), np.where(inside, flat % width, -1)


def upright_view(intrinsics: CameraIntrinsics, up_in_camera: FloatArray | None) -> UprightView:
    """The view of a camera. ``up_in_camera``: (3,) the world's up in the stored image's optical
    axes, or None where unknown, which counts as upright."""
    turns = 0 if up_in_camera is None else _quarter_turns(up_in_camera)
    shape = (intrinsics.height, intrinsics.width)
    index = np.arange(shape[0] * shape[1], dtype=np.int64).reshape(shape)
    if not intrinsics.is_straight:
        index = _straight_index(index, intrinsics)
    index = np.rot90(index, turns)
    is_identity = turns == 0 and intrinsics.is_straight
    return UprightView(
        intrinsics=_rotate_intrinsics(intrinsics.straight, turns),
        stored_shape=shape,
        stored_index=None if is_identity else np.ascontiguousarray(index),
        R_stored_view=_R_STORED_VIEW[turns].copy(),
    )


# Columns: the view's right, down and forward in the stored image's optical axes, after 0 to 3
# quarter turns counter-clockwise.
_R_STORED_VIEW: list[FloatArray] = [
    np.eye(3),
    np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
]


def _quarter_turns(up_in_camera: FloatArray) -> int:
    """Turns counter-clockwise after which the image's top is up."""
    right, down = float(up_in_camera[0]), float(up_in_camera[1])
    if abs(right) > abs(down):
        return 1 if right > 0.0 else 3
    return 2 if down > 0.0 else 0


def _rotate_intrinsics(intrinsics: CameraIntrinsics, turns: int) -> CameraIntrinsics:
    """The intrinsics after quarter turns of the image counter-clockwise."""
    for _ in range(turns):
        intrinsics = replace(
            intrinsics,
            width=intrinsics.height,
            height=intrinsics.width,
            fx=intrinsics.fy,
            fy=intrinsics.fx,
            cx=intrinsics.cy,
            cy=intrinsics.width - 1 - intrinsics.cx,
        )
    return intrinsics


def _straight_index(index: IntArray, intrinsics: CameraIntrinsics) -> IntArray:
    """The (H, W) indices under the pixels of the image without distortion, -1 outside."""
    column, row = np.moveaxis(np.rint(pixels_under_straight(intrinsics)).astype(np.int64), -1, 0)
    inside = (column >= 0) & (column < intrinsics.width) & (row >= 0) & (row < intrinsics.height)
    return np.where(inside, index[np.where(inside, row, 0), np.where(inside, column, 0)], -1)
