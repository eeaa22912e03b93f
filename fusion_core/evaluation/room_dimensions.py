"""Length, width and height of a box-shaped room from a cloud of it (Song 2022, Table 3).

The axes of the box are the directions of most surfaces. Along each of them the outermost large
surface on either side is a wall; a plane is fitted to it, robustly, through one median per small
square, so that what was scanned densely does not weigh more. The dimension is the distance of the
two planes at the middle of the room.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.evaluation.box_axes import box_axes, surface_normals
from fusion_core.evaluation.wall_planes import Wall, fit_wall, square_numbers
from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, IntArray
from fusion_core.model.errors import EvaluationFailed
from fusion_core.settings import StageSettings, setting

DIMENSIONS = ("length", "width", "height")
# Fewer points have no surfaces; more than the largest hall are outliers, or millimetres.
_POINTS_MIN = 1000
_REACH_MAX_M = 200.0
_BIN_M = 0.02
# Doors through which one looks in one direction, one behind the other.
_NEXT_ROOMS_MAX = 6
# The depth of the strips on either side of a wall that are compared.
_STRIP_M = 0.3
# More points make a room no more exact: every k-th is taken.
_POINTS_MAX = 2_000_000
_FITS = 4


class RoomSettings(StageSettings):
    """What counts as a wall of a room."""

    voxel_m: float = setting(
        0.05, "One point in each cube of this size finds the walls", unit="m", ge=0.005, le=1.0
    )
    cell_m: float = setting(
        0.1, "Side of the squares of a wall that count alike", unit="m", ge=0.02, le=1.0
    )
    slab_m: float = setting(
        0.12,
        "Thickness within which points may be of one wall: four standard deviations of the noise",
        unit="m",
        ge=0.02,
        le=1.0,
    )
    support_fraction: float = setting(
        0.2,
        "Least size of a wall, seen from the middle of the cloud, against the largest surface on "
        "its side: what lies behind it is seen through a door",
        ge=0.01,
        le=1.0,
    )
    coverage_fraction: float = setting(
        0.15, "Least fraction of a wall's area that has points", ge=0.01, le=1.0
    )
    leading_fraction: float = setting(
        0.1,
        "How much of floor, ceiling and side walls must lead up to a wall, against its opposite",
        ge=0.01,
        le=1.0,
    )
    beyond_fraction: float = setting(
        0.25,
        "How much of floor, ceiling and side walls may go on beyond a wall, as through a door",
        ge=0.0,
        le=1.0,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Dimension:
    """The distance of two walls. ``sd_m``: its standard deviation by the scatter of both;
    ``parallel_deg``: the angle between them."""

    name: str
    value_m: float
    sd_m: float
    parallel_deg: float
    walls: tuple[Wall, Wall]

    @property
    def inliers(self) -> int:
        """Points on both walls."""
        return self.walls[0].inliers + self.walls[1].inliers

    def to_json(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "m": self.value_m,
            "sd_m": self.sd_m,
            "scatter_m": max(wall.scatter_m for wall in self.walls),
            "inliers": self.inliers,
            "parallel_deg": self.parallel_deg,
            "coverage": [wall.coverage for wall in self.walls],
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomDimensions:
    """``axes``: (3, 3) directions of length, width and height in the cloud's frame, as columns."""

    length: Dimension
    width: Dimension
    height: Dimension
    axes: FloatArray
    points: int

    def to_json(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            **{name: getattr(self, name).to_json() for name in DIMENSIONS},
            "axes": self.axes.tolist(),
            "points": self.points,
        }


