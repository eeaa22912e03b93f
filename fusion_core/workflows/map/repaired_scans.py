"""Each scan of a recording as repaired by Xu's chain."""

from collections.abc import Iterator

from fusion_core.model.errors import MissingStream
from fusion_core.model.labels import LabelLayer
from fusion_core.model.names import printable
from fusion_core.model.progress import Progress, silent
from fusion_core.model.sensors import LaserScan
from fusion_core.worker_processes import WorkerPool
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.camera_rig import build_camera_rig
from fusion_core.workflows.fuse.frame_labels import SessionLabels
from fusion_core.workflows.fuse.fused_results import TaskResults, fused_results, prepare_to_fuse
from fusion_core.workflows.fuse.scan_queue import RepairedScanQueue, ranges_without_burrs_m
from fusion_core.workflows.fuse.session import session_of
from fusion_core.workflows.fuse.settings import ChainSettings
from fusion_core.workflows.map.recorded_sensors import RecordedSensors


class RepairedScans:
    """Scans with the ranges that the images paired with them have repaired.

    A scan without an image stays as it is. A burr that could not be repaired is NaN, and so is what
    ``labels`` reject and nothing fills. ``intensities`` are None. ``pool``: what repairs them, by
    default this process.
    """

    def __init__(
        self,
        sensors: RecordedSensors,
        settings: ChainSettings,
        *,
        labels: LabelLayer | None = None,
        pool: WorkerPool | None = None,
        progress: Progress = silent,
    ) -> None:
        recording, streams = sensors.recording, sensors.streams
        if streams.lidar is None:
            raise MissingStream(
                "has no 2D LiDAR to repair.", file=recording.path, advice="Use --scan camera."
            )
        self._pool = pool or WorkerPool(1)
        self._pool.start(prepare_to_fuse)
        rig = build_camera_rig(recording, streams, settings.sampling, given=sensors.given)
        session = session_of(recording, streams, rig, settings)
        self._alignment = align_recording(session, progress)
        self._session = self._alignment.on_rig(session)
        self._labels: SessionLabels | None = None
        if labels is not None:
            self._labels = SessionLabels(session=self._session, layer=labels)
        self._sensors = sensors
        self.frame_id = rig.lidar_frame
        self.recorded_count = recording.received_ns(streams.lidar).size
        self._scans = self._with_image = 0

    @property
    def notes(self) -> tuple[str, ...]:
        rig_notes = self._session.rig.notes
        notes = [*rig_notes, *self._alignment.notes, *self._sensors.clock_note]
        if self._labels is not None:
            name = printable(self._labels.layer.name)
            notes.append(f"The labels of {name} overrule the classes.")
        if self._with_image < self._scans:
            without = self._scans - self._with_image
            notes.append(f"{without} of {self._scans} scans have no image and stay as they were.")
        return tuple(notes)

    def __iter__(self) -> Iterator[LaserScan]:
        queue = RepairedScanQueue()
        self._scans = self._with_image = 0
        for raw, repaired in self._repaired_pairs(queue):
            self._scans += 1
            yield raw.with_ranges(ranges_without_burrs_m(raw, repaired), None)

    def _repaired_pairs(self, queue: RepairedScanQueue) -> Iterator[tuple[LaserScan, LaserScan]]:
        paired: set[int] = set()
        labels, clock_offset_ms = self._labels, self._sensors.clock_offset_ms
        for entry in fused_results(
            self._session, self._alignment, self._pool, clock_offset_ms, labels
        ):
            if isinstance(entry, LaserScan):
                queue.push(entry, None if labels is None else labels.of_scan(entry))
                for raw, repaired in queue.pop_settled():
                    paired.discard(id(raw))
                    yield raw, repaired
            elif isinstance(entry, TaskResults):
                for result in entry.results:
                    scan = entry.task.scan_of(result.camera)
                    # Two images of one scan count once.
                    self._with_image += id(scan) not in paired
                    paired.add(id(scan))
                    queue.apply_repairs(scan, result)
        yield from queue.flush()
