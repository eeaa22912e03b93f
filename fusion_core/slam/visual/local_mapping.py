"""What a new keyframe does to the map around it (ORB-SLAM, Mur-Artal 2015, §VI).

Landmarks that few keyframes see, or few of those that should, are culled; it and its neighbours
exchange the landmarks that they see; their poses and landmarks are adjusted together; keyframes
that add nothing are culled.
"""

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.geometry import invert_transform
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.bundle_adjustment import BundleProblem, adjust_bundle
from fusion_core.slam.visual.depth_alignment import DepthAlignmentSettings, align_depths
from fusion_core.slam.visual.depth_surface import DepthSurface, SurfaceSampler
from fusion_core.slam.visual.expected_views import expect_views
from fusion_core.slam.visual.features import octave_scales
from fusion_core.slam.visual.keyframes import NO_LANDMARK, DepthAlignment, Keyframe
from fusion_core.slam.visual.landmark_descriptors import update_descriptors
from fusion_core.slam.visual.local_map import landmark_views
from fusion_core.slam.visual.observation_noise import CHI2_PIXEL, ObservationNoise
from fusion_core.slam.visual.pinhole import camera_parameters
from fusion_core.slam.visual.projection_matching import DISTANCE_LOW, FeatureGrid
from fusion_core.slam.visual.visual_map import VisualMap

# A landmark must be seen by so many keyframes when this many more have been made, and found in so
# large a part of those that should show it (ORB-SLAM: three, two and a quarter, of images).
_TRIAL_KEYFRAMES = 3
_OBSERVERS_MIN = 3
_FOUND_RATIO_MIN = 0.25
# Features within this of a landmark's projection, on the finest level, may see it.
_FUSE_RADIUS_PX = 3.0
# A keyframe is redundant where so many of its landmarks are seen by three others as finely.
_REDUNDANT_FRACTION = 0.9
_REDUNDANT_OBSERVERS = 3


class LocalMappingSettings(StageSettings):
    """Settings of ``LocalMapping``."""

    neighbours_max: int = setting(
        10,
        "Keyframes with which a new one exchanges landmarks",
        unit="keyframes",
        ge=1,
        le=100,
    )
    adjusted_max: int = setting(
        12,
        "Most keyframes that one local bundle adjustment moves",
        unit="keyframes",
        ge=1,
        le=100,
    )
    fixed_max: int = setting(
        20,
        "Most other keyframes whose observations it uses",
        unit="keyframes",
        ge=1,
        le=100,
    )
    iterations: int = setting(
        6, "Iterations of local bundle adjustment, twice", unit="iterations", ge=1, le=100
    )
    cull_keyframes: bool = setting(True, "Whether redundant keyframes are culled")


