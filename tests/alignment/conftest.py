"""Rooms made of axis-aligned boxes, seen by rays whose lengths have a closed form."""

from dataclasses import dataclass

import numpy as np
import pytest

from fusion_core.model.sensors import CameraIntrinsics

Box = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class BoxRoom:
    """A closed room from (0, 0, 0) to ``size_m`` with ``boxes`` (x0, y0, z0, x1, y1, z1) in it."""

    size_m: tuple[float, float, float] = (6.0, 5.0, 2.6)
    boxes: tuple[Box, ...] = ()

    def lengths(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Distance to the first surface, in lengths of each of the (..., 3) rays: the slab
        method, ray by ray and box by box."""
        with np.errstate(divide="ignore", invalid="ignore"):
            leaving = np.where(rays > 0.0, np.array(self.size_m) - origin, -origin) / rays
            nearest = np.where(rays == 0.0, np.inf, leaving).min(axis=-1)
            for box in self.boxes:
                low, high = (np.array(box[:3]) - origin) / rays, (np.array(box[3:]) - origin) / rays
                entry = np.minimum(low, high).max(axis=-1)
                leave = np.maximum(low, high).min(axis=-1)
                hit = (entry > 0.0) & (entry < leave)
                nearest = np.where(hit & (entry < nearest), entry, nearest)
        return nearest

    def scan_m(
        self, x: float, y: float, height: float, yaw: float, angles: np.ndarray
    ) -> np.ndarray:
        """Ranges of a level LiDAR at (x, y, height) that looks along yaw."""
        azimuths = yaw + angles
        rays = np.stack([np.cos(azimuths), np.sin(azimuths), np.zeros_like(azimuths)], axis=-1)
        return self.lengths(np.array([x, y, height]), rays)

    def depth_m(self, T_room_camera: np.ndarray, intrinsics: CameraIntrinsics) -> np.ndarray:
        """(H, W) depths along the optical axis of a camera at any pose."""
        u, v = np.meshgrid(np.arange(intrinsics.width), np.arange(intrinsics.height))
        rays = np.stack(
            [
                (u - intrinsics.cx) / intrinsics.fx,
                (v - intrinsics.cy) / intrinsics.fy,
                np.ones(u.shape),
            ],
            -1,
        )
        return self.lengths(T_room_camera[:3, 3], rays @ T_room_camera[:3, :3].T)


# What a LiDAR at 0.3 m and a camera above it see differently, all around the middle: cabinets
# lower and higher than the LiDAR, table tops, a shelf on the wall, a bench, boxes, a pillar.
FURNITURE: tuple[Box, ...] = (
    (0.0, 0.4, 0.0, 0.45, 1.6, 0.9),
    (0.0, 2.6, 0.0, 0.6, 3.6, 0.42),
    (0.3, 4.3, 0.0, 1.2, 5.0, 1.8),
    (1.7, 4.45, 0.0, 3.2, 5.0, 0.38),
    (3.7, 4.2, 0.0, 4.5, 5.0, 0.75),
    (5.2, 3.3, 0.0, 6.0, 4.4, 0.5),
    (5.5, 1.6, 0.35, 6.0, 2.9, 0.8),
    (5.3, 0.0, 0.0, 6.0, 0.9, 1.5),
    (3.0, 0.0, 0.0, 4.4, 0.5, 0.45),
    (1.3, 0.0, 0.25, 2.4, 0.4, 1.1),
    (4.5, 2.2, 0.0, 4.75, 2.45, 2.6),
    (1.2, 2.1, 0.0, 1.5, 2.5, 0.4),
)


@pytest.fixture(scope="session")
def box_room() -> type[BoxRoom]:
    return BoxRoom


@pytest.fixture(scope="session")
def furnished_room() -> BoxRoom:
    return BoxRoom(boxes=FURNITURE)
