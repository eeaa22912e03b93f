"""What neighbouring beams of a 3D LiDAR say of each other: where the depth steps, and how the
intensity stands out from its surroundings.

Beams are neighbours by the angle between them as the LiDAR sends them, so that no ring numbers are
needed: files rarely have them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only

# Left, right, up, down along the tangents of azimuth and elevation.
_DIRECTIONS = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
_OPPOSITE = (1, 0, 3, 2)
# Neighbours that are looked at: a circle of three beams around each, and more.
_NEIGHBOURS = 48
# Half the cone, as a tangent, in which the neighbour to the side lies, and that above or below:
# rings stand farther apart than the beams of one ring.
_CONE_SIDEWAYS, _CONE_UPRIGHT = 0.35, 0.6
# Denser than any scanner's beams, wider than the rounding of its coordinates.
_SAME_BEAM_RAD = 1e-4
# A gap of more beams to the side, of a scanner that turns, is sky.
_GAP = 2.5
# The share of the circle, in steps of one degree, in which a scanner that turns has returns.
_FULL_CIRCLE = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamNeighbours:
    """The beams nearest to each of N beams.

    ``spacing_rad``: median angle to the nearest one. ``indices``, ``angle_rad``: (N, k) the
    neighbours, nearest first, and the angles to them. ``offsets_rad``: (N, k, 2) the same along
    the ``tangents``, (N, 2, 3): left (azimuth) and up (elevation). ``range_m``: (N,).
    """

    points_in_lidar_m: FloatArray
    range_m: FloatArray
    tangents: FloatArray
    spacing_rad: float
    indices: IntArray
    angle_rad: FloatArray
    offsets_rad: FloatArray

    def __post_init__(self) -> None:
        for array in (self.points_in_lidar_m, self.range_m, self.tangents, self.indices):
            read_only(array)
        read_only(self.angle_rad)
        read_only(self.offsets_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthSteps:
    """Half-way points between each beam and its neighbour in one of four directions.

    ``points_in_lidar_m``: (M, 3) at the range of the nearer beam. ``towards``: (M, 3) unit vectors
    to the neighbour. ``beam``: (M,) whose. ``is_step``: (M,) whether the surface ends there.
    """

    points_in_lidar_m: FloatArray
    towards: FloatArray
    beam: IntArray
    is_step: BoolArray


def find_beam_neighbours(points_in_lidar_m: FloatArray) -> BeamNeighbours:
    """The neighbours of (N, 3) finite points, N >= 2, none at the origin."""
    range_m = np.linalg.norm(points_in_lidar_m, axis=1)
    bearing = points_in_lidar_m / range_m[:, np.newaxis]
    count = min(_NEIGHBOURS, len(bearing) - 1)
    # Each is its own nearest, or one at the same place is: the first column says nothing.
    ranks = np.arange(2, count + 2)
    angle, found = cKDTree(bearing).query(bearing, k=ranks)
    angle_rad, indices = np.asarray(angle, np.float64), np.asarray(found, np.int64)
    tangents = _tangents(bearing)
    offsets_rad = np.einsum("nij,nkj->nki", tangents, bearing[indices] - bearing[:, np.newaxis])
    return BeamNeighbours(
        points_in_lidar_m=points_in_lidar_m,
        range_m=range_m,
        tangents=tangents,
        spacing_rad=_spacing_rad(angle_rad),
        indices=indices,
        angle_rad=angle_rad,
        offsets_rad=offsets_rad,
    )


def _spacing_rad(angle_rad: FloatArray) -> float:
    """The median angle to the nearest other beam; a second return of the same one is none."""
    nearest = np.where(angle_rad > _SAME_BEAM_RAD, angle_rad, np.inf).min(axis=1)
    apart = nearest[np.isfinite(nearest)]
    return float(np.median(apart)) if apart.size else _SAME_BEAM_RAD


def turns_full_circle(points_in_lidar_m: FloatArray) -> bool:
    """Whether a scanner looks all around, so that no return to the side means open sky."""
    azimuth_deg = np.degrees(np.arctan2(points_in_lidar_m[:, 1], points_in_lidar_m[:, 0]))
    return np.unique(np.floor(azimuth_deg)).size >= _FULL_CIRCLE * 360


def find_depth_steps(
    near: BeamNeighbours, *, slope_min: float, sideways_gaps_are_sky: bool
) -> DepthSteps:
    """Where the surface ends at each beam, in each of four directions.

    The inverse range of a plane is linear in the (small) angle. With the range r of a beam, r' of
    its neighbour at the angle a, and r'' at the angle b on the other side, the surface is steeper
    towards the neighbour than it was before it by (1/r - 1/r') / a - (1/r'' - 1/r) / b; times r it
    is the tangent of an angle of incidence, and a step where it exceeds ``slope_min``.
    """
    inverse = 1.0 / near.range_m
    nearest = [_nearest_towards(near, direction) for direction in _DIRECTIONS]
    points, towards, beams, steps = [], [], [], []
    for number, direction in enumerate(_DIRECTIONS):
        angle_rad, neighbour = nearest[number]
        other_rad, other = nearest[_OPPOSITE[number]]
        gap = ~np.isfinite(angle_rad)
        if direction[0] != 0.0 and sideways_gaps_are_sky:
            gap |= angle_rad > _GAP * near.spacing_rad
            known = np.ones(gap.shape, dtype=np.bool_)
        else:
            known = ~gap
        angle_rad = np.where(gap, near.spacing_rad, angle_rad)
        ahead = np.where(gap, 0.0, inverse[neighbour])
        # Divided by inf, it is 0.
        before = (inverse[other] - inverse) / other_rad
        slope = ((inverse - ahead) / angle_rad - np.maximum(before, 0.0)) / inverse
        along = np.einsum("i,nij->nj", direction, near.tangents)
        half_way = near.points_in_lidar_m / near.range_m[:, np.newaxis] + 0.5 * (
            angle_rad[:, np.newaxis] * along
        )
        half_way *= (near.range_m / np.linalg.norm(half_way, axis=1))[:, np.newaxis]
        points.append(half_way[known])
        towards.append(along[known])
        beams.append(np.flatnonzero(known))
        steps.append(slope[known] > slope_min)
    return DepthSteps(
        points_in_lidar_m=np.concatenate(points),
        towards=np.concatenate(towards),
        beam=np.concatenate(beams),
        is_step=np.concatenate(steps),
    )


def intensity_contrast(
    near: BeamNeighbours, intensity: FloatArray, *, radius_rad: float, slope_max: float
) -> FloatArray:
    """(N,) how far each intensity's rank lies above the mean of its surroundings, in their
    standard deviations; NaN where the intensity is.

    What the range, the angle of incidence and the driver's scale do to the intensity is nearly the
    same for neighbours on one surface (those no steeper than ``slope_max``), and cancels.
    """
    rank = _ranks(intensity)
    same = near.angle_rad < radius_rad
    step_m = np.abs(near.range_m[near.indices] - near.range_m[:, np.newaxis])
    same &= step_m < slope_max * near.angle_rad * near.range_m[:, np.newaxis]
    values = rank[near.indices]
    same &= np.isfinite(values)
    values = np.where(same, values, 0.0)
    # The beam itself belongs to its surroundings, and is all of them where it is alone.
    own = np.nan_to_num(rank)
    count = same.sum(axis=1) + 1.0
    mean = (values.sum(axis=1) + own) / count
    variance = (np.square(values).sum(axis=1) + own**2) / count - mean**2
    # A part of all ranks, so that a surface of one intensity does not become noise.
    floor = 0.05
    contrast: FloatArray = (rank - mean) / (np.sqrt(np.maximum(variance, 0.0)) + floor)
    return contrast


def _tangents(bearing: FloatArray) -> FloatArray:
    """(N, 2, 3) unit vectors to the left (azimuth) and up (elevation) of bearings."""
    left = np.stack([-bearing[:, 1], bearing[:, 0], np.zeros(len(bearing))], axis=1)
    length = np.linalg.norm(left, axis=1, keepdims=True)
    # Straight up and down has no azimuth: any tangent does.
    left = np.where(length > 1e-9, left / np.maximum(length, 1e-9), [0.0, 1.0, 0.0])
    return np.stack([left, np.cross(bearing, left)], axis=1)


def _nearest_towards(near: BeamNeighbours, direction: FloatArray) -> tuple[FloatArray, IntArray]:
    """(N,) the angle to the nearest neighbour in a cone, inf where there is none, and which."""
    along = near.offsets_rad @ direction
    across = np.abs(near.offsets_rad @ np.array([-direction[1], direction[0]]))
    cone = _CONE_SIDEWAYS if direction[0] != 0.0 else _CONE_UPRIGHT
    # Returns of one beam are not its neighbours.
    inside = (along > 0.3 * near.spacing_rad) & (across < cone * along)
    angle_rad = np.where(inside, near.angle_rad, np.inf)
    first = angle_rad.argmin(axis=1)[:, np.newaxis]
    return (
        np.take_along_axis(angle_rad, first, axis=1)[:, 0],
        np.take_along_axis(near.indices, first, axis=1)[:, 0],
    )


def _ranks(values: FloatArray) -> FloatArray:
    """(N,) ranks from 0 to 1, equal values in the middle of theirs; NaN stays."""
    known = np.isfinite(values)
    _, inverse, counts = np.unique(values[known], return_inverse=True, return_counts=True)
    middle = np.cumsum(counts) - 0.5 * counts
    ranks = np.full(values.shape, np.nan)
    ranks[known] = middle[inverse] / max(1, known.sum())
    return ranks
