"""Landmarks that new keyframes should show and do not are culled; the others stay."""

import numpy as np

from fusion_core.model.geometry import transform_points
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.keyframes import NO_LANDMARK
from fusion_core.slam.visual.local_mapping import (
    LocalMapping,
    LocalMappingSettings,
    new_landmarks,
)
from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.slam.visual.pinhole import camera_parameters, unproject
from fusion_core.slam.visual.visual_map import VisualMap
from tests.slam.visual.feature_world import INTRINSICS, hall, observe, round_trip

KEYFRAMES, VANISHED_AFTER = 15, 3


def without(features, points, gone):
    """The features of an image, and the points that they see, without some of the points."""
    left = ~np.isin(points, gone)
    return FrameFeatures(
        pixels=features.pixels[left],
        depths_m=features.depths_m[left],
        octaves=features.octaves[left],
        angles_deg=features.angles_deg[left],
        descriptors=features.descriptors[left],
    ), points[left]


def test_landmarks_that_are_not_found_again_are_culled():
    world, rng = hall(), np.random.default_rng(5)
    pose = round_trip(count=40)[0]
    _, in_sight = observe(world, pose, np.random.default_rng(6))
    vanishing = in_sight[::4]
    visual_map, row_of = VisualMap(), {}
    mapping = LocalMapping(
        INTRINSICS, LocalMappingSettings(cull_keyframes=False), ObservationNoise(), levels=8
    )
    for number in range(KEYFRAMES):
        T_map_camera = pose.copy()
        T_map_camera[:3, 3] += 0.01 * rng.normal(size=3)
        features, points = observe(world, T_map_camera, rng)
        if number >= VANISHED_AFTER:
            features, points = without(features, points, vanishing)
        rows = np.array([row_of.get(p, NO_LANDMARK) for p in points.tolist()], np.int64)
        keyframe = visual_map.add_keyframe(
            number, features, T_map_camera, rows, number - 1 if number else None
        )
        in_camera = unproject(features.pixels, features.depths_m, camera_parameters(INTRINSICS))
        made = new_landmarks(visual_map, keyframe, transform_points(T_map_camera, in_camera))
        mapping.include(visual_map, number, made)
        row_of |= {
            point: row
            for point, row in zip(points.tolist(), keyframe.landmarks.tolist(), strict=True)
            if row != NO_LANDMARK
        }
    first_rows = {point: row for point, row in row_of.items() if point in set(vanishing.tolist())}
    others = {point: row for point, row in row_of.items() if point not in first_rows}
    assert len(first_rows) > 80
    assert visual_map.is_landmark_culled[list(first_rows.values())].mean() > 0.95
    assert visual_map.is_landmark_culled[list(others.values())].mean() < 0.1
