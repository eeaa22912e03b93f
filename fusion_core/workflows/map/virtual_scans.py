"""Li 2022 §2.2 over a recording: virtual scans of the cameras, alone or joined to the LiDAR's."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from fusion_core.alignment.time import ScanWindow, TimeSettings, estimate_turn_rate_rad_s
from fusion_core.mapping.camera_points import project_to_cloud
from fusion_core.mapping.virtual_scan import (
    VirtualScanSettings,
    make_camera_scan,
    merge_camera_cloud,
)
from fusion_core.model.conventions import NS_PER_MS, NS_PER_S, FloatArray
from fusion_core.model.errors import MissingStream
from fusion_core.model.planar_poses import relative_pose, transform_planar_points
from fusion_core.model.recording import Message, Recording
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.model.stamps import nearest_stamp
from fusion_core.recordings.topics import Streams
from fusion_core.workflows.map.extrinsics import CameraExtrinsics
from fusion_core.workflows.map.floor_alignment import (
    FloorAlignedCamera,
    FloorAlignment,
    align_to_floor,
)
from fusion_core.workflows.sensor_geometry import GeometryFilter, most_common_geometry

Motion = Callable[[int], FloatArray | None]
"""Stamp in ns to the (3,) planar pose of the scans' frame by odometry, None where not known."""

# A camera that lags its log by more than this is not waited for.
_TRIGGERS_WAITING = 32
_IMAGES_KEPT = 64


