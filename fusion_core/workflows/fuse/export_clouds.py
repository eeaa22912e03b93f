"""Point clouds of what ``fuse`` repaired, in the map frame: the LiDAR's beams and the depth."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.evaluation.fuse_folder import (
    FuseFolder,
    open_fuse_folder,
    read_mount,
    read_roll_rad,
)
from fusion_core.exporting.clouds import write_cloud
from fusion_core.exporting.manifest import require_intact
from fusion_core.exporting.output_folder import RunRequest, plan_output, results_folder
from fusion_core.mapping.voxel_cloud import VoxelCloud
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import NS_PER_MS, FloatArray
from fusion_core.model.errors import MissingStream, RecordingError
from fusion_core.model.geometry import invert_transform, transform_from_planar, transform_points
from fusion_core.model.given_extrinsics import CameraPose, GivenExtrinsics
from fusion_core.model.progress import Progress, silent
from fusion_core.model.rig import Mount
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.fuse.session import FuseOptions, Session, open_session
from fusion_core.workflows.fuse.settings import chain_settings
from fusion_core.workflows.recorded_poses import PoseLookup, recorded_poses
from fusion_core.workflows.source import input_files, open_source

_SUFFIXES = (".ply", ".pcd")


@dataclass(frozen=True, kw_only=True)
class CloudExport:
    """What was written: ``points`` by the cloud's name, ``notes`` for people."""

    output: Path
    points: dict[str, int]
    notes: tuple[str, ...]


def export_clouds(
    recording: Path,
    results: Path,
    output: Path,
    options: FuseOptions,
    *,
    voxel_m: float = 0.02,
    progress: Progress = silent,
) -> CloudExport:
    """Write ``lidar`` and ``depth`` as .ply and .pcd into ``output``.

    ``results``: the folder that ``fuse`` wrote from ``recording`` with ``options``. Heights count
    from the LiDAR's plane. One point is kept for each voxel, so memory follows the surfaces and not
    the length of the recording.

    Raises MissingStream where no poses are recorded, MappingFailed where a cloud becomes too large,
    ExportError for the folder, RecordingError where results and recording do not belong together.
    """
    require_intact(results, ("settings.toml", "alignment.json", "fused.mcap"), "fuse")
    preset, settings = chain_settings("default", results / "settings.toml", None)
    fuse_folder = open_fuse_folder(results)
    mount = read_mount(fuse_folder)
    fused_file = results / "fused.mcap"
    with open_source(recording, options.room) as opened, open_recording(fused_file) as fused:
        session = open_session(opened, options, settings, _given_extrinsics(fuse_folder))
        if roll_rad := read_roll_rad(fuse_folder):
            session = replace(session, rig=session.rig.rolled(roll_rad))
        poses = None
        if session.virtual_row is None:
            poses = recorded_poses(opened, session.streams, session.rig.lidar_frame)
        if poses is None:
            raise MissingStream(
                "has no recorded poses of the LiDAR, so there is no map frame to put clouds in.",
                file=recording,
                advice="Use a recording with TF, odometry or a pose topic.",
            )
        request = RunRequest(
            command="export",
            inputs=[*input_files(opened), fused_file],
            settings_text=json.dumps({"preset": preset, "voxel_m": voxel_m}),
            seed=settings.registration.seed,
        )
        plan = plan_output(output, request, force=True, progress=progress)
        clouds = {"lidar": VoxelCloud(voxel_m), "depth": VoxelCloud(voxel_m)}
        applied_ms = mount.clock_offset_ms if options.apply_clock_offset else 0.0
        topics = {camera.topic: i for i, camera in enumerate(session.rig.cameras)}
        lidar_topic = session.streams.lidar
        raw_scans = _raw_scans(session)
        total = sum(topic.count for topic in fused.topics if topic.role in ("lidar", "depth"))
        for done, message in enumerate(fused.messages([str(lidar_topic), *topics]), start=1):
            progress(done, total, "collecting points")
            value = message.value
            if isinstance(value, LaserScan):
                raw = next(raw_scans, None)
                if raw is None or raw.stamp_ns != value.stamp_ns:
                    raise RecordingError(
                        "its scans are not those of the results.",
                        file=recording,
                        advice="Build the results again.",
                    )
                _add_in_map(clouds["lidar"], _beams_m(raw, value), poses, value.stamp_ns)
            elif isinstance(value, DepthImage):
                points_m = _pixels_m(session, topics[message.topic], value, mount)
                stamp_ns = value.stamp_ns - round(applied_ms * NS_PER_MS)
                _add_in_map(clouds["depth"], points_m, poses, stamp_ns)
        with results_folder(plan) as folder:
            points = {}
            for name, cloud in clouds.items():
                points_m = cloud.points_m()
                points[name] = len(points_m)
                for suffix in _SUFFIXES if points[name] else ():
                    progress(0, None, f"writing {name}{suffix}")
                    write_cloud(folder / f"{name}{suffix}", points_m)
    return CloudExport(
        output=output, points=points, notes=tuple(_notes(session, fuse_folder.alignment))
    )


