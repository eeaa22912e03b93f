"""Shapes in space: rows of depth, curves, arrows and cameras as points and line segments.

Everything is in the LiDAR's frame (x forward, y left, z up, metres); its beams lie at z = 0.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, IntArray, read_only
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import LaserScan

# Neighbours farther apart than this are an edge: no line joins them.
_EDGE_M = 0.25
# A wall that is met at 20 degrees has its points three spacings of the beams apart.
_SPACINGS = 3.0
# Binomial: it halves the noise of single beams, and moves a corner of a wall by about a spacing.
_SMOOTHING = np.array([1.0, 4.0, 6.0, 4.0, 1.0], dtype=np.float32) / np.float32(16.0)
# So many points of a row show its course; the surface behind it shows each pixel.
_MAX_COLUMNS = 160
_BARB_M = 0.06
# Poses of a path farther apart than this are a gap of the recording.
_PATH_GAP_M = 1.0

Segments = Float32Array
"""(N, 2, 3): begin and end of N line segments."""

NO_SEGMENTS: Segments = np.empty((0, 2, 3), dtype=np.float32)
NO_SEGMENTS.setflags(write=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Frustum:
    """A camera: vertical field of view in radians, width / height, and its pose as a unit
    quaternion (w, x, y, z) of optical axes with the position of its centre."""

    fov_rad: float
    aspect: float
    wxyz: FloatArray
    position_m: FloatArray

    def __post_init__(self) -> None:
        read_only(self.wxyz)
        read_only(self.position_m)


def ridge_lines(
    depth_m: Float32Array, camera: Camera, T_lidar_camera: FloatArray, row_step: int
) -> Segments:
    """Every ``row_step``-th row of a depth image as a line in space: (N, 2, 3) segments.

    No line crosses a missing pixel or a jump of more than 0.25 m. Images of more than about 160
    columns are subsampled; the skipped pixels still decide where a line ends.
    """
    height, width = depth_m.shape
    rows = np.arange((height - 1) % row_step // 2, height, row_step)
    depth = depth_m[rows]
    step = max(1, width // _MAX_COLUMNS)
    whole = (width - 1) // step * step
    with np.errstate(invalid="ignore"):
        near = np.abs(np.diff(depth[:, : whole + 1], axis=1)) <= _EDGE_M
    joined = np.all(near.reshape(rows.size, -1, step), axis=2)
    depth = depth[:, : whole + 1 : step].astype(np.float32)
    columns = np.arange(0, whole + 1, step)
    # The three coordinates of a ray are linear in row and column: no (H, W, 3) product is needed.
    intrinsics = camera.intrinsics
    T = T_lidar_camera.astype(np.float32)
    x = ((columns - intrinsics.cx) / intrinsics.fx).astype(np.float32)
    y = ((rows - intrinsics.cy) / intrinsics.fy).astype(np.float32)[:, np.newaxis]
    points = np.empty((*depth.shape, 3), dtype=np.float32)
    for axis in range(3):
        points[..., axis] = depth * (T[axis, 0] * x + T[axis, 1] * y + T[axis, 2]) + T[axis, 3]
    segments = np.empty((int(joined.sum()), 2, 3), dtype=np.float32)
    segments[:, 0] = points[:, :-1][joined]
    segments[:, 1] = points[:, 1:][joined]
    return segments


def curve_points(scan: LaserScan, ranges_m: FloatArray) -> Float32Array:
    """(B, 3) points of ranges on a scan's beams, NaN where there is none."""
    azimuth_rad = scan.angles_rad
    return points_in_plane(azimuth_rad, ranges_m).astype(np.float32)


def polyline(points_m: FloatArray | Float32Array, longest_m: float = _EDGE_M) -> Segments:
    """(N, 3) points, in order, as segments; none from or to NaN, none longer than that."""
    if len(points_m) < 2:
        return NO_SEGMENTS
    with np.errstate(invalid="ignore"):
        joined = np.linalg.norm(np.diff(points_m, axis=0), axis=1) <= longest_m
    return _segments(points_m, joined)


