"""Visual SLAM of an RGB-D camera in six degrees of freedom.

After ORB-SLAM2 (Mur-Artal & Tardos 2017), on which Fu 2024 §3 builds: images are tracked in the
local map (``tracking``); keyframes extend and adjust the map (``local_mapping``, ``visual_map``); a
place seen again closes a loop (``loop_closing``). Here is what joins them. Mapping may run on a
second thread behind tracking: its results are taken over a fixed number of images after a keyframe,
so that they are the same with and without it.
"""

from collections.abc import Iterable
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import (
    BoolArray,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.model.errors import MappingFailed
from fusion_core.model.geometry import invert_transform
from fusion_core.model.progress import Progress, silent
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.model.visual_slam_view import VisualSlamObserver, unobserved
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.color_zoom import ColorZoomSettings
from fusion_core.slam.visual.depth_alignment import DepthAlignmentSettings
from fusion_core.slam.visual.depth_consistency import (
    DepthCheckSettings,
    depth_check,
)
from fusion_core.slam.visual.depth_surface import SurfaceSampler
from fusion_core.slam.visual.doubtful_stretches import DoubtfulStretch
from fusion_core.slam.visual.features import FeatureExtractor, FeatureSettings
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.image_trajectory import (
    ImageTrajectory,
    Jump,
    LostStretch,
    find_jumps,
    find_lost_stretches,
)
from fusion_core.slam.visual.keyframe_policy import KeyframePolicy, wants_keyframe
from fusion_core.slam.visual.keyframes import NO_LANDMARK
from fusion_core.slam.visual.live_view import LiveView
from fusion_core.slam.visual.local_map import LocalMap, take_local_map
from fusion_core.slam.visual.local_mapping import (
    LocalMapping,
    LocalMappingSettings,
    new_landmarks,
)
from fusion_core.slam.visual.loop_closing import LoopCloser, RefusedLoop, VisualLoopSettings
from fusion_core.slam.visual.mapping_thread import MappingThread
from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.slam.visual.pinhole import camera_parameters
from fusion_core.slam.visual.relocalisation import LastKnownPose, relocalise
from fusion_core.slam.visual.rival_motion import RivalMotionSettings, rival_motion_check
from fusion_core.slam.visual.stage_times import StageTimes
from fusion_core.slam.visual.tracked_frame import TrackedFrame
from fusion_core.slam.visual.tracking import Tracker, TrackingLoss, TrackingSettings
from fusion_core.slam.visual.visual_map import VisualMap

# A keyframe does not wait for mapping where less than this part of the landmarks is left in sight;
# set by hand.
_URGENT_RATIO = 0.5


class VisualMappingSettings(StageSettings):
    """Settings of ``visual_slam`` itself."""

    delay_images: int = setting(
        4,
        "Images from a keyframe until tracking takes over what mapping has made of it",
        unit="images",
        ge=1,
        le=100,
    )
    local_keyframes_max: int = setting(
        20, "Most keyframes of the local map", unit="keyframes", ge=2, le=200
    )
    refresh_images: int = setting(
        4, "Images after which the local map is taken anew", unit="images", ge=1, le=100
    )


class VisualSlamSettings(VisualLoopSettings):
    """Every stage's settings."""

    color_zoom: ColorZoomSettings = ColorZoomSettings()
    features: FeatureSettings = FeatureSettings()
    observation_noise: ObservationNoise = ObservationNoise()
    tracking: TrackingSettings = TrackingSettings()
    keyframes: KeyframePolicy = KeyframePolicy()
    local_mapping: LocalMappingSettings = LocalMappingSettings()
    depth_alignment: DepthAlignmentSettings = DepthAlignmentSettings()
    depth_check: DepthCheckSettings = DepthCheckSettings()
    rival_motion: RivalMotionSettings = RivalMotionSettings()
    visual_mapping: VisualMappingSettings = VisualMappingSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VisualSlamResult:
    """``stamps_ns``: (N,) of all images. ``T_map_camera``: (N, 4, 4) of the camera's optical frame,
    the map being that of the first keyframe; NaN where ``is_tracked``, (N,), is false.
    ``references``: (N,) the keyframe in whose local map each was tracked, -1 where lost.
    ``information``: (N, 6, 6) of each pose in that map by what the image sees, see ``PoseFit``; NaN
    where it is lost, and for the image that begins the map.
    ``visual_map``: its keyframes and landmarks. ``refused_loops``: keyframes that look alike and
    were not joined. ``seconds``: wall-clock time of each stage, which overlap where mapping has a
    thread of its own. ``notes``: for people.
    """

    stamps_ns: IntArray
    T_map_camera: FloatArray
    is_tracked: BoolArray
    references: IntArray
    information: FloatArray
    visual_map: VisualMap
    lost: tuple[LostStretch, ...]
    jumps: tuple[Jump, ...]
    doubtful: tuple[DoubtfulStretch, ...]
    refused_loops: tuple[RefusedLoop, ...]
    seconds: dict[str, float]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for array in (
            self.stamps_ns,
            self.T_map_camera,
            self.is_tracked,
            self.references,
            self.information,
        ):
            read_only(array)


def visual_slam(
    frames: Iterable[RgbdFrame],
    intrinsics: CameraIntrinsics,
    settings: VisualSlamSettings | None = None,
    progress: Progress = silent,
    observer: VisualSlamObserver = unobserved,
    *,
    executor: Executor | None = None,
    image_count: int | None = None,
) -> VisualSlamResult:
    """Track a camera's images, whose stamps increase, and map what they see.

    ``intrinsics``: of the grey images. ``executor``: on which mapping runs behind tracking; without
    it mapping runs in between, with the same result. ``image_count``: how many frames there are at
    most, for ``progress``.

    Raises MappingFailed where no image can start a map.
    """
    run = _VisualSlam(
        intrinsics,
        settings or VisualSlamSettings(),
        observer,
        executor,
    )
    for count, frame in enumerate(frames, start=1):
        run.add(frame)
        progress(count, image_count, "placing images")
    progress(0, None, "adjusting the whole map")
    return run.result()


class _VisualSlam:
    def __init__(
        self,
        intrinsics: CameraIntrinsics,
        settings: VisualSlamSettings,
        observer: VisualSlamObserver,
        executor: Executor | None,
    ) -> None:
        self._intrinsics, self._settings = intrinsics, settings
        self._camera = camera_parameters(intrinsics)
        noise, levels = settings.observation_noise, settings.features.levels
        self._extractor = FeatureExtractor(intrinsics, settings.features)
        self._tracker = Tracker(intrinsics, settings.tracking, noise, levels)
        self._surfaces = SurfaceSampler(intrinsics)
        self._checks = (
            depth_check(intrinsics, settings.depth_check, noise.depth_sigma_per_m2),
            rival_motion_check(intrinsics, settings.rival_motion, noise),
        )
        self._map = VisualMap()
        self._loops = LoopCloser(self._map, intrinsics, noise, settings)
        self._times = StageTimes(
            ("features", "tracking", "local map", "waiting for mapping", "mapping")
        )
        self._mapping = MappingThread(
            self._map,
            LocalMapping(
                intrinsics, settings.local_mapping, noise, levels, settings.depth_alignment
            ),
            self._loops,
            self._times,
            executor,
        )
        self._live_view = LiveView(observer, self._camera)
        self._trajectory = ImageTrajectory()
        self._local: LocalMap | None = None
        self._last: TrackedFrame | None = None
        self._velocity: FloatArray | None = None
        # Counts of images: since the last keyframe, and since the local map was taken.
        self._since_keyframe = self._since_local_map = 0
        # Of the images since the last keyframe.
        self._most_in_sight = 0

    def add(self, frame: RgbdFrame) -> None:
        """Place the next image."""
        with self._times.measure("features"):
            features = self._extractor.extract(frame)
        if self._local is None:
            self._start(frame, features)
            return
        self._since_keyframe += 1
        self._since_local_map += 1
        when = self._settings.visual_mapping
        if self._mapping.is_running:
            if self._since_keyframe >= when.delay_images:
                self._take_over_mapping()
        elif self._since_local_map >= when.refresh_images:
            self._take_local_map()
        with self._times.measure("tracking"):
            found = self._tracker.track(features, self._last, self._velocity, self._local)
            if isinstance(found, TrackingLoss) and self._last is None:
                found = self._relocalised(frame.stamp_ns, features, found)
        if isinstance(found, TrackingLoss):
            self._trajectory.append_lost(frame.stamp_ns, found.reason)
            self._last = self._velocity = None
            return
        self._accept(frame, found)

    def _start(self, frame: RgbdFrame, features: FrameFeatures) -> None:
        """The first keyframe, if the image has enough to see."""
        first = TrackedFrame(
            features=features,
            T_map_camera=np.eye(4),
            landmarks=np.full(len(features), NO_LANDMARK, np.int64),
            positions_in_map_m=np.full((len(features), 3), np.nan),
        )
        with_depth = np.count_nonzero(np.isfinite(features.depths_m))
        if with_depth < self._settings.tracking.start_features_min:
            self._trajectory.append_lost(
                frame.stamp_ns, f"too few features with depth to start a map ({with_depth})"
            )
            return
        first.add_points_by_depth(self._camera)
        self._last = first
        self._add_keyframe(frame, first)
        self._take_local_map()

    def _accept(self, frame: RgbdFrame, tracked: TrackedFrame) -> None:
        assert self._local is not None, "tracked images have a local map"
        T_reference_map = invert_transform(self._local.T_map_reference)
        image = len(self._trajectory.stamps_ns)
        for check in self._checks:
            check.check(image, frame.depth_m, tracked, self._local)
        before = self._last
        self._velocity = None
        if before is not None:
            self._velocity = invert_transform(tracked.T_map_camera) @ before.T_map_camera
        self._last = tracked
        if self._wants_keyframe(tracked):
            self._add_keyframe(frame, tracked)
            return
        self._trajectory.append(
            frame.stamp_ns,
            self._local.reference,
            T_reference_map @ tracked.T_map_camera,
            tracked.information,
        )

    def _wants_keyframe(self, tracked: TrackedFrame) -> bool:
        self._most_in_sight = max(self._most_in_sight, tracked.in_sight)
        if not wants_keyframe(
            tracked, self._most_in_sight, self._since_keyframe, self._settings.keyframes
        ):
            return False
        # In a fast turn the map leaves the sight before the usual delay is over.
        if self._mapping.is_running and tracked.in_sight < _URGENT_RATIO * self._most_in_sight:
            self._take_over_mapping()
        return not self._mapping.is_running

    def _add_keyframe(self, frame: RgbdFrame, tracked: TrackedFrame) -> None:
        parent = None if self._local is None else self._local.reference
        keyframe = self._map.add_keyframe(
            frame.stamp_ns,
            tracked.features,
            tracked.T_map_camera,
            tracked.landmarks,
            parent,
            self._surfaces.reduce(frame.depth_m),
        )
        made = new_landmarks(self._map, keyframe, tracked.positions_in_map_m)
        tracked.landmarks = keyframe.landmarks.copy()
        self._trajectory.append(frame.stamp_ns, keyframe.index, np.eye(4), tracked.information)
        self._since_keyframe = self._most_in_sight = 0
        self._live_view.show(self._map, self._trajectory, frame)
        # The new keyframe is seen by tracking at once; what mapping makes of it, later.
        self._take_local_map()
        self._mapping.start(keyframe.index, made)

    def _take_over_mapping(self) -> None:
        """Let tracking see what mapping has made of the newest keyframe."""
        assert self._local is not None, "mapping follows a keyframe"
        with self._times.measure("waiting for mapping"):
            self._mapping.wait()
        rows = self._mapping.drop_culled_landmarks()
        if rows is not None and self._last is not None:
            self._last.landmarks = rows[self._last.landmarks]
        if self._last is not None:
            T_reference_last = invert_transform(self._local.T_map_reference) @ (
                self._last.T_map_camera
            )
            self._last.follow_map(
                self._map, self._map.pose_of(self._local.reference) @ T_reference_last
            )
        self._take_local_map()

    def _take_local_map(self) -> None:
        newest = next(k.index for k in reversed(self._map.keyframes) if not k.is_culled)
        landmarks = np.empty(0, np.int64)
        reference = newest if self._local is None else self._local.reference
        if self._map.keyframes[reference].is_culled:
            reference = newest
        if self._last is not None:
            landmarks = self._last.landmarks[self._last.landmarks != NO_LANDMARK]
            landmarks = landmarks[~self._map.is_landmark_culled[landmarks]]
        with self._times.measure("local map"):
            self._local = take_local_map(
                self._map,
                reference,
                landmarks,
                self._settings.visual_mapping.local_keyframes_max,
            )
        self._since_local_map = 0

    def _relocalised(
        self, stamp_ns: int, features: FrameFeatures, loss: TrackingLoss
    ) -> TrackedFrame | TrackingLoss:
        if self._mapping.is_running:
            self._take_over_mapping()
        settings = self._settings
        before = self._trajectory.last_tracked()
        found = relocalise(
            self._map,
            self._loops.index,
            features,
            self._intrinsics,
            settings.observation_noise,
            settings.relative_pose,
            settings.relocalisation,
            last_known=LastKnownPose(
                T_map_camera=self._trajectory.pose_of(before, self._map),
                lost_ns=stamp_ns - self._trajectory.stamps_ns[before],
            ),
            lost_motion=settings.lost_motion,
        )
        if isinstance(found, str):
            return loss
        T_map_camera = found.T_map_camera
        self._local = take_local_map(
            self._map,
            self._map.nearest_keyframe(T_map_camera),
            np.empty(0, np.int64),
            self._settings.visual_mapping.local_keyframes_max,
        )
        return self._tracker.track_at(features, invert_transform(T_map_camera), self._local)

    def result(self) -> VisualSlamResult:
        """The trajectory and the map of all images so far."""
        self._mapping.wait()
        with self._times.measure("mapping"):
            self._loops.finish()
        trajectory = self._trajectory
        stamps_ns = np.array(trajectory.stamps_ns, np.int64)
        if not self._map.keyframes:
            reason = next(iter(trajectory.losses.values()), "there are no images")
            raise MappingFailed(
                f"no image can start a map: {reason}.",
                advice="Visual SLAM needs textured images with depth.",
            )
        poses = trajectory.poses(self._map)
        is_tracked = np.isfinite(poses[:, 0, 0])
        lost = find_lost_stretches(stamps_ns, trajectory.losses)
        return VisualSlamResult(
            stamps_ns=stamps_ns,
            T_map_camera=poses,
            is_tracked=is_tracked,
            references=np.array(trajectory.references, np.int64),
            information=np.stack(
                [np.full((6, 6), np.nan) if one is None else one for one in trajectory.information]
            ),
            visual_map=self._map,
            lost=lost,
            jumps=find_jumps(stamps_ns, poses, is_tracked),
            doubtful=tuple(s for check in self._checks for s in check.doubtful(stamps_ns)),
            refused_loops=tuple(self._loops.refused),
            seconds=dict(self._times.seconds),
        )