def _given_extrinsics(folder: FuseFolder) -> GivenExtrinsics | None:
    """Those that a person gave to the run, None where it had none."""
    source = folder.alignment.get("given_extrinsics")
    if source is None:
        return None
    cameras: dict[str | None, CameraPose] = {
        camera.topic: CameraPose(T_camera_lidar=invert_transform(camera.T_lidar_camera))
        for camera in folder.cameras
        if camera.T_lidar_camera is not None
    }
    return GivenExtrinsics(source=str(source), cameras=cameras)


def _raw_scans(session: Session) -> Iterator[LaserScan]:
    """The recording's scans as the results have them, each once and in the same order."""
    messages = session.recording.messages([str(session.streams.lidar)])
    for message in session.geometry_filter.accepted(messages):
        if isinstance(message.value, LaserScan):
            yield message.value


def _add_in_map(
    cloud: VoxelCloud, in_lidar_m: FloatArray, poses: PoseLookup, stamp_ns: int
) -> None:
    pose = poses.at(stamp_ns)
    if pose is not None:
        cloud.add(transform_points(transform_from_planar(pose), in_lidar_m))


def _beams_m(raw: LaserScan, repaired: LaserScan) -> FloatArray:
    """(N, 3) in the LiDAR's frame. A burr that nothing could repair is no surface."""
    ranges_m = repaired.ranges_m
    # The results hold 32 bits of each range.
    unchanged = ranges_m.astype(np.float32) == raw.ranges_m.astype(np.float32)
    burr = repaired.intensities == float(NoiseClass.BURR)
    kept = np.isfinite(ranges_m) & (ranges_m <= raw.range_max_m) & ~(burr & unchanged)
    angles_rad = raw.angles_rad[kept]
    across_m = np.stack([np.cos(angles_rad), np.sin(angles_rad), np.zeros(angles_rad.size)], axis=1)
    points_m: FloatArray = ranges_m[kept, np.newaxis] * across_m
    return points_m


def _pixels_m(session: Session, camera: int, image: DepthImage, mount: Mount) -> FloatArray:
    """(N, 3) in the LiDAR's frame."""
    model = session.rig.cameras[camera]
    depth_m = session.depth_of(camera, image.depth_m)
    rows, columns = np.nonzero(depth_m > 0.0)
    in_camera_m = depth_m[rows, columns, np.newaxis] * model.rays(rows, columns)
    return transform_points(mount.T_lidar_rig @ model.T_rig_camera, in_camera_m)


def _notes(session: Session, alignment: Mapping[str, Any]) -> Iterator[str]:
    for camera in session.rig.cameras:
        if not camera.calibrated:
            yield f"{camera.topic} has no intrinsics: an assumed field of view shapes its cloud."
    if alignment["row_model"] == "row":
        yield "The camera's height above the LiDAR is not known: the depth may lie too high or low."
