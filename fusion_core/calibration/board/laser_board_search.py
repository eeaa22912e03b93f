"""Which segment of each sweep lies on the board, and where the LiDAR is: without any guess.

A segment on the board obeys nᵀ(R p + t) = d for its plane (n, d) in the camera's frame (Zhang and
Pless 2004). With H = (r1 r2 t) that is linear for points (x, y, 1) of the scanner's plane: five
views, two points each, give its nine entries. Random draws of views and segments are scored by how
many views have a segment on the board itself.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.calibration.board.laser_segments import Segment
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.model.geometry import invert_transform

_VIEWS_DRAWN = 5
_CHUNK = 500
# Segments at one place in so many of the sweeps belong to the room.
_STATIC_FRACTION = 0.4
_STATIC_M, _STATIC_RAD = 0.06, np.radians(6.0)
# A board as large as its squares has a rim, whose width nobody states.
_RIM_M = 0.15
# How far off its plane a segment may be under a rough H.
ROUGH_M = 0.06
_SEGMENTS_MAX = 12


@dataclass(frozen=True, slots=True)
class Candidates:
    """The segments that may lie on the board: ``ends_m`` (V, K, 2, 2), NaN beyond those of a view.

    ``T_board_camera`` (V, 4, 4); ``middle_m`` (3,), ``half_m`` (2,): the squares in its frame.
    """

    segments: list[list[Segment]]
    ends_m: FloatArray
    T_board_camera: FloatArray
    middle_m: FloatArray
    half_m: FloatArray


def choose_candidates(
    segments: list[list[Segment]],
    T_camera_board: list[FloatArray],
    board_min_m: FloatArray,
    board_max_m: FloatArray,
) -> Candidates:
    """Segments no longer than the board, without those that stand at one place in most sweeps.

    ``board_min_m``, ``board_max_m``: (2,) corners of the squares in the board's frame.
    """
    longest_m = float(np.linalg.norm(board_max_m - board_min_m + 2.0 * _RIM_M))
    short = [[one for one in view if one.length_m <= longest_m] for view in segments]
    static = _static_segments(short)
    moving = [
        [one for one, stands in zip(view, standing, strict=True) if not stands]
        for view, standing in zip(short, static, strict=True)
    ]
    # A robot that drives past a fixed board has no static segments; one that finds no others keeps
    # what it has.
    kept = [
        sorted(some or short[index], key=lambda one: one.ends_m[:, 0].min())
        for index, some in enumerate(moving)
    ]
    kept = [view[:_SEGMENTS_MAX] for view in kept]
    most = max((len(view) for view in kept), default=0)
    ends_m = np.full((len(kept), max(most, 1), 2, 2), np.nan)
    for index, view in enumerate(kept):
        for place, segment in enumerate(view):
            ends_m[index, place] = segment.ends_m
    return Candidates(
        segments=kept,
        ends_m=ends_m,
        T_board_camera=np.stack([invert_transform(T) for T in T_camera_board]),
        middle_m=np.array([*(0.5 * (board_min_m + board_max_m)), 0.0]),
        half_m=0.5 * (board_max_m - board_min_m) + _RIM_M,
    )


def _static_segments(views: list[list[Segment]]) -> list[list[bool]]:
    """Which segments have one at their place in most of the other sweeps."""
    every = [segment for view in views for segment in view]
    if not every:
        return [[] for _ in views]
    view_of = np.repeat(np.arange(len(views)), [len(view) for view in views])
    middles = np.array([segment.ends_m.mean(axis=0) for segment in every])
    normals = np.array([segment.normal for segment in every])
    lengths = np.array([segment.length_m for segment in every])
    apart = middles[np.newaxis] - middles[:, np.newaxis]
    alike = np.abs(np.einsum("ijk,ik->ij", apart, normals)) < _STATIC_M
    alike &= np.linalg.norm(apart, axis=2) < 0.5 * lengths[:, np.newaxis]
    alike &= np.abs(normals @ normals.T) > np.cos(_STATIC_RAD)
    # In how many sweeps, its own among them.
    seen = np.stack([alike[:, view_of == v].any(axis=1) for v in range(len(views))], axis=1)
    static = seen.sum(axis=1) - 1 > _STATIC_FRACTION * (len(views) - 1)
    return [static[view_of == v].tolist() for v in range(len(views))]


def search_pose(candidates: Candidates, draws: int, seed: int) -> FloatArray | None:
    """(4, 4) T_camera_lidar that puts segments of the most views on the board, None for none."""
    rng = np.random.default_rng(seed)
    counts = np.array([len(view) for view in candidates.segments])
    usable = np.flatnonzero(counts > 0)
    if usable.size < _VIEWS_DRAWN:
        return None
    best, best_score = None, (0, -np.inf)
    done = 0
    while done < draws:
        size = min(_CHUNK, draws - done)
        done += size
        views = np.argsort(rng.random((size, usable.size)), axis=1)[:, :_VIEWS_DRAWN]
        views = usable[views]
        places = (rng.random(views.shape) * counts[views]).astype(int)
        poses = _linear_poses(candidates, views, places)
        distances = distances_m(candidates, poses)
        nearest = np.nanmin(np.where(np.isnan(distances), np.inf, distances), axis=2)
        found = nearest < ROUGH_M
        scores = found.sum(axis=1)
        mean_m = np.where(found, nearest, 0.0).sum(axis=1) / np.maximum(scores, 1)
        top = int(np.lexsort((mean_m, -scores))[0])
        score = (int(scores[top]), -float(mean_m[top]))
        if score > best_score:
            best, best_score = poses[top], score
    return best


def distances_m(candidates: Candidates, T_camera_lidar: FloatArray) -> FloatArray:
    """(D, V, K) larger distance of a segment's ends to the board's plane under (D, 4, 4) poses, inf
    where it does not lie on the board, NaN where there is no segment."""
    T = np.einsum("vij,djk->dvik", candidates.T_board_camera, T_camera_lidar)
    on_board = (
        np.einsum("dvij,vkej->dvkei", T[..., :3, :2], candidates.ends_m)
        + T[:, :, np.newaxis, np.newaxis, :3, 3]
    )
    aside = np.abs(on_board[..., :2] - candidates.middle_m[:2]) - candidates.half_m
    distance: FloatArray = np.abs(on_board[..., 2]).max(axis=-1)
    inside = (aside <= 0.0).all(axis=(-1, -2))
    return np.where(np.isnan(distance), np.nan, np.where(inside, distance, np.inf))


def associate(
    candidates: Candidates, T_camera_lidar: FloatArray, limit_m: float
) -> tuple[IntArray, IntArray]:
    """(M,) views and (M,) which of their segments lies on the board under a pose."""
    distances = distances_m(candidates, T_camera_lidar[np.newaxis])[0]
    filled = np.where(np.isnan(distances), np.inf, distances)
    place = np.argmin(filled, axis=1)
    found: BoolArray = filled[np.arange(len(place)), place] < limit_m
    views = np.flatnonzero(found)
    return views, place[views]


def _linear_poses(candidates: Candidates, views: IntArray, places: IntArray) -> FloatArray:
    """(D, 4, 4) by the linear solution for H, and the rotation nearest to it."""
    ends = candidates.ends_m[views, places]
    T = candidates.T_board_camera[views]
    # The board's z axis in the camera's frame and its distance: z_board = n p + d.
    normals, offsets = T[..., 2, :3], T[..., 2, 3]
    points = np.concatenate([ends, np.ones((*ends.shape[:-1], 1))], axis=-1)
    rows = np.einsum("dvi,dvej->dveij", normals, points)
    count = views.shape[0]
    A = rows.reshape(count, -1, 9)
    b = -np.repeat(offsets, 2, axis=1)
    normal_matrix = np.einsum("dri,drj->dij", A, A) + 1e-9 * np.eye(9)
    right = np.einsum("dri,dr->di", A, b)
    H = np.linalg.solve(normal_matrix, right[..., np.newaxis])[..., 0].reshape(count, 3, 3)
    u, _, vt = np.linalg.svd(H[:, :, :2], full_matrices=False)
    two = u @ vt
    third = np.cross(two[:, :, 0], two[:, :, 1])
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :2] = two
    poses[:, :3, 2] = third
    poses[:, :3, 3] = H[:, :, 2]
    return poses
