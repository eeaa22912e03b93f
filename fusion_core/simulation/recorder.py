"""Simulates a run and writes it: a ROS 2 MCAP file, its ground truth and its world."""

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from fusion_core.model.conventions import NS_PER_MS, NS_PER_S, FloatArray
from fusion_core.model.geometry import invert_transform, transform_from_planar
from fusion_core.model.progress import Progress, silent
from fusion_core.model.sensors import (
    CameraInfo,
    ColorImage,
    DepthImage,
    LaserScan,
    PoseSample,
    Transform,
    TransformBatch,
)
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from fusion_core.recordings.world_file import world_path, write_world
from fusion_core.simulation.faults import FaultSettings, KidnappedPath
from fusion_core.simulation.odometry import DriftingOdometry, OdometryNoise
from fusion_core.simulation.random_streams import RandomStream, make_generator
from fusion_core.simulation.sensor_mounts import CameraMount
from fusion_core.simulation.sensor_simulator import SensorSimulator, SimulatedImage, SimulationSetup
from fusion_core.simulation.truth import TruthWriter, simulated_errors, truth_path
from fusion_core.simulation.visibility import VisibilityTracker

START_NS = 1_700_000_000 * NS_PER_S
ODOMETRY_HZ = 20.0
# The camera is not triggered by the LiDAR: its first image comes a little after the first sweep.
CAMERA_DELAY_NS = 13 * NS_PER_MS
# Several cameras take turns, as their projectors would blind each other.
CAMERA_STAGGER_NS = 7 * NS_PER_MS

