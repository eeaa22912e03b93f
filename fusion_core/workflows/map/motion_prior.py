"""What is known of the LiDAR's motion before SLAM (Li 2022 §3)."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fusion_core.model.conventions import R_BODY_OPTICAL, FloatArray, IntArray
from fusion_core.model.errors import MissingStream
from fusion_core.model.geometry import make_transform
from fusion_core.model.number_text import counted
from fusion_core.model.planar_poses import PosePrior
from fusion_core.model.progress import Progress, silent
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import PoseSample
from fusion_core.motion.fusion import FusionSettings, fuse_odometry
from fusion_core.motion.fusion_weights import FusionWeights
from fusion_core.motion.laser import LaserOdometrySettings, laser_odometry
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from fusion_core.motion.resample import resample_odometry
from fusion_core.motion.visual import VisualOdometrySettings, visual_odometry
from fusion_core.motion.wheel import WheelSettings, wheel_odometry
from fusion_core.recordings.topics import Streams, choose_streams
from fusion_core.settings import SettingsGroup
from fusion_core.slam.visual.planar_motion import PlanarMotionSettings, planar_motion
from fusion_core.slam.visual.visual_slam import VisualSlamSettings, visual_slam
from fusion_core.workflows.map.recorded_sensors import RecordedSensors
from fusion_core.workflows.map.rgbd_frames import (
    Purpose,
    RgbdFrames,
    first_camera_extrinsics,
)
from fusion_core.workflows.map.scan_source import ScanSource
from fusion_core.workflows.map.visual.color_registration import register_colors
from fusion_core.workflows.recorded_poses import PoseLookup, recorded_poses
from fusion_core.workflows.stamp_filter import StampFilter

MotionKind = Literal["recorded", "wheel", "laser", "visual", "visual-slam", "fused", "none"]


class MotionSettings(SettingsGroup):
    """Every source's settings, and those of their fusion."""

    wheel: WheelSettings = WheelSettings()
    laser: LaserOdometrySettings = LaserOdometrySettings()
    visual: VisualOdometrySettings = VisualOdometrySettings()
    fusion: FusionSettings = FusionSettings()
    visual_slam_motion: PlanarMotionSettings = PlanarMotionSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionPrior:
    """The LiDAR's motion by one source, or by several.

    ``at``: interpolated poses of the LiDAR. ``tracks``: the odometry of each source at the scans'
    stamps, the fused one last; empty for recorded poses, which are used as they are.
    ``weights``: of the fusion. ``notes``: for people.
    """

    source: str
    at: PosePrior
    tracks: tuple[OdometryTrajectory, ...] = ()
    weights: FusionWeights | None = None
    notes: tuple[str, ...] = ()

    @property
    def independent(self) -> tuple[OdometryTrajectory, ...]:
        """The tracks that the LiDAR's scans take no part in. Laser odometry is the scans
        themselves, and in the fused one they are contained."""
        sources = self.tracks if self.weights is None else self.tracks[:-1]
        return tuple(track for track in sources if track.name != "laser")


def open_motion_prior(
    sensors: RecordedSensors,
    scans: ScanSource,
    kind: MotionKind,
    settings: MotionSettings | None = None,
    progress: Progress = silent,
) -> MotionPrior | None:
    """The motion of the frame in which ``scans`` lie, None for "none".

    Without extrinsics in ``sensors`` the recording's own transforms place the camera. "fused" takes
    wheels and camera where the recording has them, and notes what it lacks.

    Raises MissingStream where the recording lacks what a single source needs.
    """
    settings = settings or MotionSettings()
    if kind == "none":
        return None
    if kind == "recorded":
        poses = require_recorded_poses(
            sensors.recording, sensors.streams, scans.frame_id, wheel_only=False
        )
        return MotionPrior(source=poses.source, at=poses.at)
    sources = _OdometrySources(sensors, scans, settings, progress)
    if kind == "wheel":
        return _single_odometry(sources.wheel(), sources.notes)
    if kind == "laser":
        return _single_odometry(sources.laser(None), sources.notes)
    if kind == "visual":
        return _single_odometry(sources.visual(needs_extrinsics=False), sources.notes)
    if kind == "visual-slam":
        return _single_odometry(sources.visual_slam(), sources.notes)
    return _fused_odometry(sources, settings.fusion)


def choose_map_streams(
    recording: Recording, lidar_topic: str | None, pose_topic: str | None
) -> Streams:
    """The recording's streams; its odometry is the one published with the LiDAR's scans where there
    is one, since that has the scans' stamps and need not be interpolated."""
    streams = choose_streams(recording, lidar=lidar_topic, pose=pose_topic)
    own = f"{streams.lidar}/odom"
    if not any(topic.name == own and topic.role == "odometry" for topic in recording.topics):
        return streams
    return choose_streams(recording, lidar=lidar_topic, pose=pose_topic, odometry=own)


def require_recorded_poses(
    recording: Recording, streams: Streams, lidar_frame: str, *, wheel_only: bool
) -> PoseLookup:
    """The LiDAR's poses by what was recorded; ``wheel_only``: by odometry, not by TF.

    Raises MissingStream where that is not there.
    """
    if wheel_only:
        streams = replace(streams, tf=None, pose=None, pose_frame=None)
    poses = recorded_poses(recording, streams, lidar_frame)
    if poses is None:
        what, advice = "odometry", "Use --motion none with SLAM"
        if not wheel_only:
            what = "recorded odometry"
            advice += ", or name by --pose a topic of poses or a frame of TF, such as map"
        raise MissingStream(f"holds no {what}.", file=recording.path, advice=f"{advice}.")
    return poses


def _single_odometry(track: OdometryTrajectory, notes: list[str]) -> MotionPrior:
    return MotionPrior(
        source=track.name,
        at=track.pose_at,
        tracks=(track,),
        notes=(*notes, *_track_notes(track)),
    )


