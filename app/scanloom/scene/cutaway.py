"""What of a cloud is left out, so that the camera's path within it is seen from outside."""

import numpy as np

from fusion_core.model.conventions import BoolArray, Float32Array, IntArray
from scanloom.scene.camera_views import CameraView
from scanloom.scene.level_of_detail import screen_axes
from scanloom.scene.visual_picture import VisualPicture
from scanloom.scene.visual_shapes import KEYFRAME_DEPTH_M

# Of the screen's height: a few letters high, so that a path is a slit in the cloud.
_CELLS_DOWN = 40
# Between two places on a loop's line.
_LOOP_STEPS = 24


def hides_path(
    points_m: Float32Array, path_m: Float32Array, view: CameraView, aspect: float
) -> BoolArray:
    """(P,) which of (P, 3) points lie before a (N, 3) path, by the cells of the screen in which
    the path is drawn and those beside them. ``aspect``: width over height."""
    across = max(round(aspect * _CELLS_DOWN), 1)
    # A cell more at each side, for what is out of sight.
    farthest_m = np.full((_CELLS_DOWN + 2, across + 2), -np.inf, dtype=np.float32)
    path_cells, path_depth_m = _cells(path_m, view, farthest_m.shape)
    np.maximum.at(farthest_m, path_cells, path_depth_m)
    for axis in (0, 1):
        beside = [np.roll(farthest_m, by, axis) for by in (-1, 1)]
        farthest_m = np.maximum(farthest_m, np.maximum(*beside))
    cells, depth_m = _cells(points_m, view, farthest_m.shape)
    is_before: BoolArray = (depth_m > 0.0) & (depth_m < farthest_m[cells] - KEYFRAME_DEPTH_M)
    return is_before


def path_and_loops(picture: VisualPicture) -> Float32Array:
    """(N, 3) places along the path and along the lines of the loops."""
    ends_m = picture.T_map_keyframe[picture.loops, :3, 3]
    shares = np.linspace(0.0, 1.0, _LOOP_STEPS)[:, np.newaxis, np.newaxis]
    along_m = (1.0 - shares) * ends_m[:, 0] + shares * ends_m[:, 1]
    path_m = picture.path_m[np.isfinite(picture.path_m).all(axis=1)]
    return np.concatenate([path_m, along_m.reshape(-1, 3).astype(np.float32)])


def _cells(
    points_m: Float32Array, view: CameraView, shape: tuple[int, int]
) -> tuple[tuple[IntArray, IntArray], Float32Array]:
    """The (row, column) of (P, 3) points on a screen with an empty edge, and their depths; what is
    out of sight has the depth 0, on the edge."""
    away_m = points_m - view.position_m.astype(np.float32)
    ahead, right, up = (axis.astype(np.float32) for axis in screen_axes(view))
    depth_m = away_m @ ahead
    per_cell = np.float32(np.tan(0.5 * view.fov_rad) / (0.5 * (shape[0] - 2)))
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.stack([-(away_m @ up), away_m @ right]) / (depth_m * per_cell)
    place += 0.5 * np.array(shape, dtype=np.float32)[:, np.newaxis]
    inside = np.array(shape)[:, np.newaxis] - 1
    is_seen = (depth_m > 0.0) & ((place >= 1.0) & (place < inside)).all(axis=0)
    rows, columns = np.where(is_seen, place, 0.0).astype(np.intp)
    return (rows, columns), np.where(is_seen, depth_m, np.float32(0.0))
