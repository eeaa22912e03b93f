"""Simulates what the sensors on a robot report at any instant, and the ground truth."""

from dataclasses import dataclass, field

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, ByteArray, Float32Array, FloatArray
from fusion_core.model.geometry import (
    planar_from_transform,
    transform_from_planar,
    transform_points,
)
from fusion_core.simulation import depth_camera, lidar
from fusion_core.simulation.colors import cell_draw, shade, shade_painted
from fusion_core.simulation.corners import corner_distance_in_image, corner_distance_in_sweep
from fusion_core.simulation.depth_camera import DepthNoise, DepthView
from fusion_core.simulation.lidar import LidarNoise, LidarView
from fusion_core.simulation.paint import PaintReader
from fusion_core.simulation.paths import RobotPath
from fusion_core.simulation.random_streams import RandomStream, make_generator
from fusion_core.simulation.ray_casting import Hits, RayCaster
from fusion_core.simulation.reflections import second_surfaces
from fusion_core.simulation.sensor_mounts import SensorMounts
from fusion_core.simulation.solids import Material
from fusion_core.simulation.worlds import World

# Size of the parts of a pane or a mirror of which each shows something to a camera, or does not.
_PATCH_M = 0.08


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulationSetup:
    """A world, and a robot with its sensors that drives through it.

    ``lidar_skew``: whether the robot moves during a sweep; otherwise all beams share one pose.
    ``rolling_s``: time from the first to the last row of a depth image, 0 for one instant. People
    stand still during one sweep or image. ``color_sigma``: standard deviation of a colour's noise,
    of 255.
    """

    world: World
    mounts: SensorMounts
    path: RobotPath
    seed: int
    lidar_skew: bool = False
    rolling_s: float = 0.0
    lidar_noise: LidarNoise = field(default_factory=LidarNoise)
    depth_noise: DepthNoise = field(default_factory=DepthNoise)
    color_sigma: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedSweep:
    """``ranges_m``: (N,) as reported, NaN where lost. ``true_m``: (N,). ``kinds``: (N,) uint8."""

    ranges_m: FloatArray
    true_m: FloatArray
    kinds: ByteArray


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedImage:
    """``depth_m``: (H, W) as reported, NaN where lost. ``true_m``: (H, W) z along the optical
    axis. ``kinds``: (H, W) uint8. ``rgb``: (H, W, 3) uint8.
    """

    depth_m: Float32Array
    true_m: FloatArray
    kinds: ByteArray
    rgb: ByteArray

    def darkened(self) -> "SimulatedImage":
        """The same view when the camera reports nothing: every pixel a hole, and black."""
        return SimulatedImage(
            depth_m=np.full_like(self.depth_m, np.nan),
            true_m=self.true_m,
            kinds=np.full_like(self.kinds, NoiseClass.HOLE),
            rgb=np.zeros_like(self.rgb),
        )


