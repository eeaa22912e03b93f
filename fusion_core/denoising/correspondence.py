"""Which depth pixel belongs to which LiDAR beam, and what each sensor predicts for the other.

Every beam inside the camera's view is kept: nothing is decimated. Along the projected curve (the
default, where the mount is known) a beam with a range is paired with the pixel onto which its point
projects. Every beam, with a range or without, is also cast as a ray through the depth image: the
range at which it first meets the surface that the camera sees is the camera's prediction for it. In
the row (where the mount is not known, and in the paper) a beam is paired with the row's pixel of
the same azimuth.
"""

from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import LaserScan
from fusion_core.registration.models import apply_transform

RowModel = Literal["curve", "row"]

# A seen depth that changes by more than this between two steps of a ray is an edge, not a surface
# that the ray pierces.
_EDGE_M = 0.25
# About the noise of a LiDAR at 2 m; the crossing is interpolated within a step.
_RAY_STEP_M = 0.03
# The least depth of an Intel D435 at 640 x 360 pixels, by its data sheet; a Kinect's is greater.
_MIN_DEPTH_M = 0.15
# Beams that leave the camera's plane too slowly gain almost no depth per step: 78 degrees off axis.
_MIN_FORWARD = 0.2
# The tangent of a pixel's angle grows without bound towards 90 degrees.
_MAX_OFF_AXIS_RAD = np.deg2rad(85.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Correspondence:
    """One scan against one image: arrays over the B beams inside the camera's view.

    ``beam``: index in the scan. ``row``, ``column``: pixel in the upright view, -1 where the
    beam's point lies outside the image or is not known.
    ``lidar_range_m``: the beam's own range; ``depth_m``: the pixel's own depth along the optical
    axis; ``depth_as_range_m``: that pixel's point as a horizontal range from the LiDAR's origin;
    ``lidar_as_depth_m``: the beam's point as a depth along the optical axis;
    ``camera_range_m``: the range at which the beam, cast as a ray, meets what the camera sees;
    ``camera_blocked``: before that it passes behind something nearer, above or below its plane, so
    that the camera does not see all of its way.
    ``azimuth_rad``: the beam in the LiDAR frame, continuous over the seam of a full circle, as the
    order of the pairs is. ``residual_m``: what eq. (6) compares with
    epsilon, signed depth - LiDAR where both are ranges. NaN where missing.
    """

    model: RowModel
    beam: IntArray
    row: IntArray
    column: IntArray
    azimuth_rad: FloatArray
    lidar_range_m: FloatArray
    depth_m: FloatArray
    depth_as_range_m: FloatArray
    lidar_as_depth_m: FloatArray
    camera_range_m: FloatArray
    camera_blocked: BoolArray
    residual_m: FloatArray

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name != "model":
                read_only(getattr(self, field.name))

    def subset(self, own: BoolArray) -> "Correspondence":
        """Some of the pairs. ``own``: (B,)."""
        arrays = {
            field.name: getattr(self, field.name)[own]
            for field in fields(self)
            if field.name != "model"
        }
        return replace(self, **arrays)


def match_along_curve(
    scan: LaserScan,
    depth_m: Float32Array,
    smooth_depth_m: Float32Array,
    camera: Camera,
    T_lidar_camera: FloatArray,
) -> Correspondence:
    """Pair beams and pixels along the LiDAR's projected curve.

    ``depth_m``: (H, W) upright view, ``smooth_depth_m`` the same without speckle (rays follow
    it). ``T_lidar_camera``: (4, 4) optical frame at the image's stamp to the LiDAR frame at the
    scan's stamp.
    """
    intrinsics = camera.intrinsics
    scan, first = _with_seam_behind(scan, T_lidar_camera)
    T_camera_lidar = invert_transform(T_lidar_camera)
    camera_range, blocked = _cast_rays(
        scan.angles_rad,
        smooth_depth_m,
        T_camera_lidar,
        np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy]),
        scan.range_max_m,
    )
    guess = np.where(np.isfinite(scan.ranges_m), scan.ranges_m, camera_range)
    beam = np.flatnonzero(_is_column_in_view(scan.angles_rad, guess, T_camera_lidar, camera))
    azimuth_rad = scan.angles_rad[beam]
    lidar = scan.ranges_m[beam]
    in_camera = transform_points(T_camera_lidar, _points_at_range(azimuth_rad, guess[beam]))
    scale = np.where(in_camera[:, 2] > _MIN_DEPTH_M, in_camera[:, 2], np.nan)
    u = intrinsics.cx + intrinsics.fx * in_camera[:, 0] / scale
    v = intrinsics.cy + intrinsics.fy * in_camera[:, 1] / scale
    row, column = _nearest_pixel(u, v, intrinsics.height, intrinsics.width)
    depth = np.where(row >= 0, depth_m[row, column], np.nan).astype(np.float64)
    seen = transform_points(T_lidar_camera, depth[:, np.newaxis] * camera.rays(row, column))
    depth_as_range = np.hypot(seen[:, 0], seen[:, 1])
    return Correspondence(
        model="curve",
        beam=(beam + first) % scan.ranges_m.size,
        row=row,
        column=column,
        azimuth_rad=azimuth_rad,
        lidar_range_m=lidar,
        depth_m=depth,
        depth_as_range_m=depth_as_range,
        lidar_as_depth_m=np.where(np.isfinite(lidar), in_camera[:, 2], np.nan),
        camera_range_m=camera_range[beam],
        camera_blocked=blocked[beam],
        residual_m=depth_as_range - lidar,
    )