PublishedMounts = Literal["all", "cameras", "none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedRun:
    """Everything that determines a synthetic recording.

    ``published_mounts``: the mounts in /tf_static: of every sensor ("all", and then there is a
    /tf too), of the cameras relative to each other ("cameras"), or none. ``clock_offset_ms``:
    camera stamp - LiDAR stamp of the same instant. Where the robot is kidnapped,
    ``simulation.path`` is a KidnappedPath.
    """

    simulation: SimulationSetup
    duration_s: float
    camera_rate_hz: float
    published_mounts: PublishedMounts
    clock_offset_ms: float
    odometry_noise: OdometryNoise = field(default_factory=OdometryNoise)
    faults: FaultSettings = field(default_factory=FaultSettings)


# The log time of a message, and how to write it.
_Event = tuple[int, Callable[[], None]]


def record_run(run: SimulatedRun, path: Path, progress: Progress = silent) -> None:
    """Write a recording, its ground truth and its world.

    The latter two are written beside ``path``, to ``truth_path`` and ``world_path``.
    Messages are written one at a time in the order of their log time, so that memory does not
    grow with the duration. Raises ExportError where a file cannot be written.
    """
    with TruthWriter(truth_path(path)) as truth, Ros2McapWriter(path) as writer:
        recorder = _Recorder(run, writer, truth)
        recorder.run(progress)
        write_world(world_path(path), recorder.visibility.outline())


class _Recorder:
    def __init__(self, run: SimulatedRun, writer: Ros2McapWriter, truth: TruthWriter) -> None:
        self._run = run
        self._sensor_mounts = run.simulation.mounts
        self._simulator = SensorSimulator(run.simulation)
        self.visibility = VisibilityTracker(run.simulation)
        self._writer = writer
        self._truth = truth

    def run(self, progress: Progress) -> None:
        self._truth.put(self._constant_truth())
        cameras = range(len(self._sensor_mounts.cameras))
        streams = [
            self._static_transform_events(),
            self._sweep_events(),
            self._pose_events(),
            *map(self._image_events, cameras),
        ]
        total_ms = round(self._run.duration_s * 1000.0)
        # At equal log times the streams keep their order.
        for received_ns, write in heapq.merge(*streams, key=lambda event: event[0]):
            write()
            done_ms = (received_ns - START_NS) // NS_PER_MS
            progress(min(done_ms, total_ms), total_ms, "recording")
        progress(total_ms, total_ms, "recording")

    def _static_transform_events(self) -> Iterator[_Event]:
        transforms = self._published_transforms()
        if transforms:
            batch = TransformBatch(received_ns=START_NS, transforms=transforms)
            yield START_NS, partial(self._writer.write_transforms, "/tf_static", batch)

    def _sweep_events(self) -> Iterator[_Event]:
        mount = self._sensor_mounts.lidar
        skew = self._run.simulation.lidar_skew
        faults, seed = self._run.faults, self._run.simulation.seed
        for index, after_ns in enumerate(_trigger_times_ns(mount.rate_hz, self._run.duration_s)):
            time_s = after_ns / NS_PER_S
            sweep = self._simulator.simulate_sweep(time_s, index)
            stamp_ns = START_NS + after_ns
            self._truth.append("scan_stamp", np.array(stamp_ns, dtype=np.int64))
            self._truth.append("scan_true", sweep.true_m.astype(np.float32))
            self._truth.append("scan_kind", sweep.kinds)
            self._truth.append("pose", self._simulator.lidar_pose(time_s))
            lost = faults.is_dropout(time_s) or faults.is_scan_lost(seed, index)
            if faults.has_any:
                self._truth.append("scan_lost", np.array(lost))
            if lost:
                continue
            self.visibility.add_sweep(self._T_world_base(time_s), time_s)
            scan = LaserScan(
                stamp_ns=stamp_ns,
                received_ns=stamp_ns,
                frame_id=mount.frame_id,
                angle_min_rad=mount.angle_min_rad,
                angle_increment_rad=mount.angle_increment_rad,
                range_min_m=mount.range_min_m,
                range_max_m=mount.range_max_m,
                ranges_m=sweep.ranges_m,
                scan_time_s=1.0 / mount.rate_hz,
                time_increment_s=mount.time_increment_s if skew else 0.0,
            )
            yield stamp_ns, partial(self._writer.write_laser_scan, "/scan", scan)

    def _image_events(self, camera: int) -> Iterator[_Event]:
        run, mount = self._run, self._sensor_mounts.cameras[camera]
        suffix = f"_{camera}" if len(self._sensor_mounts.cameras) > 1 else ""
        first_ns = CAMERA_DELAY_NS + camera * CAMERA_STAGGER_NS
        offset_ns = round(run.clock_offset_ms * NS_PER_MS)
        faults = run.faults
        for index, trigger_ns in enumerate(_trigger_times_ns(run.camera_rate_hz, run.duration_s)):
            after_ns = first_ns + trigger_ns
            time_s = after_ns / NS_PER_S
            image = self._simulator.simulate_image(camera, time_s, index)
            if faults.is_dark(time_s):
                image = image.darkened()
            stamp_ns = START_NS + after_ns + offset_ns
            true_mm = np.rint(image.true_m * 1000.0).astype(np.uint16)
            self._truth.append(f"depth_stamp{suffix}", np.array(stamp_ns, dtype=np.int64))
            self._truth.append(f"depth_true{suffix}", true_mm)
            self._truth.append(f"depth_kind{suffix}", image.kinds)
            if faults.is_dropout(time_s):
                continue
            if not faults.is_dark(time_s):
                self.visibility.add_image(camera, self._T_world_base(time_s), time_s)
            yield stamp_ns, partial(self._write_image, mount, stamp_ns, image)

    def _write_image(self, mount: CameraMount, stamp_ns: int, image: SimulatedImage) -> None:
        depth = DepthImage(
            stamp_ns=stamp_ns,
            received_ns=stamp_ns,
            frame_id=mount.frame_id,
            depth_m=image.depth_m,
            encoding="16UC1",
        )
        color = ColorImage(
            stamp_ns=stamp_ns, received_ns=stamp_ns, frame_id=mount.frame_id, rgb=image.rgb
        )
        info = CameraInfo(
            stamp_ns=stamp_ns,
            received_ns=stamp_ns,
            frame_id=mount.frame_id,
            intrinsics=mount.intrinsics,
        )
        self._writer.write_depth(mount.depth_topic, depth)
        self._writer.write_color(mount.color_topic, color)
        self._writer.write_camera_info(mount.info_topic, info)

    def _pose_events(self) -> Iterator[_Event]:
        run, faults = self._run, self._run.faults
        rng = make_generator(run.simulation.seed, RandomStream.ODOMETRY)
        odometry = DriftingOdometry(run.odometry_noise, rng)
        path, time_before_s = run.simulation.path, 0.0
        for after_ns in _trigger_times_ns(ODOMETRY_HZ, run.duration_s):
            time_s, stamp_ns = after_ns / NS_PER_S, START_NS + after_ns
            if isinstance(path, KidnappedPath) and time_before_s < path.at_s <= time_s:
                lifted_at, set_down_at = path.poses_around_kidnap()
                odometry.step(path.at_s, lifted_at, faults.slip_factor_at(time_before_s))
                odometry.kidnap(path.at_s, set_down_at)
            slip = faults.slip_factor_at(0.5 * (time_before_s + time_s))
            T_odom_base = odometry.step(time_s, self._simulator.base_pose(time_s), slip)
            T_map_lidar = transform_from_planar(self._simulator.lidar_pose(time_s))
            time_before_s = time_s
            T_reported = None if faults.is_dropout(time_s) else T_odom_base
            yield stamp_ns, partial(self._write_poses, stamp_ns, T_reported, T_map_lidar)

    def _write_poses(
        self, stamp_ns: int, T_odom_base: FloatArray | None, T_map_lidar: FloatArray
    ) -> None:
        """The odometry (None during a dropout) and the ground truth, which has no dropouts."""
        if T_odom_base is not None:
            odometry = _pose_sample(stamp_ns, "odom", "base_link", T_odom_base)
            self._writer.write_odometry("/odom", odometry)
        self._writer.write_pose_stamped(
            "/ground_truth", _pose_sample(stamp_ns, "map", "", T_map_lidar)
        )
        if T_odom_base is not None and self._run.published_mounts == "all":
            moving = _transform("odom", "base_link", T_odom_base, stamp_ns)
            batch = TransformBatch(received_ns=stamp_ns, transforms=(moving,))
            self._writer.write_transforms("/tf", batch)

    def _T_world_base(self, time_s: float) -> FloatArray:
        return transform_from_planar(self._simulator.base_pose(time_s))

    def _published_transforms(self) -> tuple[Transform, ...]:
        mounts = self._sensor_mounts
        if self._run.published_mounts == "all":
            sensors = [(mounts.lidar.frame_id, mounts.lidar.T_base_lidar)]
            sensors += [(camera.frame_id, camera.T_base_optical) for camera in mounts.cameras]
            return tuple(_transform("base_link", child, T) for child, T in sensors)
        if self._run.published_mounts == "cameras":
            T_rig_base = invert_transform(mounts.T_base_rig)
            return tuple(
                _transform("camera_rig", camera.frame_id, T_rig_base @ camera.T_base_optical)
                for camera in mounts.cameras
            )
        return ()

    def _constant_truth(self) -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]]:
        run, mounts = self._run, self._sensor_mounts
        pinholes = [camera.intrinsics for camera in mounts.cameras]
        return {
            "cam_yaw": np.array(mounts.camera_yaw_rad),
            "size": np.array(run.simulation.world.size_m, dtype=np.float64),
            "blocks": run.simulation.world.blocks_m,
            "lidar_angle_min": np.array(mounts.lidar.angle_min_rad),
            "lidar_angle_increment": np.array(mounts.lidar.angle_increment_rad),
            "intrinsics": np.array([(p.fx, p.fy, p.cx, p.cy) for p in pinholes]),
            "T_lidar_camera": mounts.T_lidar_camera(),
            "camera_topics": np.array([camera.depth_topic for camera in mounts.cameras]),
            "clock_offset_ms": np.array(run.clock_offset_ms, dtype=np.float64),
            "seed": np.array(run.simulation.seed, dtype=np.int64),
            "simulated_errors": simulated_errors(
                wheel=run.odometry_noise,
                lidar=run.simulation.lidar_noise,
                camera=run.simulation.depth_noise,
                **({"faults": run.faults} if run.faults.has_any else {}),
            ),
            **self._fault_intervals(),
        }

    def _fault_intervals(self) -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]]:
        """The interval [start, end) of each fault that the run has, in nanoseconds."""
        faults, path = self._run.faults, self._run.simulation.path
        spans_s = {
            "silence": (faults.silence_at_s, faults.silence_s),
            "slip": (faults.slip_at_s, faults.slip_s),
            "dark": (faults.dark_at_s, faults.dark_s),
        }
        intervals: dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]] = {
            f"fault_{name}_ns": np.array([_stamp_ns(start_s), _stamp_ns(start_s + length_s)])
            for name, (start_s, length_s) in spans_s.items()
            if length_s > 0.0
        }
        if isinstance(path, KidnappedPath):
            intervals["fault_kidnap_ns"] = np.array(_stamp_ns(path.at_s))
            # (2, 3): x, y, yaw of the base before and after.
            intervals["fault_kidnap_poses"] = np.stack(path.poses_around_kidnap())
        return intervals


def _stamp_ns(time_s: float) -> int:
    return START_NS + round(time_s * NS_PER_S)


def _trigger_times_ns(rate_hz: float, duration_s: float) -> Iterator[int]:
    """Nanoseconds after the start at which a sensor of constant rate is triggered."""
    for index in range(round(duration_s * rate_hz)):
        yield int(index * NS_PER_S / rate_hz)


def _transform(parent: str, child: str, T: FloatArray, stamp_ns: int = START_NS) -> Transform:
    return Transform(stamp_ns=stamp_ns, parent=parent, child=child, T_parent_child=T)


def _pose_sample(stamp_ns: int, parent: str, child: str, T: FloatArray) -> PoseSample:
    return PoseSample(
        stamp_ns=stamp_ns, received_ns=stamp_ns, parent=parent, child=child, T_parent_child=T
    )
