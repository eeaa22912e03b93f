"""Li 2022 §2.2 over a recording: virtual scans of the cameras, alone or merged with the LiDAR's."""

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from fusion_core.alignment.scan_motion import estimate_motion
from fusion_core.alignment.time import ScanWindow, TimeSettings
from fusion_core.mapping.camera_points import project_to_cloud
from fusion_core.mapping.height_bands import ImageEdges
from fusion_core.mapping.virtual_scan import (
    VirtualScanSettings,
    make_camera_scan,
    merge_camera_cloud,
)
from fusion_core.model.conventions import NS_PER_MS, NS_PER_S, FloatArray
from fusion_core.model.errors import MissingStream
from fusion_core.model.planar_poses import PosePrior, relative_pose, transform_planar_points
from fusion_core.model.recording import Message
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.model.stamps import nearest_stamp
from fusion_core.workflows.map.extrinsics import CameraExtrinsics
from fusion_core.workflows.map.floor_alignment import FloorAlignedCamera, align_to_floor
from fusion_core.workflows.map.recorded_sensors import RecordedSensors
from fusion_core.workflows.sensor_geometry import GeometryFilter, most_common_geometry

# Messages that wait for a camera that is logged later than they are: 3 s of a 10 Hz LiDAR.
_TRIGGERS_WAITING = 32
# Images from before and after the oldest waiting trigger: 2 s of a 30 Hz camera.
_IMAGES_KEPT = 64


class CameraScans:
    """A virtual scan for each image of the first camera, with what the others saw at that time."""

    def __init__(
        self,
        sensors: RecordedSensors,
        extrinsics: CameraExtrinsics,
        settings: VirtualScanSettings,
        *,
        prior: PosePrior | None = None,
    ) -> None:
        self._clouds = _CloudReader(sensors, extrinsics, settings, prior)
        self.frame_id = extrinsics.frame_id
        first_camera = self._clouds.cameras[0].topic
        self.recorded_count = sensors.recording.received_ns(first_camera).size

    @property
    def notes(self) -> tuple[str, ...]:
        return self._clouds.notes

    def __iter__(self) -> Iterator[LaserScan]:
        clouds = self._clouds
        messages = GeometryFilter(clouds.sensors.recording, None, clouds.image_shapes)
        for image, window in clouds.iterate_triggers(None, clouds.cameras[0].topic, messages):
            assert isinstance(image, DepthImage), "the trigger is a camera's topic"
            stamp_ns = image.stamp_ns - clouds.sensors.clock_offset_ns
            yield make_camera_scan(
                clouds.cloud_at(stamp_ns, window),
                clouds.settings,
                stamp_ns=stamp_ns,
                received_ns=image.received_ns,
                frame_id=self.frame_id,
                cameras=clouds.image_edges,
            )


class MergedScans:
    """The LiDAR's scans, each with what the cameras saw at its time; raw without an image."""

    def __init__(
        self,
        sensors: RecordedSensors,
        extrinsics: CameraExtrinsics,
        settings: VirtualScanSettings,
        *,
        prior: PosePrior | None = None,
    ) -> None:
        recording, lidar = sensors.recording, sensors.streams.lidar
        if lidar is None:
            raise MissingStream(
                "has no 2D LiDAR to merge the camera with.",
                file=recording.path,
                advice="Use --scan camera.",
            )
        self._lidar = lidar
        self._clouds = _CloudReader(sensors, extrinsics, settings, prior)
        self._geometry = most_common_geometry(recording, lidar)
        self.frame_id = extrinsics.frame_id
        self.recorded_count = recording.received_ns(lidar).size

    @property
    def notes(self) -> tuple[str, ...]:
        return self._clouds.notes

    def __iter__(self) -> Iterator[LaserScan]:
        clouds = self._clouds
        messages = GeometryFilter(clouds.sensors.recording, self._geometry, clouds.image_shapes)
        for scan, window in clouds.iterate_triggers(self._lidar, self._lidar, messages):
            assert isinstance(scan, LaserScan), "the trigger is the LiDAR's topic"
            yield merge_camera_cloud(
                scan,
                clouds.cloud_at(scan.stamp_ns, window),
                clouds.settings,
                clouds.lidar_height_m,
                clouds.image_edges,
            )


