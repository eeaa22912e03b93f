"""Painted corridors and rooms for visual loop closing, and an RGB-D camera led through them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from fusion_core.model.conventions import NS_PER_S, FloatArray
from fusion_core.model.geometry import make_transform
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.simulation import textures
from fusion_core.simulation.textured_room import Panel, RoomCaster, TexturedRoom

INTRINSICS = CameraIntrinsics(width=320, height=240, fx=262.5, fy=262.5, cx=159.5, cy=119.5)
HEIGHT_M = 2.5
_TEXEL_M = 0.004
RATE_HZ = 15
# Of a Kinect's inverse depth (Khoshelham & Elberink 2012), before its quantisation; see DepthNoise.
_INVERSE_DEPTH_SIGMA, _DISPARITY_STEP = 1.16e-3, 2.85e-3
_RANGE_M = (0.4, 8.0)
_GRAY_SIGMA = 2.0

Wall = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class CameraRun:
    """``T_world_camera``: (N, 4, 4) of the images of a camera among painted walls. ``noise``: of
    its depth, in noises of a Kinect."""

    caster: RoomCaster
    T_world_camera: FloatArray
    seed: int
    noise: float = 1.0

    def frames(self, first: int = 0, end: int | None = None) -> Iterator[RgbdFrame]:
        """The images from ``first`` to before ``end``, as a Kinect would see them."""
        for index in range(first, len(self.T_world_camera) if end is None else end):
            rng = np.random.default_rng((self.seed, index))
            stamp_ns = index * NS_PER_S // RATE_HZ
            yield render(self.caster, self.T_world_camera[index], rng, stamp_ns, self.noise)

    def moved(self, right_m: float, right_rad: float) -> "CameraRun":
        """The same way with the camera to its right and turned to the right."""
        c, s = np.cos(right_rad), np.sin(right_rad)
        R = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        T_camera_moved = make_transform(R, np.array([right_m, 0.0, 0.0]))
        return replace(
            self, T_world_camera=self.T_world_camera @ T_camera_moved, seed=self.seed + 1
        )


def render(
    caster: RoomCaster,
    T_world_camera: FloatArray,
    rng: np.random.Generator,
    stamp_ns: int,
    noise: float,
) -> RgbdFrame:
    """An image with the noise of a Kinect, that of its depth times a factor."""
    v, u = np.mgrid[: INTRINSICS.height, : INTRINSICS.width].reshape(2, -1).astype(np.float64)
    rays = np.column_stack(
        [
            (u - INTRINSICS.cx) / INTRINSICS.fx,
            (v - INTRINSICS.cy) / INTRINSICS.fy,
            np.ones(u.size),
        ]
    )
    directions = rays @ T_world_camera[:3, :3].T
    hits = caster.cast(T_world_camera[:3, 3], directions)
    # The third coordinate of a ray is one, so the distance along it is the depth.
    depth_m = hits.distance
    points = T_world_camera[:3, 3] + directions * np.where(
        np.isfinite(depth_m), depth_m, 0.0
    ).reshape(-1, 1)
    shape = (INTRINSICS.height, INTRINSICS.width)
    rgb = caster.rgb(hits, points).reshape(*shape, 3)
    gray = cv2.cvtColor(rgb.astype(np.uint8), cv2.COLOR_RGB2GRAY).astype(np.float64)
    gray = np.clip(np.rint(gray + rng.normal(0.0, _GRAY_SIGMA, shape)), 0, 255).astype(np.uint8)
    inverse = 1.0 / depth_m + rng.normal(0.0, noise * _INVERSE_DEPTH_SIGMA, depth_m.shape)
    step = noise * _DISPARITY_STEP
    inverse = np.maximum(np.rint(inverse / step), 1.0) * step
    reported = 1.0 / inverse
    reported[(depth_m < _RANGE_M[0]) | (depth_m > _RANGE_M[1])] = np.nan
    return RgbdFrame(
        stamp_ns=stamp_ns, gray=gray, depth_m=reported.reshape(shape).astype(np.float32)
    )


def paint_walls(walls: Sequence[Wall], seed: int) -> list[Panel]:
    """Walls with pictures, seen from the left of the way from their start to their end."""
    rng = np.random.default_rng(seed)
    panels = []
    for start, end in walls:
        # From inside a wall is seen from its end to its start, so that letters are not mirrored.
        corner = np.array([*end, 0.0])
        along = np.array([*start, 0.0]) - corner
        length = float(np.linalg.norm(along))
        shape = (round(HEIGHT_M / _TEXEL_M), max(8, round(length / _TEXEL_M)))
        base = textures.paint(textures.plaster, shape, rng)
        pictures = []
        column = 10
        while column < shape[1] - 60:
            width = int(rng.integers(60, 150))
            height = int(rng.integers(70, 160))
            for row in (int(rng.integers(20, 160)), int(rng.integers(330, 440))):
                if column + width < shape[1]:
                    painted = textures.paint(textures.poster, (height, width), rng)
                    pictures.append((row, column, painted))
            column += width + int(rng.integers(20, 100))
        texture = textures.hang(base, pictures, rng)
        panels.append(Panel(corner, along, np.array([0.0, 0.0, HEIGHT_M]), texture))
    return panels


def floor_and_ceiling(low: FloatArray, high: FloatArray, seed: int) -> list[Panel]:
    """Of a rectangle from (2,) to (2,)."""
    rng = np.random.default_rng(seed)
    length, width = (float(side) for side in high - low)
    shape = (round(width / (2 * _TEXEL_M)), round(length / (2 * _TEXEL_M)))
    along_x, along_y = np.array([length, 0.0, 0.0]), np.array([0.0, width, 0.0])
    corner = np.array([*low, 0.0])
    return [
        Panel(corner, along_x, along_y, textures.paint(textures.tiles, shape, rng)),
        Panel(
            np.array([*low, HEIGHT_M]),
            along_x,
            along_y,
            textures.paint(textures.plaster, shape, rng),
        ),
    ]


def moved(panels: Sequence[Panel], by_m: FloatArray) -> list[Panel]:
    """The same panels elsewhere."""
    return [Panel(p.corner_m + by_m, p.edge_a_m, p.edge_b_m, p.texture) for p in panels]


def caster_of(panels: Sequence[Panel]) -> RoomCaster:
    room = TexturedRoom(
        size_m=(1.0, 1.0, HEIGHT_M),
        panels=tuple(panels),
        viewpoint_m=np.zeros(3),
        heading_rad=0.0,
    )
    return RoomCaster(room, footprint_m=0.0)


def ring_corridor(side_m: float, width_m: float, seed: int) -> RoomCaster:
    """A corridor round a block; its outer side is ``side_m`` long and starts at the origin."""
    a, b, c = 0.0, width_m, side_m - width_m
    outer = [(a, a), (side_m, a), (side_m, side_m), (a, side_m)]
    inner = [(b, b), (b, c), (c, c), (c, b)]
    walls = [(corners[i], corners[(i + 1) % 4]) for corners in (outer, inner) for i in range(4)]
    low, high = np.zeros(2), np.array([side_m, side_m])
    return caster_of([*paint_walls(walls, seed), *floor_and_ceiling(low, high, seed + 1)])


def ring_path(side_m: float, width_m: float, laps: float, step_m: float) -> FloatArray:
    """(N, 4, 4) along the middle of the corridor, looking ahead, round the corners on an arc."""
    middle, radius = 0.5 * width_m, 0.5 * width_m
    straight = side_m - 2.0 * middle - 2.0 * radius
    quarter = 0.5 * np.pi * radius
    lap = 4.0 * (straight + quarter)
    poses = []
    for s in np.arange(0.0, laps * lap, step_m):
        side, along = divmod(s % lap, straight + quarter)
        heading = 0.5 * np.pi * side
        if along < straight:
            local = np.array([along, 0.0])
            turned = 0.0
        else:
            turned = (along - straight) / radius
            local = np.array([straight + radius * np.sin(turned), radius * (1 - np.cos(turned))])
        # Each side starts where the last arc ends.
        corner = np.array(
            [
                (middle + radius, middle),
                (side_m - middle, middle + radius),
                (side_m - middle - radius, side_m - middle),
                (middle, side_m - middle - radius),
            ]
        )[int(side)]
        c, s_ = np.cos(heading), np.sin(heading)
        place = corner + np.array([[c, -s_], [s_, c]]) @ local
        poses.append(camera_pose(place[0], place[1], heading + turned))
    return np.array(poses)


def identical_rooms(size_m: float, apart_m: float, seed: int) -> RoomCaster:
    """Two rooms with the same walls, floors and all, and a corridor between their doors.

    The first stands about the origin, the second ``apart_m`` along x.
    """
    h, door = 0.5 * size_m, 0.5
    room = paint_walls(
        [
            ((-h, -h), (h, -h)),
            ((h, -h), (h, -door)),
            ((h, door), (h, h)),
            ((h, h), (-h, h)),
            ((-h, h), (-h, door)),
            ((-h, -door), (-h, -h)),
        ],
        seed,
    )
    room += floor_and_ceiling(np.array([-h, -h]), np.array([h, h]), seed + 1)
    # What closes the doors that lead nowhere differs, and so does the corridor.
    ends = paint_walls(
        [((-h, door), (-h, -door)), ((apart_m + h, -door), (apart_m + h, door))], seed + 2
    )
    corridor = paint_walls(
        [((h, -door), (apart_m - h, -door)), ((apart_m - h, door), (h, door))], seed + 3
    )
    corridor += floor_and_ceiling(np.array([h, -door]), np.array([apart_m - h, door]), seed + 4)
    away = np.array([apart_m, 0.0, 0.0])
    return caster_of([*room, *ends, *corridor, *moved(room, away)])


def rooms_path(apart_m: float, step_m: float, step_rad: float) -> FloatArray:
    """(N, 4, 4): a round in the first room, the way to the second, a round in it."""
    angles = np.arange(0.0, 2.0 * np.pi, step_rad)

    def round_about(x: float) -> list[FloatArray]:
        return [camera_pose(x + 0.4 * np.cos(a) - 0.4, 0.4 * np.sin(a), a) for a in angles]

    way = [camera_pose(x, 0.0, 0.0) for x in np.arange(0.0, apart_m, step_m)]
    return np.array([*round_about(0.0), *way, *round_about(apart_m)])


def camera_pose(x: float, y: float, heading_rad: float) -> FloatArray:
    """T_world_camera of a level camera at half the height."""
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    # Columns: right, down, ahead.
    R = np.array([[s, 0.0, c], [-c, 0.0, s], [0.0, -1.0, 0.0]])
    return make_transform(R, np.array([x, y, 0.5 * HEIGHT_M]))
