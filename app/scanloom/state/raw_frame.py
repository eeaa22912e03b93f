"""A frame as it was recorded: what is displayed before the recording is aligned."""

from dataclasses import dataclass

from fusion_core.model.conventions import Float32Array, read_only
from fusion_core.model.rig import Mount
from fusion_core.model.sensors import LaserScan, PoseSample
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.session import Session
from fusion_core.workflows.lone_stream import LoneStream


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RawFrame:
    """A depth image and its scan, at a mount that no alignment has checked.

    ``paired``: the image as stored, and the scan nearest to it in time. ``depth_m``: (H, W) upright
    view of it. ``mount``: the given or the recorded one; without, a level camera at the LiDAR that
    looks along its zero azimuth, and ``is_mount_recorded`` is False.
    """

    paired: PairedImage
    depth_m: Float32Array
    mount: Mount
    is_mount_recorded: bool

    def __post_init__(self) -> None:
        read_only(self.depth_m)

    @property
    def camera(self) -> int:
        """The index of the image's camera."""
        return self.paired.camera

    @property
    def stamp_ns(self) -> int:
        """The image's stamp."""
        return self.paired.image.stamp_ns

    @property
    def scan(self) -> LaserScan | None:
        """The scan nearest to the image in time, None where none is near enough."""
        return None if self.paired.window is None else self.paired.window.scan


def raw_frame(session: Session, frames: FrameReader, number: int) -> RawFrame:
    """A frame of a recording, read by its index alone: without a pass over the recording.

    Raises RecordingError for a frame that cannot be read.
    """
    paired = frames.raw_pair(number)
    recorded = session.rig.known_mount
    return RawFrame(
        paired=paired,
        depth_m=session.depth_of(paired.camera, paired.image.depth_m),
        mount=Mount(yaw_rad=0.0) if recorded is None else recorded,
        is_mount_recorded=recorded is not None,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoneFrame:
    """A scan of a recording without depth images, or a pose of one without a LiDAR, too."""

    value: LaserScan | PoseSample

    @property
    def stamp_ns(self) -> int:
        """The stamp of the scan or of the pose."""
        return self.value.stamp_ns

    @property
    def scan(self) -> LaserScan | None:
        """The scan, None in a recording of odometry alone."""
        return self.value if isinstance(self.value, LaserScan) else None


def lone_frame(stream: LoneStream, number: int) -> LoneFrame:
    """A frame of a recording without depth images. Raises as ``LoneStream.read``."""
    return LoneFrame(value=stream.read(number))
