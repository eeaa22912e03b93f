"""The scans that motion and SLAM work on, read again in each pass."""

from collections.abc import Iterator
from typing import Literal, Protocol

from fusion_core.mapping.virtual_scan import VirtualScanSettings
from fusion_core.model.errors import MissingStream
from fusion_core.model.labels import LabelLayer
from fusion_core.model.planar_poses import PosePrior
from fusion_core.model.progress import Progress, silent
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import LaserScan
from fusion_core.recordings.topics import Streams
from fusion_core.worker_processes import WorkerPool
from fusion_core.workflows.fuse.settings import ChainSettings
from fusion_core.workflows.map.extrinsics import find_extrinsics
from fusion_core.workflows.map.recorded_sensors import RecordedSensors
from fusion_core.workflows.map.repaired_scans import RepairedScans
from fusion_core.workflows.map.virtual_scans import CameraScans, MergedScans
from fusion_core.workflows.sensor_geometry import first_scan
from fusion_core.workflows.stamp_filter import StampFilter

ScanKind = Literal["lidar", "camera", "repaired", "merged"]


class ScanSource(Protocol):
    """Scans with increasing stamps, which can be iterated any number of times.

    ``frame_id``: the frame in which they lie. ``recorded_count``: how many the recording holds,
    with those that are left out. ``notes``: for people, complete after the last scan was read.
    """

    frame_id: str
    recorded_count: int

    @property
    def notes(self) -> tuple[str, ...]: ...

    def __iter__(self) -> Iterator[LaserScan]: ...


class LidarScans:
    """The scans of a topic as they were recorded."""

    def __init__(self, recording: Recording, streams: Streams) -> None:
        if streams.lidar is None:
            raise MissingStream(
                "holds no LaserScan.",
                file=recording.path,
                advice="scanloom info lists what it holds.",
            )
        self._recording, self._topic = recording, streams.lidar
        self._order = StampFilter(recording)
        self.recorded_count = recording.received_ns(streams.lidar).size
        self.frame_id = first_scan(recording, streams.lidar).frame_id

    @property
    def notes(self) -> tuple[str, ...]:
        return ()

    def __iter__(self) -> Iterator[LaserScan]:
        for message in self._order.accepted(self._recording.messages([self._topic])):
            if isinstance(message.value, LaserScan):
                yield message.value


def open_scans(
    sensors: RecordedSensors,
    kind: ScanKind,
    settings: VirtualScanSettings | None = None,
    *,
    chain: ChainSettings | None = None,
    prior: PosePrior | None = None,
    labels: LabelLayer | None = None,
    pool: WorkerPool | None = None,
    progress: Progress = silent,
) -> ScanSource:
    """The scans of a kind.

    "lidar": as recorded. "camera": virtual scans of the depth cameras, one for each image, in the
    LiDAR's frame, or level below the camera where the recording has no LiDAR. "merged": the LiDAR's
    with what the cameras saw at their times. "repaired": the LiDAR's as Xu's chain repairs them.

    ``settings``: of virtual scans. ``chain``: of the repair, and of the alignment that finds the
    extrinsics where ``sensors`` have none. ``prior``: odometry of the scans' frame, which moves a
    camera's cloud to the stamp of its scan; without it by the motion between the scans.
    ``labels``: a person's, which overrule the classes of the repair. ``pool``: the processes that
    repair, by default this one.

    Raises MissingStream for what the recording lacks, AlignmentFailed where mount or floor cannot
    be found.
    """
    settings, chain = settings or VirtualScanSettings(), chain or ChainSettings()
    recording, streams = sensors.recording, sensors.streams
    if kind == "lidar":
        return LidarScans(recording, streams)
    if kind == "repaired":
        return RepairedScans(sensors, chain, labels=labels, pool=pool, progress=progress)
    if kind == "merged" and streams.lidar is None:
        raise MissingStream(
            "has no 2D LiDAR to merge the camera with.",
            file=recording.path,
            advice="Use --scan camera.",
        )
    extrinsics = sensors.extrinsics or find_extrinsics(recording, streams, chain, progress=progress)
    if kind == "camera":
        return CameraScans(sensors, extrinsics, settings, prior=prior)
    return MergedScans(sensors, extrinsics, settings, prior=prior)
