"""A furnished room with pictures on its walls, seen by a LiDAR from one point and by a camera: by
ray casting alone, without the project's own simulation.

Paint looks alike to both for the most part: a share of it reflects infrared as it likes.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from fusion_core.lens.projection import project_points
from fusion_core.model.conventions import R_BODY_OPTICAL, ByteArray, Float32Array, FloatArray
from fusion_core.model.geometry import invert_transform, make_transform
from fusion_core.model.sensors import CameraIntrinsics, PointCloud

TEXEL_M = 0.004
# A LiDAR looks along +x at the far wall, the camera with it.
_ROOM_M = np.array([[-2.9, -2.6, -1.4], [3.4, 3.3, 1.2]])


@dataclass(frozen=True)
class Face:
    """A rectangle: a corner, two edges along axes of the room, and what is painted on it."""

    corner_m: FloatArray
    axis: int
    edges_m: tuple[float, float]
    visible: Float32Array
    infrared: Float32Array


def _paint(
    rng: np.random.Generator, edges_m: tuple[float, float], density: float, alike: float
) -> tuple[Float32Array, Float32Array]:
    shape = tuple(max(2, round(edge / TEXEL_M)) for edge in edges_m)
    base = rng.uniform(0.35, 0.75)
    visible = np.full(shape, base, dtype=np.float32)
    infrared = np.full(shape, base * rng.uniform(0.9, 1.1), dtype=np.float32)
    for _ in range(round(density * edges_m[0] * edges_m[1])):
        size = np.exp(rng.uniform(np.log(0.02), np.log(0.5), 2)) / TEXEL_M
        centre = rng.uniform(0.0, 1.0, 2) * shape
        seen = rng.uniform(0.05, 0.95)
        back = seen if rng.random() < alike else rng.uniform(0.05, 0.95)
        low = np.maximum(0, centre - size / 2).astype(int)
        high = np.minimum(shape, centre + size / 2 + 1).astype(int)
        rows, columns = np.ogrid[low[0] : high[0], low[1] : high[1]]
        inside = np.ones((high - low).clip(0), dtype=bool)
        if rng.random() < 0.5:
            inside = ((rows - centre[0]) / size[0]) ** 2 + (
                (columns - centre[1]) / size[1]
            ) ** 2 < 0.25
        for layer, value in ((visible, seen), (infrared, back)):
            layer[low[0] : high[0], low[1] : high[1]][inside] = value
    return visible, infrared


def _box_faces(
    rng: np.random.Generator, low: FloatArray, high: FloatArray, density: float, alike: float
) -> list[Face]:
    faces = []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        edges = (float(high[others[0]] - low[others[0]]), float(high[others[1]] - low[others[1]]))
        for side in (low, high):
            corner = np.array(low, dtype=float)
            corner[axis] = side[axis]
            faces.append(Face(corner, axis, edges, *_paint(rng, edges, density, alike)))
    return faces


@cache
def furnished_room(seed: int = 0, density: float = 25.0, alike: float = 0.7) -> tuple[Face, ...]:
    """Walls, floor and ceiling, and pieces of furniture before the walls."""
    rng = np.random.default_rng(seed)
    faces = _box_faces(rng, _ROOM_M[0], _ROOM_M[1], density, alike)
    for _ in range(8):
        size = rng.uniform([0.3, 0.3, 0.4], [0.9, 0.9, 1.6])
        azimuth, distance = rng.uniform(-np.pi, np.pi), rng.uniform(1.7, 2.6)
        low = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), _ROOM_M[0, 2]])
        low[:2] -= size[:2] / 2
        low = np.maximum(low, _ROOM_M[0] + 0.01)
        high = np.minimum(low + size, _ROOM_M[1] - 0.01)
        if (high - low).min() > 0.05:
            faces += _box_faces(rng, low, high, density, alike)
    return tuple(faces)


def cast(
    faces: tuple[Face, ...], origin_m: FloatArray, directions: FloatArray
) -> tuple[FloatArray, np.ndarray, Float32Array, Float32Array]:
    """Range, the face's normal axis, visible and infrared paint where each ray ends."""
    count = len(directions)
    best = np.full(count, np.inf)
    axis = np.zeros(count, dtype=int)
    visible, infrared = np.zeros(count, np.float32), np.zeros(count, np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        for face in faces:
            others = [k for k in range(3) if k != face.axis]
            t = (face.corner_m[face.axis] - origin_m[face.axis]) / directions[:, face.axis]
            a = origin_m[others[0]] + t * directions[:, others[0]] - face.corner_m[others[0]]
            b = origin_m[others[1]] + t * directions[:, others[1]] - face.corner_m[others[1]]
            hit = (t > 1e-6) & (t < best) & (a >= 0) & (b >= 0)
            hit &= (a < face.edges_m[0]) & (b < face.edges_m[1])
            best[hit] = t[hit]
            axis[hit] = face.axis
            i = np.minimum((a[hit] / TEXEL_M).astype(int), face.visible.shape[0] - 1)
            j = np.minimum((b[hit] / TEXEL_M).astype(int), face.visible.shape[1] - 1)
            visible[hit], infrared[hit] = face.visible[i, j], face.infrared[i, j]
    return best, axis, visible, infrared


def dense_cloud(
    faces: tuple[Face, ...],
    *,
    rays: int,
    sigma_m: float,
    seed: int,
    range_power: float = 1.0,
    ahead_min: float = -1.0,
) -> PointCloud:
    """What a turning LiDAR gathers: rays of even density in all directions, with noise; those
    alone whose x is more than ``ahead_min``."""
    rng = np.random.default_rng((seed, 1))
    directions = rng.normal(size=(rays, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, np.newaxis]
    directions = directions[directions[:, 0] > ahead_min]
    rays = len(directions)
    # A beam is 3 mrad wide: its foot's edge mixes what lies beside.
    wide = 0.0
    for _ in range(2):
        nearby = directions + rng.normal(scale=0.0008, size=directions.shape)
        nearby /= np.linalg.norm(nearby, axis=1)[:, np.newaxis]
        wide = wide + cast(faces, np.zeros(3), nearby)[3] / 2
    range_m, axis, _, _ = cast(faces, np.zeros(3), directions)
    incidence = np.abs(np.take_along_axis(directions, axis[:, np.newaxis], axis=1)[:, 0])
    strength = 160.0 * wide * incidence * range_m ** (-range_power)
    strength = strength * (1.0 + rng.normal(scale=0.05, size=rays)) + rng.normal(scale=1, size=rays)
    range_m = range_m + rng.normal(scale=sigma_m, size=rays)
    points = (directions * range_m[:, np.newaxis]).astype(np.float32)
    return PointCloud(
        stamp_ns=0,
        received_ns=None,
        frame_id="lidar",
        xyz_m=points,
        intensity=np.clip(np.round(strength), 0, 255).astype(np.float32),
    )


def intrinsics(scale: float = 1.0, distortion: tuple[float, ...] = ()) -> CameraIntrinsics:
    """The camera of Song's Table 1, of 1280 x 960 pixels, or a smaller one."""
    return CameraIntrinsics(
        width=round(1280 * scale),
        height=round(960 * scale),
        fx=1055.5 * scale,
        fy=1053.0 * scale,
        cx=(649.6 + 0.5) * scale - 0.5,
        cy=(485.2 + 0.5) * scale - 0.5,
        distortion=distortion,
    )


def mounted_camera(seed: int, yaw_rad: float = 0.0) -> FloatArray:
    """T_camera_lidar of a camera beside the LiDAR, its mount off by some degrees."""
    rng = np.random.default_rng((seed, 2))
    turned = Rotation.from_euler("z", yaw_rad).as_matrix() @ R_BODY_OPTICAL
    wrong = Rotation.from_rotvec(rng.uniform(-0.07, 0.07, 3)).as_matrix()
    place = rng.uniform([-0.15, -0.15, -0.15], [0.15, 0.15, 0.15])
    return invert_transform(make_transform(turned @ wrong, place))


def photograph(
    faces: tuple[Face, ...],
    T_camera_lidar: FloatArray,
    camera: CameraIntrinsics,
    seed: int,
    samples: int = 2,
) -> ByteArray:
    """(H, W) grey image with shading, vignetting and noise."""
    rng = np.random.default_rng((seed, 3))
    rays = _pixel_rays(camera, samples) @ T_camera_lidar[:3, :3]
    origin = invert_transform(T_camera_lidar)[:3, 3]
    value = np.empty(len(rays), np.float32)
    for start in range(0, len(rays), 500_000):
        part = slice(start, start + 500_000)
        _, axis, visible, _ = cast(faces, origin, rays[part])
        value[part] = visible * np.array([0.8, 0.9, 1.0])[axis]
    grid = value.reshape(camera.height, samples, camera.width, samples).mean(axis=(1, 3))
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    off = np.hypot(columns - camera.cx, rows - camera.cy) / camera.width
    grid = 230.0 * grid**0.8 * (1.0 - 0.5 * off**2) + rng.normal(scale=3, size=grid.shape)
    return np.clip(np.round(grid), 0, 255).astype(np.uint8)


def _pixel_rays(camera: CameraIntrinsics, samples: int) -> FloatArray:
    """Rays of (H samples, W samples) places, by inverting the projection by fixed point."""
    places = [(np.arange(n * samples) + 0.5) / samples - 0.5 for n in (camera.height, camera.width)]
    v, u = np.meshgrid(*places, indexing="ij")
    wanted = np.stack([u.ravel(), v.ravel()], axis=1)
    x = (wanted - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    rays = np.concatenate([x, np.ones((len(x), 1))], axis=1)
    if any(camera.distortion):
        for _ in range(20):
            off = wanted - project_points(rays, camera)
            rays[:, :2] += off / [camera.fx, camera.fy]
            if np.abs(off).max() < 1e-3:
                break
    return rays


@dataclass(frozen=True)
class Scene:
    """``cloud`` and ``grey`` of a room, with the truth."""

    cloud: PointCloud
    grey: ByteArray
    camera: CameraIntrinsics
    T_camera_lidar: FloatArray


@cache
def small_scene(
    seed: int = 0, distortion: tuple[float, ...] = (-0.1, 0.03, 0.0, 0.0, 0.0)
) -> Scene:
    """The part of a room that the camera looks at, in few points and pixels."""
    faces = furnished_room(seed)
    camera, T = intrinsics(0.4, distortion), mounted_camera(seed)
    cloud = dense_cloud(faces, rays=900_000, sigma_m=0.01, seed=seed, ahead_min=0.35)
    return Scene(
        cloud=cloud, grey=photograph(faces, T, camera, seed), camera=camera, T_camera_lidar=T
    )