def measure_room(
    points_m: FloatArray | Float32Array, settings: RoomSettings | None = None
) -> RoomDimensions:
    """The dimensions of the room around (N, 3) points, in any pose; rows with NaN are left out.

    The height is the dimension whose direction is nearest to the cloud's z, the length the longer
    of the other two. Raises EvaluationFailed where a wall is missing, and says which.
    """
    settings = RoomSettings() if settings is None else settings
    finite_m = points_m[np.isfinite(points_m).all(axis=1)].astype(np.float64)
    if len(finite_m) < _POINTS_MIN:
        raise EvaluationFailed(
            f"the cloud has {len(finite_m)} points with a position.",
            advice=f"A room needs {_POINTS_MIN} or more.",
        )
    finite_m = finite_m[:: -(-len(finite_m) // _POINTS_MAX)]
    finite_m -= np.median(finite_m, axis=0)
    finite_m = finite_m[np.abs(finite_m).max(axis=1) < _REACH_MAX_M]
    thinned_m = _one_in_each_voxel(finite_m, settings.voxel_m)
    if 2 * len(finite_m) < _POINTS_MIN or len(thinned_m) < _POINTS_MIN // 4:
        raise EvaluationFailed(
            f"only {len(thinned_m)} cubes of {settings.voxel_m:g} m hold points within "
            f"{_REACH_MAX_M:g} m of the cloud's middle.",
            advice="Lengths are in metres; a room needs a dense cloud.",
        )
    normals, is_surface = surface_normals(thinned_m)
    axes = box_axes(normals[is_surface])
    if axes is None:
        raise EvaluationFailed(
            "the cloud has no surfaces at right angles.", advice="Use a cloud of a whole room."
        )
    room = _Room(
        thinned_m=thinned_m[is_surface],
        normals=normals[is_surface],
        points_m=finite_m,
        settings=settings,
    )
    axes, offsets_m = room.fit_box(_named(axes))
    spans_m = offsets_m[:, 1] - offsets_m[:, 0]
    if spans_m[1] > spans_m[0]:
        # Turned by 90°, so that the axes stay right-handed.
        axes = np.stack([axes[:, 1], -axes[:, 0], axes[:, 2]], axis=1)
        offsets_m = np.stack([offsets_m[1], -offsets_m[0, ::-1], offsets_m[2]])
    walls = room.fit_walls(axes, offsets_m)
    length, width, height = (
        _dimension(name, low, high) for name, (low, high) in zip(DIMENSIONS, walls, strict=True)
    )
    return RoomDimensions(
        length=length, width=width, height=height, axes=axes, points=len(finite_m)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Room:
    """A cloud around its middle. ``thinned_m`` and ``normals``: one point of each voxel that is a
    surface."""

    thinned_m: FloatArray
    normals: FloatArray
    points_m: FloatArray
    settings: RoomSettings

    def fit_box(self, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The axes of the room and (3, 2) the offsets of its walls along them, without what is seen
        through its doors."""
        reach_m = np.full((3, 2), _REACH_MAX_M)
        for _ in range(_NEXT_ROOMS_MAX):
            offsets_m = self.find_walls(axes, reach_m)
            for _ in range(_FITS):
                walls = self.fit_walls(axes, offsets_m)
                axes, offsets_m = _squared(axes, walls)
            next_room = self.next_room(axes, walls)
            if next_room is None:
                return axes, offsets_m
            axis, side = next_room
            reach_m[axis, side] = abs(offsets_m[axis, side]) - self.settings.slab_m
        raise _missing(axis, side, "lies beyond what leads to it")

    def find_walls(self, axes: FloatArray, reach_m: FloatArray) -> FloatArray:
        """(3, 2) offsets of the lower and upper wall along each axis, no farther than the reach."""
        along_m = self.thinned_m @ axes
        faces = np.abs(self.normals @ axes) > np.cos(np.pi / 6.0)
        offsets_m = np.empty((3, 2))
        for axis in range(3):
            own = faces[:, axis]
            across = square_numbers(np.delete(along_m[own], axis, axis=1), self.settings.cell_m)
            for side, sign in enumerate((-1.0, 1.0)):
                outwards_m = sign * along_m[own, axis]
                within = outwards_m < reach_m[axis, side]
                found_m = self._outermost(outwards_m[within], across[within])
                if found_m is None:
                    raise _missing(axis, side, "has no surface")
                offsets_m[axis, side] = sign * found_m
        return offsets_m

    def _outermost(self, along_m: FloatArray, cells: IntArray) -> float | None:
        """The offset of the outermost large surface on the positive side."""
        settings = self.settings
        width = max(1, round(settings.slab_m / _BIN_M))
        bins = np.floor(along_m / _BIN_M).astype(np.int64)
        last = int(bins.max(initial=0))
        pairs = np.unique(np.stack([bins, cells]), axis=1)
        support = np.zeros(last + 1)
        for first in range(last + 1):
            lo, hi = np.searchsorted(pairs[0], (first, first + width))
            support[first] = len(np.unique(pairs[1, lo:hi]))
        distance_m = np.maximum(1.0, (np.arange(last + 1) + width / 2.0) * _BIN_M)
        size = support / distance_m**2
        large = np.flatnonzero(size >= settings.support_fraction * size.max(initial=0.0))
        if size.max(initial=0.0) == 0.0:
            return None
        # The window of most support among those that overlap the outermost large one.
        outermost = int(large[-1])
        start = max(0, outermost - width)
        best = start + int(np.argmax(support[start : outermost + 1]))
        inside = (bins >= best) & (bins < best + width)
        return float(np.median(along_m[inside]))

    def fit_walls(self, axes: FloatArray, offsets_m: FloatArray) -> list[tuple[Wall, Wall]]:
        """The planes near the offsets."""
        along_m = self.points_m @ axes
        middle_m = offsets_m.mean(axis=1)
        # Squares that would have four points each if all of the box were equally dense.
        length_m, width_m, height_m = np.diff(offsets_m, axis=1).ravel()
        surface_m2 = 2.0 * (length_m * width_m + (length_m + width_m) * height_m)
        sparse_m = float(np.sqrt(4.0 * max(surface_m2, 0.0) / len(self.points_m)))
        coverage_square_m = max(self.settings.cell_m, sparse_m)
        walls = []
        for axis in range(3):
            others = [other for other in range(3) if other != axis]
            # Near the edges stand the points of the other walls.
            margin_m = self.settings.slab_m
            inside = np.ones(len(along_m), np.bool_)
            for other in others:
                low_m, high_m = offsets_m[other] + (margin_m, -margin_m)
                inside &= (along_m[:, other] > low_m) & (along_m[:, other] < high_m)
            area = np.prod(offsets_m[others, 1] - offsets_m[others, 0] - 2.0 * margin_m)
            pair = []
            for side in range(2):
                offset_m = offsets_m[axis, side]
                near = inside & (np.abs(along_m[:, axis] - offset_m) < self.settings.slab_m)
                across_m = along_m[np.ix_(near, others)] - middle_m[others]
                wall = fit_wall(
                    along_m[near, axis],
                    across_m,
                    square_m=self.settings.cell_m,
                    coverage_square_m=coverage_square_m,
                    area_m2=float(area),
                )
                if wall is None:
                    raise _missing(axis, side, "has too few points")
                pair.append(wall)
            walls.append((pair[0], pair[1]))
        return walls

    def next_room(self, axes: FloatArray, walls: list[tuple[Wall, Wall]]) -> tuple[int, int] | None:
        """The axis and side of a wall that is seen through a door, None where all are the room's.

        Floor, ceiling and the walls beside it lead up to a wall and end there. Where they do not
        lead up to it, as they do to the opposite one, it is seen through a door. Where they go on,
        it is furniture before a wall that is missing: raises EvaluationFailed, as for a wall of
        which too little is seen.
        """
        settings = self.settings
        along_m = self.thinned_m @ axes
        offsets_m = np.array([[wall.offset_m for wall in pair] for pair in walls])
        inside, beyond = np.empty((3, 2)), np.empty((3, 2))
        for axis, side in np.ndindex(3, 2):
            leading_m = along_m[_near_the_others(along_m, offsets_m, axis, settings.slab_m), axis]
            depth_m = (1.0 - 2.0 * side) * (leading_m - offsets_m[axis, side])
            strip = np.abs(np.abs(depth_m) - settings.slab_m - _STRIP_M / 2.0) < _STRIP_M / 2.0
            inside[axis, side] = (strip & (depth_m > 0.0)).sum()
            beyond[axis, side] = (strip & (depth_m < 0.0)).sum()
        led_to = inside >= settings.leading_fraction * inside.max(axis=1, keepdims=True)
        if not led_to.all():
            axis, side = np.argwhere(~led_to)[0]
            return int(axis), int(side)
        for axis, side in np.ndindex(3, 2):
            wall = walls[axis][side]
            if wall.coverage < settings.coverage_fraction:
                raise _missing(axis, side, f"shows {wall.coverage:.0%} of its area")
            if beyond[axis, side] > settings.beyond_fraction * inside[axis, side]:
                raise _missing(axis, side, "is furniture: the room goes on beyond it")
        return None


def _near_the_others(
    along_m: FloatArray, offsets_m: FloatArray, axis: int, slab_m: float
) -> BoolArray:
    """Which points lie on the four walls across the other axes."""
    others = [other for other in range(3) if other != axis]
    from_low_m = along_m[:, others] - offsets_m[others, 0]
    from_high_m = along_m[:, others] - offsets_m[others, 1]
    within = ((from_low_m > -slab_m) & (from_high_m < slab_m)).all(axis=1)
    on_wall = (np.abs(from_low_m) < slab_m) | (np.abs(from_high_m) < slab_m)
    return np.asarray(within & on_wall.any(axis=1))


def _missing(axis: int, side: int, problem: str) -> EvaluationFailed:
    names = (("one end", "the other end"), ("one side", "the other side"))
    name = ("its floor", "its ceiling")[side] if axis == 2 else names[axis][side]
    return EvaluationFailed(
        f"the room is no whole box: {name} {problem}.",
        advice="Use a cloud that shows six walls of one room.",
    )


def _one_in_each_voxel(points_m: FloatArray, voxel_m: float) -> FloatArray:
    """The mean of the points of each cube."""
    keys = np.floor(points_m / voxel_m).astype(np.int64) + (1 << 20)
    key = (keys[:, 0] << 42) | (keys[:, 1] << 21) | keys[:, 2]
    _, voxel, counts = np.unique(key, return_inverse=True, return_counts=True)
    sums = [np.bincount(voxel, points_m[:, axis]) for axis in range(3)]
    return np.asarray(np.stack(sums, axis=1) / counts[:, np.newaxis], dtype=np.float64)


def _named(axes: FloatArray) -> FloatArray:
    """The axes with the one nearest to z last, upwards, and right-handed."""
    height = int(np.argmax(np.abs(axes[2])))
    first, second = (axes[:, (height + step) % 3] for step in (1, 2))
    up = axes[:, height] * np.sign(axes[2, height])
    if np.cross(first, second) @ up < 0.0:
        second = -second
    return np.stack([first, second, up], axis=1)


def _squared(axes: FloatArray, walls: list[tuple[Wall, Wall]]) -> tuple[FloatArray, FloatArray]:
    """The axes turned to the normals of the walls, and the walls' offsets along them."""
    normals = np.empty((3, 3))
    for axis, pair in enumerate(walls):
        others = [other for other in range(3) if other != axis]
        normals[axis, axis] = 1.0
        normals[others, axis] = -np.mean([wall.slope for wall in pair], axis=0)
    # Points at the middle of each wall, in the cloud's frame.
    middle_m = np.array([np.mean([wall.offset_m for wall in pair]) for pair in walls])
    u, _, vt = np.linalg.svd(axes @ (normals / np.linalg.norm(normals, axis=0)))
    turned = np.asarray(u @ vt, dtype=np.float64)
    offsets_m = np.empty((3, 2))
    for axis, pair in enumerate(walls):
        for side, wall in enumerate(pair):
            at_m = middle_m.copy()
            at_m[axis] = wall.offset_m
            offsets_m[axis, side] = (axes @ at_m) @ turned[:, axis]
    return turned, offsets_m


def _dimension(name: str, low: Wall, high: Wall) -> Dimension:
    normals = [np.array([1.0, -wall.slope[0], -wall.slope[1]]) for wall in (low, high)]
    low_normal, high_normal = (normal / np.linalg.norm(normal) for normal in normals)
    angle = np.arctan2(
        np.linalg.norm(np.cross(low_normal, high_normal)), float(low_normal @ high_normal)
    )
    return Dimension(
        name=name,
        value_m=high.offset_m - low.offset_m,
        sd_m=float(np.hypot(low.sd_m, high.sd_m)),
        parallel_deg=float(np.degrees(angle)),
        walls=(low, high),
    )