def _segments(points_m: FloatArray | Float32Array, joined: BoolArray) -> Segments:
    """(N, 3) points as those segments from one to the next that are ``joined`` (N - 1,)."""
    segments = np.stack([points_m[:-1], points_m[1:]], axis=1)
    return np.asarray(segments[joined], dtype=np.float32)


def scan_curve(points_m: Float32Array, increment_rad: float) -> tuple[Segments, Float32Array]:
    """A scan's (B, 3) points as the segments of a curve, and the (M, 3) points that no segment
    joins. It is broken where ranges jump, and joined where adjacent beams are far apart because
    they end far away. It is smoothed over five beams, to be looked at and not to be measured."""
    if len(points_m) < len(_SMOOTHING):
        return NO_SEGMENTS, points_m[np.isfinite(points_m[:, 0])]
    range_m = np.linalg.norm(points_m, axis=1)
    with np.errstate(invalid="ignore"):
        spacing_m = abs(increment_rad) * np.minimum(range_m[:-1], range_m[1:])
        longest_m = np.maximum(_EDGE_M, _SPACINGS * spacing_m)
        joined = np.linalg.norm(np.diff(points_m, axis=0), axis=1) <= longest_m
    alone = np.isfinite(range_m)
    alone[:-1] &= ~joined
    alone[1:] &= ~joined
    # Beams in the middle of five that are joined.
    inner = joined[:-3] & joined[1:-2] & joined[2:-1] & joined[3:]
    shown = points_m.copy()
    windows = np.lib.stride_tricks.sliding_window_view(points_m, len(_SMOOTHING), axis=0)
    shown[2:-2][inner] = windows[inner] @ _SMOOTHING
    return _segments(shown, joined), points_m[alone]


def arrow_segments(from_to_m: Segments, codes: IntArray) -> tuple[Segments, IntArray]:
    """(3 N, 2, 3) lines of arrows: shaft and two barbs each, in the LiDAR's plane, with the codes
    (N,) of the arrows for each line."""
    begin, end = from_to_m[:, 0], from_to_m[:, 1]
    along = end - begin
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-6)
    along = along / length
    across = np.stack([-along[:, 1], along[:, 0], np.zeros_like(along[:, 0])], axis=1)
    barb = np.minimum(_BARB_M, 0.5 * length)
    tips = [begin, end - barb * (along - 0.5 * across), end - barb * (along + 0.5 * across)]
    lines = np.stack([np.stack([tip, end], axis=1) for tip in tips], axis=1)
    return lines.reshape(-1, 2, 3).astype(np.float32), np.repeat(codes, 3)


def path_segments(positions_in_map: FloatArray | Float32Array) -> Segments:
    """A trajectory of (N, 3) positions, in order, as segments; none from or to NaN, none across a
    gap of more than 1 m."""
    return polyline(positions_in_map, _PATH_GAP_M)


def frustum(camera: Camera, T_lidar_camera: FloatArray) -> Frustum:
    """How a camera is drawn."""
    intrinsics = camera.intrinsics
    half_height = 0.5 * intrinsics.height / intrinsics.fy
    return Frustum(
        fov_rad=2.0 * float(np.arctan(half_height)),
        aspect=0.5 * intrinsics.width / intrinsics.fx / half_height,
        wxyz=quaternion(T_lidar_camera[:3, :3]),
        position_m=T_lidar_camera[:3, 3].copy(),
    )


def quaternion(R: FloatArray) -> FloatArray:
    """(4,) unit quaternion (w, x, y, z), w >= 0, of a (3, 3) rotation."""
    # The eigenvector method of Bar-Itzhack (2000) has no special cases.
    K = np.empty((4, 4))
    K[0, 0] = np.trace(R)
    K[0, 1:] = K[1:, 0] = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
    K[1:, 1:] = R + R.T - np.trace(R) * np.eye(3)
    q: FloatArray = np.linalg.eigh(K)[1][:, -1]
    return q if q[0] >= 0.0 else -q


def points_in_plane(azimuth_rad: FloatArray, range_m: FloatArray) -> FloatArray:
    """(N, 3) points of the LiDAR's plane, NaN in all three where there is no range."""
    zero = 0.0 * range_m
    return np.stack([range_m * np.cos(azimuth_rad), range_m * np.sin(azimuth_rad), zero], axis=1)
