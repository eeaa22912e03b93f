"""A robot that stands in a room before which a checkerboard is carried from place to place.

Everything is in the LiDAR's frame (x ahead, z up), which stands level above the floor. The board is
held by a stand and a person behind it, whom the LiDAR sees too.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import R_BODY_OPTICAL, ByteArray, Float32Array, FloatArray
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_yaw_pitch_roll,
    transform_points,
)
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.simulation.colors import cell_draw
from fusion_core.simulation.random_streams import RandomStream, make_generator

SQUARES = (8, 6)
SQUARE_M = 0.1
# White around the squares, and around the printed part the board itself.
RIM_M = 0.04
HALF_M = np.array([0.5 * count * SQUARE_M + RIM_M for count in SQUARES])
INTRINSICS = CameraIntrinsics(
    width=640, height=480, fx=525.0, fy=524.0, cx=321.5, cy=238.0, distortion=(0.0,) * 5
)
# Corners of the room, seen from the LiDAR.
_ROOM_MIN_M = np.array([-2.3, -2.6, -0.35])
_ROOM_MAX_M = np.array([4.2, 2.4, 2.1])
# Cupboards: x, y, z of two corners.
_CUPBOARDS_M = np.array(
    [
        [[3.6, 1.3, -0.35], [4.2, 2.4, 1.2]],
        [[1.5, -2.6, -0.35], [2.4, -2.1, 0.5]],
        [[3.7, -1.9, -0.35], [4.2, -0.9, 0.9]],
    ]
)
_LEG_RADIUS_M, _POLE_RADIUS_M = 0.07, 0.02
# The pole stands just behind the board.
_POLE_BEHIND_M = 0.04
_TEXTURE_PX_PER_M = 400
_SUPERSAMPLING = 2
_CELL_M = 0.3
_OBLIQUE_MAX_RAD = np.radians(55.0)


@dataclass(frozen=True, slots=True)
class Carrier:
    """Where the person stands behind the board: metres behind and beside its middle."""

    behind_m: float
    beside_m: float


def draw_camera(seed: int) -> FloatArray:
    """(4, 4) T_camera_lidar: a camera above the LiDAR that looks ahead and a little down."""
    rng = make_generator(seed, RandomStream.WORLD)
    yaw, pitch, roll = np.radians(
        [rng.uniform(-8.0, 8.0), rng.uniform(2.0, 12.0), rng.uniform(-3.0, 3.0)]
    )
    place_m = np.array([rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1), rng.uniform(0.15, 0.4)])
    body = rotation_from_yaw_pitch_roll(float(yaw), float(pitch), float(roll))
    return invert_transform(make_transform(body @ R_BODY_OPTICAL, place_m))


def draw_board_pose(T_camera_lidar: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(4, 4) T_lidar_board of a board whole in the image, which the LiDAR's plane crosses.

    The board's frame has its origin in the middle, x along the longer side, z away from the
    sensors.
    """
    while True:
        distance_m = rng.uniform(0.9, 2.3)
        middle = np.array([1.0, rng.uniform(-0.5, 0.5), rng.uniform(-0.15, 0.35)]) * distance_m
        # Facing the sensors: x to their right, y down, z away.
        tilt = rotation_from_yaw_pitch_roll(
            *np.radians([rng.uniform(-50.0, 50.0), rng.uniform(-50.0, 50.0), 0.0])
        )
        turn = rotation_from_yaw_pitch_roll(float(np.radians(rng.uniform(-45.0, 45.0))), 0.0, 0.0)
        T_lidar_board = make_transform(tilt @ R_BODY_OPTICAL @ turn, middle)
        if _is_seen(T_camera_lidar, T_lidar_board):
            return T_lidar_board


def outline_m() -> FloatArray:
    """(4, 3) corners of the board in its own frame."""
    x, y = HALF_M
    return np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])


def _is_seen(T_camera_lidar: FloatArray, T_lidar_board: FloatArray) -> bool:
    corners = transform_points(T_lidar_board, outline_m())
    inside = ((corners > _ROOM_MIN_M + 0.05) & (corners < _ROOM_MAX_M - 0.05)).all()
    seen = transform_points(T_camera_lidar, corners)
    # Not so oblique that its squares run into each other.
    sight = T_lidar_board[:3, 3] / np.linalg.norm(T_lidar_board[:3, 3])
    inside = inside and float(sight @ T_lidar_board[:3, 2]) > np.cos(_OBLIQUE_MAX_RAD)
    if not inside or (seen[:, 2] < 0.3).any():
        return False
    pixels = seen[:, :2] / seen[:, 2:] * (INTRINSICS.fx, INTRINSICS.fy)
    pixels += (INTRINSICS.cx, INTRINSICS.cy)
    in_image = ((pixels > 4.0) & (pixels < (INTRINSICS.width - 5, INTRINSICS.height - 5))).all()
    heights = corners[:, 2]
    # The plane crosses two of the outline's sides well inside.
    crossing = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if start[2] * end[2] < 0.0:
            crossing.append(start + (end - start) * start[2] / (start[2] - end[2]))
    wide = len(crossing) == 2 and float(np.linalg.norm(crossing[0] - crossing[1])) > 0.4
    return bool(in_image and wide and heights.min() < -0.05 and heights.max() > 0.05)


