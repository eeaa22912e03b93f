"""Scans with depth images of the same places, as the calibration without a board takes them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fusion_core.calibration.planar.depth_patches import DepthPatches
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only

FRAME_KEY = 10.0
"""More than a full turn: beams of different frames are this far apart."""

# Points whose line a beam's own place is averaged over, on each side.
_NEIGHBOURS = 8
# Of one line: a neighbour is no farther from it than some times the noise of a range, and goes the
# same way. Beyond a corner the other wall is near the line, too, always on one side of it.
_SAME_LINE_M = 0.05
_SAME_LINE_COSINE = float(np.cos(np.deg2rad(3.0)))
# The noise of depths is learned in bins of so many patches, from the quantile that is surely of
# clean planes; those count that spread up to so many times as much.
_PER_BIN = 500
_CLEAN = 0.3
_NOISE_FACTOR = 1.25
# Patches of one surface: cosine between their normals, and a step between them besides the noise.
_SAME_NORMAL = float(np.cos(np.deg2rad(10.0)))
_STEP_M = 0.005
# A hole or the image's border may stand for one of the four neighbours.
_LEAST_NEIGHBOURS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanWithPatches:
    """One scan and one depth image.

    ``azimuths_rad``: (B,) of the beams that met something, rising. ``points_m``: (B, 2) where.
    ``normals``: (B, 2) of the line that each lies on in its scan, NaN where on none, and
    ``normal_sd_rad``: (B,) the deviations of their directions. ``velocity``: (3,) of the LiDAR in
    its own frame: x, y in m/s, turn rate in rad/s. ``image_after_scan_s``: between their stamps.
    ``heading_rad``: of the LiDAR in the room, from that of the first frame.
    """

    azimuths_rad: FloatArray
    points_m: FloatArray
    normals: FloatArray
    normal_sd_rad: FloatArray
    velocity: FloatArray
    image_after_scan_s: float
    heading_rad: float
    patches: DepthPatches

    def __post_init__(self) -> None:
        if (np.diff(self.azimuths_rad) < 0.0).any():
            raise ValueError("azimuths_rad must rise")
        for array in (self.azimuths_rad, self.points_m, self.normals, self.normal_sd_rad):
            read_only(array)
        read_only(self.velocity)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatFrames:
    """All frames as flat arrays. Beams (B,): ``azimuth_rad`` with 10 times the frame's number
    added, so that one search finds a frame's own; ``normal``, ``normal_sd_rad`` and ``offset_m`` of
    their lines. Patches (N,): ``point_m``, ``normal_in_camera``, ``frame``, ``pixel``."""

    beam_key: FloatArray
    beam_azimuth_rad: FloatArray
    beam_normal: FloatArray
    beam_normal_sd_rad: FloatArray
    beam_offset_m: FloatArray
    beam_range_m: FloatArray
    point_m: FloatArray
    normal_in_camera: FloatArray
    frame: IntArray
    pixel: IntArray
    velocity: FloatArray
    image_after_scan_s: FloatArray
    heading_rad: FloatArray

    @classmethod
    def of(cls, frames: Sequence[ScanWithPatches], patches_max: int) -> "FlatFrames":
        """Concatenates the frames, with at most some ``patches_max`` patches of each, evenly spread
        over those inside a surface."""
        sizes = [frame.patches.pixel.size for frame in frames]
        flat = is_flat(
            np.concatenate([frame.patches.points_m[:, 2] for frame in frames]),
            np.concatenate([frame.patches.spread_m for frame in frames]),
        )
        first = np.cumsum([0, *sizes])
        flat = np.concatenate(
            [
                is_interior(frame.patches, flat[first[n] : first[n + 1]])
                for n, frame in enumerate(frames)
            ]
        )
        flat &= _evenly(flat, first, patches_max)
        return cls(
            beam_key=np.concatenate(
                [frame.azimuths_rad + FRAME_KEY * n for n, frame in enumerate(frames)]
            ),
            beam_azimuth_rad=np.concatenate([frame.azimuths_rad for frame in frames]),
            beam_normal=np.concatenate([frame.normals for frame in frames]),
            beam_normal_sd_rad=np.concatenate([frame.normal_sd_rad for frame in frames]),
            beam_offset_m=np.concatenate([_line_offsets_m(frame) for frame in frames]),
            beam_range_m=np.concatenate([np.hypot(*frame.points_m.T) for frame in frames]),
            point_m=np.concatenate([frame.patches.points_m for frame in frames])[flat],
            normal_in_camera=np.concatenate([frame.patches.normals for frame in frames])[flat],
            frame=np.repeat(np.arange(len(frames)), sizes)[flat],
            pixel=np.concatenate([frame.patches.pixel for frame in frames])[flat],
            velocity=np.stack([frame.velocity for frame in frames]),
            image_after_scan_s=np.array([frame.image_after_scan_s for frame in frames]),
            heading_rad=np.array([frame.heading_rad for frame in frames]),
        )


def is_flat(depth_m: FloatArray, spread_m: FloatArray) -> BoolArray:
    """(N,) whether the pixels of patches spread no more than the depth's noise.

    At each depth the lower part of the patches is on clean planes, and shows the noise. What
    spreads more holds the edge of something, such as the foot of a wall, always on one side.
    """
    flat = np.zeros(depth_m.size, dtype=bool)
    order = np.argsort(depth_m, kind="stable")
    for part in np.array_split(order, max(1, depth_m.size // _PER_BIN)):
        if part.size:
            flat[part] = spread_m[part] <= _NOISE_FACTOR * np.quantile(spread_m[part], _CLEAN)
    return flat


def _evenly(chosen: BoolArray, first: IntArray, most: int) -> BoolArray:
    """(N,) at most some ``most`` of the chosen between each two of ``first``."""
    kept = np.zeros(chosen.size, dtype=bool)
    for begin, end in pairwise(first):
        own = begin + np.flatnonzero(chosen[begin:end])
        if own.size:
            kept[own[np.linspace(0, own.size - 1, min(own.size, most)).astype(np.int64)]] = True
    return kept


def is_interior(patches: DepthPatches, flat: BoolArray) -> BoolArray:
    """(N,) whether a flat patch is inside a surface: those above, below and on both sides go
    on with it. At an edge the pixels beyond it bend a patch, always to the same side."""
    rows, columns = patches.cell.max(axis=0, initial=0) + 3
    number = np.full((rows, columns), -1)
    row, column = patches.cell.T + 1
    own = np.arange(flat.size)
    number[row, column] = own
    going_on = np.zeros(own.size, dtype=np.int64)
    ending = np.zeros(own.size, dtype=bool)
    for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        other = number[row + down, column + right]
        apart = patches.points_m[other] - patches.points_m[own]
        off = np.abs((patches.normals[own] * apart).sum(axis=1))
        turn = (patches.normals[own] * patches.normals[other]).sum(axis=1)
        is_same = (turn > _SAME_NORMAL) & (off < patches.spread_m[own] + _STEP_M)
        ending |= (other >= 0) & ~is_same
        going_on += (other >= 0) & is_same
    interior: BoolArray = flat & ~ending & (going_on >= _LEAST_NEIGHBOURS)
    return interior


def _line_offsets_m(frame: ScanWithPatches) -> FloatArray:
    """(B,) distances n . p of the beams' lines from the LiDAR, each the mean over the neighbours on
    the same line: a beam's own noise is that of one range."""
    points, normals = frame.points_m, frame.normals
    count = points.shape[0]
    total, weight = np.zeros(count), np.zeros(count)
    index = np.arange(count)
    own = (normals * points).sum(axis=1)
    for step in range(-_NEIGHBOURS, _NEIGHBOURS + 1):
        other = np.clip(index + step, 0, count - 1)
        offset = (normals * points[other]).sum(axis=1)
        near = (other == index + step) & (np.abs(offset - own) < _SAME_LINE_M)
        near &= (normals * normals[other]).sum(axis=1) > _SAME_LINE_COSINE
        total += np.where(near, offset, 0.0)
        weight += near
    mean: FloatArray = total / np.maximum(weight, 1.0)
    return np.where(np.isfinite(own), mean, np.nan)
