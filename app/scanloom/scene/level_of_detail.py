"""Which points of a large cloud are sent to a browser: denser where its camera looks."""

import numpy as np

from fusion_core.model.conventions import (
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)
from scanloom.scene.camera_views import CameraView
from scanloom.scene.glyphs import facing

POINTS_MAX = 200_000
"""A browser is sent at most so many points at a time: 3 MB."""

# Nearer points than this would fill the screen by themselves.
_NEAREST_M = 0.5
# Of what is out of sight some stays, so that it is there while the camera is being turned.
_OUT_OF_SIGHT = 0.02
# The edge of the screen in half screens: a slightly turned camera still finds its points.
_SCREEN_EDGE = 1.15
_SEED = 1
# Points over which the width is found, and which of their neighbours tells it: the nearest one may
# be of the same place, seen twice.
_SAMPLES, _NEIGHBOURS = 400, 5
_WIDTHS_M = (0.004, 0.03)


class DetailLevels:
    """A cloud of (P, 3) points with (P, 3) colours, in which each point has its turn, drawn once:
    as the camera moves, the points that stay in sight stay the same."""

    def __init__(self, points_m: Float32Array, rgb: ByteArray) -> None:
        self.points_m, self.rgb = points_m, rgb
        read_only(points_m)
        read_only(rgb)
        # Of an exponential distribution: the least of them, divided by weights, are a sample
        # without replacement by these weights (Efraimidis & Spirakis 2006).
        rng = np.random.default_rng(_SEED)
        self._turns = rng.standard_exponential(len(points_m), dtype=np.float32)

    def seen_from(self, view: CameraView, aspect: float, limit: int = POINTS_MAX) -> IntArray:
        """Indices of at most ``limit`` points, ascending: all, if they are no more.

        A surface at the distance d fills 1 / d² of the screen, and is given as large a part of the
        points, so that each part of the screen has about as many. ``aspect``: width over height.
        """
        count = len(self.points_m)
        if count <= limit:
            return np.arange(count)
        away_m = self.points_m - view.position_m.astype(np.float32)
        distance_m2 = np.einsum("ij,ij->i", away_m, away_m)
        weights = 1.0 / np.maximum(distance_m2, np.float32(_NEAREST_M**2))
        weights[~in_sight(away_m, view, aspect)] *= np.float32(_OUT_OF_SIGHT)
        chosen = np.argpartition(self._turns / weights, limit - 1)[:limit]
        return np.sort(chosen)


def point_width_m(points_m: Float32Array) -> float:
    """How wide points are drawn so that a surface of them is closed: by the distance of some to
    their next neighbour."""
    if len(points_m) < 2:
        return _WIDTHS_M[0]
    # Imported here: it takes some tenths of a second, and a page opens without it.
    from scipy.spatial import cKDTree

    tree = cKDTree(points_m)
    some = points_m[:: max(1, len(points_m) // _SAMPLES)]
    apart_m = np.asarray(tree.query(some, k=min(_NEIGHBOURS, len(points_m)))[0])
    return float(np.clip(np.median(apart_m[:, -1]), *_WIDTHS_M))


def in_sight(away_m: Float32Array, view: CameraView, aspect: float) -> BoolArray:
    """(P,) which points, (P, 3) from the camera's place on, are on its screen or just beside."""
    ahead, right, up = (axis.astype(np.float32) for axis in _axes(view))
    depth = away_m @ ahead
    half = np.float32(_SCREEN_EDGE * np.tan(0.5 * view.fov_rad))
    is_in: BoolArray = (
        (depth > 0.0)
        & (np.abs(away_m @ up) <= half * depth)
        & (np.abs(away_m @ right) <= half * np.float32(aspect) * depth)
    )
    return is_in


def _axes(view: CameraView) -> tuple[FloatArray, FloatArray, FloatArray]:
    seen = facing(view.position_m, view.look_at_m, view.up, view.fov_rad)
    ahead: FloatArray = np.cross(seen.up, seen.right)
    return ahead, seen.right, seen.up
