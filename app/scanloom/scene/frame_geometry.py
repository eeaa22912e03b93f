"""The geometry of a frame that the scene draws, in the LiDAR's frame at the scan's stamp. It does
not depend on the viewer.
"""

from dataclasses import dataclass, fields

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
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.align import RecordingAlignment, T_lidar_camera_at
from fusion_core.workflows.fuse.camera_rig import CameraRig
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_match import FrameMatch
from scanloom.scene.geometry import (
    NO_SEGMENTS,
    Frustum,
    Segments,
    curve_points,
    frustum,
    points_in_plane,
    polyline,
    ridge_lines,
)

# Set by hand: shorter arrows are invisible.
_MIN_MOVE_M = 0.02

_NO_POINTS: Float32Array = np.empty((0, 3), dtype=np.float32)
_NO_CODES: IntArray = np.empty(0, dtype=np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameGeometry:
    """The geometry that is drawn for one frame.

    ``rows_m``: (N, 2, 3) with ``rows_depth_m`` (N,) along the optical axis; ``matched_m``: the
    depth that the LiDAR is compared with; ``curve_m``: segments of the LiDAR's curve;
    ``beams_m``: (B, 3), one point for each beam of the scan, NaN where it has no value.
    ``pairs_m``: from a beam's point to its pixel's, with ``pairs_class``; ``moved_m``: from a raw
    to a repaired sample, ``filled_m``: (M, 3) repaired samples that had no value, each with their
    codes of NoiseClass. ``lowest_m``: height below which next to nothing is seen, NaN without
    depth.
    """

    camera: int
    stamp_ns: int
    frustum: Frustum
    rows_m: Segments
    rows_depth_m: Float32Array
    matched_m: Segments
    curve_m: Segments
    beams_m: Float32Array
    pairs_m: Segments
    pairs_class: IntArray
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
    row_step: int,
    classes: frozenset[NoiseClass] = frozenset(NoiseClass),
    repaired: bool = True,
) -> FrameGeometry:
    """The geometry drawn for a matched frame. Pairs and repairs are those of ``classes``; a frame
    that is only matched has neither. ``repaired``: whether the curve shows repaired ranges."""
    fused, match = (frame, frame.match) if isinstance(frame, FusedFrame) else (None, frame)
    camera = rig.cameras[match.pair.camera_index]
    T_lidar_camera = camera_pose(match, rig, alignment)
    rows_m, rows_depth_m = ridge_lines(match.depth_m, camera, T_lidar_camera, row_step)
    pixels_m = pixel_points(match, camera, T_lidar_camera, match.correspondence.depth_m)
    pairs_m, pairs_class = NO_SEGMENTS, _NO_CODES
    moved_m, moved_class, filled_m, filled_class = NO_SEGMENTS, _NO_CODES, _NO_POINTS, _NO_CODES
    if fused is not None:
        pairs_m, pairs_class = pair_segments(fused, pixels_m, classes)
        moved_m, moved_class, filled_m, filled_class = repairs(
            fused, camera, T_lidar_camera, classes
        )
    beams_m = curve_points(match.scan, _ranges_m(match.scan, fused if repaired else None))
    return FrameGeometry(
        camera=match.pair.camera_index,
        stamp_ns=match.stamp_ns,
        frustum=frustum(camera, T_lidar_camera),
        rows_m=rows_m,
        rows_depth_m=rows_depth_m,
        matched_m=polyline(pixels_m),
        curve_m=polyline(beams_m),
        beams_m=beams_m,
        pairs_m=pairs_m,
        pairs_class=pairs_class,
        moved_m=moved_m,
        moved_class=moved_class,
        filled_m=filled_m,
        filled_class=filled_class,
        lowest_m=_lowest_m(rows_m),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class UnmatchedFrame:
    """An upright depth image (H, W) and its scan, if any, without pairs."""

    camera: int
    stamp_ns: int
    depth_m: Float32Array
    scan: LaserScan | None


def unmatched_geometry(
    frame: UnmatchedFrame, rig: CameraRig, alignment: RecordingAlignment, *, row_step: int
) -> FrameGeometry:
    """What is drawn of a frame without pairs: its depth, at the recording's mount, and its scan."""
    model = rig.cameras[frame.camera]
    T_lidar_camera = T_lidar_camera_at(model, alignment.mount, 0.0)
    rows_m, rows_depth_m = ridge_lines(frame.depth_m, model, T_lidar_camera, row_step)
    beams_m = _NO_POINTS if frame.scan is None else curve_points(frame.scan, frame.scan.ranges_m)
    return FrameGeometry(
        camera=frame.camera,
        stamp_ns=frame.stamp_ns,
        frustum=frustum(model, T_lidar_camera),
        rows_m=rows_m,
        rows_depth_m=rows_depth_m,
        matched_m=NO_SEGMENTS,
        curve_m=polyline(beams_m),
        beams_m=beams_m,
        pairs_m=NO_SEGMENTS,
        pairs_class=_NO_CODES,
        moved_m=NO_SEGMENTS,
        moved_class=_NO_CODES,
        filled_m=_NO_POINTS,
        filled_class=_NO_CODES,
        lowest_m=_lowest_m(rows_m),
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
        return T_lidar_camera_at(camera, alignment.mount, frame.turned_rad)
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
    """Lines from beams to their pixels' points (B, 3), and the (N,) class of each pair.

    A pair has the worse class of its two sides: burr, then conflict, then good. Pairs with a hole
    have no line.
    """
    pairs, noise = frame.match.correspondence, frame.classes
    segments = np.stack([points_in_plane(pairs.azimuth_rad, pairs.lidar_range_m), pixels_m], axis=1)
    code = np.full(pairs.beam.size, int(NoiseClass.GOOD))
    for worse in (NoiseClass.CONFLICT, NoiseClass.BURR):
        code[(noise.lidar_class == worse) | (noise.depth_class == worse)] = worse
    drawn = np.isfinite(segments).all(axis=(1, 2)) & _among(code, classes)
    return segments[drawn].astype(np.float32), code[drawn]


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


def _ranges_m(scan: LaserScan, fused: FusedFrame | None) -> FloatArray:
    """(B,) the scan's ranges, with the repairs of a fused frame."""
    if fused is None:
        return scan.ranges_m
    ranges_m = scan.ranges_m.copy()
    ranges_m[fused.match.correspondence.beam] = fused.repair.lidar_range_m
    return ranges_m


def _among(code: IntArray, classes: frozenset[NoiseClass]) -> BoolArray:
    return np.isin(code, [int(noise_class) for noise_class in classes])


def _lowest_m(rows_m: Segments) -> float:
    # Speckle below the floor is less than a hundredth of an image.
    return float(np.percentile(rows_m[:, 0, 2], 1.0)) if len(rows_m) else float("nan")
