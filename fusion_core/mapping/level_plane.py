"""The lowest large level plane through points, by RANSAC: of what may be the floor."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray

# Points that score a draw: the inlier ratio is then known to 1 % (two standard deviations).
_SCORED = 12_000
# Rounds of refitting to the inliers.
_REFITS = 4
# Twice the least area of a drawn triangle: smaller ones give no reliable normal.
_TRIANGLE_MIN_M2 = 0.01
# Planes that may lie above the floor, each below the one before: shelf, table, seat, step.
_PLANES_ABOVE_FLOOR = 4
# Patches that a plane needs to be the floor, as a fraction of those of the plane above it, which is
# then furniture, or of all level patches of an image. Set by hand.
LARGE_FRACTION = 0.15


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelPlaneSearch:
    """What counts as a level plane. A plane is (4,): the unit normal towards ``up`` and an offset;
    a point p lies ``normal @ p + offset`` above it.

    ``up``: (3,) unit; a plane may tilt against it by ``tilt_max_rad``. ``is_near``: which of (N, 3)
    points lie on a plane. ``camera_height_m``: of the camera above a plane, at least
    ``camera_height_min_m``. ``points_min``: fewer show no plane. ``below_m``: what lies this far
    below a plane is not on it. ``draws``: of RANSAC.
    """

    up: FloatArray
    tilt_max_rad: float
    is_near: Callable[[FloatArray, FloatArray], BoolArray]
    camera_height_m: Callable[[FloatArray], float]
    camera_height_min_m: float
    points_min: int
    below_m: float
    draws: int

    def find(self, points_m: FloatArray, rng: np.random.Generator) -> FloatArray | None:
        """The floor among (N, 3) points, not yet refitted; None without a level plane."""
        plane = self._ransac(points_m, rng)
        if plane is None:
            return None
        # The largest plane may be a table top: look for the floor below it.
        for _ in range(_PLANES_ABOVE_FLOOR):
            on_plane = int(self.is_near(points_m, plane).sum())
            below = points_m @ plane[:3] + plane[3] < -self.below_m
            lower = self._ransac(points_m[below], rng)
            if lower is None or self.is_near(points_m, lower).sum() < LARGE_FRACTION * on_plane:
                break
            plane = lower
        return plane

    def refit(self, points_m: FloatArray, plane: FloatArray) -> FloatArray:
        """The least-squares plane of the inliers of a plane, refitted a few times."""
        for _ in range(_REFITS):
            near_m = points_m[self.is_near(points_m, plane)]
            if len(near_m) < 3:
                return plane
            middle_m = near_m.mean(axis=0)
            off_m = near_m - middle_m
            normal = np.linalg.eigh(off_m.T @ off_m)[1][:, 0]
            normal *= np.sign(normal @ plane[:3])
            plane = np.append(normal, -float(normal @ middle_m))
        return plane

    def _ransac(self, points_m: FloatArray, rng: np.random.Generator) -> FloatArray | None:
        """The plane below the camera with most inliers, None without."""
        if len(points_m) < self.points_min:
            return None
        scored_m = points_m
        if len(points_m) > _SCORED:
            scored_m = points_m[np.sort(rng.choice(len(points_m), _SCORED, replace=False))]
        best: FloatArray | None = None
        most = 0
        for _ in range(self.draws):
            a, b, c = points_m[rng.integers(len(points_m), size=3)]
            normal = np.cross(b - a, c - a)
            length = float(np.linalg.norm(normal))
            # Three points in a line, or nearly so, have no normal.
            if length < _TRIANGLE_MIN_M2:
                continue
            normal *= np.sign(normal @ self.up) / length
            plane = np.append(normal, -float(normal @ a))
            if (
                normal @ self.up < np.cos(self.tilt_max_rad)
                or self.camera_height_m(plane) < self.camera_height_min_m
            ):
                continue
            count = int(self.is_near(scored_m, plane).sum())
            if count > most:
                best, most = plane, count
        return best