class _RecentClouds:
    """The last images of one camera; each becomes a cloud once, when it is needed."""

    def __init__(
        self, camera: FloorAlignedCamera, settings: VirtualScanSettings, clock_offset_ns: int
    ) -> None:
        self._camera, self._settings = camera, settings
        self._clock_offset_ns = clock_offset_ns
        self._images: deque[tuple[int, DepthImage]] = deque(maxlen=_IMAGES_KEPT)
        self._clouds: dict[int, FloatArray] = {}

    def add(self, image: DepthImage) -> None:
        self._images.append((image.stamp_ns - self._clock_offset_ns, image))

    def has_passed(self, stamp_ns: int) -> bool:
        """Whether no later image can be nearer to an instant."""
        return bool(self._images) and self._images[-1][0] >= stamp_ns

    def drop_before(self, stamp_ns: int) -> None:
        """Forget the images that no later trigger can need."""
        while self._images and self._images[0][0] < stamp_ns:
            self._images.popleft()
        kept = {stamp for stamp, _ in self._images}
        self._clouds = {stamp: cloud for stamp, cloud in self._clouds.items() if stamp in kept}

    def nearest(self, stamp_ns: int, max_gap_ns: float) -> tuple[int, FloatArray] | None:
        """Stamp and cloud of the image nearest in time, None where none is within the gap."""
        nearest = nearest_stamp([stamp for stamp, _ in self._images], stamp_ns, max_gap_ns)
        if nearest is None:
            return None
        image_ns, image = self._images[nearest]
        if image_ns not in self._clouds:
            view = self._camera.view
            self._clouds[image_ns] = project_to_cloud(
                view.remap(image.depth_m),
                view.intrinsics,
                self._camera.T_floor_camera,
                self._settings,
            )
        return image_ns, self._clouds[image_ns]


