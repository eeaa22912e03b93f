"""What a run of ``scanloom map`` reads: the scans to place, their odometry, and those to draw."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from fusion_core.model.progress import Progress
from fusion_core.model.recording import Recording
from fusion_core.recordings.calibration_files.extrinsics import read_given_extrinsics
from fusion_core.recordings.topics import Streams
from fusion_core.worker_processes import WorkerPool
from fusion_core.workflows.map.extrinsics import find_extrinsics
from fusion_core.workflows.map.motion_prior import (
    MotionPrior,
    choose_map_streams,
    open_motion_prior,
)
from fusion_core.workflows.map.occupancy_maps import CameraBeams
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.recorded_sensors import RecordedSensors
from fusion_core.workflows.map.scan_source import LidarScans, ScanSource, open_scans
from fusion_core.workflows.map.settings import MapSettings
from fusion_core.workflows.recorded_poses import recorded_poses


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapInput:
    """``scans``: those that SLAM places, with ``motion`` as its prior, None for none.

    ``drawn``: the scans of each map, by its name. ``has_camera_layer``: whether the merged map is
    drawn of the camera's beams only, to be overlaid on the LiDAR's map.
    """

    streams: Streams
    scans: ScanSource
    motion: MotionPrior | None
    drawn: Mapping[str, ScanSource]
    has_camera_layer: bool

    @property
    def notes(self) -> list[str]:
        """For people, complete once the scans were read."""
        if self.motion is None:
            motion = ["Without odometry the length of a bare corridor is a guess."]
        else:
            motion = [f"Motion from {self.motion.source}.", *self.motion.notes]
        return [*self.streams.notes, *motion, *self.scans.notes]


def open_map_input(
    recording: Recording,
    options: MapOptions,
    settings: MapSettings,
    pool: WorkerPool,
    progress: Progress,
) -> MapInput:
    """Open the scans and estimate their odometry by the options of a run. ``pool``: the processes
    that repair the scans."""
    streams = choose_map_streams(recording, options.lidar_topic, options.pose_topic)
    sensors = RecordedSensors(
        recording=recording, streams=streams, clock_offset_ms=options.clock_offset_ms
    )
    lidar = LidarScans(recording, streams) if streams.lidar is not None else None
    # Only virtual scans need the odometry before the scans: they move clouds to other instants.
    recorded = None
    if options.has_virtual_scans and lidar is not None:
        recorded = recorded_poses(recording, streams, lidar.frame_id)
    if options.has_virtual_scans or options.extrinsics_file is not None:
        extrinsics = find_extrinsics(
            recording, streams, settings, file=options.extrinsics_file, progress=progress
        )
        sensors = replace(sensors, extrinsics=extrinsics)
    if options.extrinsics_file is not None:
        sensors = replace(sensors, given=read_given_extrinsics(options.extrinsics_file))
    scans = open_scans(
        sensors,
        options.scan,
        settings.virtual_scan,
        chain=settings,
        prior=recorded.at if recorded else None,
        labels=options.labels,
        pool=pool,
        progress=progress,
    )
    motion = open_motion_prior(sensors, scans, options.motion, settings, progress)
    has_camera_layer = options.scan == "merged" and settings.virtual_scan.layers
    drawn: dict[str, ScanSource] = {}
    if lidar is not None and options.scan != "lidar":
        drawn["lidar"] = lidar
    drawn[options.scan] = CameraBeams(scans) if has_camera_layer else scans
    return MapInput(
        streams=streams,
        scans=scans,
        motion=motion,
        drawn=drawn,
        has_camera_layer=has_camera_layer,
    )