def pixels_met(
    pairs: Correspondence, camera: Camera, T_lidar_camera: FloatArray
) -> tuple[IntArray, IntArray]:
    """(B,) row and column of the upright pixel that shows what each beam meets there, at
    ``camera_range_m``; -1 where it meets nothing. In a row it is the pair's own pixel.

    ``T_lidar_camera``: as for ``match_along_curve``.
    """
    if pairs.model == "row":
        return pairs.row, pairs.column
    points = _points_at_range(pairs.azimuth_rad, pairs.camera_range_m)
    x, y, z = transform_points(invert_transform(T_lidar_camera), points).T
    intrinsics = camera.intrinsics
    return _nearest_pixel(
        intrinsics.cx + intrinsics.fx * x / z,
        intrinsics.cy + intrinsics.fy * y / z,
        intrinsics.height,
        intrinsics.width,
    )


def match_in_row(
    scan: LaserScan,
    depth_m: Float32Array,
    smooth_depth_m: Float32Array,
    camera: Camera,
    T_lidar_camera: FloatArray,
    row: int,
) -> Correspondence:
    """Pair beams with the pixels of one row that have the same azimuth, as the paper does.

    The camera is assumed level and on the LiDAR's axis: only the yaw of ``T_lidar_camera`` is used,
    and a row's horizontal range is compared with the beam's as it is.
    """
    intrinsics = camera.intrinsics
    scan, first = _with_seam_behind(scan, T_lidar_camera)
    yaw_rad = float(np.arctan2(T_lidar_camera[1, 2], T_lidar_camera[0, 2]))
    relative = np.angle(np.exp(1j * (scan.angles_rad - yaw_rad)))
    ahead = np.abs(relative) < _MAX_OFF_AXIS_RAD
    u = np.where(
        ahead, intrinsics.cx - intrinsics.fx * np.tan(np.where(ahead, relative, 0.0)), np.nan
    )
    beam = np.flatnonzero((u >= -0.5) & (u < intrinsics.width - 0.5))
    column = np.floor(u[beam] + 0.5).astype(np.int64)
    range_per_depth = 1.0 / np.cos(relative[beam])
    lidar = scan.ranges_m[beam]
    depth = depth_m[row, column].astype(np.float64)
    return Correspondence(
        model="row",
        beam=(beam + first) % scan.ranges_m.size,
        row=np.full(beam.size, row, dtype=np.int64),
        column=column,
        azimuth_rad=scan.angles_rad[beam],
        lidar_range_m=lidar,
        depth_m=depth,
        depth_as_range_m=depth * range_per_depth,
        lidar_as_depth_m=lidar / range_per_depth,
        camera_range_m=smooth_depth_m[row, column] * range_per_depth,
        camera_blocked=np.zeros(beam.size, dtype=np.bool_),
        residual_m=depth * range_per_depth - lidar,
    )


