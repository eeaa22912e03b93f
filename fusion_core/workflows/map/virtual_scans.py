"""Li 2022 §2.2 over a recording: virtual scans of the cameras, alone or joined to the LiDAR's."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from fusion_core.alignment.time import ScanWindow, TimeSettings, turn_rate_rad_s
from fusion_core.mapping.camera_points import camera_cloud
from fusion_core.mapping.virtual_scan import VirtualScanSettings, camera_scan, merged_scan
from fusion_core.model.conventions import NS_PER_MS, NS_PER_S, FloatArray
from fusion_core.model.errors import MissingStream
from fusion_core.model.planar_poses import relative_pose, transform_planar_points
from fusion_core.model.recording import Message, Recording
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.recordings.topics import Streams
from fusion_core.workflows.fitting import Fitting, usual_geometry
from fusion_core.workflows.map.extrinsics import Extrinsics
from fusion_core.workflows.map.floor_alignment import LevelCamera, Levelled, levelled

Motion = Callable[[int], FloatArray | None]
"""Stamp in ns to the (3,) planar pose of the scans' frame by odometry, None where not known."""

# A camera that lags its log by more than this is not waited for.
_BEATS_WAITING = 32
_IMAGES_KEPT = 64


class CameraScans:
    """A virtual scan for each image of the first camera, with what the others saw at that time."""

    def __init__(
        self,
        recording: Recording,
        placed: Extrinsics,
        settings: VirtualScanSettings,
        *,
        motion: Motion | None = None,
        clock_offset_ms: float = 0.0,
    ) -> None:
        self._passes = _Passes(recording, placed, settings, motion, clock_offset_ms)
        self.frame_id = placed.frame_id
        self.recorded = recording.received_ns(self._passes.level.cameras[0].topic).size

    @property
    def notes(self) -> tuple[str, ...]:
        return self._passes.notes

    def __iter__(self) -> Iterator[LaserScan]:
        passes = self._passes
        first = passes.level.cameras[0].topic
        fitting = Fitting(passes.recording, None, passes.shapes)
        for image, window in passes.beats(None, first, fitting):
            assert isinstance(image, DepthImage), "the beat is a camera's topic"
            yield camera_scan(
                passes.cloud_at(image.stamp_ns - passes.offset_ns, window),
                passes.settings,
                stamp_ns=image.stamp_ns - passes.offset_ns,
                received_ns=image.received_ns,
                frame_id=self.frame_id,
            )


class MergedScans:
    """Each of the LiDAR's scans with what the cameras saw at its time; as it was without images."""

    def __init__(
        self,
        recording: Recording,
        streams: Streams,
        placed: Extrinsics,
        settings: VirtualScanSettings,
        *,
        motion: Motion | None = None,
        clock_offset_ms: float = 0.0,
    ) -> None:
        if streams.lidar is None:
            raise MissingStream(
                "has no 2D LiDAR to merge the camera with.",
                file=recording.path,
                advice="Use --scan camera.",
            )
        self._lidar = streams.lidar
        self._passes = _Passes(recording, placed, settings, motion, clock_offset_ms)
        self._geometry = usual_geometry(recording, streams.lidar)
        self.frame_id = placed.frame_id
        self.recorded = recording.received_ns(streams.lidar).size

    @property
    def notes(self) -> tuple[str, ...]:
        return self._passes.notes

    def __iter__(self) -> Iterator[LaserScan]:
        passes = self._passes
        fitting = Fitting(passes.recording, self._geometry, passes.shapes)
        for scan, window in passes.beats(self._lidar, self._lidar, fitting):
            assert isinstance(scan, LaserScan), "the beat is the LiDAR's topic"
            yield merged_scan(
                scan,
                passes.cloud_at(scan.stamp_ns, window),
                passes.settings,
                passes.level.lidar_height_m,
            )


class _Images:
    """One camera's last images, each turned into a cloud once, and only if it is asked for."""

    def __init__(self, camera: LevelCamera, settings: VirtualScanSettings, offset_ns: int) -> None:
        self._camera, self._settings, self._offset_ns = camera, settings, offset_ns
        self._kept: deque[tuple[int, DepthImage]] = deque(maxlen=_IMAGES_KEPT)
        self._clouds: dict[int, FloatArray] = {}

    def add(self, image: DepthImage) -> None:
        self._kept.append((image.stamp_ns - self._offset_ns, image))

    def reaches(self, stamp_ns: int) -> bool:
        """Whether no later image can be nearer to an instant."""
        return bool(self._kept) and self._kept[-1][0] >= stamp_ns

    def forget(self, before_ns: int) -> None:
        """Drop what no later scan can need."""
        while self._kept and self._kept[0][0] < before_ns:
            self._kept.popleft()
        kept = {stamp_ns for stamp_ns, _ in self._kept}
        self._clouds = {stamp: cloud for stamp, cloud in self._clouds.items() if stamp in kept}

    def nearest(self, stamp_ns: int, max_gap_ns: float) -> tuple[int, FloatArray] | None:
        """Stamp and cloud of the image nearest in time, None where none is near enough."""
        if not self._kept:
            return None
        found_ns, image = min(self._kept, key=lambda entry: abs(entry[0] - stamp_ns))
        if abs(found_ns - stamp_ns) > max_gap_ns:
            return None
        if found_ns not in self._clouds:
            view = self._camera.view
            self._clouds[found_ns] = camera_cloud(
                view.of(image.depth_m),
                view.intrinsics,
                self._camera.floor_from_camera,
                self._settings,
            )
        return found_ns, self._clouds[found_ns]


