"""A furnished box as a scanner in it sees it, by intersecting rays with boxes."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

Box = tuple[Sequence[float], Sequence[float]]
# Lower and upper corners; the scanner stands near the middle of a room of 6.4 x 5.2 x 2.6 m.
SIZE_M = np.array([6.4, 5.2, 2.6])
FURNITURE: tuple[Box, ...] = (
    ((-3.2, -2.6, -1.3), (-2.6, -0.6, 0.7)),  # a cupboard along one end
    ((0.8, 2.0, -1.3), (2.4, 2.6, -0.55)),  # a sideboard
    ((1.6, -1.4, -0.62), (2.8, -0.4, -0.58)),  # a table top
    ((-1.0, -2.6, 0.2), (0.4, -2.35, 0.5)),  # a shelf
    ((2.9, -2.6, -1.3), (3.2, -2.3, 1.3)),  # a pillar in a corner
)


def scan_box(
    rng: np.random.Generator,
    *,
    rays: int = 60_000,
    noise_m: float = 0.01,
    yaw_rad: float = 0.4,
    tilt_rad: float = 0.04,
    outliers: float = 0.02,
    furniture: Sequence[Box] = FURNITURE,
    without: Sequence[tuple[int, int]] = (),
    holes: Sequence[tuple[int, int, Sequence[float], Sequence[float]]] = (),
) -> np.ndarray:
    """(N, 3) points in the scanner's frame.

    ``without``: (axis, sign) of walls that give no return. ``holes``: (axis, sign, low, high), the
    corners of openings in a wall, through which nothing returns.
    """
    directions = rng.normal(size=(rays, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origin = np.array([0.3, -0.2, 0.1])
    half = SIZE_M / 2.0
    # The wall in front of each ray.
    to_walls = (np.sign(directions) * half - origin) / directions
    wall = np.argmin(to_walls, axis=1)
    range_m = to_walls.min(axis=1)
    side = np.sign(directions[np.arange(rays), wall])
    hit = origin + range_m[:, np.newaxis] * directions
    lost = np.zeros(rays, bool)
    for axis, sign in without:
        lost |= (wall == axis) & (side == sign)
    for axis, sign, low, high in holes:
        on_wall = np.delete(hit, axis, axis=1)
        within = ((on_wall > low) & (on_wall < high)).all(axis=1)
        lost |= (wall == axis) & (side == sign) & within
    range_m = np.where(lost, np.inf, range_m)
    for low, high in furniture:
        ends = [(np.array(corner) - origin) / directions for corner in (low, high)]
        entry, leave = np.minimum(*ends).max(axis=1), np.maximum(*ends).min(axis=1)
        ahead = (entry > 0.0) & (entry < leave)
        range_m = np.where(ahead, np.minimum(range_m, entry), range_m)
    measured_m = range_m + rng.normal(scale=noise_m, size=rays)
    stray = rng.random(rays) < outliers
    measured_m[stray] = rng.uniform(0.2, 12.0, int(stray.sum()))
    points = measured_m[:, np.newaxis] * directions
    points = points[np.isfinite(points).all(axis=1)]
    turn = Rotation.from_euler("xyz", [tilt_rad, -0.7 * tilt_rad, yaw_rad])
    return turn.apply(points)
