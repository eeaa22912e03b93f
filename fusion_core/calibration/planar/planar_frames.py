"""Scans with depth images of the same places, as the calibration without a board takes them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.patches.depth_patches import DepthPatches
from fusion_core.patches.inside_surfaces import find_inside

FRAME_KEY = 10.0
"""More than a full turn: beams of different frames are this far apart."""

# Points whose line a beam's own place is averaged over, on each side.
_NEIGHBOURS = 8
# Of one line: a neighbour is no farther from it than some times the noise of a range, and goes the
# same way. Beyond a corner the other wall is near the line, too, always on one side of it.
_SAME_LINE_M = 0.05
_SAME_LINE_COSINE = float(np.cos(np.deg2rad(3.0)))


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
        first = np.cumsum([0, *sizes])
        flat = np.concatenate(find_inside([frame.patches for frame in frames]))
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


def _evenly(chosen: BoolArray, first: IntArray, most: int) -> BoolArray:
    """(N,) at most some ``most`` of the chosen between each two of ``first``."""
    kept = np.zeros(chosen.size, dtype=bool)
    for begin, end in pairwise(first):
        own = begin + np.flatnonzero(chosen[begin:end])
        if own.size:
            kept[own[np.linspace(0, own.size - 1, min(own.size, most)).astype(np.int64)]] = True
    return kept


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