class LocalMapping:
    """Works on the map that it is given; nothing else may change it meanwhile."""

    def __init__(
        self,
        intrinsics: CameraIntrinsics,
        settings: LocalMappingSettings,
        noise: ObservationNoise,
        levels: int,
        alignment: DepthAlignmentSettings | None = None,
    ) -> None:
        self._settings, self._noise, self._levels = settings, noise, levels
        self._alignment = alignment or DepthAlignmentSettings()
        self._sampler = SurfaceSampler(intrinsics)
        # Of the keyframes to which the last one was aligned: the next one mostly has the same.
        self._surfaces: dict[int, DepthSurface] = {}
        self._size = (intrinsics.width, intrinsics.height)
        self._camera = camera_parameters(intrinsics)
        # Of the keyframes on trial: the first of the landmarks that each made, and the last + 1.
        self._made: list[tuple[int, int]] = []

    def include(self, visual_map: VisualMap, index: int, made: tuple[int, int]) -> None:
        """Work in a new keyframe that has made the landmarks ``made[0]`` to ``made[1]`` - 1."""
        self._cull_landmarks_on_trial(visual_map, made)
        self._exchange_landmarks(visual_map, visual_map.keyframes[index])
        self._align_depths(visual_map, visual_map.keyframes[index])
        local = self._local_keyframes(visual_map, index)
        self._adjust(visual_map, local)
        self._cull_landmarks_not_found(visual_map, visual_map.keyframes[index], local)
        seen = visual_map.keyframes[index].landmarks
        update_descriptors(visual_map, seen[seen != NO_LANDMARK])
        if self._settings.cull_keyframes:
            self._cull_keyframes(visual_map, index, local)

    def follow_rows(self, rows: IntArray) -> None:
        """Take over new numbers of the landmarks, by ``VisualMap.drop_culled_landmarks``."""
        kept_before = np.concatenate([[0], np.cumsum(rows[:-1] != NO_LANDMARK)])
        self._made = [(int(kept_before[a]), int(kept_before[b])) for a, b in self._made]

    def _cull_landmarks_on_trial(self, visual_map: VisualMap, made: tuple[int, int]) -> None:
        self._made.append(made)
        if len(self._made) <= _TRIAL_KEYFRAMES:
            return
        rows = np.arange(*self._made.pop(0))
        visual_map.cull_landmarks(rows[visual_map.observer_counts(rows) < _OBSERVERS_MIN])

    def _cull_landmarks_not_found(
        self, visual_map: VisualMap, keyframe: Keyframe, local: list[int]
    ) -> None:
        """Count what the new keyframe should show of the local landmarks, and what it does."""
        views = landmark_views(visual_map, local)
        expected = expect_views(
            views,
            invert_transform(keyframe.T_map_camera),
            self._camera,
            self._size,
            self._levels,
            np.empty(0, np.int64),
        )
        seen = keyframe.landmarks[keyframe.landmarks != NO_LANDMARK]
        rows = np.union1d(views.rows[expected.which], seen)
        visual_map.expected_counts[rows] += 1
        visual_map.found_counts[seen] += 1
        is_missed = visual_map.found_counts[rows] < (
            _FOUND_RATIO_MIN * visual_map.expected_counts[rows]
        )
        visual_map.cull_landmarks(rows[is_missed])

    def _exchange_landmarks(self, visual_map: VisualMap, keyframe: Keyframe) -> None:
        neighbours, _ = visual_map.covisible(keyframe.index)
        neighbours = neighbours[: self._settings.neighbours_max]
        if not len(neighbours):
            return
        self._fuse(visual_map, keyframe, neighbours.tolist())
        for neighbour in neighbours.tolist():
            self._fuse(visual_map, visual_map.keyframes[neighbour], [keyframe.index])

    def _align_depths(self, visual_map: VisualMap, keyframe: Keyframe) -> None:
        """Align the new keyframe's depth image to those of its neighbours."""
        if keyframe.reduced_depth_m is None:
            return
        beside, _ = visual_map.covisible(keyframe.index)
        source = self._sampler.surface(keyframe.reduced_depth_m)
        surfaces = {keyframe.index: source}
        for index in beside[: self._alignment.neighbours_max].tolist():
            other = visual_map.keyframes[index]
            if other.reduced_depth_m is None:
                continue
            target = self._surfaces.get(index)
            if target is None:
                target = self._sampler.surface(other.reduced_depth_m)
            surfaces[index] = target
            found = align_depths(
                source,
                target,
                invert_transform(other.T_map_camera) @ keyframe.T_map_camera,
                self._noise.depth_sigma_per_m2,
                self._alignment.overlap_min,
            )
            if found is not None:
                T_second_first, information = found
                visual_map.alignments.append(
                    DepthAlignment(
                        first=keyframe.index,
                        second=index,
                        T_second_first=T_second_first,
                        information=information,
                    )
                )
        self._surfaces = surfaces

    def _fuse(self, visual_map: VisualMap, keyframe: Keyframe, others: list[int]) -> None:
        """Let a keyframe see the landmarks of others that project onto its features."""
        views = landmark_views(visual_map, others)
        T_camera_map = invert_transform(keyframe.T_map_camera)
        expected = expect_views(
            views, T_camera_map, self._camera, self._size, self._levels, keyframe.landmarks
        )
        found = FeatureGrid(keyframe.features).match(
            expected.pixels,
            _FUSE_RADIUS_PX * octave_scales(expected.octaves),
            expected.octaves - 1,
            expected.octaves + 1,
            views.descriptors[expected.which],
            distance_max=DISTANCE_LOW,
        )
        hit = np.flatnonzero(found >= 0)
        features, which = found[hit], expected.which[hit]
        off = keyframe.features.pixels[features] - expected.pixels[hit]
        sigmas = self._noise.pixel_sigmas(keyframe.features.octaves[features])
        chi2 = (off**2).sum(axis=1) / sigmas**2
        depths_m = keyframe.features.depths_m[features]
        inverse_off = 1.0 / expected.points_in_camera_m[hit, 2] - 1.0 / depths_m
        is_near = ~(np.abs(inverse_off) > 3.0 * self._noise.depth_sigma_per_m2)
        fits = (chi2 <= CHI2_PIXEL) & is_near
        self._join(visual_map, keyframe, features[fits], views.rows[which[fits]])

    @staticmethod
    def _join(
        visual_map: VisualMap, keyframe: Keyframe, features: IntArray, landmarks: IntArray
    ) -> None:
        own = keyframe.landmarks[features]
        free = own == NO_LANDMARK
        visual_map.observe(keyframe.index, features[free], landmarks[free])
        taken = ~free
        for mine, other in zip(own[taken].tolist(), landmarks[taken].tolist(), strict=True):
            if visual_map.is_landmark_culled[mine] or visual_map.is_landmark_culled[other]:
                continue
            counts = visual_map.observer_counts(np.array([mine, other]))
            # Of equals the older, which has the lower row.
            kept, merged = mine, other
            if (counts[0], -mine) < (counts[1], -other):
                kept, merged = other, mine
            visual_map.merge_landmarks(kept, merged)

    def _local_keyframes(self, visual_map: VisualMap, index: int) -> list[int]:
        beside, _ = visual_map.covisible(index)
        return [index, *beside[: self._settings.adjusted_max - 1].tolist()]

    def _adjust(self, visual_map: VisualMap, local: list[int]) -> None:
        free = sorted(index for index in local if index != 0)
        if not free:
            return
        landmarks = visual_map.landmarks_of(local)
        around, _ = visual_map.sharing(landmarks)
        fixed = [i for i in around.tolist() if i not in free][: self._settings.fixed_max]
        if not fixed:
            # Nothing else holds the map in place.
            fixed, free = [free[0]], free[1:]
        if not free:
            return
        keyframes = sorted([*free, *fixed])
        seen = visual_map.observations(keyframes)
        in_problem = np.isin(seen.landmarks, landmarks)
        rows, which = np.unique(seen.landmarks[in_problem], return_inverse=True)
        order = np.array(keyframes, np.int64)
        result = adjust_bundle(
            BundleProblem(
                T_camera_map=np.stack(
                    [invert_transform(visual_map.keyframes[i].T_map_camera) for i in keyframes]
                ),
                is_fixed=np.isin(order, fixed),
                points_in_map_m=visual_map.positions_in_map_m[rows],
                keyframes=np.searchsorted(order, seen.keyframes[in_problem]),
                landmarks=which.astype(np.int64),
                pixels=seen.pixels[in_problem],
                depths_m=seen.depths_m[in_problem],
                pixel_sigmas=self._noise.pixel_sigmas(seen.octaves[in_problem]),
                camera=self._camera,
                depth_sigma_per_m2=self._noise.depth_sigma_per_m2,
                alignments=visual_map.alignments_between(order),
            ),
            self._settings.iterations,
        )
        visual_map.positions_in_map_m[rows] = result.points_in_map_m
        for i, T_camera_map in zip(keyframes, result.T_camera_map, strict=True):
            if i not in fixed:
                visual_map.keyframes[i].T_map_camera = invert_transform(T_camera_map)
        wrong = ~result.is_inlier
        of, features = seen.keyframes[in_problem][wrong], seen.features[in_problem][wrong]
        for i in np.unique(of).tolist():
            visual_map.forget(i, features[of == i])

    def _cull_keyframes(self, visual_map: VisualMap, newest: int, local: list[int]) -> None:
        for index in sorted(local):
            keyframe = visual_map.keyframes[index]
            if index in (0, newest) or keyframe.parent is None or keyframe.is_culled:
                continue
            if self._is_redundant(visual_map, keyframe):
                visual_map.cull_keyframe(index)

    @staticmethod
    def _is_redundant(visual_map: VisualMap, keyframe: Keyframe) -> bool:
        seen = np.flatnonzero(keyframe.landmarks != NO_LANDMARK)
        if not len(seen):
            return True
        enough = _REDUNDANT_FRACTION * len(seen)
        counts = visual_map.observer_counts(keyframe.landmarks[seen])
        # It is one of them.
        is_candidate = counts > _REDUNDANT_OBSERVERS
        # Most keyframes are told by the counts alone.
        if np.count_nonzero(is_candidate) <= enough:
            return False
        redundant = 0
        for feature in seen[is_candidate].tolist():
            octave = keyframe.features.octaves[feature] + 1
            others = visual_map.observers_of(int(keyframe.landmarks[feature]))
            del others[keyframe.index]
            as_fine = sum(
                bool(visual_map.keyframes[other].features.octaves[by] <= octave)
                for other, by in others.items()
            )
            redundant += as_fine >= _REDUNDANT_OBSERVERS
        return redundant > enough


def new_landmarks(
    visual_map: VisualMap, keyframe: Keyframe, positions_in_map_m: FloatArray
) -> tuple[int, int]:
    """Make a landmark of each feature that sees none and has a position, (F, 3) with NaN for none.

    The first of the new rows and the last + 1.
    """
    missing = np.flatnonzero(
        (keyframe.landmarks == NO_LANDMARK) & np.isfinite(positions_in_map_m[:, 0])
    )
    rows = visual_map.add_landmarks(
        positions_in_map_m[missing], keyframe.features.descriptors[missing]
    )
    visual_map.observe(keyframe.index, missing, rows)
    first = len(visual_map.positions_in_map_m) - len(rows)
    return first, first + len(rows)
