"""The tables, the repaired recording and the maps of a run, written as its frames come."""

from collections import Counter
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType

import numpy as np

from fusion_core.denoising.overruling import is_rejected
from fusion_core.exporting.tables import CsvTable, ParquetTable
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import IntArray
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.labels import CaptureLabels
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.figure_collector import FigureCollector
from fusion_core.workflows.fuse.frame_labels import SessionLabels
from fusion_core.workflows.fuse.frame_result import FrameResult
from fusion_core.workflows.fuse.fused_results import TaskResults
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.scan_queue import RepairedScanQueue
from fusion_core.workflows.fuse.sensor_maps import Confirmation, SensorMaps
from fusion_core.workflows.fuse.session import Session
from fusion_core.workflows.fuse.tables import FRAME_COLUMNS, sample_schema, unpaired_row
from fusion_core.workflows.recorded_poses import PoseLookup

# Small row groups, since the rows of an unfinished one are held in memory.
_SAMPLES_PER_GROUP = 8192


class ResultWriter:
    """Writes frames.csv, samples.parquet, fused.mcap and, where there are ``poses``, the maps.

    ``labels``: a person's. They hold outside of all pairs too: what they reject is missing in
    fused.mcap, and with them it has each image's classes on the topic TOPIC/class, an image of
    codes of NoiseClass, -1 where a pixel has none.

    ``frames`` counts the depth images, ``paired`` those that were fused, ``lidar_counts`` the beams
    of each class. ``figures`` collects what the figures show.
    """

    def __init__(
        self,
        folder: Path,
        session: Session,
        alignment: RecordingAlignment,
        poses: PoseLookup | None,
        labels: SessionLabels | None = None,
    ) -> None:
        self._folder = folder
        self._labels = labels
        self._session = session
        self._alignment = alignment
        self._topics = [camera.topic for camera in session.rig.cameras]
        lidar_topic = session.streams.lidar if session.virtual_row is None else None
        self._lidar_topic = lidar_topic or "/virtual_lidar/scan"
        self._maps = None if poses is None else _sensor_maps(session, alignment, poses)
        self._queue = RepairedScanQueue()
        self._last_stamp_ns = 0
        self.frames = self.paired = 0
        self.lidar_counts: Counter[str] = Counter()
        self.figures = FigureCollector()

    def __enter__(self) -> "ResultWriter":
        with ExitStack() as stack:
            self._frame_table = stack.enter_context(
                CsvTable(self._folder / "frames.csv", FRAME_COLUMNS)
            )
            self._sample_table = stack.enter_context(
                ParquetTable(
                    self._folder / "samples.parquet",
                    sample_schema(),
                    rows_per_group=_SAMPLES_PER_GROUP,
                )
            )
            self._mcap = stack.enter_context(Ros2McapWriter(self._folder / "fused.mcap"))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def add(self, entry: LaserScan | PairedImage | TaskResults) -> None:
        """Write what pass 2 yields: a scan, an image without one, or what came of a task."""
        if isinstance(entry, LaserScan):
            labels = self._labels
            self._queue.push(entry, None if labels is None else labels.of_scan(entry))
            for raw, repaired in self._queue.pop_settled():
                self._write_scan(raw, repaired)
            return
        if isinstance(entry, PairedImage):
            self._add_unfused(entry)
            return
        if not entry.results:
            for image in entry.task.images:
                self._add_unfused(image)
        self.figures.add(entry)
        images = {image.camera: image.image for image in entry.task.images}
        for result in entry.results:
            self._add_fused(images[result.camera], entry.task.scan_of(result.camera), result)

    def _add_unfused(self, entry: PairedImage) -> None:
        self.frames += 1
        topic = self._topics[entry.camera]
        self._frame_table.append(unpaired_row(topic, entry))
        self._write_image(topic, entry.image, entry.camera, None)

    def _add_fused(self, image: DepthImage, scan: LaserScan, result: FrameResult) -> None:
        self.frames += 1
        self.paired += 1
        self._frame_table.append(result.row)
        self._sample_table.append(result.samples)
        self._write_image(self._topics[result.camera], image, result.camera, result)
        self._queue.apply_repairs(scan, result)
        if self._maps is not None:
            self._maps.add_camera(scan, result)
        per_class = np.bincount(result.lidar_class, minlength=len(NoiseClass))
        for noise_class, count in zip(NoiseClass, per_class, strict=True):
            self.lidar_counts[noise_class.name.lower()] += int(count)
        self._last_stamp_ns = max(self._last_stamp_ns, result.stamp_ns)

    def finish(self) -> tuple[dict[str, OccupancyGrid], list[str]]:
        """Write the scans that still wait and the maps; the maps, and notes for people."""
        for raw, repaired in self._queue.flush():
            self._write_scan(raw, repaired)
        if self._maps is None:
            return {}, []
        grids, notes = self._maps.write(self._folder)
        if self._maps.scans_without_pose:
            notes.append(f"{self._maps.scans_without_pose} scans have no pose and are in no map.")
        if "fused" in grids:
            self._mcap.write_occupancy_grid("/map_fused", grids["fused"], self._last_stamp_ns)
        return grids, notes

    def _write_image(
        self, topic: str, image: DepthImage, camera: int, result: FrameResult | None
    ) -> None:
        """A depth image without what a person rejects, with the repairs of its frame."""
        labels = None if self._labels is None else self._labels.of_image(image, camera)
        if labels is not None:
            rejected = is_rejected(labels.as_image())
            image = replace(image, depth_m=np.where(rejected, np.float32(np.nan), image.depth_m))
        if result is not None:
            image = repaired_image(image, result)
        self._mcap.write_depth(topic, image)
        if self._labels is not None:
            self._mcap.write_classes(f"{topic}/class", image, pixel_classes(image, labels, result))

    def _write_scan(self, raw: LaserScan, repaired: LaserScan) -> None:
        self._mcap.write_laser_scan(self._lidar_topic, repaired)
        if self._maps is not None:
            self._maps.add_scan(raw, repaired)


def repaired_image(image: DepthImage, result: FrameResult) -> DepthImage:
    """A stored depth image with the repaired pixels of its frame's curve."""
    depth_m = image.depth_m.copy()
    changed = np.isfinite(result.pixel_repaired_m)
    row, column = result.pixel_row[changed], result.pixel_column[changed]
    depth_m[row, column] = result.pixel_repaired_m[changed]
    return replace(image, depth_m=depth_m)


def pixel_classes(
    image: DepthImage, labels: CaptureLabels | None, result: FrameResult | None
) -> IntArray:
    """(H, W) codes of NoiseClass of a stored image: a person's on any pixel, else those of its
    frame's curve; -1 for a pixel without."""
    classes = np.full(image.depth_m.shape, -1)
    if result is not None:
        classes[result.pixel_row, result.pixel_column] = result.pixel_class
    if labels is not None:
        decided = labels.subset(np.isin(labels.label, list(NoiseClass)))
        classes[decided.row, decided.column] = decided.label
    return classes


def _sensor_maps(session: Session, alignment: RecordingAlignment, poses: PoseLookup) -> SensorMaps:
    """The maps of a run; as in repairs, returns are confirmed unless the preset is the paper's."""
    repair = session.settings.repair
    confirmation = Confirmation(scale=alignment.scale, least=repair.confirm_line)
    return SensorMaps(poses, session.settings.grid, confirmation if repair.check_nearby else None)
