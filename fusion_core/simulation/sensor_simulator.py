"""Simulates what the sensors on a robot report at any instant, and the ground truth."""

from dataclasses import dataclass, field

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray
from fusion_core.model.geometry import (
    planar_from_transform,
    transform_from_planar,
    transform_points,
)
from fusion_core.simulation import depth_camera, lidar
from fusion_core.simulation.colors import shade
from fusion_core.simulation.depth_camera import DepthNoise, DepthView
from fusion_core.simulation.lidar import LidarNoise, LidarView
from fusion_core.simulation.paths import RobotPath
from fusion_core.simulation.random_streams import RandomStream, make_generator
from fusion_core.simulation.ray_casting import RayCaster
from fusion_core.simulation.sensor_mounts import SensorMounts
from fusion_core.simulation.solids import Material
from fusion_core.simulation.worlds import World


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulationSetup:
    """A world, and a robot with its sensors that drives through it.

    ``lidar_skew``: whether the robot moves during a sweep; otherwise all beams share one pose.
    """

    world: World
    mounts: SensorMounts
    path: RobotPath
    seed: int
    lidar_skew: bool = False
    lidar_noise: LidarNoise = field(default_factory=LidarNoise)
    depth_noise: DepthNoise = field(default_factory=DepthNoise)


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
        glass = hits.materials == Material.GLASS
        # A millimetre past the pane, so that it is not met again.
        past_m = true_m[glass] + 0.001
        beyond = self._caster.cast(
            origins_m[glass] + past_m[:, None] * directions[glass], directions[glass], time_s
        )
        behind_m = np.full(mount.beams, np.nan)
        behind_m[glass] = past_m + _require_finite(beyond.distance)
        noisy = lidar.add_noise(
            LidarView(
                true_m=true_m,
                incidence_cos=hits.incidence_cos,
                glass=glass,
                dark=hits.materials == Material.DARK,
                behind_m=behind_m,
            ),
            simulation.lidar_noise,
            (mount.range_min_m, mount.range_max_m),
            make_generator(simulation.seed, RandomStream.LIDAR, index),
        )
        return SimulatedSweep(ranges_m=noisy.ranges_m, true_m=true_m, kinds=noisy.kinds)

    def simulate_image(self, camera: int, time_s: float, index: int) -> SimulatedImage:
        """The ``index``-th image of a camera, taken at ``time_s``."""
        simulation, mount = self._simulation, self._simulation.mounts.cameras[camera]
        T_world_optical = self._T_world_base(time_s) @ mount.T_base_optical
        directions = self._rays[camera] @ T_world_optical[:3, :3].T
        eye_m = T_world_optical[:3, 3]
        hits = self._caster.cast(eye_m, directions, time_s)
        depth_m = _require_finite(hits.distance)
        points_m = eye_m + depth_m[:, None] * directions
        baseline_m = np.array([simulation.depth_noise.projector_baseline_m, 0.0, 0.0])
        shadowed = self._caster.blocked(
            points_m, transform_points(T_world_optical, baseline_m), time_s
        )
        shape = (mount.intrinsics.height, mount.intrinsics.width)
        noisy = depth_camera.add_noise(
            DepthView(
                true_m=depth_m.reshape(shape),
                incidence_cos=hits.incidence_cos.reshape(shape),
                glass=(hits.materials == Material.GLASS).reshape(shape),
                dark=(hits.materials == Material.DARK).reshape(shape),
                shadowed=shadowed.reshape(shape),
            ),
            simulation.depth_noise,
            make_generator(simulation.seed, RandomStream.CAMERA, camera, index),
        )
        return SimulatedImage(
            depth_m=noisy.depth_m,
            true_m=depth_m.reshape(shape),
            kinds=noisy.kinds,
            rgb=shade(points_m, hits, fine=simulation.world.fine_texture).reshape(*shape, 3),
        )

    def lidar_pose(self, time_s: float) -> FloatArray:
        """(x, y, yaw) of the LiDAR in the world."""
        return planar_from_transform(
            self._T_world_base(time_s) @ self._simulation.mounts.lidar.T_base_lidar
        )

    def base_pose(self, time_s: float) -> FloatArray:
        """(x, y, yaw) of the robot's base in the world."""
        return self._simulation.path.pose(time_s)

    def _T_world_base(self, time_s: float) -> FloatArray:
        return transform_from_planar(self.base_pose(time_s))


def _require_finite(distance: FloatArray) -> FloatArray:
    if not np.isfinite(distance).all():
        raise ValueError("a ray leaves the world: worlds must be closed")
    return distance
