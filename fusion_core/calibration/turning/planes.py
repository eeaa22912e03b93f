"""Planes in a cloud: seeds from small neighbourhoods, the best supported one refitted and taken
out, and so on."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.settings import StageSettings, setting

_SEEDS_PER_PLANE = 40
_SEED_NEIGHBOURS = 48
_SCORED_POINTS = 6000
_REFITS = 6
# A seed whose neighbourhood is this much longer than wide is an edge or one ring, and has no plane.
_SEED_WIDTH_MIN = 0.2


class PlaneSettings(StageSettings):
    """What counts as a plane."""

    tolerance_m: float = setting(
        0.06, "Greatest distance of a point from its plane", unit="m", ge=1e-3, le=1.0
    )
    points_min: int = setting(150, "Least number of points of a plane", ge=10, le=100000)
    planes_max: int = setting(12, "Planes to look for in a cloud", ge=1, le=100)


@dataclass(frozen=True, slots=True)
class Plane:
    """normal · p = offset, with the unit ``normal`` (3,) and ``offset_m`` >= 0: the normal points
    from the origin to the plane. ``members``: (M,) indices of its points."""

    normal: FloatArray
    offset_m: float
    members: IntArray

    def __post_init__(self) -> None:
        read_only(self.normal)
        read_only(self.members)


def extract_planes(
    points_m: FloatArray, settings: PlaneSettings, rng: np.random.Generator
) -> tuple[Plane, ...]:
    """The planes of (N, 3) points, the one with most points first."""
    planes: list[Plane] = []
    left = np.arange(len(points_m))
    while len(planes) < settings.planes_max and left.size >= settings.points_min:
        normal_offset = _best_seed(points_m[left], settings.tolerance_m, rng)
        if normal_offset is None:
            break
        plane = _refit(points_m, left, *normal_offset, settings.tolerance_m)
        if plane is None or plane.members.size < settings.points_min:
            break
        planes.append(plane)
        left = left[~np.isin(left, plane.members, assume_unique=True)]
    return tuple(sorted(planes, key=lambda plane: -plane.members.size))


def fit_plane(points_m: FloatArray) -> tuple[FloatArray, float]:
    """Unit normal and offset >= 0 of the plane with the least squares of distances to (N, 3)."""
    middle = points_m.mean(axis=0)
    centred = points_m - middle
    _, vectors = np.linalg.eigh(centred.T @ centred)
    return oriented(vectors[:, 0], float(vectors[:, 0] @ middle))


def oriented(normal: FloatArray, offset_m: float) -> tuple[FloatArray, float]:
    """The same plane with an offset >= 0."""
    return (-normal, -offset_m) if offset_m < 0.0 else (normal, offset_m)


def _best_seed(
    points_m: FloatArray, tolerance_m: float, rng: np.random.Generator
) -> tuple[FloatArray, float] | None:
    seeds = rng.integers(len(points_m), size=_SEEDS_PER_PLANE)
    sample = points_m[rng.integers(len(points_m), size=min(_SCORED_POINTS, len(points_m)))]
    # Neighbours among a sample: wide enough that noise does not tilt the plane of the seed.
    count = min(_SEED_NEIGHBOURS, len(sample))
    _, neighbours = cKDTree(sample).query(points_m[seeds], k=count)
    groups = sample[np.atleast_2d(neighbours)]
    centred = groups - groups.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("skx,sky->sxy", centred, centred))
    wide = values[:, 1] > _SEED_WIDTH_MIN**2 * values[:, 2]
    if not wide.any():
        return None
    normals = vectors[wide, :, 0]
    offsets = np.einsum("sx,sx->s", normals, groups[wide].mean(axis=1))
    near = np.abs(sample @ normals.T - offsets) < tolerance_m
    best = int(near.sum(axis=0).argmax())
    return normals[best], float(offsets[best])


def _refit(
    points_m: FloatArray, left: IntArray, normal: FloatArray, offset_m: float, tolerance_m: float
) -> Plane | None:
    candidates = points_m[left]
    inside: BoolArray = np.zeros(0, dtype=np.bool_)
    for _ in range(_REFITS):
        inside = np.abs(candidates @ normal - offset_m) < tolerance_m
        if inside.sum() < 3:
            return None
        normal, offset_m = fit_plane(candidates[inside])
    return Plane(normal, offset_m, left[inside])