def true_ranges_m(
    azimuths_rad: FloatArray, T_lidar_board: FloatArray, carrier: Carrier
) -> tuple[FloatArray, FloatArray]:
    """(N,) ranges of the beams, and (N,) cosines of their incidence."""
    rays = np.stack([np.cos(azimuths_rad), np.sin(azimuths_rad), np.zeros(azimuths_rad.size)], 1)
    ranges, cosines = _inside_room(rays)
    for box in _CUPBOARDS_M:
        _take_nearer(ranges, cosines, *_box(rays, box))
    middle, away = T_lidar_board[:3, 3], T_lidar_board[:3, 2]
    level = away[:2] / max(float(np.linalg.norm(away[:2])), 1e-9)
    across = np.array([-level[1], level[0]])
    stand = middle[:2] + carrier.behind_m * level + carrier.beside_m * across
    for offset in (-0.13, 0.13):
        leg = _cylinder(rays, stand + offset * across, _LEG_RADIUS_M)
        _take_nearer(ranges, cosines, *leg)
    if middle[2] > 0.0:
        # Where the plane passes under the board's middle it meets the pole that holds it.
        pole = middle[:2] + _POLE_BEHIND_M * level
        _take_nearer(ranges, cosines, *_cylinder(rays, pole, _POLE_RADIUS_M))
    _take_nearer(ranges, cosines, *_board(rays, T_lidar_board))
    return ranges, cosines


def _take_nearer(
    ranges: FloatArray, cosines: FloatArray, other: FloatArray, other_cosines: FloatArray
) -> None:
    nearer = other < ranges
    ranges[nearer] = other[nearer]
    cosines[nearer] = other_cosines[nearer]


