"""How far depth patches are from the scans' lines and from the floor, under a pose.

A patch of an upright surface lies above or below the line that the scan draws there, whatever its
height; its distance from that line along the camera's ray is the residual. One of the floor is at
the camera's height below it.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.calibration.planar.planar_frames import FRAME_KEY, FlatFrames
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.model.extrinsics import POSE_PARAMETERS

POSE = len(POSE_PARAMETERS)
STRETCH, CLOCK, FLOOR = range(POSE, POSE + 3)
"""The unknowns after the six of POSE_PARAMETERS."""

UNKNOWNS = POSE + 3

# Sine of the angle by which a patch may lean from upright or from level: more than a first guess of
# the camera's tilt is off.
_LEAN = float(np.sin(np.deg2rad(15.0)))
# Below this cosine between ray and normal a patch is as wide as the noise on the surface.
_LEAST_COSINE = 0.2
# Beams farther apart than this from the patch's azimuth are of something else.
_BEAM_GAP_RAD = float(np.deg2rad(1.0))
# Layers that the floor is looked for in, and how much of the level patches it takes at least.
_LAYER_M = 0.04
_LEAST_FLOOR = 0.15
_BELOW = 0.03
_PLACE_RAD = float(np.deg2rad(5.0))
# Places of the floor are parts of the image, numbered after all directions of walls.
_FLOOR_PLACE = 1_000_000
_FLOOR_CELLS = 12
# Fewer level patches are no floor.
_MIN_LEVEL = 50
# A ray more slanted than this along the floor says nothing of it.
_LEAST_SLOPE = 0.05


@dataclass(slots=True)
class PlanarState:
    """Where an iteration is: the pose ``T`` = T_camera_lidar, by which fraction depths are too
    long, how late the camera's stamps are, and its height above the floor, NaN without one."""

    T: FloatArray
    stretch: float
    clock_s: float
    floor_m: float


@dataclass(frozen=True, slots=True)
class SurfaceResiduals:
    """``value``: (N,) in m along the ray, ``jacobian``: (N, 9), ``line_error``: (N, 9) deviation of
    the jacobian by the lines' directions, ``by_range``: (N,) derivative by an offset of all ranges
    that is not estimated, ``depth_m``, ``frame``, ``place``: (N,), ``is_floor``:
    (N,)."""

    value: FloatArray
    jacobian: FloatArray
    line_error: FloatArray
    by_range: FloatArray
    depth_m: FloatArray
    frame: IntArray
    place: IntArray
    is_floor: BoolArray


def find_floor_m(flat: FlatFrames, state: PlanarState, kept: BoolArray) -> float:
    """Height of the camera above the floor, the lowest layer that much of the level patches are
    in; NaN where there is none."""
    up = state.T[:3, 2]
    level = (flat.normal_in_camera @ up > np.sqrt(1.0 - _LEAN**2)) & kept[flat.frame]
    heights = flat.point_m @ up / (1.0 + state.stretch)
    all_heights = heights[kept[flat.frame]]
    heights = heights[level]
    if heights.size < _MIN_LEVEL:
        return np.nan
    lowest = float(heights.min())
    layer = np.floor((heights - lowest) / _LAYER_M).astype(np.int64)
    count = np.bincount(layer)
    # Two layers: the floor may be on the border of two.
    pairs = count + np.append(count[1:], 0)
    enough = np.flatnonzero(pairs >= _LEAST_FLOOR * heights.size)
    if not enough.size:
        return np.nan
    bottom = lowest + enough[0] * _LAYER_M
    if np.mean(all_heights < bottom - 2.0 * _LAYER_M) > _BELOW:
        return np.nan
    chosen = heights[(layer == enough[0]) | (layer == enough[0] + 1)]
    return -float(np.median(chosen))


def surface_residuals(
    flat: FlatFrames, state: PlanarState, kept: BoolArray, image_size: tuple[int, int]
) -> SurfaceResiduals:
    """Of all walls, and of the floor where its height is known, in the frames of ``kept`` (F,)."""
    walls = _wall_residuals(flat, state, kept)
    if not np.isfinite(state.floor_m):
        return walls
    floor = _floor_residuals(flat, state, kept, image_size)
    return SurfaceResiduals(
        np.concatenate([walls.value, floor.value]),
        np.concatenate([walls.jacobian, floor.jacobian]),
        np.concatenate([walls.line_error, floor.line_error]),
        np.concatenate([walls.by_range, floor.by_range]),
        np.concatenate([walls.depth_m, floor.depth_m]),
        np.concatenate([walls.frame, floor.frame]),
        np.concatenate([walls.place, floor.place]),
        np.concatenate([walls.is_floor, floor.is_floor]),
    )


