"""Images of two textured walls that meet in a corner, drawn by their homographies, with depth."""

import cv2
import numpy as np

from fusion_core.model.geometry import invert_transform, make_transform
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics

INTRINSICS = CameraIntrinsics(width=320, height=240, fx=288.0, fy=288.0, cx=159.5, cy=119.5)
STEP_NS = 33_333_333
PX_PER_M = 120.0
SIZE_M = 8.0
# Along the world's x, and towards the camera; both from the corner, 3.5 m ahead.
_CORNER = np.array([1.0, -0.5 * SIZE_M, 3.5])
_WALLS = (np.array([-1.0, 0.0, 0.25]), np.array([0.3, 0.0, -1.0]))
_DOWN = np.array([0.0, 1.0, 0.0])


def _texture(seed):
    """Random blocks of many sizes."""
    random = np.random.default_rng(seed)
    size = int(SIZE_M * PX_PER_M)
    drawn = np.full((size, size), 128.0)
    for cells in (20, 60, 160):
        grid = random.uniform(-60.0, 60.0, (cells, cells)).astype(np.float32)
        drawn += cv2.resize(grid, (size, size), interpolation=cv2.INTER_NEAREST)
    return cv2.GaussianBlur(np.clip(drawn, 0, 255).astype(np.uint8), (0, 0), 1.0)


_TEXTURES = [_texture(3), _texture(4)]


def frame(T_world_camera, number, *, light=1.0, noise=2.0):
    """What the camera sees from a pose in the world, whose axes are optical."""
    K = INTRINSICS.matrix
    T_camera_world = invert_transform(T_world_camera)
    shape = (INTRINSICS.height, INTRINSICS.width)
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    rays = np.stack([(u - INTRINSICS.cx) / INTRINSICS.fx, (v - INTRINSICS.cy) / INTRINSICS.fy], -1)
    rays = np.concatenate([rays, np.ones((*shape, 1))], axis=-1)
    depth_m, gray = np.full(shape, np.inf), np.zeros(shape)
    for along, texture in zip(_WALLS, _TEXTURES, strict=True):
        along = along / np.linalg.norm(along)
        normal = np.cross(along, _DOWN)
        n = T_camera_world[:3, :3] @ normal
        corner = T_camera_world[:3, :3] @ _CORNER + T_camera_world[:3, 3]
        with np.errstate(divide="ignore"):
            z = (n @ corner) / (rays @ n)
        points = z[..., np.newaxis] * rays - corner
        a = points @ (T_camera_world[:3, :3] @ along)
        b = points @ (T_camera_world[:3, :3] @ _DOWN)
        on_wall = (z > 0.1) & (z < depth_m) & (a >= 0.0) & (a < SIZE_M) & (b >= 0) & (b < SIZE_M)
        plane = np.stack([along, _DOWN], axis=1) / PX_PER_M
        H = K @ np.column_stack([T_camera_world[:3, :3] @ plane, corner])
        drawn = cv2.warpPerspective(texture, H, shape[::-1], flags=cv2.INTER_LINEAR)
        depth_m, gray = np.where(on_wall, z, depth_m), np.where(on_wall, drawn, gray)
    random = np.random.default_rng(number)
    noisy = np.clip(light * gray + random.normal(0.0, noise, shape), 0, 255).astype(np.uint8)
    depth_m = np.where(np.isfinite(depth_m), depth_m, np.nan)
    depth_m += random.normal(0.0, 0.002, shape) * depth_m**2
    depth_m[random.uniform(size=shape) < 0.05] = np.nan
    return RgbdFrame(stamp_ns=number * STEP_NS, gray=noisy, depth_m=depth_m.astype(np.float32))


def poses(count, *, reach_m=0.5):
    """(count, 4, 4) T_world_camera of a camera swung to and fro: sideways, up and down, turning."""
    t = np.arange(count) / 30.0
    result = []
    for s in t:
        turn = cv2.Rodrigues(
            np.array([0.06 * np.sin(1.9 * s), 0.12 * np.sin(1.3 * s), 0.05 * np.sin(2.3 * s)])
        )[0]
        place = reach_m * np.array([np.sin(1.1 * s), 0.3 * np.sin(1.7 * s), 0.4 * np.sin(0.9 * s)])
        result.append(make_transform(np.asarray(turn, float), place))
    return np.stack(result)
