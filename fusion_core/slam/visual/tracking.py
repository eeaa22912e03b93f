"""The pose of each image in the local map (ORB-SLAM, Mur-Artal 2015, §V; ORB-SLAM2, 2017, §III).

By the motion model first: what the last image saw is looked for where it would be if the camera
kept its velocity. Failing that by the descriptors of the reference keyframe. Then the landmarks of
the local map are looked for around their projections.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, IntArray, read_only
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.motion.feature_matching import match_descriptors
from fusion_core.motion.ransac_pnp import ransac_pnp
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.expected_views import expect_views
from fusion_core.slam.visual.features import octave_scales
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.keyframes import NO_LANDMARK
from fusion_core.slam.visual.local_map import LocalMap
from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.slam.visual.pinhole import camera_parameters, project
from fusion_core.slam.visual.pose_optimisation import PoseFit, optimise_pose
from fusion_core.slam.visual.projection_matching import (
    DISTANCE_HIGH,
    FeatureGrid,
)
from fusion_core.slam.visual.tracked_frame import TrackedFrame

# The search radii of ORB-SLAM2 for RGB-D, on the finest level.
_MOTION_RADIUS_PX = 15.0
_MAP_RADIUS_PX = 8.0
# Fewest matches by the motion model before the search is widened, and before it is given up.
_MATCHES_WANTED = 20
# Bins of the rotation of matches; the fullest three hold the true ones.
_ROTATION_BINS = 30
_ROTATION_BINS_KEPT = 3
_RATIO_MAX = 0.8
_RANSAC_CONFIDENCE = 0.999
_RANSAC_DRAWS = 300


class TrackingSettings(StageSettings):
    """Settings of ``Tracker``."""

    inliers_min: int = setting(
        30, "Fewest landmarks of the local map that a pose needs", unit="landmarks", ge=6, le=10_000
    )
    start_features_min: int = setting(
        100, "Fewest features with depth of a map's first image", unit="features", ge=6, le=10_000
    )
    ransac_threshold_px: float = setting(
        3.0,
        "RANSAC by the reference keyframe: greatest reprojection error of an inlier",
        unit="px",
        ge=1e-6,
        le=50.0,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackingLoss:
    """Why an image has no pose."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Matches:
    """M features of the image, ``features``: (M,), that see ``positions_in_map_m``: (M, 3), of
    ``landmarks``: (M,)."""

    features: IntArray
    landmarks: IntArray
    positions_in_map_m: FloatArray

    def __post_init__(self) -> None:
        for array in (self.features, self.landmarks, self.positions_in_map_m):
            read_only(array)

    def kept(self, which: BoolArray) -> "_Matches":
        return _Matches(
            features=self.features[which],
            landmarks=self.landmarks[which],
            positions_in_map_m=self.positions_in_map_m[which],
        )