class _Passes:
    """What every pass over a recording shares, and what the last one has counted."""

    def __init__(
        self,
        recording: Recording,
        placed: Extrinsics,
        settings: VirtualScanSettings,
        motion: Motion | None,
        clock_offset_ms: float,
    ) -> None:
        self.recording, self.settings = recording, settings
        self.level: Levelled = levelled(recording, placed, settings)
        self.offset_ns = round(clock_offset_ms * NS_PER_MS)
        self.shapes = {camera.topic: camera.view.stored_shape for camera in self.level.cameras}
        self._motion = motion
        self._max_gap_ns = settings.max_gap_ms * NS_PER_MS
        self._fixed_notes = (*placed.notes, *self.level.notes)
        if self.offset_ns:
            self._fixed_notes += (f"Camera stamps taken {clock_offset_ms:g} ms earlier.",)
        self._images: list[_Images] = []
        self._alone = self._at_rest = 0

    @property
    def notes(self) -> tuple[str, ...]:
        counted = (
            (self._alone, f"have no image within {self.settings.max_gap_ms:g} ms."),
            (
                self._at_rest,
                "take the robot to stand still until the image: its turn is not known.",
            ),
        )
        return self._fixed_notes + tuple(
            f"{count} scans {what}" for count, what in counted if count
        )

    def beats(
        self, lidar: str | None, beat: str, fitting: Fitting
    ) -> Iterator[tuple[LaserScan | DepthImage, ScanWindow | None]]:
        """Every message of topic ``beat`` once the images around it are known, with the scans
        beside it where it is a scan."""
        self._alone = self._at_rest = 0
        cameras = self.level.cameras
        self._images = [_Images(camera, self.settings, self.offset_ns) for camera in cameras]
        index_of = {camera.topic: index for index, camera in enumerate(cameras)}
        waiting: deque[LaserScan | DepthImage] = deque()
        before: LaserScan | None = None
        topics = [*index_of] if lidar is None else [lidar, *index_of]
        for message in _and_end(fitting.of(self.recording.messages(topics))):
            if message is not None:
                value = message.value
                if isinstance(value, DepthImage):
                    self._images[index_of[message.topic]].add(value)
                if message.topic == beat and isinstance(value, LaserScan | DepthImage):
                    waiting.append(value)
            while waiting and (message is None or self._settled(waiting)):
                taken = waiting.popleft()
                window = None
                if isinstance(taken, LaserScan):
                    after = waiting[0] if waiting else None
                    assert after is None or isinstance(after, LaserScan)
                    window = ScanWindow(before=before, scan=taken, after=after)
                    before = taken
                yield taken, window
                at_ns = self._stamp_ns(taken)
                for images in self._images:
                    images.forget(at_ns - round(self._max_gap_ns))

    def cloud_at(self, stamp_ns: int, window: ScanWindow | None) -> FloatArray:
        """(N, 3) what the cameras saw nearest to an instant, as seen from the scan's frame then."""
        clouds = []
        for images in self._images:
            found = images.nearest(stamp_ns, self._max_gap_ns)
            if found is not None:
                clouds.append(self._carried(*found, stamp_ns, window))
        if not clouds:
            self._alone += 1
            return np.empty((0, 3))
        return np.concatenate(clouds)

    def _settled(self, waiting: Sequence[LaserScan | DepthImage]) -> bool:
        """No later image can be nearer, and the scan after it has come."""
        if len(waiting) > _BEATS_WAITING:
            return True
        followed = len(waiting) > 1 or isinstance(waiting[0], DepthImage)
        at_ns = self._stamp_ns(waiting[0])
        return followed and all(images.reaches(at_ns) for images in self._images)

    def _stamp_ns(self, beat: LaserScan | DepthImage) -> int:
        return beat.stamp_ns - (self.offset_ns if isinstance(beat, DepthImage) else 0)

    def _carried(
        self, from_ns: int, cloud_m: FloatArray, to_ns: int, window: ScanWindow | None
    ) -> FloatArray:
        """The cloud as it would have been seen at another instant: at 0.5 rad/s a gap of 70 ms
        turns what is seen by 2 degrees."""
        if from_ns == to_ns:
            return cloud_m
        pose_scan_image = self._moved(from_ns, to_ns, window)
        if pose_scan_image is None:
            self._at_rest += 1
            return cloud_m
        carried_m = cloud_m.copy()
        carried_m[:, :2] = transform_planar_points(pose_scan_image, cloud_m[:, :2])
        return carried_m

    def _moved(self, from_ns: int, to_ns: int, window: ScanWindow | None) -> FloatArray | None:
        """(3,) pose of the scans' frame at one instant in that of another."""
        if self._motion is not None:
            before, after = self._motion(from_ns), self._motion(to_ns)
            if before is not None and after is not None:
                return relative_pose(after, before)
        if window is None:
            return None
        rate_rad_s = turn_rate_rad_s(window, TimeSettings())
        if not np.isfinite(rate_rad_s):
            return None
        return np.array([0.0, 0.0, rate_rad_s * (from_ns - to_ns) / NS_PER_S])


def _and_end(messages: Iterator[Message]) -> Iterator[Message | None]:
    yield from messages
    yield None
