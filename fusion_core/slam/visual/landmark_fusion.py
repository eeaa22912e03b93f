"""What becomes of the landmarks when a loop is closed: they are moved, and those of both visits
become one."""

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.slam.visual.keyframes import NO_LANDMARK, LoopClosure
from fusion_core.slam.visual.pinhole import camera_parameters, project
from fusion_core.slam.visual.projection_matching import DISTANCE_LOW, FeatureGrid
from fusion_core.slam.visual.visual_map import VisualMap

# About a landmark's predicted place: what a closed loop is off by.
_RADIUS_PX = 8.0
# No pyramid has more.
_LEVELS_MAX = 16
# A feature's depth must agree with the landmark's: several times the depth noise at 8 m.
_DEPTH_RATIO = 0.06


def move_landmarks(visual_map: VisualMap, T_map_camera_before: FloatArray) -> None:
    """Move each landmark with the keyframe that saw it first.

    ``T_map_camera_before``: (K, 4, 4) of the keyframes before they were moved.
    """
    keyframes = visual_map.keyframes
    reference = np.full(len(visual_map.positions_in_map_m), NO_LANDMARK)
    for keyframe in reversed(keyframes):
        reference[keyframe.landmarks[keyframe.landmarks != NO_LANDMARK]] = keyframe.index
    order = np.argsort(reference, kind="stable")
    indices, begins = np.unique(reference[order], return_index=True)
    for index, rows in zip(indices.tolist(), np.split(order, begins[1:]), strict=True):
        if index == NO_LANDMARK:
            continue
        T_after_before = visual_map.pose_of(index) @ invert_transform(T_map_camera_before[index])
        visual_map.positions_in_map_m[rows] = transform_points(
            T_after_before, visual_map.positions_in_map_m[rows]
        )


def fuse_matches(visual_map: VisualMap, loop: LoopClosure) -> int:
    """Let the matched features of a loop see one landmark, the first keyframe's; how many do."""
    first, second = visual_map.keyframes[loop.first], visual_map.keyframes[loop.second]
    fused = 0
    for a, b in loop.pose.matches.tolist():
        kept, other = int(first.landmarks[a]), int(second.landmarks[b])
        if kept != NO_LANDMARK and other != NO_LANDMARK:
            visual_map.merge_landmarks(kept, other)
        elif kept != NO_LANDMARK:
            visual_map.observe(loop.second, np.array([b]), np.array([kept]))
        elif other != NO_LANDMARK:
            visual_map.observe(loop.first, np.array([a]), np.array([other]))
        else:
            continue
        fused += 1
    return fused


def fuse_neighbours(
    visual_map: VisualMap,
    loop: LoopClosure,
    T_map_camera_before: FloatArray,
    intrinsics: CameraIntrinsics,
    neighbours_max: int,
) -> int:
    """Let keyframes about the loop's second see the landmarks about its first, where they lie at
    the same place and look alike; how many sightings that adds or merges.

    ``T_map_camera_before``: (K, 4, 4) of the keyframes before the loop was closed, which say best
    how those about the second lie to each other.
    """
    T_after_before = (
        visual_map.pose_of(loop.first)
        @ loop.pose.T_first_second
        @ invert_transform(T_map_camera_before[loop.second])
    )
    around_first = _neighbourhood(visual_map, loop.first, neighbours_max)
    around_second = _neighbourhood(visual_map, loop.second, neighbours_max)
    landmarks = visual_map.landmarks_of(around_first)
    fused = 0
    for index in around_second:
        if index not in around_first:
            T_map_camera = T_after_before @ T_map_camera_before[index]
            fused += _fuse_into(visual_map, index, T_map_camera, landmarks, intrinsics)
    return fused


def _neighbourhood(visual_map: VisualMap, index: int, neighbours_max: int) -> list[int]:
    return [index, *visual_map.covisible(index)[0][:neighbours_max].tolist()]


def _fuse_into(
    visual_map: VisualMap,
    index: int,
    T_map_camera: FloatArray,
    landmarks: IntArray,
    intrinsics: CameraIntrinsics,
) -> int:
    keyframe = visual_map.keyframes[index]
    landmarks = landmarks[~visual_map.is_landmark_culled[landmarks]]
    landmarks = landmarks[~np.isin(landmarks, keyframe.landmarks)]
    points = transform_points(
        invert_transform(T_map_camera), visual_map.positions_in_map_m[landmarks]
    )
    features = keyframe.features
    anywhere = np.zeros(len(landmarks), np.int64)
    found = FeatureGrid(features).match(
        project(points, camera_parameters(intrinsics)),
        np.full(len(landmarks), _RADIUS_PX),
        anywhere,
        anywhere + _LEVELS_MAX,
        visual_map.landmark_descriptors[landmarks],
        distance_max=DISTANCE_LOW,
    )
    matched = np.flatnonzero(found >= 0)
    matches = np.column_stack([matched, found[matched]])
    depth_m = features.depths_m[matches[:, 1]]
    agrees = np.abs(depth_m - points[matches[:, 0], 2]) < _DEPTH_RATIO * depth_m
    # A feature without depth may still be of the landmark: its place and look agree.
    matches = matches[agrees | np.isnan(depth_m)]
    for row, feature in matches.tolist():
        landmark, other = int(landmarks[row]), int(keyframe.landmarks[feature])
        if other == NO_LANDMARK:
            visual_map.observe(index, np.array([feature]), np.array([landmark]))
        elif not visual_map.is_landmark_culled[landmark]:
            visual_map.merge_landmarks(landmark, other)
    return len(matches)
