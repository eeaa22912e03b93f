"""Visibility: which parts of the obstacle outlines each sensor could see, by ray casting.

A sample of an outline is visible from a pose if a ray from the sensor to it first meets the world
there, at a height that both the sensor's view and the obstacle cover. Range, field of view and
panes count; noise and the gaps between the beams of a sweep do not.
"""

from dataclasses import replace

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.world_outline import WorldOutline, find_runs
from fusion_core.simulation.obstacle_outlines import MIN_OBSTACLE_HEIGHT_M, ROBOT_HEIGHT_M
from fusion_core.simulation.ray_casting import Hits, RayCaster
from fusion_core.simulation.sensor_simulator import SimulationSetup
from fusion_core.simulation.solids import Material

# Heights above the floor at which visibility to the camera is checked.
_CAMERA_CHECK_HEIGHTS_M = np.arange(MIN_OBSTACLE_HEIGHT_M + 0.01, ROBOT_HEIGHT_M, 0.03)
# A ray reaches a sample if it ends this near to it, measured along the floor.
_REACHED_TOLERANCE_M = 0.01


class VisibilityTracker:
    """Accumulates what the sensors could see, pose by pose. Memory does not grow with the poses."""

    def __init__(self, simulation: SimulationSetup) -> None:
        self._simulation = simulation
        self._caster = RayCaster(simulation.world)
        self._outlines = simulation.world.obstacles
        counts = [outline.sample_count for outline in self._outlines]
        self._starts = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
        samples = [outline.samples_m() for outline in self._outlines]
        self._samples_m: FloatArray = np.concatenate([np.zeros((0, 2)), *samples])
        heights = [(outline.z_min_m, outline.z_max_m) for outline in self._outlines]
        spans = np.array(heights, dtype=np.float64).reshape(-1, 2)
        self._spans_m: FloatArray = np.repeat(spans, counts, axis=0)
        total = len(self._samples_m)
        self._seen = {name: np.zeros(total, dtype=np.bool_) for name in ("lidar", "camera")}

    def add_sweep(self, T_world_base: FloatArray, time_s: float) -> None:
        """Mark what a sweep from a pose could hit."""
        mount = self._simulation.mounts.lidar
        T_world_lidar = T_world_base @ mount.T_base_lidar
        height_m = float(T_world_lidar[2, 3])
        unseen = np.flatnonzero(~self._seen["lidar"] & self._has_height(height_m))
        targets_m = self._points_at_height(unseen, height_m)
        in_lidar = transform_points(invert_transform(T_world_lidar), targets_m)
        range_m = np.hypot(in_lidar[:, 0], in_lidar[:, 1])
        azimuth = np.arctan2(in_lidar[:, 1], in_lidar[:, 0])
        # In a full circle the first beam is the neighbour of the last.
        half_rad = -mount.angle_min_rad + 0.5 * mount.angle_increment_rad
        inside = (range_m >= mount.range_min_m) & (range_m <= mount.range_max_m)
        inside &= np.abs(azimuth) <= half_rad
        unseen, targets_m = unseen[inside], targets_m[inside]
        reached, hits = self._reaches_targets(T_world_lidar[:3, 3], targets_m, time_s)
        # Panes and mirrors return a beam only near normal incidence.
        noise = self._simulation.lidar_noise
        fronts_rad = {
            Material.GLASS: noise.glass_front_rad,
            Material.MIRROR: noise.mirror_front_rad,
        }
        for material, front_rad in fronts_rad.items():
            reached &= (hits.materials != material) | (hits.incidence_cos >= np.cos(front_rad))
        self._seen["lidar"][unseen[reached]] = True

    def add_image(self, camera: int, T_world_base: FloatArray, time_s: float) -> None:
        """Mark what a depth image from a pose could show."""
        mount, noise = self._simulation.mounts.cameras[camera], self._simulation.depth_noise
        intrinsics = mount.intrinsics
        T_world_optical = T_world_base @ mount.T_base_optical
        T_optical_world = invert_transform(T_world_optical)
        for height_m in _CAMERA_CHECK_HEIGHTS_M:
            unseen = np.flatnonzero(~self._seen["camera"] & self._has_height(float(height_m)))
            targets_m = self._points_at_height(unseen, float(height_m))
            x, y, z = transform_points(T_optical_world, targets_m).T
            ahead = (z >= noise.near_m) & (z <= noise.far_m)
            depth = np.where(ahead, z, 1.0)
            u, v = (
                intrinsics.cx + intrinsics.fx * x / depth,
                intrinsics.cy + intrinsics.fy * y / depth,
            )
            inside = ahead & (u >= -0.5) & (u < intrinsics.width - 0.5)
            inside &= (v >= -0.5) & (v < intrinsics.height - 0.5)
            unseen, targets_m = unseen[inside], targets_m[inside]
            reached, hits = self._reaches_targets(T_world_optical[:3, 3], targets_m, time_s)
            reached &= ~np.isin(hits.materials, (Material.GLASS, Material.MIRROR))
            self._seen["camera"][unseen[reached]] = True

    def outline(self) -> WorldOutline:
        """The outline of the world, with what was visible so far."""
        world = self._simulation.world
        obstacles = []
        for number, outline in enumerate(self._outlines):
            own = slice(self._starts[number], self._starts[number + 1])
            seen_by = {name: find_runs(seen[own]) for name, seen in self._seen.items()}
            obstacles.append(replace(outline, seen_by=seen_by))
        return WorldOutline(
            robot_height_m=ROBOT_HEIGHT_M,
            obstacles=tuple(obstacles),
            lines=world.lines,
            angles=world.angles,
        )

    def _has_height(self, height_m: float) -> BoolArray:
        stands: BoolArray = (self._spans_m[:, 0] <= height_m) & (height_m <= self._spans_m[:, 1])
        return stands

    def _points_at_height(
        self, chosen: np.ndarray[tuple[int], np.dtype[np.int64]], z: float
    ) -> FloatArray:
        return np.column_stack([self._samples_m[chosen], np.full(len(chosen), z)])

    def _reaches_targets(
        self, eye_m: FloatArray, targets_m: FloatArray, time_s: float
    ) -> tuple[BoolArray, Hits]:
        """(N,): whether the ray to each target (N, 3) first meets the world there."""
        directions = targets_m - eye_m
        hits = self._caster.cast(eye_m, directions, time_s)
        along_floor_m = np.hypot(directions[:, 0], directions[:, 1])
        met: BoolArray = np.abs(hits.distance - 1.0) * along_floor_m <= _REACHED_TOLERANCE_M
        return met, hits