class SensorSimulator:
    """Simulates sweeps and images. Each has its own random stream, so their order is free.

    Times are seconds since the start of the recording.
    """

    def __init__(self, simulation: SimulationSetup) -> None:
        self._simulation = simulation
        self._caster = RayCaster(simulation.world)
        paint = simulation.world.paint
        self._paint = None if paint is None else PaintReader(paint)
        self._rays = [
            depth_camera.pixel_rays(camera.intrinsics) for camera in simulation.mounts.cameras
        ]
        mount = simulation.mounts.lidar
        azimuth = mount.angle_min_rad + np.arange(mount.beams) * mount.angle_increment_rad
        self._beams = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=1)

    def simulate_sweep(self, time_s: float, index: int) -> SimulatedSweep:
        """The LiDAR's ``index``-th sweep, whose first beam leaves at ``time_s``."""
        simulation, mount = self._simulation, self._simulation.mounts.lidar
        delay_s = (
            np.arange(mount.beams) * mount.time_increment_s if simulation.lidar_skew else [0.0]
        )
        T_world_lidar = np.stack(
            [self._T_world_base(time_s + delay) @ mount.T_base_lidar for delay in delay_s]
        )
        directions = np.einsum(
            "nij,nj->ni",
            np.broadcast_to(T_world_lidar[:, :3, :3], (mount.beams, 3, 3)),
            self._beams,
        )
        origins_m = np.broadcast_to(T_world_lidar[:, :3, 3], directions.shape)
        hits = self._caster.cast(origins_m, directions, time_s)
        true_m = _require_finite(hits.distance)
        points_m = origins_m + true_m[:, None] * directions
        second = second_surfaces(self._caster, origins_m, directions, hits, time_s)
        _require_finite(second.distance)
        sunlit = self._sunlit(points_m, time_s)
        sunlit[second.rays] = self._sunlit(second.points_m, time_s)
        noisy = lidar.add_noise(
            LidarView(
                true_m=true_m,
                incidence_cos=hits.incidence_cos,
                glass=hits.materials == Material.GLASS,
                mirror=hits.materials == Material.MIRROR,
                dark=hits.materials == Material.DARK,
                sunlit=sunlit,
                behind_m=second.among(mount.beams),
                corner_m=corner_distance_in_sweep(
                    points_m, _towards_sensor(hits, directions), _is_bright(hits)
                ),
            ),
            simulation.lidar_noise,
            (mount.range_min_m, mount.range_max_m),
            make_generator(simulation.seed, RandomStream.LIDAR, index),
        )
        return SimulatedSweep(ranges_m=noisy.ranges_m, true_m=true_m, kinds=noisy.kinds)

    def simulate_image(self, camera: int, time_s: float, index: int) -> SimulatedImage:
        """The ``index``-th image of a camera, whose first row is taken at ``time_s``."""
        simulation, mount = self._simulation, self._simulation.mounts.cameras[camera]
        shape = (mount.intrinsics.height, mount.intrinsics.width)
        eyes_m, directions, projectors_m = self._rows_of_rays(camera, time_s)
        hits = self._caster.cast(eyes_m, directions, time_s)
        depth_m = _require_finite(hits.distance)
        points_m = eyes_m + depth_m[:, None] * directions
        shadowed = self._caster.blocked(points_m, projectors_m, time_s)
        second = second_surfaces(self._caster, eyes_m, directions, hits, time_s)
        _require_finite(second.distance)
        sunlit = self._sunlit(points_m, time_s)
        sunlit[second.rays] = self._sunlit(second.points_m, time_s)
        surface_draw = np.zeros(depth_m.size)
        surface_draw[second.rays] = cell_draw(points_m[second.rays], _PATCH_M)
        focal_px = mount.intrinsics.fx
        rgb = self._shade(points_m, hits, depth_m / focal_px)
        mirrored = hits.materials[second.rays] == Material.MIRROR
        seen_in_mirrors = self._shade(second.points_m, second.hits, second.distance / focal_px)
        rgb[second.rays[mirrored]] = seen_in_mirrors[mirrored]
        rgb = self._with_color_noise(rgb, camera, index)
        noisy = depth_camera.add_noise(
            DepthView(
                true_m=depth_m.reshape(shape),
                incidence_cos=hits.incidence_cos.reshape(shape),
                glass=(hits.materials == Material.GLASS).reshape(shape),
                mirror=(hits.materials == Material.MIRROR).reshape(shape),
                dark=(hits.materials == Material.DARK).reshape(shape),
                sunlit=sunlit.reshape(shape),
                shadowed=shadowed.reshape(shape),
                behind_m=second.among(depth_m.size).reshape(shape),
                surface_draw=surface_draw.reshape(shape),
                corner_m=corner_distance_in_image(
                    points_m.reshape(*shape, 3),
                    _towards_sensor(hits, directions).reshape(*shape, 3),
                    _is_bright(hits).reshape(shape),
                ),
            ),
            simulation.depth_noise,
            make_generator(simulation.seed, RandomStream.CAMERA, camera, index),
        )
        return SimulatedImage(
            depth_m=noisy.depth_m,
            true_m=depth_m.reshape(shape),
            kinds=noisy.kinds,
            rgb=rgb.reshape(*shape, 3),
        )

    def lidar_pose(self, time_s: float) -> FloatArray:
        """(x, y, yaw) of the LiDAR in the world."""
        return planar_from_transform(
            self._T_world_base(time_s) @ self._simulation.mounts.lidar.T_base_lidar
        )

    def base_pose(self, time_s: float) -> FloatArray:
        """(x, y, yaw) of the robot's base in the world."""
        return self._simulation.path.pose(time_s)

    def _rows_of_rays(
        self, camera: int, time_s: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(H * W, 3) each: origins, directions and the projector's place for the rays of a camera.

        One row is exposed after the other where the exposure rolls; otherwise the origins and the
        projector's places are (3,).
        """
        simulation, mount = self._simulation, self._simulation.mounts.cameras[camera]
        baseline_m = np.array([simulation.depth_noise.projector_baseline_m, 0.0, 0.0])
        if simulation.rolling_s == 0.0:
            T_world_optical = self._T_world_base(time_s) @ mount.T_base_optical
            directions = self._rays[camera] @ T_world_optical[:3, :3].T
            return (
                T_world_optical[:3, 3],
                directions,
                transform_points(T_world_optical, baseline_m),
            )
        height, width = mount.intrinsics.height, mount.intrinsics.width
        delays_s = np.linspace(0.0, simulation.rolling_s, height)
        T_rows = np.stack(
            [self._T_world_base(time_s + delay) @ mount.T_base_optical for delay in delays_s]
        )
        rays = self._rays[camera].reshape(height, width, 3)
        rows = np.einsum("nij,nwj->nwi", T_rows[:, :3, :3], rays).reshape(-1, 3)
        eyes_m = np.repeat(T_rows[:, :3, 3], width, axis=0)
        projectors_m = np.repeat(T_rows[:, :3, :3] @ baseline_m + T_rows[:, :3, 3], width, axis=0)
        return eyes_m, rows, projectors_m

    def _shade(self, points_m: FloatArray, hits: Hits, across_m: FloatArray) -> ByteArray:
        """(N, 3) RGB of surface points (N, 3); ``across_m``: (N,) the width of a pixel there."""
        if self._paint is None:
            return shade(points_m, hits, fine=self._simulation.world.fine_texture)
        # Seen from the side the patch is longer by 1 / cos.
        footprint_m = across_m / np.sqrt(np.maximum(hits.incidence_cos, 1e-3))
        return shade_painted(points_m, hits, self._paint, footprint_m)

    def _with_color_noise(self, rgb: ByteArray, camera: int, index: int) -> ByteArray:
        sigma = self._simulation.color_sigma
        if sigma == 0.0:
            return rgb
        rng = make_generator(self._simulation.seed, RandomStream.COLOR, camera, index)
        noisy: Float32Array = rgb + np.float32(sigma) * rng.standard_normal(rgb.shape, np.float32)
        rounded: ByteArray = np.rint(noisy.clip(0.0, 255.0)).astype(np.uint8)
        return rounded

    def _sunlit(self, points_m: FloatArray, time_s: float) -> BoolArray:
        """(N,) whether it is day or the sun shines on surface points (N, 3)."""
        sunlight = self._simulation.world.sunlight
        if sunlight is None:
            return np.zeros(len(points_m), dtype=np.bool_)
        lit, source_m = sunlight.source_of_light(points_m)
        lit[lit] = ~self._caster.blocked(points_m[lit], source_m[lit], time_s)
        return lit | sunlight.is_outside(points_m)

    def _T_world_base(self, time_s: float) -> FloatArray:
        return transform_from_planar(self.base_pose(time_s))


def _towards_sensor(hits: Hits, directions: FloatArray) -> FloatArray:
    """(N, 3) unit normals on the sensor's side of the surfaces that rays (N, 3) hit."""
    away = np.einsum("ij,ij->i", hits.normals, directions) > 0.0
    return np.where(away[:, None], -hits.normals, hits.normals)


def _is_bright(hits: Hits) -> BoolArray:
    """(N,) whether a surface passes enough light on to disturb its neighbour in a corner."""
    dull = (Material.DARK, Material.GLASS, Material.MIRROR)
    return ~np.isin(hits.materials, dull)


def _require_finite(distance: FloatArray) -> FloatArray:
    if not np.isfinite(distance).all():
        raise ValueError("a ray leaves the world: worlds must be closed")
    return distance