class CameraScans:
    """A virtual scan for each image of the first camera, with what the others saw at that time."""

    def __init__(
        self,
        recording: Recording,
        placed: CameraExtrinsics,
        settings: VirtualScanSettings,
        *,
        motion: Motion | None = None,
        clock_offset_ms: float = 0.0,
    ) -> None:
        self._clouds = _CloudReader(recording, placed, settings, motion, clock_offset_ms)
        self.frame_id = placed.frame_id
        self.recorded_count = recording.received_ns(self._clouds.floor.cameras[0].topic).size

    @property
    def notes(self) -> tuple[str, ...]:
        return self._clouds.notes

    def __iter__(self) -> Iterator[LaserScan]:
        passes = self._clouds
        first = passes.floor.cameras[0].topic
        fitting = GeometryFilter(passes.recording, None, passes.shapes)
        for image, window in passes.triggers(None, first, fitting):
            assert isinstance(image, DepthImage), "the beat is a camera's topic"
            yield make_camera_scan(
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
        placed: CameraExtrinsics,
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
        self._clouds = _CloudReader(recording, placed, settings, motion, clock_offset_ms)
        self._geometry = most_common_geometry(recording, streams.lidar)
        self.frame_id = placed.frame_id
        self.recorded_count = recording.received_ns(streams.lidar).size

    @property
    def notes(self) -> tuple[str, ...]:
        return self._clouds.notes

    def __iter__(self) -> Iterator[LaserScan]:
        passes = self._clouds
        fitting = GeometryFilter(passes.recording, self._geometry, passes.shapes)
        for scan, window in passes.triggers(self._lidar, self._lidar, fitting):
            assert isinstance(scan, LaserScan), "the beat is the LiDAR's topic"
            yield merge_camera_cloud(
                scan,
                passes.cloud_at(scan.stamp_ns, window),
                passes.settings,
                passes.floor.lidar_height_m,
            )


class _RecentClouds:
    """One camera's last images, each turned into a cloud once, and only if it is asked for."""

    def __init__(
        self, camera: FloorAlignedCamera, settings: VirtualScanSettings, offset_ns: int
    ) -> None:
        self._camera, self._settings, self._offset_ns = camera, settings, offset_ns
        self._kept: deque[tuple[int, DepthImage]] = deque(maxlen=_IMAGES_KEPT)
        self._clouds: dict[int, FloatArray] = {}

    def add(self, image: DepthImage) -> None:
        self._kept.append((image.stamp_ns - self._offset_ns, image))

    def has_passed(self, stamp_ns: int) -> bool:
        """Whether no later image can be nearer to an instant."""
        return bool(self._kept) and self._kept[-1][0] >= stamp_ns

    def drop_before(self, before_ns: int) -> None:
        """Drop what no later scan can need."""
        while self._kept and self._kept[0][0] < before_ns:
            self._kept.popleft()
        kept = {stamp_ns for stamp_ns, _ in self._kept}
        self._clouds = {stamp: cloud for stamp, cloud in self._clouds.items() if stamp in kept}

    def nearest(self, stamp_ns: int, max_gap_ns: float) -> tuple[int, FloatArray] | None:
        """Stamp and cloud of the image nearest in time, None where none is near enough."""
        nearest = nearest_stamp([stamp for stamp, _ in self._kept], stamp_ns, max_gap_ns)
        if nearest is None:
            return None
        found_ns, image = self._kept[nearest]
        if found_ns not in self._clouds:
            view = self._camera.view
            self._clouds[found_ns] = project_to_cloud(
                view.remap(image.depth_m),
                view.intrinsics,
                self._camera.T_floor_camera,
                self._settings,
            )
        return found_ns, self._clouds[found_ns]


class _CloudReader:
    """What every pass over a recording shares, and what the last one has counted."""

    def __init__(
        self,
        recording: Recording,
        placed: CameraExtrinsics,
        settings: VirtualScanSettings,
        motion: Motion | None,
        clock_offset_ms: float,
    ) -> None:
        self.recording, self.settings = recording, settings
        self.floor: FloorAlignment = align_to_floor(recording, placed, settings)
        self.offset_ns = round(clock_offset_ms * NS_PER_MS)
        self.shapes = {camera.topic: camera.view.stored_shape for camera in self.floor.cameras}
        self._motion = motion
        self._max_gap_ns = settings.max_gap_ms * NS_PER_MS
        self._fixed_notes = (*placed.notes, *self.floor.notes)
        if self.offset_ns:
            self._fixed_notes += (f"Camera stamps taken {clock_offset_ms:g} ms earlier.",)
        self._images: list[_RecentClouds] = []
        self._without_image = self._unknown_motion = 0

    @property
    def notes(self) -> tuple[str, ...]:
        counted = (
            (self._without_image, f"have no image within {self.settings.max_gap_ms:g} ms."),
            (
                self._unknown_motion,
                "take the robot to stand still until the image: its turn is not known.",
            ),
        )
        return self._fixed_notes + tuple(
            f"{count} scans {what}" for count, what in counted if count
        )

    def triggers(
        self, lidar: str | None, beat: str, fitting: GeometryFilter
    ) -> Iterator[tuple[LaserScan | DepthImage, ScanWindow | None]]:
        """Every message of topic ``beat`` once the images around it are known, with the scans
        beside it where it is a scan."""
        self._without_image = self._unknown_motion = 0
        cameras = self.floor.cameras
        self._images = [_RecentClouds(camera, self.settings, self.offset_ns) for camera in cameras]
        index_of = {camera.topic: index for index, camera in enumerate(cameras)}
        waiting: deque[LaserScan | DepthImage] = deque()
        before: LaserScan | None = None
        topics = [*index_of] if lidar is None else [lidar, *index_of]
        for message in _with_end_mark(fitting.accepted(self.recording.messages(topics))):
            if message is not None:
                value = message.value
                if isinstance(value, DepthImage):
                    self._images[index_of[message.topic]].add(value)
                if message.topic == beat and isinstance(value, LaserScan | DepthImage):
                    waiting.append(value)
            while waiting and (message is None or self._is_settled(waiting)):
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
                    images.drop_before(at_ns - round(self._max_gap_ns))

    def cloud_at(self, stamp_ns: int, window: ScanWindow | None) -> FloatArray:
        """(N, 3) what the cameras saw nearest to an instant, as seen from the scan's frame then."""
        clouds = []
        for images in self._images:
            found = images.nearest(stamp_ns, self._max_gap_ns)
            if found is not None:
                clouds.append(self._transform_cloud(*found, stamp_ns, window))
        if not clouds:
            self._without_image += 1
            return np.empty((0, 3))
        return np.concatenate(clouds)

    def _is_settled(self, waiting: Sequence[LaserScan | DepthImage]) -> bool:
        """No later image can be nearer, and the scan after it has come."""
        if len(waiting) > _TRIGGERS_WAITING:
            return True
        followed = len(waiting) > 1 or isinstance(waiting[0], DepthImage)
        at_ns = self._stamp_ns(waiting[0])
        return followed and all(images.has_passed(at_ns) for images in self._images)

    def _stamp_ns(self, beat: LaserScan | DepthImage) -> int:
        return beat.stamp_ns - (self.offset_ns if isinstance(beat, DepthImage) else 0)

    def _transform_cloud(
        self, from_ns: int, cloud_m: FloatArray, to_ns: int, window: ScanWindow | None
    ) -> FloatArray:
        """The cloud as it would have been seen at another instant: at 0.5 rad/s a gap of 70 ms
        turns what is seen by 2 degrees."""
        if from_ns == to_ns:
            return cloud_m
        pose_scan_image = self._relative_pose(from_ns, to_ns, window)
        if pose_scan_image is None:
            self._unknown_motion += 1
            return cloud_m
        carried_m = cloud_m.copy()
        carried_m[:, :2] = transform_planar_points(pose_scan_image, cloud_m[:, :2])
        return carried_m

    def _relative_pose(
        self, from_ns: int, to_ns: int, window: ScanWindow | None
    ) -> FloatArray | None:
        """(3,) pose of the scans' frame at one instant in that of another."""
        if self._motion is not None:
            before, after = self._motion(from_ns), self._motion(to_ns)
            if before is not None and after is not None:
                return relative_pose(after, before)
        if window is None:
            return None
        rate_rad_s = estimate_turn_rate_rad_s(window, TimeSettings())
        if not np.isfinite(rate_rad_s):
            return None
        return np.array([0.0, 0.0, rate_rad_s * (from_ns - to_ns) / NS_PER_S])


def _with_end_mark(messages: Iterator[Message]) -> Iterator[Message | None]:
    yield from messages
    yield None
