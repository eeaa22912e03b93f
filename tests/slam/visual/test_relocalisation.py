"""A lost camera finds itself in a map."""

import numpy as np

from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.slam.visual.place_recognition import PlaceIndex
from fusion_core.slam.visual.relative_pose import RelativePoseSettings
from fusion_core.slam.visual.relocalisation import LastKnownPose, Relocalisation, relocalise
from tests.slam.visual.feature_world import (
    INTRINSICS,
    DriftingTracker,
    camera_pose,
    hall,
    observe,
    rooms_trip,
    round_trip,
    two_rooms,
    walls,
)


def mapped(world, poses, **noise):
    tracker = DriftingTracker(world, 1, **noise)
    index = PlaceIndex()
    for pose in poses:
        keyframe = tracker.add(pose)
        index.add(keyframe, tracker.map.keyframes[keyframe].features.descriptors)
    return tracker.map, index


def find(visual_map, index, features, **known):
    return relocalise(
        visual_map, index, features, INTRINSICS, ObservationNoise(), RelativePoseSettings(), **known
    )


def test_a_camera_between_the_keyframes_is_found():
    world = hall()
    visual_map, index = mapped(world, round_trip(count=36, turns=0.95))
    for x, y, heading in ((3.2, 0.8, 0.1), (-0.5, 3.5, 1.8), (-3.0, -1.5, 3.6)):
        truth = camera_pose(x, y, heading, z=1.4)
        features, _ = observe(world, truth, np.random.default_rng(5))
        found = find(visual_map, index, features)
        assert isinstance(found, Relocalisation)
        assert np.linalg.norm(found.T_map_camera[:3, 3] - truth[:3, 3]) < 0.05
        np.testing.assert_allclose(found.T_map_camera[:3, :3], truth[:3, :3], atol=0.02)


def test_a_place_outside_the_map_is_not_found():
    visual_map, index = mapped(hall(), round_trip(count=20, turns=0.4))
    elsewhere = walls(np.random.default_rng(9), (9.0, 9.0), 6000)
    features, _ = observe(elsewhere, camera_pose(0.0, 0.0, 0.3), np.random.default_rng(5))
    assert isinstance(find(visual_map, index, features), str)
    assert find(visual_map, PlaceIndex(), features) == "no keyframe looks like the image"


def test_of_two_identical_rooms_the_one_in_reach_is_taken():
    first, way, second = rooms_trip()
    world = two_rooms()
    visual_map, index = mapped(world, [*first, *way, *second], range_max_m=3.0)
    # The rooms look alike: where the image is from says nothing, where the camera was does.
    for seen, near in ((first, second), (second, first), (first, first), (second, second)):
        features, _ = observe(world, seen[4], np.random.default_rng(5), range_max_m=3.0)
        last = LastKnownPose(T_map_camera=near[4].copy(), lost_ns=10**9)
        found = find(visual_map, index, features, last_known=last)
        assert isinstance(found, Relocalisation)
        assert np.linalg.norm(found.T_map_camera[:3, 3] - near[4][:3, 3]) < 0.1