def match_by_sample(
    scan: LaserScan,
    depth_m: Float32Array,
    curve_beams: IntArray,
    row_columns: IntArray,
    u: float,
    v: float,
) -> tuple[Correspondence, FloatArray, FloatArray]:
    """The paper's pairs: sample u + w of the curve and sample w of row v, values as they come.

    Returns the pairs, not yet compared, and the (W, 2) points (x, z) of L and D for eq. (5): z the
    value, holes as 0, and x = w s with s the frame's median range times the angle of a sample (our
    reading: the paper names no unit, and so both axes are metres).
    """
    first = round(u)
    inside = (first + np.arange(row_columns.size) >= 0) & (
        first + np.arange(row_columns.size) < curve_beams.size
    )
    column = row_columns[inside]
    beam = curve_beams[first + np.flatnonzero(inside)]
    lidar = scan.ranges_m[beam]
    depth = depth_m[round(v), column].astype(np.float64)
    azimuth_rad = scan.angles_rad[beam]
    samples = curve_beams.size
    if scan.is_full_circle:
        # The curve goes on beyond its seam.
        azimuth_rad, samples = np.unwrap(azimuth_rad), np.unique(curve_beams).size
    step_rad = abs(scan.angle_increment_rad) * scan.ranges_m.size / samples
    valid = lidar[np.isfinite(lidar)]
    spacing_m = float(np.median(valid)) * step_rad if valid.size else step_rad
    x = np.arange(beam.size) * spacing_m
    missing = np.full(beam.size, np.nan)
    pairs = Correspondence(
        model="row",
        beam=beam,
        row=np.full(beam.size, round(v), dtype=np.int64),
        column=column,
        azimuth_rad=azimuth_rad,
        lidar_range_m=lidar,
        depth_m=depth,
        depth_as_range_m=missing,
        lidar_as_depth_m=missing,
        camera_range_m=missing,
        camera_blocked=np.zeros(beam.size, dtype=np.bool_),
        residual_m=missing,
    )
    L = np.stack([x, np.nan_to_num(lidar, nan=0.0)], axis=1)
    D = np.stack([x, np.nan_to_num(depth, nan=0.0)], axis=1)
    return pairs, L, D


def compare_samples(
    pairs: Correspondence,
    L: FloatArray,
    D: FloatArray,
    A: FloatArray,
    A_inverse: FloatArray,
    residual_m: FloatArray,
) -> Correspondence:
    """The paper's pairs with the values predicted through A: D A^-1 (7) for beams, L A (8) for
    pixels."""
    has_lidar, has_depth = np.isfinite(pairs.lidar_range_m), np.isfinite(pairs.depth_m)
    as_range = np.where(has_depth, apply_transform(A_inverse, D)[:, 1], np.nan)
    return replace(
        pairs,
        depth_as_range_m=as_range,
        camera_range_m=as_range,
        lidar_as_depth_m=np.where(has_lidar, apply_transform(A, L)[:, 1], np.nan),
        residual_m=np.where(has_lidar & has_depth, residual_m, np.nan),
    )


def planar_points(pairs: Correspondence, range_m: FloatArray) -> FloatArray:
    """(B, 2) points (x to the right, z ahead) of ranges on the pairs' beams, as eq. (5) has them.

    Ahead is the middle of the beams in view.
    """
    middle_rad = float(np.median(pairs.azimuth_rad)) if pairs.azimuth_rad.size else 0.0
    relative = pairs.azimuth_rad - middle_rad
    return np.stack([-range_m * np.sin(relative), range_m * np.cos(relative)], axis=1)


def map_through_A(pairs: Correspondence, A: FloatArray, A_inverse: FloatArray) -> Correspondence:
    """The pairs with each sensor's value mapped to the other through A, eqs. (7) and (8).

    For pairs in the row, whose mount is not known: a pixel predicts the beam's range as the length
    of D A^-1, and a beam predicts the pixel's depth, scaled by the length of L A.
    """

    def mapped_range(range_m: FloatArray, matrix: FloatArray) -> FloatArray:
        image = apply_transform(matrix, planar_points(pairs, range_m))
        return np.hypot(image[:, 0], image[:, 1])

    as_range = mapped_range(pairs.depth_as_range_m, A_inverse)
    with np.errstate(invalid="ignore", divide="ignore"):
        depth_per_range = pairs.lidar_as_depth_m / pairs.lidar_range_m
    return replace(
        pairs,
        depth_as_range_m=as_range,
        camera_range_m=mapped_range(pairs.camera_range_m, A_inverse),
        lidar_as_depth_m=mapped_range(pairs.lidar_range_m, A) * depth_per_range,
        residual_m=as_range - pairs.lidar_range_m,
    )


