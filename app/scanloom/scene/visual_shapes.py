"""What visual SLAM shows in space: keyframes as small pyramids, loops as lines, voxels as boxes."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, IntArray, read_only
from scanloom.plots.palette import color_map
from scanloom.scene.geometry import NO_SEGMENTS, Segments

# A keyframe as deep as this: small beside a room, and told apart at a step of 10 cm.
KEYFRAME_DEPTH_M = 0.08
# Of a pyramid: its tip, and its corners right and down in half images.
_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_EDGES = ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class HalfView:
    """Half of what a camera sees at the distance 1: tangents across and down."""

    across: float
    down: float

    @property
    def fov_rad(self) -> float:
        """Vertical field of view."""
        return 2.0 * float(np.arctan(self.down))

    @property
    def aspect(self) -> float:
        """Width over height."""
        return self.across / self.down


USUAL_VIEW = HalfView(across=0.6, down=0.45)
"""Of a camera that is not known: about a Kinect's."""


def keyframe_segments(
    T_map_camera: FloatArray, view: HalfView, depth_m: float = KEYFRAME_DEPTH_M
) -> Segments:
    """(8 K, 2, 3) lines of pyramids at (K, 4, 4) poses of optical frames, tips at the cameras."""
    if not len(T_map_camera):
        return NO_SEGMENTS
    corners = np.column_stack([_CORNERS * (view.across, view.down), np.ones(4)])
    shape = depth_m * np.vstack([np.zeros(3), corners])
    points = shape @ T_map_camera[:, :3, :3].transpose(0, 2, 1) + T_map_camera[:, np.newaxis, :3, 3]
    segments: Segments = points[:, _EDGES].reshape(-1, 2, 3).astype(np.float32)
    return segments


def loop_segments(T_map_camera: FloatArray, loops: IntArray) -> Segments:
    """(L, 2, 3) lines between the keyframes that loops join; ``loops``: (L, 2) indices of them."""
    if not len(loops):
        return NO_SEGMENTS
    ends: Segments = T_map_camera[loops, :3, 3].astype(np.float32)
    return ends


def nearest_keyframe(
    T_map_camera: FloatArray, ray_origin_m: FloatArray, ray_direction: FloatArray, within_m: float
) -> int | None:
    """The first keyframe along a ray whose middle is within a distance of it; None for a miss."""
    if not len(T_map_camera):
        return None
    middle_m = T_map_camera[:, :3, 3] + 0.5 * KEYFRAME_DEPTH_M * T_map_camera[:, :3, 2]
    away = middle_m - ray_origin_m
    direction = ray_direction / max(float(np.linalg.norm(ray_direction)), 1e-9)
    along = away @ direction
    beside = np.linalg.norm(away - along[:, np.newaxis] * direction, axis=1)
    hit = np.flatnonzero((along > 0.0) & (beside <= within_m))
    return int(hit[along[hit].argmin()]) if hit.size else None


def floor_place(
    ray_origin_m: FloatArray, ray_direction: FloatArray, height_m: float = 0.0
) -> FloatArray | None:
    """(2,) x, y where a ray meets the plane z = ``height_m``; None where it does not."""
    if abs(ray_direction[2]) < 1e-9:
        return None
    along = (height_m - ray_origin_m[2]) / ray_direction[2]
    if not along > 0.0:
        return None
    place: FloatArray = (ray_origin_m + along * ray_direction)[:2]
    return place


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Boxes:
    """(N, 3) middles in the map and (N,) edge lengths of cubes, with their (N, 3) colours."""

    middles_m: Float32Array
    sizes_m: Float32Array
    rgb: ByteArray

    def __post_init__(self) -> None:
        for array in (self.middles_m, self.sizes_m, self.rgb):
            read_only(array)


def height_colors(heights_m: FloatArray | Float32Array) -> ByteArray:
    """(N, 3) colours of heights, from the lowest to the highest, outliers aside."""
    if not len(heights_m):
        return np.empty((0, 3), np.uint8)
    low, high = np.percentile(heights_m, [2.0, 98.0])
    share = np.clip((heights_m - low) / max(float(high - low), 1e-6), 0.0, 1.0)
    colors: ByteArray = color_map("viridis")[np.rint(255.0 * share).astype(np.intp)]
    return colors
