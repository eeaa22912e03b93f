"""Shapes of the noise classes as line segments that face a viewpoint, of one size on the screen.

A class has a shape of its own, so that it is told apart without its colour: good is a dot (drawn as
a point), a hole a ring, a burr a cross, a conflict a diamond. All but dots stand on posts.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, IntArray, read_only
from scanloom.scene.geometry import NO_SEGMENTS, Segments

# Vertical field of view of the steps' viewpoints.
USUAL_FOV_RAD = float(np.deg2rad(50.0))
# Half the size of a shape and the length of its post, per metre of distance: about 9 and 40 px on
# a screen of 900 px.
_HALF_SIZE = 0.0095
_POST = 0.042
_RING_SIDES = 12
# Shapes of one class whose middles are nearer to each other than this many half sizes would form a
# coil: of those, one is drawn, and a post for each.
_LEAST_APART = 2.6
# Dots lie on the curve, which must be seen between them.
_DOTS_APART = 3.2

_ANGLES = np.linspace(0.0, 2.0 * np.pi, _RING_SIDES + 1)
_RING = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
_CORNERS = np.array([[1.25, 0.0], [0.0, 1.25], [-1.25, 0.0], [0.0, -1.25], [1.25, 0.0]])
# (K, 2, 2): begin and end of each line, to the right and upwards, in half sizes.
_SHAPES: dict[NoiseClass, FloatArray] = {
    NoiseClass.HOLE: np.stack([_RING[:-1], _RING[1:]], axis=1),
    NoiseClass.BURR: np.array([[[-1.0, -1.0], [1.0, 1.0]], [[-1.0, 1.0], [1.0, -1.0]]]),
    NoiseClass.CONFLICT: np.stack([_CORNERS[:-1], _CORNERS[1:]], axis=1),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Facing:
    """A viewpoint that shapes face. ``eye_m``: (3,); ``right``, ``up``: (3,) of its screen;
    ``zoom``: how much smaller its field of view is than the usual one."""

    eye_m: FloatArray
    right: FloatArray
    up: FloatArray
    zoom: float = 1.0

    def __post_init__(self) -> None:
        for value in (self.eye_m, self.right, self.up):
            read_only(value)

    def distance_m(self, points_m: FloatArray | Float32Array) -> FloatArray:
        """(N,) distances of points (N, 3), as they would look as large in the usual view."""
        away: FloatArray = np.linalg.norm(points_m - self.eye_m, axis=1) / self.zoom
        return away

    def lifted(self, points_m: FloatArray | Float32Array, share: float) -> Float32Array:
        """(..., 3) points moved towards the eye by a share of their distance: they are seen at the
        same place, before what lies behind them."""
        eye_m = self.eye_m.astype(np.float32)
        return np.asarray((1.0 - share) * points_m + share * eye_m, dtype=np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class Glyphs:
    """``dots_m``: (D, 3) of good pairs; ``lines_m``: (N, 2, 3) of posts and shapes, with the codes
    (N,) of their classes."""

    dots_m: Float32Array
    lines_m: Segments
    lines_class: IntArray


def facing(
    position_m: FloatArray, look_at_m: FloatArray, up: FloatArray, fov_rad: float = USUAL_FOV_RAD
) -> Facing:
    """The screen of a camera that looks at a point, with a vertical field of view."""
    ahead = look_at_m - position_m
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    right = np.cross(ahead, up)
    if np.linalg.norm(right) < 1e-6:
        # It looks along its upward direction.
        right = np.cross(ahead, np.array([1.0, 0.0, 0.0]) if abs(ahead[0]) < 0.9 else [0, 1.0, 0])
    right = right / np.linalg.norm(right)
    return Facing(
        eye_m=np.array(position_m, float),
        right=right,
        up=np.cross(right, ahead),
        zoom=float(np.tan(0.5 * USUAL_FOV_RAD) / np.tan(0.5 * fov_rad)),
    )


def class_glyphs(points_m: Float32Array, codes: IntArray, seen_from: Facing) -> Glyphs:
    """The shapes of classes (N,) at points (N, 3), adjacent ones next to each other."""
    half_m = _HALF_SIZE * seen_from.distance_m(points_m)
    good = codes == NoiseClass.GOOD
    dots = np.flatnonzero(good)[_spread(points_m[good], _DOTS_APART * half_m[good])]
    parts, classes = [NO_SEGMENTS], [np.empty(0, dtype=np.int64)]
    for noise, shape in _SHAPES.items():
        at = np.flatnonzero(codes == noise)
        if not at.size:
            continue
        feet = points_m[at].astype(np.float64)
        length_m = _POST / _HALF_SIZE * half_m[at, np.newaxis]
        tops = feet + length_m * np.array([0.0, 0.0, 1.0])
        # A post ends below its shape.
        ends = tops - half_m[at, np.newaxis] * np.array([0.0, 0.0, 1.0])
        parts.append(np.stack([feet, ends], axis=1).astype(np.float32))
        kept = _spread(feet, _LEAST_APART * half_m[at])
        offsets = shape[..., :1] * seen_from.right + shape[..., 1:] * seen_from.up
        size_m = half_m[at][kept][:, np.newaxis, np.newaxis, np.newaxis]
        lines = tops[kept][:, np.newaxis, np.newaxis] + size_m * offsets
        parts.append(lines.reshape(-1, 2, 3).astype(np.float32))
        classes.append(np.full(len(at) + len(parts[-1]), int(noise)))
    return Glyphs(
        dots_m=points_m[dots], lines_m=np.concatenate(parts), lines_class=np.concatenate(classes)
    )


def _spread(points_m: FloatArray | Float32Array, apart_m: FloatArray) -> BoolArray:
    """(N,): points that lie at least ``apart_m`` (N,) from the last one kept before them."""
    kept = np.zeros(len(points_m), dtype=np.bool_)
    last = None
    for index, point in enumerate(points_m):
        if last is None or float(np.linalg.norm(point - last)) >= apart_m[index]:
            kept[index] = True
            last = point
    return kept


def ring_segments(points_m: Float32Array, seen_from: Facing, half_sizes: float) -> Segments:
    """(N K, 2, 3) rings around points (N, 3), so many half sizes of a class's shape in radius."""
    half_m = half_sizes * _HALF_SIZE * seen_from.distance_m(points_m)
    shape = _SHAPES[NoiseClass.HOLE]
    offsets = shape[..., :1] * seen_from.right + shape[..., 1:] * seen_from.up
    size_m = half_m[:, np.newaxis, np.newaxis, np.newaxis]
    lines = points_m[:, np.newaxis, np.newaxis] + size_m * offsets
    return np.asarray(lines.reshape(-1, 2, 3), dtype=np.float32)