def _wall_residuals(flat: FlatFrames, state: PlanarState, kept: BoolArray) -> SurfaceResiduals:
    """Of upright patches from the lines of their scans, in m along the ray."""
    T = state.T
    R, t = T[:3, :3], T[:3, 3]
    chosen = (np.abs(flat.normal_in_camera @ R[:, 2]) < _LEAN) & kept[flat.frame]
    index = np.flatnonzero(chosen)
    frame, seen = flat.frame[index], flat.point_m[index]
    own = seen / (1.0 + state.stretch) - t
    at_image = own @ R
    delay = flat.image_after_scan_s[frame] - state.clock_s
    velocity = flat.velocity[frame]
    turned = velocity[:, 2] * delay
    cos, sin = np.cos(turned), np.sin(turned)
    x = cos * at_image[:, 0] - sin * at_image[:, 1] + velocity[:, 0] * delay
    y = sin * at_image[:, 0] + cos * at_image[:, 1] + velocity[:, 1] * delay
    azimuth = np.arctan2(y, x)
    beam = _nearest_beam(flat, frame, azimuth)
    gap = np.abs(flat.beam_azimuth_rad[beam] - azimuth)
    normal = flat.beam_normal[beam]
    is_line = (gap < _BEAM_GAP_RAD) & np.isfinite(flat.beam_normal_sd_rad[beam])
    off = normal[:, 0] * x + normal[:, 1] * y - flat.beam_offset_m[beam]

    def at_scan(vectors: FloatArray) -> FloatArray:
        """(N, 2) vectors of the LiDAR's frame at the image, turned to that at the scan."""
        return np.stack(
            [
                cos * vectors[:, 0] - sin * vectors[:, 1],
                sin * vectors[:, 0] + cos * vectors[:, 1],
            ],
            axis=1,
        )

    # The normal in the LiDAR's frame at the image, and in the camera's.
    back = np.stack(
        [cos * normal[:, 0] + sin * normal[:, 1], -sin * normal[:, 0] + cos * normal[:, 1]],
        axis=1,
    )
    in_camera = back @ R[:, :2].T
    ray = seen / seen[:, 2:3]
    along = np.einsum("ni,ni->n", in_camera, ray)
    is_line &= np.abs(along) > _LEAST_COSINE * np.linalg.norm(ray, axis=1)
    # Both sides of one wall are not one surface.
    is_line &= np.einsum("ni,ni->n", in_camera, flat.normal_in_camera[index]) * -np.sign(
        along
    ) > np.cos(np.deg2rad(20.0))
    keep = np.flatnonzero(is_line)
    index, frame, own, off = index[keep], frame[keep], own[keep], off[keep]
    in_camera, along, velocity = in_camera[keep], along[keep], velocity[keep]
    normal, seen, beam = normal[keep], seen[keep], beam[keep]
    turned_xy = at_scan(at_image)[keep]
    moved = np.stack(
        [
            -velocity[:, 2] * turned_xy[:, 1] + velocity[:, 0],
            velocity[:, 2] * turned_xy[:, 0] + velocity[:, 1],
        ],
        axis=1,
    )

    def derivative(direction_in_camera: FloatArray, direction: FloatArray) -> FloatArray:
        """Of the distance along a direction, by the unknowns."""
        return np.column_stack(
            [
                # d(R^T (s - t)) = R^T [s - t]x omega - R^T tau.
                np.cross(direction_in_camera, own),
                -direction_in_camera,
                -np.einsum("ni,ni->n", direction_in_camera, seen) / (1.0 + state.stretch) ** 2,
                -np.einsum("ni,ni->n", direction, moved),
                np.zeros(index.size),
            ]
        )

    at_beam = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    tangent_in_camera = (
        np.stack(
            [
                cos[keep] * tangent[:, 0] + sin[keep] * tangent[:, 1],
                -sin[keep] * tangent[:, 0] + cos[keep] * tangent[:, 1],
            ],
            axis=1,
        )
        @ R[:, :2].T
    )
    scale = 1.0 / along[:, None]
    place = np.floor((flat.heading_rad[frame] + azimuth[keep]) / _PLACE_RAD).astype(np.int64)
    return SurfaceResiduals(
        off / along,
        derivative(in_camera, normal) * scale,
        derivative(tangent_in_camera, tangent) * scale * flat.beam_normal_sd_rad[beam][:, None],
        # A range that is too short puts the line too near, by the cosine to its normal.
        -(normal * at_beam[keep]).sum(axis=1) / along,
        seen[:, 2],
        frame,
        place,
        np.zeros(index.size, dtype=bool),
    )


def _floor_residuals(
    flat: FlatFrames, state: PlanarState, kept: BoolArray, image_size: tuple[int, int]
) -> SurfaceResiduals:
    """Of level patches from the floor's height, in m along the ray."""
    T = state.T
    up = T[:3, 2]
    chosen = (flat.normal_in_camera @ up > np.sqrt(1.0 - _LEAN**2)) & kept[flat.frame]
    index = np.flatnonzero(chosen)
    seen = flat.point_m[index]
    own = seen / (1.0 + state.stretch)
    along = (seen / seen[:, 2:3]) @ up
    is_steep = np.abs(along) > _LEAST_SLOPE
    index, seen, own, along = index[is_steep], seen[is_steep], own[is_steep], along[is_steep]
    off = own @ up + state.floor_m
    ups = np.broadcast_to(up, own.shape)
    jacobian = np.column_stack(
        [
            np.cross(ups, own),
            np.zeros((index.size, 3)),
            -(seen @ up) / (1.0 + state.stretch) ** 2,
            np.zeros(index.size),
            np.ones(index.size),
        ]
    )
    width, height = image_size
    row, column = np.divmod(flat.pixel[index], width)
    cell = (row * _FLOOR_CELLS // height) * _FLOOR_CELLS + column * _FLOOR_CELLS // width
    return SurfaceResiduals(
        off / along,
        jacobian / along[:, None],
        np.zeros((index.size, UNKNOWNS)),
        np.zeros(index.size),
        seen[:, 2],
        flat.frame[index],
        _FLOOR_PLACE + cell,
        np.ones(index.size, dtype=bool),
    )


def _nearest_beam(flat: FlatFrames, frame: IntArray, azimuth: FloatArray) -> IntArray:
    keys = flat.beam_key
    wanted = azimuth + FRAME_KEY * frame
    right = np.clip(np.searchsorted(keys, wanted), 1, keys.size - 1)
    left = right - 1
    nearest: IntArray = np.where(wanted - keys[left] < keys[right] - wanted, left, right).astype(
        np.int64
    )
    return nearest
