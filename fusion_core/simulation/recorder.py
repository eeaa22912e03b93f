"""Writes what an observer sees at the sensors' stamps: a ROS 2 MCAP, its truth and its world."""

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
from fusion_core.simulation.observer import Image, Observer, Setup
from fusion_core.simulation.odometry import DriftingOdometry, OdometryNoise
from fusion_core.simulation.randomness import Stream, generator
from fusion_core.simulation.rigs import CameraMount
from fusion_core.simulation.sightings import Sightings
from fusion_core.simulation.truth import TruthWriter, truth_path

START_NS = 1_700_000_000 * NS_PER_S
ODOMETRY_HZ = 20.0
# Nothing triggers the camera: its first image comes a little after the first sweep.
CAMERA_DELAY_NS = 13 * NS_PER_MS
# Several cameras take turns, as their projectors would blind each other.
CAMERA_STAGGER_NS = 7 * NS_PER_MS

Extrinsics = Literal["all", "cameras", "none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Take:
    """What decides a recording.

    ``extrinsics``: what /tf_static tells: every mount ("all", and then there is a /tf), the
    cameras among themselves, or nothing. ``clock_offset_ms``: camera stamp - LiDAR stamp of the
    same instant. Where the robot is kidnapped, ``setup.path`` is a KidnappedPath.
    """

    setup: Setup
    duration_s: float
    camera_rate_hz: float
    extrinsics: Extrinsics
    clock_offset_ms: float
    odometry_noise: OdometryNoise = field(default_factory=OdometryNoise)
    faults: FaultSettings = field(default_factory=FaultSettings)


# The log time of a message, and how to write it.
_Event = tuple[int, Callable[[], None]]


def record(take: Take, path: Path, progress: Progress = silent) -> None:
    """Write a recording to ``path``, and beside it its truth and the outline of its world.

    They stand at ``truth_path`` and ``world_path``.

    Messages come in the order of their log time, one at a time, so that memory does not grow
    with the duration. Raises ExportError where a file cannot be written.
    """
    with TruthWriter(truth_path(path)) as truth, Ros2McapWriter(path) as writer:
        recorder = _Recorder(take, writer, truth)
        recorder.run(progress)
        write_world(world_path(path), recorder.sightings.outline())


class _Recorder:
    def __init__(self, take: Take, writer: Ros2McapWriter, truth: TruthWriter) -> None:
        self._take = take
        self._rig = take.setup.rig
        self._observer = Observer(take.setup)
        self.sightings = Sightings(take.setup)
        self._writer = writer
        self._truth = truth

    def run(self, progress: Progress) -> None:
        self._truth.put(self._constants())
        cameras = range(len(self._rig.cameras))
        streams = [self._static(), self._sweeps(), self._motion(), *map(self._images, cameras)]
        total_ms = round(self._take.duration_s * 1000.0)
        # At equal log times the streams keep their order.
        for received_ns, write in heapq.merge(*streams, key=lambda event: event[0]):
            write()
            done_ms = (received_ns - START_NS) // NS_PER_MS
            progress(min(done_ms, total_ms), total_ms, "recording")
        progress(total_ms, total_ms, "recording")

    def _static(self) -> Iterator[_Event]:
        transforms = self._mounts()
        if transforms:
            batch = TransformBatch(received_ns=START_NS, transforms=transforms)
            yield START_NS, partial(self._writer.write_transforms, "/tf_static", batch)

    def _sweeps(self) -> Iterator[_Event]:
        mount = self._rig.lidar
        skew = self._take.setup.lidar_skew
        faults, seed = self._take.faults, self._take.setup.seed
        for index, after_ns in enumerate(_ticks(mount.rate_hz, self._take.duration_s)):
            time_s = after_ns / NS_PER_S
            sweep = self._observer.sweep(time_s, index)
            stamp_ns = START_NS + after_ns
            self._truth.append("scan_stamp", np.array(stamp_ns, dtype=np.int64))
            self._truth.append("scan_true", sweep.true_m.astype(np.float32))
            self._truth.append("scan_kind", sweep.kinds)
            self._truth.append("pose", self._observer.lidar_pose(time_s))
            lost = faults.silent(time_s) or faults.scan_lost(seed, index)
            if faults.any:
                self._truth.append("scan_lost", np.array(lost))
            if lost:
                continue
            self.sightings.sweep(self._T_world_base(time_s), time_s)
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

    def _images(self, camera: int) -> Iterator[_Event]:
        take, mount = self._take, self._rig.cameras[camera]
        suffix = f"_{camera}" if len(self._rig.cameras) > 1 else ""
        first_ns = CAMERA_DELAY_NS + camera * CAMERA_STAGGER_NS
        offset_ns = round(take.clock_offset_ms * NS_PER_MS)
        faults = take.faults
        for index, tick_ns in enumerate(_ticks(take.camera_rate_hz, take.duration_s)):
            after_ns = first_ns + tick_ns
            time_s = after_ns / NS_PER_S
            image = self._observer.image(camera, time_s, index)
            if faults.dark(time_s):
                image = image.darkened()
            stamp_ns = START_NS + after_ns + offset_ns
            true_mm = np.rint(image.true_m * 1000.0).astype(np.uint16)
            self._truth.append(f"depth_stamp{suffix}", np.array(stamp_ns, dtype=np.int64))
            self._truth.append(f"depth_true{suffix}", true_mm)
            self._truth.append(f"depth_kind{suffix}", image.kinds)
            if faults.silent(time_s):
                continue
            if not faults.dark(time_s):
                self.sightings.image(camera, self._T_world_base(time_s), time_s)
            yield stamp_ns, partial(self._write_image, mount, stamp_ns, image)

    def _write_image(self, mount: CameraMount, stamp_ns: int, image: Image) -> None:
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

    def _motion(self) -> Iterator[_Event]:
        take, faults = self._take, self._take.faults
        rng = generator(take.setup.seed, Stream.ODOMETRY)
        odometry = DriftingOdometry(take.odometry_noise, rng)
        path, time_before_s = take.setup.path, 0.0
        for after_ns in _ticks(ODOMETRY_HZ, take.duration_s):
            time_s, stamp_ns = after_ns / NS_PER_S, START_NS + after_ns
            if isinstance(path, KidnappedPath) and time_before_s < path.at_s <= time_s:
                lifted_at, set_down_at = path.lifted()
                odometry.step(path.at_s, lifted_at, faults.slip(time_before_s))
                odometry.carried(path.at_s, set_down_at)
            slip = faults.slip(0.5 * (time_before_s + time_s))
            T_odom_base = odometry.step(time_s, self._observer.base_pose(time_s), slip)
            T_map_lidar = transform_from_planar(self._observer.lidar_pose(time_s))
            time_before_s = time_s
            heard = None if faults.silent(time_s) else T_odom_base
            yield stamp_ns, partial(self._write_motion, stamp_ns, heard, T_map_lidar)

    def _write_motion(
        self, stamp_ns: int, T_odom_base: FloatArray | None, T_map_lidar: FloatArray
    ) -> None:
        """What the odometry says, None where it is silent, and the truth, which never is."""
        if T_odom_base is not None:
            odometry = _pose_sample(stamp_ns, "odom", "base_link", T_odom_base)
            self._writer.write_odometry("/odom", odometry)
        self._writer.write_pose_stamped(
            "/ground_truth", _pose_sample(stamp_ns, "map", "", T_map_lidar)
        )
        if T_odom_base is not None and self._take.extrinsics == "all":
            moving = _transform("odom", "base_link", T_odom_base, stamp_ns)
            batch = TransformBatch(received_ns=stamp_ns, transforms=(moving,))
            self._writer.write_transforms("/tf", batch)

    def _T_world_base(self, time_s: float) -> FloatArray:
        return transform_from_planar(self._observer.base_pose(time_s))

    def _mounts(self) -> tuple[Transform, ...]:
        rig = self._rig
        if self._take.extrinsics == "all":
            sensors = [(rig.lidar.frame_id, rig.lidar.T_base_lidar)]
            sensors += [(camera.frame_id, camera.T_base_optical) for camera in rig.cameras]
            return tuple(_transform("base_link", child, T) for child, T in sensors)
        if self._take.extrinsics == "cameras":
            T_rig_base = invert_transform(rig.T_base_rig)
            return tuple(
                _transform("camera_rig", camera.frame_id, T_rig_base @ camera.T_base_optical)
                for camera in rig.cameras
            )
        return ()

    def _constants(self) -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]]:
        take, rig = self._take, self._rig
        pinholes = [camera.intrinsics for camera in rig.cameras]
        return {
            "cam_yaw": np.array(rig.camera_yaw_rad),
            "size": np.array(take.setup.world.size_m, dtype=np.float64),
            "blocks": take.setup.world.blocks_m,
            "lidar_angle_min": np.array(rig.lidar.angle_min_rad),
            "lidar_angle_increment": np.array(rig.lidar.angle_increment_rad),
            "intrinsics": np.array([(p.fx, p.fy, p.cx, p.cy) for p in pinholes]),
            "T_lidar_camera": rig.T_lidar_camera(),
            "camera_topics": np.array([camera.depth_topic for camera in rig.cameras]),
            "clock_offset_ms": np.array(take.clock_offset_ms, dtype=np.float64),
            "seed": np.array(take.setup.seed, dtype=np.int64),
            **self._faults(),
        }

    def _faults(self) -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]]:
        """When each fault begins and ends, [start, end) in ns; nothing where there is none."""
        faults, path = self._take.faults, self._take.setup.path
        spans_s = {
            "silence": (faults.silence_at_s, faults.silence_s),
            "slip": (faults.slip_at_s, faults.slip_s),
            "dark": (faults.dark_at_s, faults.dark_s),
        }
        told: dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]] = {
            f"fault_{name}_ns": np.array([_stamp_ns(start_s), _stamp_ns(start_s + length_s)])
            for name, (start_s, length_s) in spans_s.items()
            if length_s > 0.0
        }
        if isinstance(path, KidnappedPath):
            told["fault_kidnap_ns"] = np.array(_stamp_ns(path.at_s))
            # (2, 3): the base's x, y, yaw before and after.
            told["fault_kidnap_poses"] = np.stack(path.lifted())
        return told


def _stamp_ns(time_s: float) -> int:
    return START_NS + round(time_s * NS_PER_S)


def _ticks(rate_hz: float, duration_s: float) -> Iterator[int]:
    """Nanoseconds after the start of each observation of a steady sensor."""
    for index in range(round(duration_s * rate_hz)):
        yield int(index * NS_PER_S / rate_hz)


def _transform(parent: str, child: str, T: FloatArray, stamp_ns: int = START_NS) -> Transform:
    return Transform(stamp_ns=stamp_ns, parent=parent, child=child, T_parent_child=T)


def _pose_sample(stamp_ns: int, parent: str, child: str, T: FloatArray) -> PoseSample:
    return PoseSample(
        stamp_ns=stamp_ns, received_ns=stamp_ns, parent=parent, child=child, T_parent_child=T
    )
