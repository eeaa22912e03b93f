"""Pairs of scan and depth image, streamed from a recording in bounded memory."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from fusion_core.alignment.time import ScanWindow, TimeSettings
from fusion_core.alignment.virtual_lidar import cut_scan
from fusion_core.model.conventions import NS_PER_MS, Float32Array, read_only
from fusion_core.model.errors import MissingStream
from fusion_core.model.recording import Recording
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.model.stamps import nearest_stamp
from fusion_core.recordings.topics import Streams
from fusion_core.workflows.fuse.camera_rig import CameraRig
from fusion_core.workflows.sensor_geometry import GeometryFilter

# Streams of a log may be interleaved out of the order of their stamps by this many messages.
SCANS_KEPT = 64
_IMAGES_WAITING = 32
# A group of images waits for half of the scans that are kept, and its own must still be among them.
_SCANS_KEPT_BY_RATES = SCANS_KEPT // 2 - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedImage:
    """A depth image and its scan, the nearest in time or by the rates; ``window`` is None where
    there is none, or none near enough.

    ``gap_ns``: image stamp - scan stamp, with the applied clock offset taken out.
    """

    camera: int
    image: DepthImage
    window: ScanWindow | None
    gap_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class UprightDepth:
    """The upright view of a depth image: (H', W') metres along the optical axis."""

    stamp_ns: int
    depth_m: Float32Array

    def __post_init__(self) -> None:
        read_only(self.depth_m)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FramePair:
    """A depth image and its scan: the input of the chain for one frame.

    ``camera`` is the rig's camera number ``camera_index``. ``image`` is as stored, ``depth_m`` its
    upright view (H', W'), without the rows that a virtual LiDAR is cut from. ``window``: the scan
    with its neighbours in time. ``gap_ns``: image stamp - scan stamp, with the applied clock offset
    taken out. ``aligned_scan``: the scan that u, v and the mount are found with: the paired one, or
    one interpolated at the image's instant, whose ranges are no measurements of their own.
    ``previous``: the camera's image before, None for its first.
    """

    camera_index: int
    camera: Camera
    image: DepthImage
    depth_m: Float32Array
    window: ScanWindow
    gap_ns: int
    aligned_scan: LaserScan
    previous: UprightDepth | None = None

    def __post_init__(self) -> None:
        read_only(self.depth_m)

    @property
    def scan(self) -> LaserScan:
        """The scan that the image is paired with."""
        return self.window.scan

    @property
    def upright(self) -> UprightDepth:
        """The image as the next one's ``previous``."""
        return UprightDepth(stamp_ns=self.image.stamp_ns, depth_m=self.depth_m)


def paired_images(
    recording: Recording,
    streams: Streams,
    rig: CameraRig,
    fitting: GeometryFilter,
    settings: TimeSettings,
    clock_offset_ms: float = 0.0,
) -> Iterator[LaserScan | PairedImage]:
    """Every scan as it arrives, and every depth image once the scans around it are known."""
    assert streams.lidar is not None, "build_camera_rig refuses a recording without LiDAR"
    offset_ns = round(clock_offset_ms * NS_PER_MS)
    if settings.pair_by == "rates":
        yield from _paired_by_rates(recording, streams.lidar, rig, fitting, offset_ns)
        return
    max_gap_ns = round(settings.max_gap_ms * NS_PER_MS)
    scans: deque[LaserScan] = deque(maxlen=SCANS_KEPT)
    waiting: deque[tuple[int, DepthImage]] = deque()
    topics = [camera.topic for camera in rig.cameras]
    for message in fitting.accepted(recording.messages([streams.lidar, *topics])):
        value = message.value
        if isinstance(value, LaserScan):
            scans.append(value)
            yield value
        elif isinstance(value, DepthImage):
            waiting.append((topics.index(message.topic), value))
        while waiting and _is_settled(waiting[0][1].stamp_ns - offset_ns, scans, waiting):
            yield pair_with(*waiting.popleft(), scans, offset_ns, max_gap_ns)
    while waiting:
        yield pair_with(*waiting.popleft(), scans, offset_ns, max_gap_ns)


