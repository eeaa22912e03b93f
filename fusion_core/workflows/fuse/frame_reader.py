"""Random access to the depth images of a session, each with the scans around it."""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from fusion_core.model.bounded_cache import BoundedCache
from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.errors import MissingStream, RecordingError
from fusion_core.model.sensors import ColorImage, DepthImage, LaserScan
from fusion_core.model.stamps import longest_ascending
from fusion_core.workflows.fuse.pairing import (
    PairedImage,
    SamplingRates,
    UprightDepth,
    pair_by_number,
    pair_with,
    virtual_pair,
)
from fusion_core.workflows.fuse.session import Session

# Scans that are read to either side of an image, in the order of the log.
_SCANS_BESIDE = 6
_SCANS_KEPT = 64
# Of each camera. An image is read for its own frame, for the one after it and for the panoramas
# beside it, and a survey may read elsewhere meanwhile.
_IMAGES_KEPT = 6


class FrameReader:
    """Frames are the depth images of all cameras in the order of their log, numbered from 0.

    Safe for threads. A frame that cannot be read raises RecordingError.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        recording = session.recording
        self._topics = [camera.topic for camera in session.rig.cameras]
        clocks = [recording.received_ns(topic) for topic in self._topics]
        owners = np.repeat(np.arange(len(clocks)), [clock.size for clock in clocks])
        indexes = np.concatenate([np.arange(clock.size) for clock in clocks])
        times_ns = np.concatenate(clocks)
        order = np.lexsort((owners, times_ns))
        self._owner, self._index = owners[order], indexes[order]
        self.times_ns = times_ns[order]
        lidar = session.streams.lidar if session.virtual_row is None else None
        self._lidar = lidar
        self._scan_times_ns = (
            np.empty(0, np.int64) if lidar is None else recording.received_ns(lidar)
        )
        self._scans: BoundedCache[int, LaserScan | None] = BoundedCache(_SCANS_KEPT)
        self._images: BoundedCache[tuple[int, int], object] = BoundedCache(
            _IMAGES_KEPT * len(self._topics)
        )

    def __len__(self) -> int:
        return int(self.times_ns.size)

    def camera_of(self, number: int) -> int:
        """The camera of a frame."""
        return int(self._owner[number])

    def image(self, number: int) -> DepthImage:
        """The stored depth image of a frame. Raises IndexError beyond the last, RecordingError for
        one that cannot be read or is of another size than the rig's."""
        camera = self.camera_of(number)
        topic, view = self._topics[camera], self._session.rig.views[camera]
        value = self._stored(camera, int(self._index[number]))
        if not isinstance(value, DepthImage):
            raise MissingStream(f"{topic} holds no depth images.")
        if value.depth_m.shape != view.stored_shape:
            (height, width), (usual_height, usual_width) = value.depth_m.shape, view.stored_shape
            raise RecordingError(
                f"{topic}: image {int(self._index[number])} has {width} x {height} pixels, not "
                f"{usual_width} x {usual_height}.",
                file=self._session.recording.path,
                advice="It is of another rig than the rest: go to another frame.",
            )
        return value

    def _stored(self, camera: int, index: int) -> object:
        """What a camera's topic holds at an index: of a depth camera its images."""
        read = self._session.recording.read
        return self._images.get_or_compute(
            (camera, index), lambda: read(self._topics[camera], index).value
        )

    def pair(self, number: int, clock_offset_ms: float = 0.0) -> PairedImage:
        """A frame and its scan, as a pass over the recording pairs them."""
        return self._pair(number, clock_offset_ms, self._scan)

    def raw_pair(self, number: int) -> PairedImage:
        """A frame and its scan, from the messages logged about it alone.

        It is that of ``pair`` without a clock offset, unless a stamp nearby is in order there and
        out of order in the whole recording, or the reverse.
        """
        return self._pair(number, 0.0, self._scan_of_geometry)

    def _pair(
        self, number: int, clock_offset_ms: float, scan_at: Callable[[int], LaserScan | None]
    ) -> PairedImage:
        image = self.image(number)
        if self._session.virtual_row is not None:
            return virtual_pair(self._session.rig, image, self._session.virtual_row)
        settings = self._session.settings.time
        offset_ns = round(clock_offset_ms * NS_PER_MS)
        camera = self.camera_of(number)
        if settings.pair_by == "rates" and self._lidar is not None:
            counted = self._rates.scan_of(camera, int(self._index[number]))
            count = self._scan_times_ns.size
            return pair_by_number(
                camera,
                image,
                lambda index: scan_at(index) if 0 <= index < count else None,
                counted,
                offset_ns,
            )
        return pair_with(
            camera,
            image,
            self._scans_near(int(self.times_ns[number]) - offset_ns, scan_at),
            offset_ns,
            round(settings.max_gap_ms * NS_PER_MS),
        )

    def previous(self, number: int) -> UprightDepth | None:
        """The same camera's image before, None for its first, and where that one cannot be read."""
        index = int(self._index[number])
        if index == 0:
            return None
        camera = self.camera_of(number)
        try:
            value = self._stored(camera, index - 1)
        except RecordingError:
            return None
        shape = self._session.rig.views[camera].stored_shape
        if not isinstance(value, DepthImage) or value.depth_m.shape != shape:
            return None
        return UprightDepth(
            stamp_ns=value.stamp_ns, depth_m=self._session.depth_of(camera, value.depth_m)
        )

    def panorama(self, number: int) -> tuple[int, ...]:
        """The frames of all cameras, in their order, that belong to one instant with a frame; the
        frame alone where a camera has none near enough, or one that cannot be read."""
        max_gap_ns = round(self._session.settings.time.max_gap_ms * NS_PER_MS)
        own_ns = self.image(number).stamp_ns
        numbers, stamps_ns = [], []
        for camera in range(len(self._topics)):
            found = (number, own_ns)
            if camera != self.camera_of(number):
                beside = self._nearest(camera, number, own_ns)
                if beside is None:
                    return (number,)
                found = beside
            numbers.append(found[0])
            stamps_ns.append(found[1])
        together = max(stamps_ns) - min(stamps_ns) <= max_gap_ns
        return tuple(numbers) if together else (number,)

    def _nearest(self, camera: int, number: int, stamp_ns: int) -> tuple[int, int] | None:
        """The frame of a camera nearest to a stamp, and its own, among those logged beside a frame
        of another camera; the first of equally near ones."""
        of_camera = np.flatnonzero(self._owner == camera)
        place = int(np.searchsorted(of_camera, number))
        near: list[tuple[int, int]] = []
        for other in of_camera[max(0, place - 1) : place + 1]:
            try:
                near.append((int(other), self.image(int(other)).stamp_ns))
            except RecordingError:
                continue
        return min(near, key=lambda found: abs(found[1] - stamp_ns), default=None)

    def color(self, number: int) -> ColorImage | None:
        """The colour image of the frame's camera that was logged nearest in time."""
        topic = self._session.streams.color[self.camera_of(number)]
        if topic is None:
            return None
        times_ns = self._session.recording.received_ns(topic)
        if not times_ns.size:
            return None
        nearest = int(np.argmin(np.abs(times_ns - self.times_ns[number])))
        value = self._session.recording.read(topic, nearest).value
        return value if isinstance(value, ColorImage) else None

    def _scans_near(
        self, time_ns: int, scan_at: Callable[[int], LaserScan | None]
    ) -> list[LaserScan]:
        place = int(np.searchsorted(self._scan_times_ns, time_ns))
        first = max(0, place - _SCANS_BESIDE)
        last = min(self._scan_times_ns.size, place + _SCANS_BESIDE)
        scans = [scan for i in range(first, last) if (scan := scan_at(i)) is not None]
        stamps_ns = np.array([scan.stamp_ns for scan in scans], dtype=np.int64)
        return [
            scan for scan, kept in zip(scans, longest_ascending(stamps_ns), strict=True) if kept
        ]

    @cached_property
    def _rates(self) -> SamplingRates:
        assert self._lidar is not None, "a session without a LiDAR has a virtual one"
        return SamplingRates(self._session.recording, self._lidar, self._topics)

    def _scan(self, index: int) -> LaserScan | None:
        """A scan, None where it cannot be read, is stamped out of order or is of another geometry
        than the rig's."""
        # As in a pass over the recording: where a scan is left out, the next nearest is taken.
        lidar = self._lidar
        assert lidar is not None, "a session without a LiDAR has a virtual one"
        if not self._session.geometry_filter.is_in_order(lidar, index):
            return None
        return self._scan_of_geometry(index)

    def _scan_of_geometry(self, index: int) -> LaserScan | None:
        """A scan, None where it cannot be read or is of another geometry than the rig's.

        Whether it is stamped in order only the stamps of the whole recording tell.
        """
        lidar = self._lidar
        assert lidar is not None, "a session without a LiDAR has a virtual one"
        return self._scans.get_or_compute(index, lambda: self._read_scan(lidar, index))

    def _read_scan(self, topic: str, index: int) -> LaserScan | None:
        try:
            value = self._session.recording.read(topic, index).value
        except RecordingError:
            return None
        geometry = self._session.rig.scan_geometry
        fits = isinstance(value, LaserScan) and geometry is not None and geometry.matches(value)
        return value if isinstance(value, LaserScan) and fits else None
