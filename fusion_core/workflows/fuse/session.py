"""A recording opened for the chain: its streams, its rig, and passes over its pairs."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fusion_core.alignment.interpolated_scan import scan_at_image
from fusion_core.alignment.virtual_lidar import mask_cut_rows
from fusion_core.model.conventions import Float32Array
from fusion_core.model.given_extrinsics import GivenExtrinsics
from fusion_core.model.labels import LabelLayer
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import LaserScan
from fusion_core.recordings.calibration_files.extrinsics import read_given_extrinsics
from fusion_core.recordings.topics import Streams, choose_streams
from fusion_core.workflows.fuse.camera_rig import CameraRig, build_camera_rig
from fusion_core.workflows.fuse.pairing import (
    FramePair,
    PairedImage,
    UprightDepth,
    paired_images,
    virtual_pairs,
)
from fusion_core.workflows.fuse.settings import ChainSettings, PresetName
from fusion_core.workflows.sensor_geometry import GeometryFilter

if TYPE_CHECKING:
    # It knows all formats, which a worker process need not load.
    from fusion_core.workflows.source import RoomChoice


@dataclass(frozen=True, kw_only=True)
class FuseOptions:
    """The options of a run; the chain's own settings are in the preset and the file.

    ``seed`` overrides theirs unless None. ``room`` is a room of a data set. ``extrinsics_file``:
    where the LiDAR is in the cameras' frames, instead of the recording's transforms and of what
    scans and images show. ``labels``: a person's on this recording, which overrule the classes.
    ``workers``: processes that share in the work, None for one a core; the results are the same for
    each number.
    """

    preset: PresetName = "default"
    settings_file: Path | None = None
    room: "RoomChoice | None" = None
    virtual_lidar_row: int | None = None
    lidar_topic: str | None = None
    depth_topics: tuple[str, ...] = ()
    pose_topic: str | None = None
    extrinsics_file: Path | None = None
    apply_clock_offset: bool = False
    maps: bool = True
    figures: bool = True
    truth: Path | None = None
    labels: LabelLayer | None = None
    seed: int | None = None
    workers: int | None = 1
    force: bool = False
    overwrite: bool = False

    def given_extrinsics(self) -> GivenExtrinsics | None:
        """Those of the file, None without one. Raises SettingsError for what it has wrong."""
        return None if self.extrinsics_file is None else read_given_extrinsics(self.extrinsics_file)


@dataclass(frozen=True, kw_only=True)
class FrameSetup:
    """A rig and its settings: all that a frame needs of a session, and no file."""

    rig: CameraRig
    settings: ChainSettings
    virtual_row: int | None

    def frame_pair(
        self, paired: PairedImage, previous: UprightDepth | None = None
    ) -> FramePair | None:
        """An image and its scan, ready for the chain; None where no scan is near enough."""
        if paired.window is None:
            return None
        return FramePair(
            camera_index=paired.camera,
            camera=self.rig.cameras[paired.camera],
            image=paired.image,
            depth_m=self.depth_of(paired.camera, paired.image.depth_m),
            window=paired.window,
            gap_ns=paired.gap_ns,
            aligned_scan=scan_at_image(paired.window, paired.gap_ns, self.settings.time),
            previous=previous,
        )

    def depth_of(self, camera: int, stored_m: Float32Array) -> Float32Array:
        """(H', W') upright view of a stored image, without the rows of a virtual LiDAR."""
        depth_m = self.rig.views[camera].remap(stored_m)
        return depth_m if self.virtual_row is None else mask_cut_rows(depth_m, self.virtual_row)


@dataclass(frozen=True, kw_only=True)
class Session(FrameSetup):
    """An opened recording with its streams, its rig and its settings."""

    recording: Recording
    streams: Streams
    geometry_filter: GeometryFilter

    def pairs(self, clock_offset_ms: float = 0.0) -> Iterator[LaserScan | PairedImage]:
        """A new pass over scans and images."""
        if self.virtual_row is not None:
            return virtual_pairs(self.recording, self.rig, self.geometry_filter, self.virtual_row)
        return paired_images(
            self.recording,
            self.streams,
            self.rig,
            self.geometry_filter,
            self.settings.time,
            clock_offset_ms,
        )

    @property
    def setup(self) -> FrameSetup:
        """What frames need, without the recording."""
        return FrameSetup(rig=self.rig, settings=self.settings, virtual_row=self.virtual_row)

    @property
    def image_count(self) -> int:
        """Depth images of the rig's cameras."""
        wanted = {camera.topic for camera in self.rig.cameras}
        return sum(topic.count for topic in self.recording.topics if topic.name in wanted)


def open_session(
    recording: Recording,
    options: FuseOptions,
    settings: ChainSettings,
    given: GivenExtrinsics | None = None,
) -> Session:
    """Choose the streams and build the rig. ``given``: extrinsics instead of those of the options'
    file. Raises MissingStream and SettingsError as ``build_camera_rig``."""
    streams = choose_streams(
        recording,
        lidar=options.lidar_topic,
        depth=options.depth_topics or None,
        pose=options.pose_topic,
    )
    virtual = options.virtual_lidar_row is not None
    given = given or options.given_extrinsics()
    rig = build_camera_rig(recording, streams, settings.sampling, virtual=virtual, given=given)
    return session_of(recording, streams, rig, settings, options.virtual_lidar_row)


def session_of(
    recording: Recording,
    streams: Streams,
    rig: CameraRig,
    settings: ChainSettings,
    virtual_row: int | None = None,
) -> Session:
    """A session with a rig that is built; with the recording's own LiDAR unless ``virtual_row``."""
    return Session(
        recording=recording,
        streams=streams,
        rig=rig,
        geometry_filter=make_geometry_filter(recording, rig),
        settings=settings,
        virtual_row=virtual_row,
    )


def make_geometry_filter(recording: Recording, rig: CameraRig) -> GeometryFilter:
    """A filter that passes only the messages of a rig's geometry."""
    shapes = {
        camera.topic: view.stored_shape for camera, view in zip(rig.cameras, rig.views, strict=True)
    }
    return GeometryFilter(recording, rig.scan_geometry, shapes)