class Tracker:
    """Estimates poses; it holds nothing between images."""

    def __init__(
        self,
        intrinsics: CameraIntrinsics,
        settings: TrackingSettings,
        noise: ObservationNoise,
        levels: int,
    ) -> None:
        self._settings, self._noise, self._levels = settings, noise, levels
        self._size = (intrinsics.width, intrinsics.height)
        self._camera = camera_parameters(intrinsics)

    def track(
        self,
        features: FrameFeatures,
        last: TrackedFrame | None,
        velocity: FloatArray | None,
        local: LocalMap,
    ) -> TrackedFrame | TrackingLoss:
        """The image's pose.

        ``last``: the image before, None where it had no pose. ``velocity``: (4, 4) its
        T_camera_before, None where it is unknown.
        """
        if len(features) < self._settings.inliers_min:
            return TrackingLoss(reason="too few features")
        grid = FeatureGrid(features)
        found = None
        if last is not None:
            T_start = invert_transform(last.T_map_camera)
            found = self._by_motion(grid, last, T_start if velocity is None else velocity @ T_start)
            if found is None and velocity is not None:
                found = self._by_motion(grid, last, T_start)
        if found is None:
            found = self._by_reference(features, local)
        if found is None:
            return TrackingLoss(reason="too few matches with the last image and its keyframe")
        return self._in_local_map(grid, *found, local)

    def track_at(
        self, features: FrameFeatures, T_camera_map: FloatArray, local: LocalMap
    ) -> TrackedFrame | TrackingLoss:
        """The image's pose near a given one."""
        none = _Matches(
            features=np.empty(0, np.int64),
            landmarks=np.empty(0, np.int64),
            positions_in_map_m=np.empty((0, 3)),
        )
        return self._in_local_map(FeatureGrid(features), T_camera_map, none, local)

    def _in_local_map(
        self, grid: FeatureGrid, T_camera_map: FloatArray, matches: "_Matches", local: LocalMap
    ) -> TrackedFrame | TrackingLoss:
        """The pose by all landmarks of the local map, from a start and what is matched already."""
        features = grid.features
        matches = _joined(matches, self._by_local_map(grid, T_camera_map, matches, local))
        fit = self._fit(features, T_camera_map, matches)
        inliers = matches.kept(fit.is_inlier & (matches.landmarks != NO_LANDMARK))
        if len(inliers.features) < self._settings.inliers_min:
            return TrackingLoss(reason="too few landmarks of the map in sight")
        landmarks = np.full(len(features), NO_LANDMARK, np.int64)
        landmarks[inliers.features] = inliers.landmarks
        positions = np.full((len(features), 3), np.nan)
        positions[inliers.features] = inliers.positions_in_map_m
        frame = TrackedFrame(
            features=features,
            T_map_camera=invert_transform(fit.T_camera_map),
            landmarks=landmarks,
            positions_in_map_m=positions,
            information=fit.information,
        )
        frame.add_points_by_depth(self._camera)
        return frame

    def _by_motion(
        self, grid: FeatureGrid, last: TrackedFrame, T_camera_map: FloatArray
    ) -> tuple[FloatArray, _Matches] | None:
        seen = np.flatnonzero(np.isfinite(last.positions_in_map_m[:, 0]))
        positions = last.positions_in_map_m[seen]
        pixels = project(transform_points(T_camera_map, positions), self._camera)
        octaves = last.features.octaves[seen]
        for widening in (1.0, 2.0):
            found = grid.match(
                pixels,
                widening * _MOTION_RADIUS_PX * octave_scales(octaves),
                octaves - 1,
                octaves + 1,
                last.features.descriptors[seen],
                distance_max=DISTANCE_HIGH,
            )
            which = np.flatnonzero(found >= 0)
            which = which[
                _turn_alike(
                    last.features.angles_deg[seen[which]], grid.features.angles_deg[found[which]]
                )
            ]
            if len(which) >= _MATCHES_WANTED:
                break
        else:
            return None
        return self._checked(
            grid.features,
            T_camera_map,
            _Matches(
                features=found[which],
                landmarks=last.landmarks[seen[which]],
                positions_in_map_m=positions[which],
            ),
        )

    def _by_reference(
        self, features: FrameFeatures, local: LocalMap
    ) -> tuple[FloatArray, _Matches] | None:
        """T_camera_map by what the features of the reference keyframe see, wherever they lie in the
        image."""
        others, positions_in_map_m = local.features, local.feature_positions_in_map_m
        seen = np.flatnonzero(np.isfinite(positions_in_map_m[:, 0]))
        if len(seen) < _MATCHES_WANTED or len(features) < _MATCHES_WANTED:
            return None
        pairs = match_descriptors(
            others.descriptors[seen], features.descriptors, ratio_max=_RATIO_MAX
        )
        first, second = pairs[np.argsort(pairs[:, 1])].T
        alike = _turn_alike(others.angles_deg[seen[first]], features.angles_deg[second])
        first, second = seen[first[alike]], second[alike]
        if len(first) < _MATCHES_WANTED:
            return None
        matches = _Matches(
            features=second,
            landmarks=local.feature_landmarks[first],
            positions_in_map_m=positions_in_map_m[first],
        )
        start = self._by_pnp(features, matches)
        return None if start is None else self._checked(features, start[0], matches.kept(start[1]))

    def _by_pnp(
        self, features: FrameFeatures, matches: _Matches
    ) -> tuple[FloatArray, BoolArray] | None:
        fx, fy, cx, cy = self._camera
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        found = ransac_pnp(
            matches.positions_in_map_m,
            features.pixels[matches.features],
            K,
            draws=_RANSAC_DRAWS,
            threshold=self._settings.ransac_threshold_px,
            confidence=_RANSAC_CONFIDENCE,
            method=cv2.SOLVEPNP_EPNP,
        )
        if found is None or np.count_nonzero(found[1]) < _MATCHES_WANTED:
            return None
        return found if np.isfinite(found[0]).all() else None

    def _checked(
        self, features: FrameFeatures, T_camera_map: FloatArray, matches: _Matches
    ) -> tuple[FloatArray, _Matches] | None:
        fit = self._fit(features, T_camera_map, matches)
        if np.count_nonzero(fit.is_inlier) < _MATCHES_WANTED // 2:
            return None
        return fit.T_camera_map, matches.kept(fit.is_inlier)

    def _by_local_map(
        self, grid: FeatureGrid, T_camera_map: FloatArray, matches: _Matches, local: LocalMap
    ) -> _Matches:
        views = local.views
        expected = expect_views(
            views, T_camera_map, self._camera, self._size, self._levels, matches.landmarks
        )
        is_free = np.ones(len(grid.features), np.bool_)
        is_free[matches.features[matches.landmarks != NO_LANDMARK]] = False
        found = grid.match(
            expected.pixels,
            _MAP_RADIUS_PX * octave_scales(expected.octaves),
            expected.octaves - 1,
            expected.octaves + 1,
            views.descriptors[expected.which],
            distance_max=DISTANCE_HIGH,
            ratio_max=_RATIO_MAX,
            is_free=is_free,
        )
        hit = found >= 0
        return _Matches(
            features=found[hit],
            landmarks=views.rows[expected.which[hit]],
            positions_in_map_m=views.positions_in_map_m[expected.which[hit]],
        )

    def _fit(self, features: FrameFeatures, T_camera_map: FloatArray, matches: _Matches) -> PoseFit:
        at = matches.features
        return optimise_pose(
            T_camera_map,
            matches.positions_in_map_m,
            features.pixels[at],
            features.depths_m[at],
            self._noise.pixel_sigmas(features.octaves[at]),
            self._noise.depth_sigma_per_m2,
            self._camera,
        )


def _joined(first: _Matches, second: _Matches) -> _Matches:
    """Both; a feature of both keeps what the second says, which is a landmark."""
    kept = first.kept(~np.isin(first.features, second.features))
    return _Matches(
        features=np.concatenate([kept.features, second.features]),
        landmarks=np.concatenate([kept.landmarks, second.landmarks]),
        positions_in_map_m=np.concatenate([kept.positions_in_map_m, second.positions_in_map_m]),
    )


def _turn_alike(first_deg: Float32Array, second_deg: Float32Array) -> BoolArray:
    """(M,) the matches whose features turn by what most others do (ORB-SLAM)."""
    turns = (second_deg.astype(np.float64) - first_deg) % 360.0
    bins = np.rint(turns * (_ROTATION_BINS / 360.0)).astype(np.int64) % _ROTATION_BINS
    counts = np.bincount(bins, minlength=_ROTATION_BINS)
    fullest = np.argsort(-counts, kind="stable")[:_ROTATION_BINS_KEPT]
    fullest = fullest[counts[fullest] >= 0.1 * counts[fullest[0]]]
    return np.isin(bins, fullest)