class _CloudReader:
    """The cameras' clouds at the times of the messages that trigger a scan, pass after pass.

    ``cameras``: aligned to the floor. ``lidar_height_m``: of its plane above the floor, None where
    it is not known. ``image_edges``: of each camera, none where heights play no part.
    ``image_shapes``: by depth topic.
    """

    def __init__(
        self,
        sensors: RecordedSensors,
        extrinsics: CameraExtrinsics,
        settings: VirtualScanSettings,
        prior: PosePrior | None,
    ) -> None:
        self.sensors, self.settings = sensors, settings
        floor = align_to_floor(sensors.recording, extrinsics, settings)
        self.cameras, self.lidar_height_m = floor.cameras, floor.lidar_height_m
        # As published, a beam frees whatever it passes.
        self.image_edges = (
            tuple(ImageEdges.of(c.view.intrinsics, c.T_floor_camera) for c in self.cameras)
            if settings.layers
            else ()
        )
        self.image_shapes = {camera.topic: camera.view.stored_shape for camera in self.cameras}
        self._prior = prior
        self._max_gap_ns = settings.max_gap_ms * NS_PER_MS
        self._fixed_notes = (*extrinsics.notes, *floor.notes, *sensors.clock_note)
        self._recent: list[_RecentClouds] = []
        self._without_image = self._without_motion = 0

    @property
    def notes(self) -> tuple[str, ...]:
        """For people; the counts are those of the last pass."""
        counted = (
            (self._without_image, f"have no image within {self.settings.max_gap_ms:g} ms."),
            (
                self._without_motion,
                "take the robot to stand still until the image: its turn is not known.",
            ),
        )
        return self._fixed_notes + tuple(
            f"{count} scans {what}" for count, what in counted if count
        )

    def iterate_triggers(
        self, lidar: str | None, trigger: str, messages: GeometryFilter
    ) -> Iterator[tuple[LaserScan | DepthImage, ScanWindow | None]]:
        """Every message of topic ``trigger`` once the images around it have been read, with its
        neighbours where it is a scan."""
        self._without_image = self._without_motion = 0
        self._recent = [
            _RecentClouds(camera, self.settings, self.sensors.clock_offset_ns)
            for camera in self.cameras
        ]
        index_of = {camera.topic: index for index, camera in enumerate(self.cameras)}
        waiting: deque[LaserScan | DepthImage] = deque()
        before: LaserScan | None = None
        topics = [*index_of] if lidar is None else [lidar, *index_of]
        logged = self.sensors.recording.messages(topics)
        for message in _with_end_mark(messages.accepted(logged)):
            if message is not None:
                value = message.value
                if isinstance(value, DepthImage):
                    self._recent[index_of[message.topic]].add(value)
                if message.topic == trigger and isinstance(value, LaserScan | DepthImage):
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
                stamp_ns = self._stamp_ns(taken)
                for clouds in self._recent:
                    clouds.drop_before(stamp_ns - round(self._max_gap_ns))

    def cloud_at(self, stamp_ns: int, window: ScanWindow | None) -> FloatArray:
        """(N, 3) what the cameras saw nearest to an instant, in the scan's frame then."""
        clouds = []
        for recent in self._recent:
            found = recent.nearest(stamp_ns, self._max_gap_ns)
            if found is not None:
                clouds.append(self._move_cloud(*found, stamp_ns, window))
        if not clouds:
            self._without_image += 1
            return np.empty((0, 3))
        return np.concatenate(clouds)

    def _is_settled(self, waiting: Sequence[LaserScan | DepthImage]) -> bool:
        """Whether no later image can be nearer, and the scan after it has been read."""
        if len(waiting) > _TRIGGERS_WAITING:
            return True
        followed = len(waiting) > 1 or isinstance(waiting[0], DepthImage)
        stamp_ns = self._stamp_ns(waiting[0])
        return followed and all(clouds.has_passed(stamp_ns) for clouds in self._recent)

    def _stamp_ns(self, value: LaserScan | DepthImage) -> int:
        """The stamp by the LiDAR's clock."""
        is_image = isinstance(value, DepthImage)
        return value.stamp_ns - (self.sensors.clock_offset_ns if is_image else 0)

    def _move_cloud(
        self, from_ns: int, cloud_m: FloatArray, to_ns: int, window: ScanWindow | None
    ) -> FloatArray:
        """The cloud as seen from the robot's pose at another instant: at 0.5 rad/s a gap of 70 ms
        turns it by 2 degrees."""
        if from_ns == to_ns:
            return cloud_m
        pose_scan_image = self._pose_between(from_ns, to_ns, window)
        if pose_scan_image is None:
            self._without_motion += 1
            return cloud_m
        moved_m = cloud_m.copy()
        moved_m[:, :2] = transform_planar_points(pose_scan_image, cloud_m[:, :2])
        return moved_m

    def _pose_between(
        self, from_ns: int, to_ns: int, window: ScanWindow | None
    ) -> FloatArray | None:
        """(3,) pose of the scans' frame at ``from_ns`` in that at ``to_ns``: by odometry, else the
        motion between the scans, else None."""
        if self._prior is not None:
            before, after = self._prior(from_ns), self._prior(to_ns)
            if before is not None and after is not None:
                return relative_pose(after, before)
        if window is None:
            return None
        motion = estimate_motion(window, TimeSettings())
        return None if motion is None else motion.pose_after((from_ns - to_ns) / NS_PER_S)


def _with_end_mark(messages: Iterator[Message]) -> Iterator[Message | None]:
    """The messages, then None."""
    yield from messages
    yield None