def _inside_room(rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    with np.errstate(divide="ignore"):
        wall = np.where(rays > 0.0, _ROOM_MAX_M, _ROOM_MIN_M) / rays
    wall[rays == 0.0] = np.inf
    axis = np.argmin(wall, axis=1)
    rows = np.arange(len(rays))
    return wall[rows, axis], np.abs(rays[rows, axis])


def _box(rays: FloatArray, box: FloatArray) -> tuple[FloatArray, FloatArray]:
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort(np.stack([box[0] / rays, box[1] / rays]), axis=0)
    parallel = rays == 0.0
    inside = (box[0] < 0.0) & (box[1] > 0.0)
    ends[0][parallel] = np.where(inside, -np.inf, np.inf)[np.nonzero(parallel)[1]]
    ends[1][parallel] = np.where(inside, np.inf, -np.inf)[np.nonzero(parallel)[1]]
    entry, leave = ends[0].max(axis=1), ends[1].min(axis=1)
    axis = np.argmax(ends[0], axis=1)
    hit = (entry > 0.0) & (entry < leave)
    return np.where(hit, entry, np.inf), np.abs(rays[np.arange(len(rays)), axis])


def _cylinder(
    rays: FloatArray, middle_m: FloatArray, radius_m: float
) -> tuple[FloatArray, FloatArray]:
    along = rays[:, :2] @ middle_m
    off2 = float(middle_m @ middle_m) - along**2
    half = np.sqrt(np.maximum(radius_m**2 - off2, 0.0))
    hit = (off2 < radius_m**2) & (along > 0.0)
    return np.where(hit, along - half, np.inf), half / radius_m


def _board(rays: FloatArray, T_lidar_board: FloatArray) -> tuple[FloatArray, FloatArray]:
    normal = T_lidar_board[:3, 2]
    towards = rays @ normal
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = float(normal @ T_lidar_board[:3, 3]) / towards
        on_board = transform_points(invert_transform(T_lidar_board), rays * distance[:, np.newaxis])
        hit = (distance > 0.0) & (np.abs(on_board[:, :2]) < HALF_M).all(axis=1)
    return np.where(hit, distance, np.inf), np.abs(towards)


class BoardImages:
    """Images of the board before the room, from a camera that stands still."""

    def __init__(self, T_camera_lidar: FloatArray, seed: int) -> None:
        self._T_camera_lidar = T_camera_lidar
        self._texture = _board_texture()
        rng = make_generator(seed, RandomStream.FEATURES)
        self._room = self._draw_room(rng)
        # A lamp: brighter on one side.
        rows, columns = np.mgrid[0 : INTRINSICS.height, 0 : INTRINSICS.width]
        slope = rng.uniform(-0.25, 0.25, 2)
        light = 1.0 + slope[0] * (columns / INTRINSICS.width - 0.5)
        self._light = (light + slope[1] * (rows / INTRINSICS.height - 0.5)).astype(np.float32)

    def image(self, T_lidar_board: FloatArray, rng: np.random.Generator) -> ByteArray:
        """(H, W, 3) RGB with blur, uneven light and noise."""
        scale = _SUPERSAMPLING
        T = self._T_camera_lidar @ T_lidar_board
        K = INTRINSICS.matrix
        per_px = 1.0 / _TEXTURE_PX_PER_M
        to_board = np.array(
            [
                [per_px, 0.0, 0.5 * per_px - HALF_M[0]],
                [0.0, per_px, 0.5 * per_px - HALF_M[1]],
                [0.0, 0.0, 1.0],
            ]
        )
        finer = np.array(
            [[scale, 0.0, 0.5 * (scale - 1)], [0.0, scale, 0.5 * (scale - 1)], [0.0, 0.0, 1.0]]
        )
        # Only the part of the image that the board covers is drawn.
        corners = transform_points(T, outline_m())
        pixels = (corners @ K.T)[:, :2] / corners[:, 2:]
        left, top = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 2, 0)
        right, bottom = np.minimum(
            np.ceil(pixels.max(axis=0)).astype(int) + 3, (INTRINSICS.width, INTRINSICS.height)
        )
        K[:2, 2] -= (left, top)
        small = (int(right - left), int(bottom - top))
        size = (small[0] * scale, small[1] * scale)
        homography = finer @ K @ np.stack([T[:3, 0], T[:3, 1], T[:3, 3]], axis=1) @ to_board
        drawn = cv2.warpPerspective(self._texture, homography, size, flags=cv2.INTER_AREA)
        mask = cv2.warpPerspective(np.ones_like(self._texture), homography, size)
        board = cv2.resize(drawn, small, interpolation=cv2.INTER_AREA)[..., np.newaxis]
        covered = cv2.resize(mask, small, interpolation=cv2.INTER_AREA)[..., np.newaxis]
        scene = self._room.copy()
        scene[top:bottom, left:right] = scene[top:bottom, left:right] * (1.0 - covered) + board
        scene *= self._light[..., np.newaxis]
        seen: Float32Array = np.asarray(cv2.GaussianBlur(scene, (0, 0), 0.6), np.float32)
        seen += np.float32(3.0) * rng.standard_normal(seen.shape, dtype=np.float32)
        stored: ByteArray = np.clip(np.rint(seen), 0.0, 255.0).astype(np.uint8)
        return stored

    def _draw_room(self, rng: np.random.Generator) -> Float32Array:
        """(H, W, 3) the room without the board: walls with patches of random grey."""
        v, u = np.mgrid[0 : INTRINSICS.height, 0 : INTRINSICS.width]
        rays = np.stack(
            [
                (u.ravel() - INTRINSICS.cx) / INTRINSICS.fx,
                (v.ravel() - INTRINSICS.cy) / INTRINSICS.fy,
                np.ones(u.size),
            ],
            axis=1,
        )
        T_lidar_camera = invert_transform(self._T_camera_lidar)
        directions = rays @ T_lidar_camera[:3, :3].T
        eye = T_lidar_camera[:3, 3]
        with np.errstate(divide="ignore"):
            wall = (np.where(directions > 0.0, _ROOM_MAX_M, _ROOM_MIN_M) - eye) / directions
        distance = np.where(directions == 0.0, np.inf, wall).min(axis=1)
        for box in _CUPBOARDS_M:
            entry, _ = _box_from(eye, directions, box)
            distance = np.minimum(distance, entry)
        points = eye + 0.999 * distance[:, np.newaxis] * directions
        grey = 90.0 + 110.0 * cell_draw(points, _CELL_M)
        tint = 1.0 + rng.uniform(-0.1, 0.1, 3)
        room = grey[:, np.newaxis] * tint
        return room.reshape(INTRINSICS.height, INTRINSICS.width, 3).astype(np.float32)


def _box_from(
    eye_m: FloatArray, directions: FloatArray, box: FloatArray
) -> tuple[FloatArray, FloatArray]:
    return _box(directions, box - eye_m)


def _board_texture() -> Float32Array:
    """Grey values of the board, ``_TEXTURE_PX_PER_M`` pixels a metre."""
    cell, rim = round(SQUARE_M * _TEXTURE_PX_PER_M), round(RIM_M * _TEXTURE_PX_PER_M)
    squares = np.indices((SQUARES[1], SQUARES[0])).sum(axis=0) % 2
    printed = np.kron(squares, np.ones((cell, cell))) * 200.0 + 25.0
    return np.pad(printed, rim, constant_values=225.0).astype(np.float32)
