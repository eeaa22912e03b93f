"""Loop closing: a place that is seen again is recognised, and the map is bent until it agrees.

After ORB-SLAM2 (Mur-Artal & Tardós 2017, §III-C): candidates by place recognition, a relative pose
by their features, fusion of the landmarks of both visits, the essential graph, and bundle
adjustment of all. What is added is the gate: a loop is refused where it asks for more drift than
the odometry can have had.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.model.geometry import invert_transform
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import SettingsGroup, StageSettings, setting
from fusion_core.slam.visual.drift import (
    GATE_CHI2,
    DriftSettings,
    path_length_m,
    shortest_path,
    step_lengths_m,
)
from fusion_core.slam.visual.essential_graph import (
    EssentialGraphSettings,
    PoseEdge,
    connected_parts,
    essential_edges,
    loop_chi2,
    optimise_poses,
)
from fusion_core.slam.visual.global_adjustment import GlobalAdjustmentSettings, adjust_globally
from fusion_core.slam.visual.keyframes import LoopClosure
from fusion_core.slam.visual.landmark_fusion import fuse_matches, fuse_neighbours, move_landmarks
from fusion_core.slam.visual.loop_candidates import LoopCandidates, LoopCandidateSettings
from fusion_core.slam.visual.loop_gate import LostMotionSettings, loop_refusal
from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.slam.visual.place_recognition import PlaceIndex, PlaceSettings
from fusion_core.slam.visual.relative_pose import (
    RelativePose,
    RelativePoseSettings,
    estimate_relative_pose,
)
from fusion_core.slam.visual.relocalisation import RelocalisationSettings
from fusion_core.slam.visual.visual_map import VisualMap

# A loop within this is no news to the map: its edge is kept, nothing is moved. 0.95 quantile of
# chi-square with six degrees of freedom.
_NEWS_CHI2 = 12.59
# The whole map is adjusted again when it has grown by this fraction, so that the time of all
# adjustments stays linear in the map's size. Set by hand.
_GROWTH_MIN = 0.5


class LoopClosingSettings(StageSettings):
    """Closing of loops."""

    is_used: bool = setting(True, "Close loops")
    pause_keyframes: int = setting(
        5, "Keyframes after a loop before the next is closed", unit="keyframes", ge=0, le=10_000
    )
    neighbours_max: int = setting(
        10,
        "Keyframes about each end of a loop whose landmarks are fused",
        unit="keyframes",
        ge=0,
        le=1000,
    )


class VisualLoopSettings(SettingsGroup):
    """All stages of loop closing."""

    loop_closing: LoopClosingSettings = LoopClosingSettings()
    places: PlaceSettings = PlaceSettings()
    candidates: LoopCandidateSettings = LoopCandidateSettings()
    relative_pose: RelativePoseSettings = RelativePoseSettings()
    drift: DriftSettings = DriftSettings()
    lost_motion: LostMotionSettings = LostMotionSettings()
    essential_graph: EssentialGraphSettings = EssentialGraphSettings()
    global_adjustment: GlobalAdjustmentSettings = GlobalAdjustmentSettings()
    relocalisation: RelocalisationSettings = RelocalisationSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class RefusedLoop:
    """Two keyframes whose features give a pose and that were not joined all the same, and why.

    ``inliers``: of the pose.
    """

    first: int
    second: int
    inliers: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosedLoop:
    """``loop``, and what it did to the map: ``T_after_before``, (4, 4), moves what was placed by
    its second keyframe. ``fused``: sightings of landmarks that became one."""

    loop: LoopClosure
    T_after_before: FloatArray
    fused: int

    def __post_init__(self) -> None:
        read_only(self.T_after_before)


class LoopCloser:
    """Closes loops of a map that grows.

    ``refused``: what was not joined, in the order of the search. ``tried``: how many pairs of
    keyframes were compared by their features. ``adjustments``: how often all of the map was
    adjusted.
    """

    def __init__(
        self,
        visual_map: VisualMap,
        intrinsics: CameraIntrinsics,
        noise: ObservationNoise | None = None,
        settings: VisualLoopSettings | None = None,
    ) -> None:
        self._map, self._intrinsics = visual_map, intrinsics
        self._noise, self._settings = noise or ObservationNoise(), settings or VisualLoopSettings()
        self._candidates = LoopCandidates(
            visual_map, self._settings.places, self._settings.candidates
        )
        self._strong_pairs: list[tuple[int, int]] = []
        self._paused_until = 0
        self._adjusted_size, self._loops_adjusted = 0, 0
        self.refused: list[RefusedLoop] = []
        self.tried = self.adjustments = 0

    @property
    def index(self) -> PlaceIndex:
        """The places of the map, for relocalisation; each is a keyframe's number."""
        return self._candidates.index

    def add(self, keyframe: int) -> ClosedLoop | None:
        """Search a loop to the newest keyframe, whose landmarks are known, and close it.

        Keyframes and landmarks of the map are moved.
        """
        shared_min = self._settings.essential_graph.shared_min
        others, _ = self._map.covisible(keyframe, shared_min)
        self._strong_pairs += [(other, keyframe) for other in others.tolist() if other < keyframe]
        candidates = self._candidates.add(keyframe)
        if not self._settings.loop_closing.is_used or keyframe < self._paused_until:
            return None
        best: tuple[int, RelativePose] | None = None
        for candidate in candidates:
            found = self._measure(candidate, keyframe)
            if found is not None and (best is None or len(found.matches) > len(best[1].matches)):
                best = candidate, found
        return None if best is None else self._close(best[0], keyframe, best[1])

    def finish(self) -> None:
        """Adjust the whole map of a run with loops, if it has changed since that was done last."""
        size, loops = len(self._map.kept_keyframes), len(self._map.loops)
        if loops and (size, loops) != (self._adjusted_size, self._loops_adjusted):
            self._adjust()

    def _pairs(self) -> list[tuple[int, int]]:
        """The keyframes that are connected: by the tree, shared landmarks and loops."""
        tree = [(k.parent, k.index) for k in self._map.keyframes if k.parent is not None]
        return [
            *tree,
            *self._strong_pairs,
            *((loop.first, loop.second) for loop in self._map.loops),
        ]

    def _measure(self, first: int, second: int) -> RelativePose | None:
        """The pose of a keyframe in a candidate, where it can be believed."""
        keyframes, settings = self._map.keyframes, self._settings
        found = estimate_relative_pose(
            keyframes[first].features,
            keyframes[second].features,
            self._intrinsics,
            self._noise,
            settings.relative_pose,
        )
        self.tried += 1
        if isinstance(found, str):
            return None
        reason = loop_refusal(
            self._map, self._pairs(), first, second, found, settings.drift, settings.lost_motion
        )
        if reason is not None:
            self._refuse(first, second, len(found.matches), reason)
            return None
        return found

    def _refuse(self, first: int, second: int, inliers: int, reason: str) -> None:
        self.refused.append(RefusedLoop(first=first, second=second, inliers=inliers, reason=reason))

    def _close(self, first: int, second: int, found: RelativePose) -> ClosedLoop | None:
        visual_map = self._map
        T_before = _poses(visual_map)
        loop = LoopClosure(first=first, second=second, pose=found)
        _join_parts(visual_map, self._pairs(), loop)
        if not self._bend_map(loop):
            _place(visual_map, T_before)
            self._refuse(
                first, second, len(found.matches), "the other loops and odometry contradict it"
            )
            return None
        visual_map.loops.append(loop)
        move_landmarks(visual_map, T_before)
        fused = fuse_matches(visual_map, loop)
        fused += fuse_neighbours(
            visual_map, loop, T_before, self._intrinsics, self._settings.loop_closing.neighbours_max
        )
        size = len(visual_map.kept_keyframes)
        if size >= (1.0 + _GROWTH_MIN) * self._adjusted_size:
            self._adjust()
        self._candidates.clear_groups()
        self._paused_until = second + 1 + self._settings.loop_closing.pause_keyframes
        return ClosedLoop(
            loop=loop,
            T_after_before=visual_map.pose_of(second) @ invert_transform(T_before[second]),
            fused=fused,
        )

    def _bend_map(self, loop: LoopClosure) -> bool:
        """Move the keyframes until they agree with a loop; whether they do."""
        edge = PoseEdge(
            first=loop.first,
            second=loop.second,
            T_first_second=loop.pose.T_first_second,
            covariance=loop.pose.covariance.copy(),
            is_loop=True,
        )
        placed = _poses(self._map)
        if loop_chi2(placed, edge) <= _NEWS_CHI2:
            return True
        edges = essential_edges(
            self._map, self._strong_pairs, self._settings.drift, self._path_length_m(placed, loop)
        )
        # Without a kernel first, as a loop after much drift would weigh nothing with it; then with
        # it, so that a wrong loop is overruled by the others.
        for robust_scale in (None, self._settings.essential_graph.robust_scale):
            placed = optimise_poses(placed, [*edges, edge], robust_scale)
        if loop_chi2(placed, edge) > GATE_CHI2:
            return False
        _place(self._map, placed)
        return True

    def _path_length_m(self, T_map_camera: FloatArray, loop: LoopClosure) -> float:
        """Of the shortest path between a loop's ends; of the tree, where none connects them."""
        drift, pairs = self._settings.drift, self._pairs()
        path = shortest_path(T_map_camera, pairs, loop.first, loop.second, drift)
        if path is not None:
            return path_length_m(T_map_camera[path], drift)
        ends = np.array(pairs)
        return float(
            step_lengths_m(T_map_camera[ends[:, 0]], T_map_camera[ends[:, 1]], drift).sum()
        )

    def _adjust(self) -> None:
        self._adjusted_size = len(self._map.kept_keyframes)
        self._loops_adjusted = len(self._map.loops)
        if not self._settings.global_adjustment.is_used:
            return
        self.adjustments += 1
        adjust_globally(self._map, self._intrinsics, self._noise, self._settings.global_adjustment)


def _poses(visual_map: VisualMap) -> FloatArray:
    """(K, 4, 4) of all keyframes, those that are culled too."""
    return np.array([visual_map.pose_of(index) for index in range(len(visual_map.keyframes))])


def _place(visual_map: VisualMap, T_map_camera: FloatArray) -> None:
    """Move the kept keyframes; the culled ones follow their parents."""
    for keyframe in visual_map.kept_keyframes:
        keyframe.T_map_camera = T_map_camera[keyframe.index].copy()


def _join_parts(visual_map: VisualMap, pairs: list[tuple[int, int]], loop: LoopClosure) -> None:
    """Place the later of two parts that only a loop connects by that loop."""
    part = connected_parts(len(visual_map.keyframes), pairs)
    if part[loop.first] == part[loop.second]:
        return
    T_map_first, T_map_second = visual_map.pose_of(loop.first), visual_map.pose_of(loop.second)
    T_after_before = T_map_first @ loop.pose.T_first_second @ invert_transform(T_map_second)
    moved = part[loop.second]
    for keyframe in visual_map.kept_keyframes:
        if part[keyframe.index] == moved:
            keyframe.T_map_camera = T_after_before @ keyframe.T_map_camera
