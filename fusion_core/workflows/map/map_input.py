"""What a run of ``scanloom map`` reads: the scans to place, their odometry, and those to draw."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from fusion_core.model.progress import Progress
from fusion_core.model.recording import Recording
from fusion_core.recordings.calibration_files.extrinsics import read_given_extrinsics
from fusion_core.recordings.topics import Streams
from fusion_core.worker_processes import WorkerPool
from fusion_core.workflows.map.extrinsics import find_extrinsics
from fusion_core.workflows.map.grid_fusion import require_two_sensors
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

    ``drawn``: the scans of each map, by its name; for a fusion the LiDAR's own and the camera's
    own, which share no beam. ``has_camera_layer``: whether the merged map is drawn of the camera's
    beams only, to be overlaid on the LiDAR's map.
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
        sources = (self.scans, *self.drawn.values())
        # Two sources of one camera have the same notes on its mount.
        scans = dict.fromkeys(note for source in sources for note in source.notes)
        return [*self.streams.notes, *motion, *scans]


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
    if options.fusion != "none":
        require_two_sensors(recording, streams, options.fusion)
    # Only virtual scans need the odometry before the scans: they move clouds to other instants.
    recorded = None
    if options.draws_camera and lidar is not None:
        recorded = recorded_poses(recording, streams, lidar.frame_id)
    if options.draws_camera or options.extrinsics_file is not None:
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
    # The ranges of merged scans are in part the LiDAR's own: a fusion takes the camera's alone.
    has_camera_layer = (
        options.scan == "merged" and options.fusion == "none" and settings.virtual_scan.layers
    )
    drawn: dict[str, ScanSource] = {}
    if lidar is not None:
        drawn["lidar"] = lidar
    if options.fusion == "none":
        drawn[options.scan] = CameraBeams(scans) if has_camera_layer else scans
    elif options.scan == "camera":
        drawn["camera"] = scans
    else:
        drawn["camera"] = open_scans(
            sensors,
            "camera",
            settings.virtual_scan,
            chain=settings,
            prior=recorded.at if recorded else None,
            progress=progress,
        )
    return MapInput(
        streams=streams,
        scans=scans,
        motion=motion,
        drawn=drawn,
        has_camera_layer=has_camera_layer,
    )
