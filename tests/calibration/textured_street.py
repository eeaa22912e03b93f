"""A simulated scene with walls and a floor of known reflectance, seen by a spinning LiDAR and a
camera: the same pattern makes the LiDAR's intensity and, under uneven light, the grey values."""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.geometry import invert_transform, make_transform
from fusion_core.model.sensors import CameraIntrinsics

INTRINSICS = CameraIntrinsics(width=640, height=400, fx=500.0, fy=500.0, cx=320.0, cy=200.0)
# The camera looks along the LiDAR's x axis, 10 cm beside it and 20 cm below.
T_CAMERA_LIDAR: FloatArray = make_transform(
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    np.array([0.1, -0.2, -0.15]),
)
_FLOOR_M = -1.6
_BACK_M = 12.0
# Boxes between the camera and the back wall: x, y, width, height in the LiDAR's frame.
_BOARDS = (
    (5.0, -1.6, 0.7, 1.4),
    (6.0, 1.3, 1.0, 2.4),
    (8.0, -0.2, 0.8, 1.0),
    (7.0, 3.0, 0.5, 3.0),
    (9.0, -3.6, 1.2, 2.2),
)


@dataclass(frozen=True)
class TexturedStreet:
    """Points in the LiDAR's frame with their intensity, and the image."""

    points_m: FloatArray
    intensity: FloatArray
    grey: ByteArray


def textured_street(seed: int = 0, range_sigma_m: float = 0.01) -> TexturedStreet:
    """The scene with noise of ranges, of intensities and of grey values."""
    rng = np.random.default_rng(seed)
    patterns = [_pattern(rng) for _ in range(len(_BOARDS) + 2)]
    azimuth = np.radians(np.arange(-45.0, 45.0, 0.25))
    elevation = np.radians(np.arange(-24.0, 16.0, 0.5))
    a, e = (grid.ravel() for grid in np.meshgrid(azimuth, elevation))
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    range_m, reflectance = _cast(np.zeros(3), rays, patterns)
    range_m = range_m + rng.normal(0.0, range_sigma_m, range_m.shape)
    points_m = rays * range_m[:, np.newaxis]
    # Reflectance by range and angle, in a driver's own unit.
    intensity = 200.0 * reflectance / (1.0 + 0.1 * range_m) + rng.normal(0.0, 3.0, range_m.shape)
    k = INTRINSICS
    u, v = np.meshgrid(np.arange(k.width), np.arange(k.height))
    rays = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones(u.shape)], axis=-1)
    T_lidar_camera = invert_transform(T_CAMERA_LIDAR)
    rays = rays.reshape(-1, 3) @ T_lidar_camera[:3, :3].T
    _, seen = _cast(T_lidar_camera[:3, 3], rays, patterns)
    light = 0.4 + 0.6 * u / k.width
    grey = 40.0 + 180.0 * light * seen.reshape(u.shape) ** 0.8
    grey = cv2.GaussianBlur(grey, (0, 0), 0.7) + rng.normal(0.0, 2.0, grey.shape)
    return TexturedStreet(
        points_m=points_m,
        intensity=intensity,
        grey=np.clip(grey, 0, 255).astype(np.uint8),
    )


def _pattern(rng: np.random.Generator) -> FloatArray:
    """(64, 64) reflectances, a cell 20 cm wide, of a few materials."""
    coarse = rng.choice([0.1, 0.35, 0.6, 0.9], size=(64, 64))
    return np.asarray(coarse, dtype=np.float64)


def _cast(
    origin: FloatArray, rays: FloatArray, patterns: list[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Distances along rays, in their lengths, to what they meet first, and its reflectance."""
    best = np.full(len(rays), np.inf)
    shade = np.zeros(len(rays))
    surfaces = [(_BACK_M, -100.0, 200.0, 200.0), *_BOARDS]
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = np.where(rays[:, 2] < 0.0, (_FLOOR_M - origin[2]) / rays[:, 2], np.inf)
        _meet(best, shade, floor, origin + floor[:, np.newaxis] * rays, (0, 1), patterns[-1])
        for (x, y, width, height), pattern in zip(surfaces, patterns, strict=False):
            t = (x - origin[0]) / rays[:, 0]
            hit = origin + t[:, np.newaxis] * rays
            inside = (t > 0.0) & (hit[:, 1] > y) & (hit[:, 1] < y + width)
            inside &= hit[:, 2] < _FLOOR_M + height
            _meet(best, shade, np.where(inside, t, np.inf), hit, (1, 2), pattern)
    return best, shade


def _meet(
    best: FloatArray,
    shade: FloatArray,
    t: FloatArray,
    hit: FloatArray,
    axes: tuple[int, int],
    pattern: FloatArray,
) -> None:
    nearer = t < best
    best[nearer] = t[nearer]
    cells = np.floor(hit[nearer][:, axes] / 0.2).astype(np.int64) % len(pattern)
    shade[nearer] = pattern[cells[:, 0], cells[:, 1]]