def _with_seam_behind(scan: LaserScan, T_lidar_camera: FloatArray) -> tuple[LaserScan, int]:
    """A full circle cut behind the camera, so that the beams in view follow each other in number
    and azimuth, and the beam that is its first; a scan with ends as it is."""
    first = scan.beam_behind(float(np.arctan2(T_lidar_camera[1, 2], T_lidar_camera[0, 2])))
    return scan.with_seam_at(first), first


def _points_at_range(azimuth_rad: FloatArray, range_m: FloatArray) -> FloatArray:
    """(N, 3) points of the LiDAR's plane."""
    zero = np.zeros(azimuth_rad.size)
    return np.stack([range_m * np.cos(azimuth_rad), range_m * np.sin(azimuth_rad), zero], axis=1)


def _nearest_pixel(
    u: FloatArray, v: FloatArray, height: int, width: int
) -> tuple[IntArray, IntArray]:
    inside = (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5)
    row = np.where(inside, np.floor(np.where(inside, v, 0.0) + 0.5), -1).astype(np.int64)
    column = np.where(inside, np.floor(np.where(inside, u, 0.0) + 0.5), -1).astype(np.int64)
    return row, column


def _is_column_in_view(
    azimuth_rad: FloatArray, range_m: FloatArray, T_camera_lidar: FloatArray, camera: Camera
) -> BoolArray:
    """(N,) beams whose column lies in the image; a beam without any range is taken at the range
    interpolated between its neighbours."""
    known = np.isfinite(range_m)
    if not known.any():
        return np.zeros(range_m.size, dtype=np.bool_)
    index = np.arange(range_m.size)
    filled = np.interp(index, index[known], range_m[known])
    in_camera = transform_points(T_camera_lidar, _points_at_range(azimuth_rad, filled))
    ahead = in_camera[:, 2] > _MIN_DEPTH_M
    intrinsics = camera.intrinsics
    u = intrinsics.cx + intrinsics.fx * in_camera[:, 0] / np.where(ahead, in_camera[:, 2], np.nan)
    in_view: BoolArray = (u >= -0.5) & (u < intrinsics.width - 0.5)
    return in_view


@compiled()
def _cast_rays(
    azimuth_rad: FloatArray,
    depth_m: Float32Array,
    T_camera_lidar: FloatArray,
    intrinsics: FloatArray,
    range_max_m: float,
) -> tuple[FloatArray, BoolArray]:
    """(N,) range at which each beam first meets the seen surface, NaN where it never does.

    A ray that passes behind something nearer (a table top) is followed further: it may reappear.
    (N,): whether it has passed so.
    """
    height, width = depth_m.shape
    fx, fy, cx, cy = intrinsics
    T = T_camera_lidar
    found = np.full(azimuth_rad.size, np.nan)
    blocked = np.zeros(azimuth_rad.size, dtype=np.bool_)
    farthest = 0.0
    for value in depth_m.ravel():
        if value > farthest:
            farthest = float(value)
    for index in range(azimuth_rad.size):
        x, y = np.cos(azimuth_rad[index]), np.sin(azimuth_rad[index])
        dx = T[0, 0] * x + T[0, 1] * y
        dy = T[1, 0] * x + T[1, 1] * y
        dz = T[2, 0] * x + T[2, 1] * y
        if dz < _MIN_FORWARD:
            continue
        ahead_before = np.nan
        seen_before = np.nan
        distance = _MIN_DEPTH_M
        while distance <= range_max_m:
            depth = T[2, 3] + distance * dz
            distance += _RAY_STEP_M
            if depth < _MIN_DEPTH_M:
                continue
            # One step behind the farthest depth no surface is left to meet.
            if depth > farthest + _RAY_STEP_M:
                break
            u = cx + fx * (T[0, 3] + (distance - _RAY_STEP_M) * dx) / depth
            v = cy + fy * (T[1, 3] + (distance - _RAY_STEP_M) * dy) / depth
            if u < -0.5 or u >= width - 0.5 or v < -0.5 or v >= height - 0.5:
                ahead_before = np.nan
                continue
            seen = depth_m[int(np.floor(v + 0.5)), int(np.floor(u + 0.5))]
            ahead = seen - depth
            if ahead <= 0.0 and ahead_before > 0.0 and abs(seen - seen_before) < _EDGE_M:
                fraction = ahead_before / (ahead_before - ahead)
                found[index] = distance - _RAY_STEP_M * (2.0 - fraction)
                break
            blocked[index] |= ahead < -_EDGE_M
            ahead_before = ahead
            seen_before = seen
    return found, blocked
