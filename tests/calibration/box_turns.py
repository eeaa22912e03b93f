"""Turns of a spinning LiDAR between planes, by intersecting rays with them one by one."""

from collections.abc import Sequence

import numpy as np

from fusion_core.calibration.turning.turn import Turn
from fusion_core.model.geometry import make_transform

# The LiDAR lies on its side: its spin axis along y, its azimuth 0 along x.
ON_ITS_SIDE = make_transform(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.zeros(3))
FLOOR, CEILING = ((0.0, 0.0, -1.0), 1.4), ((0.0, 0.0, 1.0), 1.2)
WALLS = (
    ((1.0, 0.0, 0.0), 3.1),
    ((-1.0, 0.0, 0.0), 2.7),
    ((0.0, 1.0, 0.0), 2.2),
    ((0.0, -1.0, 0.0), 3.6),
)
ROOM = (FLOOR, CEILING, *WALLS)
SOMEWHERE = np.array([np.deg2rad(1.41), np.deg2rad(-0.15), 0.006, -0.004])


def make_turn(
    planes: Sequence[tuple[tuple[float, float, float], float]] = ROOM,
    parameters: np.ndarray = SOMEWHERE,
    *,
    sigma_m: float = 0.0,
    seed: int = 0,
    scans: int = 120,
    columns: int = 60,
    turn_deg: float = 360.0,
    nominal: np.ndarray = ON_ITS_SIDE,
    max_range_m: float = 8.0,
) -> Turn:
    """A turn with a mounting of ``parameters``; rays that meet no plane have no point."""
    rng = np.random.default_rng(seed)
    theta, beta, delta_x, delta_y = parameters
    ct, st, cb, sb = np.cos(theta), np.sin(theta), np.cos(beta), np.sin(beta)
    tilt = np.array([[1, 0, 0], [0, ct, -st], [0, st, ct]]) @ np.array(
        [[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]]
    )
    azimuth, elevation = np.meshgrid(
        np.arange(columns) * 2 * np.pi / columns, np.deg2rad(np.arange(-15, 16, 2)), indexing="ij"
    )
    rays = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=-1,
    ).reshape(-1, 3)
    order = np.arange(len(rays)) / len(rays)
    points, angles, indices = [], [], []
    for scan in range(scans):
        angle = np.deg2rad(turn_deg) * (scan + order) / scans
        c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
        turned = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
        in_axis = rays @ (tilt @ nominal[:3, :3]).T
        directions = np.einsum("nij,nj->ni", turned, in_axis)
        origins = np.einsum("nij,j->ni", turned, nominal[:3, 3] + np.array([delta_x, delta_y, 0.0]))
        range_m = np.full(len(rays), np.inf)
        for normal, offset in planes:
            slope = directions @ np.array(normal)
            with np.errstate(divide="ignore"):
                along = (offset - origins @ np.array(normal)) / slope
            range_m = np.where((along > 0) & (along < range_m), along, range_m)
        seen = range_m < max_range_m
        measured = range_m[seen] + sigma_m * rng.standard_normal(seen.sum())
        points.append(measured[:, np.newaxis] * rays[seen])
        angles.append(angle[seen])
        indices.append(np.full(seen.sum(), scan))
    return Turn(
        points_in_lidar_m=np.concatenate(points),
        axis_angles_rad=np.concatenate(angles),
        scan_indices=np.concatenate(indices),
        T_axis_lidar_nominal=nominal,
    )