def _fused_odometry(sources: "_OdometrySources", settings: FusionSettings) -> MotionPrior:
    tracks = []
    try:
        tracks.append(sources.wheel())
    except MissingStream as error:
        sources.notes.append(f"Fused without wheels: {error.problem}")
    # The wheels' steps are the initial guess of each scan match, not a part of its measurement.
    tracks.append(sources.laser(tracks[0].pose_at if tracks else None))
    try:
        tracks.append(sources.visual(needs_extrinsics=True))
    except MissingStream as error:
        sources.notes.append(f"Fused without the camera: {error.problem}")
    notes = sources.notes + [note for track in tracks for note in _track_notes(track)]
    if len(tracks) == 1:
        alone = tracks[0]
        notes.append(f"Nothing to fuse: {alone.name} odometry is all there is.")
        return MotionPrior(
            source=alone.name,
            at=alone.pose_at,
            tracks=(alone,),
            notes=tuple(notes),
        )
    fusion = fuse_odometry(tracks, settings)
    return MotionPrior(
        source=f"fused ({', '.join(track.name for track in tracks)})",
        at=fusion.trajectory.pose_at,
        tracks=(*tracks, fusion.trajectory),
        weights=fusion.weights,
        notes=(*notes, *fusion.trajectory.notes),
    )


def _track_notes(track: OdometryTrajectory) -> tuple[str, ...]:
    if track.measured.size and not track.measured.any():
        return (*track.notes, f"{track.name} odometry measured not a single step.")
    return track.notes


class _OdometrySources:
    """The odometries of a recording, each estimated when it is called for."""

    def __init__(
        self,
        sensors: RecordedSensors,
        scans: ScanSource,
        settings: MotionSettings,
        progress: Progress,
    ) -> None:
        self._recording, self._streams = sensors.recording, sensors.streams
        self._sensors, self._scans = sensors, scans
        self._settings, self._progress = settings, progress
        self._stamps_ns: IntArray | None = None
        self.notes: list[str] = []

    def stamps_ns(self) -> IntArray:
        """(N,) of the scans, read once."""
        if self._stamps_ns is None:
            self._stamps_ns = np.array([scan.stamp_ns for scan in self._scans], dtype=np.int64)
            if not self._stamps_ns.size:
                raise MissingStream("there is no scan to follow.", file=self._recording.path)
        return self._stamps_ns

    def wheel(self) -> OdometryTrajectory:
        poses = require_recorded_poses(
            self._recording, self._streams, self._scans.frame_id, wheel_only=True
        )
        topic = self._streams.odometry
        assert topic is not None, "poses by odometry have a topic"
        if poses.source != topic:
            self.notes.append(f"Wheel odometry: {poses.source}.")
        order = StampFilter(self._recording, strictly=False)
        sampled_ns = [
            message.value.stamp_ns
            for message in order.accepted(self._recording.messages([topic]))
            if isinstance(message.value, PoseSample)
        ]
        return wheel_odometry(
            self.stamps_ns(), poses.at, np.array(sampled_ns, dtype=np.int64), self._settings.wheel
        )

    def laser(self, predicted: PosePrior | None) -> OdometryTrajectory:
        track = laser_odometry(self._scans, self._settings.laser, predicted, self._progress)
        self._stamps_ns = track.stamps_ns
        return track

    def visual(self, *, needs_extrinsics: bool) -> OdometryTrajectory:
        frames = self._frames("Visual odometry")
        T_lidar_camera = self._T_lidar_camera()
        if T_lidar_camera is None:
            if needs_extrinsics:
                raise self._unknown_mount()
            T_lidar_camera = make_transform(R_BODY_OPTICAL, np.zeros(3))
            self.notes.append(
                "Visual odometry is the camera's own, taken to be level and to look ahead: nothing "
                "tells where it stands on the LiDAR."
            )
        track = visual_odometry(
            frames, frames.intrinsics, T_lidar_camera, self._settings.visual, self._progress
        )
        self.notes.extend(frames.notes)
        return resample_odometry(track, self.stamps_ns())

    def visual_slam(self) -> OdometryTrajectory:
        frames = self._frames("Visual SLAM")
        T_lidar_camera = self._T_lidar_camera()
        if T_lidar_camera is None:
            raise self._unknown_mount()
        settings = VisualSlamSettings()
        registered = register_colors(frames, frames.intrinsics, settings)
        result = visual_slam(registered, frames.intrinsics, settings, progress=self._progress)
        self.notes.extend((*frames.notes, *registered.notes, *result.notes))
        visual_map = result.visual_map
        self.notes.append(
            f"Visual SLAM has placed {int(result.is_tracked.sum())} of {len(result.stamps_ns)} "
            f"images, with {counted(len(visual_map.kept_keyframes), 'keyframe')} and "
            f"{counted(len(visual_map.loops), 'loop')}."
        )
        track = planar_motion(result, T_lidar_camera, self._settings.visual_slam_motion)
        return resample_odometry(track, self.stamps_ns())

    def _frames(self, purpose: Purpose) -> RgbdFrames:
        return RgbdFrames(
            self._recording,
            self._streams,
            clock_offset_ns=self._sensors.clock_offset_ns,
            purpose=purpose,
        )

    def _T_lidar_camera(self) -> FloatArray | None:
        T_lidar_camera, notes = first_camera_extrinsics(
            self._recording, self._streams, self._sensors.extrinsics
        )
        self.notes.extend(notes)
        return T_lidar_camera

    def _unknown_mount(self) -> MissingStream:
        return MissingStream(
            "does not tell where the camera stands on the LiDAR.",
            file=self._recording.path,
            advice="Give --extrinsics FILE.",
        )