def _is_settled(
    stamp_ns: int, scans: deque[LaserScan], waiting: deque[tuple[int, DepthImage]]
) -> bool:
    """Whether no later scan can be nearer, and the one after the nearest has come."""
    after = sum(scan.stamp_ns > stamp_ns for scan in scans)
    return after >= 2 or len(waiting) > _IMAGES_WAITING


def pair_with(
    camera: int,
    image: DepthImage,
    scans: Iterable[LaserScan],
    offset_ns: int,
    max_gap_ns: int,
) -> PairedImage:
    """The pair of an image and the nearest of ``scans``, which come in any order.

    ``offset_ns``: the clock offset that is applied, camera stamp - LiDAR stamp of one instant.
    """
    stamp_ns = image.stamp_ns - offset_ns
    ordered = sorted(scans, key=lambda scan: scan.stamp_ns)
    best = nearest_stamp([scan.stamp_ns for scan in ordered], stamp_ns, max_gap_ns)
    if best is None:
        return PairedImage(camera=camera, image=image, window=None, gap_ns=0)
    return PairedImage(
        camera=camera,
        image=image,
        window=ScanWindow(
            before=ordered[best - 1] if best > 0 else None,
            scan=ordered[best],
            after=ordered[best + 1] if best + 1 < len(ordered) else None,
        ),
        gap_ns=stamp_ns - ordered[best].stamp_ns,
    )


class SamplingRates:
    """The paper's pairing, t = f(i) / g(j): the rates of the LiDAR and of each camera, and with
    them the number of an image's scan. Both count from the recording's start.

    A late start or lost messages of a sensor shift all pairs after them, as they must.

    Raises MissingStream where a stream has no rate.
    """

    def __init__(self, recording: Recording, lidar: str, cameras: Sequence[str]) -> None:
        self._scans_per_image = [
            _rate_hz(recording, lidar) / _rate_hz(recording, camera) for camera in cameras
        ]

    def scan_of(self, camera: int, index: int) -> int:
        """The number of the scan of a camera's ``index``-th image."""
        return round(index * self._scans_per_image[camera])


def _rate_hz(recording: Recording, name: str) -> float:
    rate_hz = next(topic.rate_hz for topic in recording.topics if topic.name == name)
    if rate_hz is None:
        raise MissingStream(
            f"{name} has no rate: fewer than two messages, or all of one time.",
            file=recording.path,
            advice="Set time.pair_by to nearest.",
        )
    return rate_hz


def pair_by_number(
    camera: int,
    image: DepthImage,
    scan_at: Callable[[int], LaserScan | None],
    number: int,
    offset_ns: int,
) -> PairedImage:
    """The pair of an image and the ``number``-th scan, whatever their stamps; ``scan_at`` gives the
    scans, None where one is missing or of no use."""
    scan = scan_at(number)
    if scan is None:
        return PairedImage(camera=camera, image=image, window=None, gap_ns=0)
    return PairedImage(
        camera=camera,
        image=image,
        window=ScanWindow(before=scan_at(number - 1), scan=scan, after=scan_at(number + 1)),
        gap_ns=image.stamp_ns - offset_ns - scan.stamp_ns,
    )


def _paired_by_rates(
    recording: Recording, lidar: str, rig: CameraRig, fitting: GeometryFilter, offset_ns: int
) -> Iterator[LaserScan | PairedImage]:
    """As ``paired_images``, by counting. Scans are read as far as the images ask for them."""
    topics = [camera.topic for camera in rig.cameras]
    rates = SamplingRates(recording, lidar, topics)
    scans = fitting.accepted(recording.messages([lidar]))
    kept: dict[int, LaserScan] = {}
    last = -1
    for message in fitting.accepted(recording.messages(topics)):
        if not isinstance(message.value, DepthImage):
            continue
        camera = topics.index(message.topic)
        number = rates.scan_of(camera, message.index)
        while last <= number:
            following = next(scans, None)
            if following is None:
                break
            last = following.index
            if isinstance(following.value, LaserScan):
                kept[last] = following.value
                yield following.value
            if len(kept) > _SCANS_KEPT_BY_RATES:
                del kept[next(iter(kept))]
        yield pair_by_number(camera, message.value, kept.get, number, offset_ns)
    for following in scans:
        if isinstance(following.value, LaserScan):
            yield following.value


