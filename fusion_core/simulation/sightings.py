"""Which parts of the outlines each sensor could see on its way, by rays against the world.

A sample of an outline could be seen from a pose when a ray from the sensor to it, at a height at
which the sensor looks and the obstacle stands, first meets the world there. Noise and the chance
that no beam of a coarse sweep hits the sample do not count; range, field of view and panes do.
"""

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.world_outline import ObstacleOutline, WorldOutline, runs_of
from fusion_core.simulation.observer import Setup
from fusion_core.simulation.ray_casting import Hits, RayCaster
from fusion_core.simulation.solids import Material
from fusion_core.simulation.standing import FLOOR_M, ROBOT_HEIGHT_M

# The camera looks for an obstacle at these heights above the floor.
_HEIGHTS_M = np.arange(FLOOR_M + 0.01, ROBOT_HEIGHT_M, 0.03)
# How far from the sample, along the floor, the ray may end.
_THERE_M = 0.01


class Sightings:
    """Collects what the sensors could see, pose by pose; memory is that of the outline."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._caster = RayCaster(setup.world)
        self._outlines = [
            ObstacleOutline(
                name=standing.name,
                z_min_m=standing.heights_m[0],
                z_max_m=standing.heights_m[1],
                outline_m=standing.outline_m,
                seen_by={},
            )
            for standing in setup.world.obstacles
        ]
        counts = [outline.sample_count for outline in self._outlines]
        self._starts = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
        samples = [outline.samples_m() for outline in self._outlines]
        self._samples_m: FloatArray = np.concatenate([np.zeros((0, 2)), *samples])
        heights = [outline.heights_m for outline in setup.world.obstacles]
        spans = np.array(heights, dtype=np.float64).reshape(-1, 2)
        self._spans_m: FloatArray = np.repeat(spans, counts, axis=0)
        total = len(self._samples_m)
        self._seen = {name: np.zeros(total, dtype=np.bool_) for name in ("lidar", "camera")}

    def sweep(self, T_world_base: FloatArray, time_s: float) -> None:
        """What a sweep from there could meet."""
        mount = self._setup.rig.lidar
        T_world_lidar = T_world_base @ mount.T_base_lidar
        height_m = float(T_world_lidar[2, 3])
        left = np.flatnonzero(~self._seen["lidar"] & self._stands_at(height_m))
        targets_m = self._at_height(left, height_m)
        in_lidar = transform_points(invert_transform(T_world_lidar), targets_m)
        range_m = np.hypot(in_lidar[:, 0], in_lidar[:, 1])
        azimuth = np.arctan2(in_lidar[:, 1], in_lidar[:, 0])
        # Around the whole circle the last beam's neighbour is the first.
        half_rad = -mount.angle_min_rad + 0.5 * mount.angle_increment_rad
        inside = (range_m >= mount.range_min_m) & (range_m <= mount.range_max_m)
        inside &= np.abs(azimuth) <= half_rad
        left, targets_m = left[inside], targets_m[inside]
        met, hits = self._meets(T_world_lidar[:3, 3], targets_m, time_s)
        # A pane answers only where its mirror image of the emitter meets the receiver.
        front = np.cos(self._setup.lidar_noise.glass_front_rad)
        met &= (hits.materials != Material.GLASS) | (hits.incidence_cos >= front)
        self._seen["lidar"][left[met]] = True

    def image(self, camera: int, T_world_base: FloatArray, time_s: float) -> None:
        """What a depth image of a camera from there could show."""
        mount, noise = self._setup.rig.cameras[camera], self._setup.depth_noise
        lens = mount.intrinsics
        T_world_optical = T_world_base @ mount.T_base_optical
        T_optical_world = invert_transform(T_world_optical)
        for height_m in _HEIGHTS_M:
            left = np.flatnonzero(~self._seen["camera"] & self._stands_at(float(height_m)))
            targets_m = self._at_height(left, float(height_m))
            x, y, z = transform_points(T_optical_world, targets_m).T
            ahead = (z >= noise.near_m) & (z <= noise.far_m)
            depth = np.where(ahead, z, 1.0)
            u, v = lens.cx + lens.fx * x / depth, lens.cy + lens.fy * y / depth
            inside = ahead & (u >= -0.5) & (u < lens.width - 0.5)
            inside &= (v >= -0.5) & (v < lens.height - 0.5)
            left, targets_m = left[inside], targets_m[inside]
            met, hits = self._meets(T_world_optical[:3, 3], targets_m, time_s)
            met &= hits.materials != Material.GLASS
            self._seen["camera"][left[met]] = True

    def outline(self) -> WorldOutline:
        """The world's outline with what was seen of it until now."""
        world = self._setup.world
        obstacles = []
        for number, outline in enumerate(self._outlines):
            own = slice(self._starts[number], self._starts[number + 1])
            obstacles.append(
                ObstacleOutline(
                    name=outline.name,
                    z_min_m=outline.z_min_m,
                    z_max_m=outline.z_max_m,
                    outline_m=outline.outline_m,
                    seen_by={name: runs_of(seen[own]) for name, seen in self._seen.items()},
                )
            )
        return WorldOutline(
            robot_height_m=ROBOT_HEIGHT_M,
            obstacles=tuple(obstacles),
            lines=world.lines,
            angles=world.angles,
        )

    def _stands_at(self, height_m: float) -> BoolArray:
        stands: BoolArray = (self._spans_m[:, 0] <= height_m) & (height_m <= self._spans_m[:, 1])
        return stands

    def _at_height(
        self, chosen: np.ndarray[tuple[int], np.dtype[np.int64]], z: float
    ) -> FloatArray:
        return np.column_stack([self._samples_m[chosen], np.full(len(chosen), z)])

    def _meets(
        self, eye_m: FloatArray, targets_m: FloatArray, time_s: float
    ) -> tuple[BoolArray, Hits]:
        """(N,): whether the ray to each target (N, 3) first meets the world there."""
        directions = targets_m - eye_m
        hits = self._caster.cast(eye_m, directions, time_s)
        along_floor_m = np.hypot(directions[:, 0], directions[:, 1])
        met: BoolArray = np.abs(hits.distance - 1.0) * along_floor_m <= _THERE_M
        return met, hits
