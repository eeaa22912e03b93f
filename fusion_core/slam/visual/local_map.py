"""The part of the map around the camera, as tracking sees it while mapping changes the map."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import (
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.slam.visual.features import SCALE_FACTOR
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.keyframes import NO_LANDMARK
from fusion_core.slam.visual.visual_map import VisualMap


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LandmarkViews:
    """L landmarks as their keyframes see them.

    ``rows``: (L,) of the map, ascending. ``positions_in_map_m``: (L, 3). ``descriptors``: (L, 32).
    ``ranges_at_zero_m``: (L,) the distance at which each would be seen on the finest level of the
    pyramid. ``directions``: (L, 3) the mean of the unit vectors from the cameras to each.
    """

    rows: IntArray
    positions_in_map_m: FloatArray
    descriptors: ByteArray
    ranges_at_zero_m: FloatArray
    directions: FloatArray

    def __post_init__(self) -> None:
        for array in (
            self.rows,
            self.positions_in_map_m,
            self.descriptors,
            self.ranges_at_zero_m,
            self.directions,
        ):
            read_only(array)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalMap:
    """A snapshot: what mapping does to the map later does not change it.

    ``reference``: the keyframe that shares most landmarks with the last image, at
    ``T_map_reference``, (4, 4), with its ``features`` and the positions of the landmarks that they
    see, ``feature_positions_in_map_m``: (F, 3), NaN for none, rows ``feature_landmarks``: (F,).
    ``reduced_depth_m``: of the reference keyframe. ``views``: the landmarks of the local keyframes.
    """

    reference: int
    T_map_reference: FloatArray
    features: FrameFeatures
    feature_landmarks: IntArray
    feature_positions_in_map_m: FloatArray
    views: LandmarkViews
    reduced_depth_m: Float32Array | None = None

    def __post_init__(self) -> None:
        for array in (
            self.T_map_reference,
            self.feature_landmarks,
            self.feature_positions_in_map_m,
        ):
            read_only(array)


def landmark_views(visual_map: VisualMap, keyframes: Iterable[int]) -> LandmarkViews:
    """The landmarks that the keyframes see, as they see them."""
    seen = visual_map.observations(keyframes)
    rows, which = np.unique(seen.landmarks, return_inverse=True)
    indices, of_keyframe = np.unique(seen.keyframes, return_inverse=True)
    centres = np.array(
        [visual_map.keyframes[index].T_map_camera[:3, 3] for index in indices.tolist()]
    ).reshape(-1, 3)
    positions = visual_map.positions_in_map_m[rows]
    rays = positions[which] - centres[of_keyframe]
    ranges_m = np.linalg.norm(rays, axis=1)
    counts = np.bincount(which, minlength=len(rows))
    directions: FloatArray = np.zeros((len(rows), 3))
    np.add.at(directions, which, rays / ranges_m[:, np.newaxis])
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    # A geometric mean: on a logarithmic scale the levels are equally far apart.
    logarithms = np.log(ranges_m) + seen.octaves * np.log(SCALE_FACTOR)
    at_zero = np.exp(np.bincount(which, weights=logarithms, minlength=len(rows)) / counts)
    return LandmarkViews(
        rows=rows,
        positions_in_map_m=positions,
        descriptors=visual_map.landmark_descriptors[rows],
        ranges_at_zero_m=at_zero,
        directions=directions,
    )


def take_local_map(
    visual_map: VisualMap, reference: int, landmarks: IntArray, keyframes_max: int
) -> LocalMap:
    """The local map around an image that sees ``landmarks``, (N,), and has ``reference`` as its
    newest keyframe.

    Local are the keyframes that share landmarks with the image, and those most covisible with
    them (ORB-SLAM, Mur-Artal 2015, §V-D: K1 and K2).
    """
    sharing, _ = visual_map.sharing(landmarks)
    local = [reference, *(i for i in sharing.tolist() if i != reference)][:keyframes_max]
    for index in tuple(local):
        if len(local) >= keyframes_max:
            break
        beside, _ = visual_map.covisible(index)
        local += [i for i in beside[:3].tolist() if i not in local]
    local = local[:keyframes_max]
    if len(sharing):
        reference = int(sharing[0])
    keyframe = visual_map.keyframes[reference]
    row = keyframe.landmarks.copy()
    has_landmark = row != NO_LANDMARK
    positions = np.full((len(row), 3), np.nan)
    positions[has_landmark] = visual_map.positions_in_map_m[row[has_landmark]]
    return LocalMap(
        reference=reference,
        T_map_reference=keyframe.T_map_camera.copy(),
        features=keyframe.features,
        feature_landmarks=row,
        feature_positions_in_map_m=positions,
        views=landmark_views(visual_map, local),
        reduced_depth_m=keyframe.reduced_depth_m,
    )