class ImageGrouper:
    """Images of all cameras of nearly the same instant, put together as they come.

    Each group holds one image of each camera, in the order of the cameras, stamped within
    ``max_gap_ms``. An image whose partners do not come is a group of its own, and so is each image
    of a single camera.
    """

    def __init__(self, cameras: int, max_gap_ms: float) -> None:
        self._cameras = cameras
        self._max_gap_ns = round(max_gap_ms * NS_PER_MS)
        self._waiting: dict[int, PairedImage] = {}
        self._scans = 0

    def push(self, entry: PairedImage) -> Iterator[tuple[PairedImage, ...]]:
        """An image as it comes; the groups that are complete, or can no longer be."""
        stamp_ns = entry.image.stamp_ns
        oldest_ns = stamp_ns - self._max_gap_ns
        yield from self._release(
            lambda held: held.camera == entry.camera or held.image.stamp_ns < oldest_ns
        )
        self._waiting[entry.camera] = entry
        self._scans = 0
        stamps_ns = [held.image.stamp_ns for held in self._waiting.values()]
        is_whole = len(stamps_ns) == self._cameras
        if is_whole and max(stamps_ns) - min(stamps_ns) <= self._max_gap_ns:
            group = tuple(self._waiting[camera] for camera in sorted(self._waiting))
            self._waiting.clear()
            yield group

    def pass_scan(self) -> Iterator[tuple[PairedImage, ...]]:
        """A scan has come: images wait no longer than scans do for them."""
        self._scans += 1
        if self._scans > SCANS_KEPT // 2:
            yield from self.flush()

    def flush(self) -> Iterator[tuple[PairedImage, ...]]:
        """The images that still wait for their partners."""
        yield from self._release(lambda _: True)

    def _release(
        self, is_released: Callable[[PairedImage], bool]
    ) -> Iterator[tuple[PairedImage, ...]]:
        released = [held for held in self._waiting.values() if is_released(held)]
        for held in sorted(released, key=lambda held: held.image.stamp_ns):
            del self._waiting[held.camera]
            yield (held,)


def share_scan(
    group: Sequence[PairedImage], settings: TimeSettings
) -> tuple[PairedImage, ...] | None:
    """The images of a panorama with one scan, the one nearest to the middle of their stamps; None
    where it is farther away than ``max_gap_ms``. By rates: the first camera's, however far."""
    windows = [entry.window for entry in group if entry.window is not None]
    if not windows:
        return None
    offset_ns = next(
        entry.image.stamp_ns - entry.window.scan.stamp_ns - entry.gap_ns
        for entry in group
        if entry.window is not None
    )
    stamps_ns = [entry.image.stamp_ns - offset_ns for entry in group]
    middle_ns = sum(stamps_ns) // len(stamps_ns)
    window = windows[0]
    if settings.pair_by != "rates":
        window = min(windows, key=lambda window: abs(window.scan.stamp_ns - middle_ns))
        if abs(window.scan.stamp_ns - middle_ns) > round(settings.max_gap_ms * NS_PER_MS):
            return None
    return tuple(
        replace(entry, window=window, gap_ns=stamp_ns - window.scan.stamp_ns)
        for entry, stamp_ns in zip(group, stamps_ns, strict=True)
    )


def virtual_pairs(
    recording: Recording, rig: CameraRig, fitting: GeometryFilter, row: int
) -> Iterator[LaserScan | PairedImage]:
    """Every depth image of the first camera, after the scan that is cut from its ``row``."""
    camera = rig.cameras[0]
    for message in fitting.accepted(recording.messages([camera.topic])):
        image = message.value
        if not isinstance(image, DepthImage):
            continue
        paired = virtual_pair(rig, image, row)
        if paired.window is not None:
            yield paired.window.scan
        yield paired


def virtual_pair(rig: CameraRig, image: DepthImage, row: int) -> PairedImage:
    """An image of the first camera with the scan that is cut from its own ``row``."""
    camera, view = rig.cameras[0], rig.full_views[0]
    upright = replace(image, depth_m=view.remap(image.depth_m))
    full = replace(camera, intrinsics=view.intrinsics)
    scan = cut_scan(upright, full, row)
    window = ScanWindow(before=None, scan=scan, after=None)
    return PairedImage(camera=0, image=image, window=window, gap_ns=0)
