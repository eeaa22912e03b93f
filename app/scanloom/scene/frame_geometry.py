"""The geometry of a frame that the scene draws, in the LiDAR's frame at the scan's stamp. It does
not depend on the viewer.
"""

from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import (
    R_BODY_OPTICAL,
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.model.geometry import (
    make_transform,
    rotation_from_yaw_pitch_roll,
    transform_points,
)
from fusion_core.model.rig import Camera, Mount
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.align import RecordingAlignment, T_lidar_camera_at
from fusion_core.workflows.fuse.camera_rig import CameraRig
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_match import FrameMatch
from scanloom.scene.depth_surface import NO_SURFACE, DepthSurface, depth_surface
from scanloom.scene.geometry import (
    NO_SEGMENTS,
    Frustum,
    Segments,
    curve_points,
    frustum,
    points_in_plane,
    polyline,
    ridge_lines,
    scan_curve,
)

# Set by hand: shorter arrows are invisible.
_MIN_MOVE_M = 0.02

_ORIGIN = (0.0, 0.0, 0.0)
_NO_POINTS: Float32Array = np.empty((0, 3), dtype=np.float32)
_NO_CODES: IntArray = np.empty(0, dtype=np.int64)


Body = Literal["LiDAR", "robot"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameGeometry:
    """The geometry that is drawn for one frame.

    ``body``: what stands at ``body_m``, the origin unless it moves along a path; None in a
    recording of depth alone. ``camera`` and ``frustum``: None for a scan alone.
    ``rows_m``: (N, 2, 3) rows of the depth image; ``matched_m``: the depth that the LiDAR is
    compared with; ``curve_m``: segments of the LiDAR's curve, ``alone_m`` (A, 3) points of it that
    none joins; ``beams_m``: (B, 3), one point for each beam of the scan, NaN where it has no value;
    ``pixels_m``: (B, 3) the point that the camera measures for each beam, NaN where there is none.
    ``pairs_m``: from a beam's point to its pixel's, with ``pairs_class``; ``marks_m``: (K, 3) where
    the classes ``marks_class`` stand; ``moved_m``: from a raw to a repaired sample, ``filled_m``:
    (M, 3) repaired samples that had no value, each with their codes of NoiseClass. ``lowest_m``:
    height below which next to nothing is seen, NaN without depth.
    """

    camera: int | None
    stamp_ns: int
    body: Body | None
    body_m: tuple[float, float, float]
    frustum: Frustum | None
    surface: DepthSurface
    rows_m: Segments
    matched_m: Segments
    curve_m: Segments
    alone_m: Float32Array
    beams_m: Float32Array
    pixels_m: Float32Array
    pairs_m: Segments
    pairs_class: IntArray
    marks_m: Float32Array
    marks_class: IntArray
    moved_m: Segments
    moved_class: IntArray
    filled_m: Float32Array
    filled_class: IntArray
    lowest_m: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                read_only(value)


def frame_geometry(
    frame: FusedFrame | FrameMatch,
    rig: CameraRig,
    alignment: RecordingAlignment,
    *,
    row_step: int | None,
    classes: frozenset[NoiseClass] = frozenset(NoiseClass),
    repaired: bool = True,
) -> FrameGeometry:
    """The geometry drawn for a matched frame. Pairs and repairs are those of ``classes``; a frame
    that is only matched has neither. ``repaired``: whether the curve shows repaired ranges."""
    fused, match = (frame, frame.match) if isinstance(frame, FusedFrame) else (None, frame)
    camera = rig.cameras[match.pair.camera_index]
    T_lidar_camera = camera_pose(match, rig, alignment)
    surface = depth_surface(match.depth_m, camera, T_lidar_camera)
    pixels_m = pixel_points(match, camera, T_lidar_camera, match.correspondence.depth_m)
    beams_m = curve_points(match.scan, _ranges_m(match.scan, fused if repaired else None))
    curve_m, alone_m = scan_curve(beams_m, match.scan.angle_increment_rad)
    pixel_of_beam_m = np.full(beams_m.shape, np.nan, dtype=np.float32)
    pixel_of_beam_m[match.correspondence.beam] = pixels_m
    matched = replace(
        _empty_geometry(match.stamp_ns),
        camera=match.pair.camera_index,
        body="LiDAR",
        frustum=frustum(camera, T_lidar_camera),
        surface=surface,
        rows_m=_rows(match.depth_m, camera, T_lidar_camera, row_step),
        matched_m=polyline(pixels_m),
        curve_m=curve_m,
        alone_m=alone_m,
        beams_m=beams_m,
        pixels_m=pixel_of_beam_m,
        lowest_m=_lowest_m(surface),
    )
    if fused is None:
        return matched
    pairs_m, pairs_class = pair_segments(fused, pixels_m, classes)
    marks_m, marks_class = class_marks(fused, pixels_m, classes)
    moved_m, moved_class, filled_m, filled_class = repairs(fused, camera, T_lidar_camera, classes)
    return replace(
        matched,
        pairs_m=pairs_m,
        pairs_class=pairs_class,
        marks_m=marks_m,
        marks_class=marks_class,
        moved_m=moved_m,
        moved_class=moved_class,
        filled_m=filled_m,
        filled_class=filled_class,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class UnmatchedFrame:
    """An upright depth image (H, W) and its scan, if any, without pairs. ``mount``: where the rig
    sits on the LiDAR, as far as is known. ``has_lidar``: False in a recording of depth alone."""

    camera: int
    stamp_ns: int
    depth_m: Float32Array
    scan: LaserScan | None
    mount: Mount
    has_lidar: bool = True


def unmatched_geometry(
    frame: UnmatchedFrame, rig: CameraRig, *, row_step: int | None
) -> FrameGeometry:
    """What is drawn of a frame without pairs: its depth, at its mount, and its scan."""
    model = rig.cameras[frame.camera]
    T_lidar_camera = T_lidar_camera_at(model, frame.mount, np.zeros(3))
    surface = depth_surface(frame.depth_m, model, T_lidar_camera)
    of_scan = _empty_geometry(frame.stamp_ns) if frame.scan is None else scan_geometry(frame.scan)
    return replace(
        of_scan,
        camera=frame.camera,
        stamp_ns=frame.stamp_ns,
        body="LiDAR" if frame.has_lidar else None,
        frustum=frustum(model, T_lidar_camera),
        surface=surface,
        rows_m=_rows(frame.depth_m, model, T_lidar_camera, row_step),
        lowest_m=_lowest_m(surface),
    )


def scan_geometry(scan: LaserScan) -> FrameGeometry:
    """What is drawn of a scan without a depth image."""
    beams_m = curve_points(scan, scan.ranges_m)
    curve_m, alone_m = scan_curve(beams_m, scan.angle_increment_rad)
    return replace(
        _empty_geometry(scan.stamp_ns),
        body="LiDAR",
        curve_m=curve_m,
        alone_m=alone_m,
        beams_m=beams_m,
        pixels_m=np.full(beams_m.shape, np.nan, dtype=np.float32),
    )


def robot_geometry(stamp_ns: int, position_m: tuple[float, float] | None) -> FrameGeometry:
    """What is drawn of a robot of which poses alone are known: a dot on its path, if that is."""
    empty = _empty_geometry(stamp_ns)
    if position_m is None:
        return empty
    at_m = (*position_m, 0.0)
    return replace(empty, body="robot", body_m=at_m, alone_m=np.array([at_m], dtype=np.float32))


def _empty_geometry(stamp_ns: int) -> FrameGeometry:
    return FrameGeometry(
        camera=None,
        stamp_ns=stamp_ns,
        body=None,
        body_m=_ORIGIN,
        frustum=None,
        surface=NO_SURFACE,
        rows_m=NO_SEGMENTS,
        matched_m=NO_SEGMENTS,
        curve_m=NO_SEGMENTS,
        alone_m=_NO_POINTS,
        beams_m=_NO_POINTS,
        pixels_m=_NO_POINTS,
        pairs_m=NO_SEGMENTS,
        pairs_class=_NO_CODES,
        marks_m=_NO_POINTS,
        marks_class=_NO_CODES,
        moved_m=NO_SEGMENTS,
        moved_class=_NO_CODES,
        filled_m=_NO_POINTS,
        filled_class=_NO_CODES,
        lowest_m=float("nan"),
    )


def camera_pose(frame: FrameMatch, rig: CameraRig, alignment: RecordingAlignment) -> FloatArray:
    """(4, 4) T_lidar_camera at which a frame is drawn.

    Along the curve it is the mount's. Pairs in a row know the yaw alone, and take the camera for
    level in the LiDAR's axis; it is drawn so, raised until the row lies about in the LiDAR's plane
    (its median does).
    """
    camera = rig.cameras[frame.pair.camera_index]
    pairs = frame.correspondence
    if frame.row_model == "curve" or not pairs.beam.size:
        return T_lidar_camera_at(camera, alignment.mount, frame.moved)
    intrinsics = camera.intrinsics
    # The yaw of the pairs themselves: they may be those of an offset chosen by hand.
    yaws_rad = pairs.azimuth_rad - camera.column_azimuths_rad(pairs.column.astype(np.float64))
    yaw_rad = float(np.angle(np.exp(1j * yaws_rad).mean()))
    depth_m = pairs.depth_m[np.isfinite(pairs.depth_m)]
    below_m = (
        float(np.median(depth_m)) * (pairs.row[0] - intrinsics.cy) / intrinsics.fy
        if depth_m.size
        else 0
    )
    return make_transform(
        rotation_from_yaw_pitch_roll(yaw_rad, 0.0, 0.0) @ R_BODY_OPTICAL,
        np.array([0.0, 0.0, below_m]),
    )


def pixel_points(
    frame: FrameMatch, camera: Camera, T_lidar_camera: FloatArray, depth_m: FloatArray
) -> FloatArray:
    """(B, 3) points of the pairs' pixels at ``depth_m`` (B,), NaN where there is no pixel or depth.

    Pairs along the curve: where the camera sees them. Pairs in a row compare horizontal ranges on a
    beam: on the beam, at the range to which A maps them.
    """
    pairs = frame.correspondence
    if frame.row_model == "curve":
        rays = camera.rays(pairs.row, pairs.column)
        inside = np.where(pairs.row >= 0, depth_m, np.nan)
        return transform_points(T_lidar_camera, inside[:, np.newaxis] * rays)
    with np.errstate(invalid="ignore", divide="ignore"):
        range_per_depth = pairs.depth_as_range_m / pairs.depth_m
    intrinsics = camera.intrinsics
    level = np.hypot(1.0, (pairs.column - intrinsics.cx) / intrinsics.fx)
    range_per_depth = np.where(np.isfinite(range_per_depth), range_per_depth, level)
    return points_in_plane(pairs.azimuth_rad, depth_m * range_per_depth)


def pair_segments(
    frame: FusedFrame, pixels_m: FloatArray, classes: frozenset[NoiseClass]
) -> tuple[Segments, IntArray]:
    """Lines from beams to their pixels' points (B, 3), and the (N,) class of each pair; a pair with
    a hole has no line."""
    pairs, code = frame.match.correspondence, frame.pair_class
    segments = np.stack([points_in_plane(pairs.azimuth_rad, pairs.lidar_range_m), pixels_m], axis=1)
    drawn = np.isfinite(segments).all(axis=(1, 2)) & _among(code, classes)
    return segments[drawn].astype(np.float32), code[drawn]


def class_marks(
    frame: FusedFrame, pixels_m: FloatArray, classes: frozenset[NoiseClass]
) -> tuple[Float32Array, IntArray]:
    """Where the class of each pair stands, (K, 3), and the (K,) classes.

    It stands at the beam's end: of the sensor that has a value, or, for a burr of the pixel alone,
    where that pixel is seen. ``pixels_m``: (B, 3) the pixels' points.
    """
    pairs, code = frame.match.correspondence, frame.pair_class
    range_m = pairs.lidar_range_m
    for other_m in (frame.repair.lidar_range_m, pairs.camera_range_m, pairs.depth_as_range_m):
        range_m = np.where(np.isfinite(range_m), range_m, other_m)
    marks_m = points_in_plane(pairs.azimuth_rad, range_m)
    by_pixel = (code == NoiseClass.BURR) & (frame.classes.lidar_class != NoiseClass.BURR)
    by_pixel &= np.isfinite(pixels_m[:, 0])
    marks_m[by_pixel] = pixels_m[by_pixel]
    drawn = np.isfinite(marks_m[:, 0]) & _among(code, classes)
    return marks_m[drawn].astype(np.float32), code[drawn]


def repairs(
    frame: FusedFrame,
    camera: Camera,
    T_lidar_camera: FloatArray,
    classes: frozenset[NoiseClass],
) -> tuple[Segments, IntArray, Float32Array, IntArray]:
    """Repairs of beams and pixels: (N, 2, 3) from raw to repaired where there was
    a value, (M, 3) points where there was none, each with its classes."""
    pairs, repair, noise = frame.match.correspondence, frame.repair, frame.classes
    before = [
        points_in_plane(pairs.azimuth_rad, pairs.lidar_range_m),
        pixel_points(frame.match, camera, T_lidar_camera, pairs.depth_m),
    ]
    after = [
        points_in_plane(pairs.azimuth_rad, repair.lidar_range_m),
        pixel_points(frame.match, camera, T_lidar_camera, repair.depth_m),
    ]
    segments = np.stack([np.concatenate(before), np.concatenate(after)], axis=1)
    code = np.concatenate([noise.lidar_class, noise.depth_class])
    had, has = np.isfinite(segments[:, 0, 0]), np.isfinite(segments[:, 1, 0])
    with np.errstate(invalid="ignore"):
        far = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1) > _MIN_MOVE_M
    wanted = _among(code, classes)
    moved, filled = wanted & far, wanted & ~had & has
    return (
        segments[moved].astype(np.float32),
        code[moved],
        segments[filled, 1].astype(np.float32),
        code[filled],
    )


def _rows(
    depth_m: Float32Array, camera: Camera, T_lidar_camera: FloatArray, row_step: int | None
) -> Segments:
    return (
        NO_SEGMENTS if row_step is None else ridge_lines(depth_m, camera, T_lidar_camera, row_step)
    )


def _ranges_m(scan: LaserScan, fused: FusedFrame | None) -> FloatArray:
    """(B,) the scan's ranges, with the repairs of a fused frame."""
    if fused is None:
        return scan.ranges_m
    ranges_m = scan.ranges_m.copy()
    ranges_m[fused.match.correspondence.beam] = fused.repair.lidar_range_m
    return ranges_m


def _among(code: IntArray, classes: frozenset[NoiseClass]) -> BoolArray:
    return np.isin(code, [int(noise_class) for noise_class in classes])


def _lowest_m(surface: DepthSurface) -> float:
    # Speckle below the floor is less than a hundredth of an image.
    heights_m = surface.points_m[:, 2]
    return float(np.percentile(heights_m, 1.0)) if heights_m.size else float("nan")
