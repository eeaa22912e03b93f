"""The links between features and landmarks stay two-way, whatever is done to them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.keyframes import NO_LANDMARK
from fusion_core.slam.visual.visual_map import VisualMap

FEATURES = 12


def features():
    return FrameFeatures(
        pixels=np.zeros((FEATURES, 2)),
        depths_m=np.ones(FEATURES),
        octaves=np.zeros(FEATURES, np.int64),
        angles_deg=np.zeros(FEATURES, np.float32),
        descriptors=np.zeros((FEATURES, 32), np.uint8),
    )


def require_consistent(visual_map):
    for landmark in range(len(visual_map.positions_in_map_m)):
        observers = visual_map.observers_of(landmark)
        for keyframe, feature in observers.items():
            assert visual_map.keyframes[keyframe].landmarks[feature] == landmark
        if visual_map.is_landmark_culled[landmark]:
            assert not observers
    for keyframe in visual_map.keyframes:
        for feature in np.flatnonzero(keyframe.landmarks != NO_LANDMARK):
            landmark = int(keyframe.landmarks[feature])
            assert visual_map.observers_of(landmark)[keyframe.index] == feature


@given(st.integers(0, 10_000))
def test_links_are_two_way_after_any_changes(seed):
    rng = np.random.default_rng(seed)
    visual_map = VisualMap()
    for _ in range(25):
        keyframes, landmarks = len(visual_map.keyframes), len(visual_map.positions_in_map_m)
        kept = [keyframe.index for keyframe in visual_map.kept_keyframes]
        change = rng.integers(8)
        if change == 0 or not keyframes:
            seen = np.full(FEATURES, NO_LANDMARK)
            if landmarks:
                seen = rng.integers(-1, landmarks, FEATURES)
            parent = int(rng.choice(kept)) if keyframes else None
            visual_map.add_keyframe(keyframes, features(), np.eye(4), seen, parent)
        elif change == 1 or not landmarks:
            visual_map.add_landmarks(np.zeros((5, 3)), np.zeros((5, 32), np.uint8))
        elif change == 2:
            at = rng.permutation(FEATURES)[:4]
            visual_map.observe(int(rng.choice(kept)), at, rng.integers(0, landmarks, 4))
        elif change == 3:
            visual_map.forget(int(rng.choice(kept)), rng.permutation(FEATURES)[:3])
        elif change == 4:
            visual_map.merge_landmarks(*rng.integers(0, landmarks, 2).tolist())
        elif change == 5:
            visual_map.cull_landmarks(rng.integers(0, landmarks, 2))
        elif change == 6:
            visual_map.drop_culled_landmarks()
        elif keyframes > 1:
            visual_map.cull_keyframe(int(rng.integers(1, keyframes)))
        require_consistent(visual_map)


def chain(count=4):
    """Keyframes in a row, each sharing landmarks with the next ones: fewer, the farther."""
    visual_map = VisualMap()
    rows = visual_map.add_landmarks(np.zeros((20, 3)), np.zeros((20, 32), np.uint8))
    for k in range(count):
        seen = np.full(FEATURES, NO_LANDMARK)
        seen[:] = rows[2 * k : 2 * k + FEATURES]
        pose = np.eye(4)
        pose[0, 3] = k
        visual_map.add_keyframe(k, features(), pose, seen, k - 1 if k else None)
    return visual_map


def test_the_most_covisible_come_first():
    visual_map = chain()
    found, counts = visual_map.covisible(0, shared_min=1)
    np.testing.assert_array_equal(found, [1, 2, 3])
    np.testing.assert_array_equal(counts, [10, 8, 6])
    assert visual_map.covisible(0, shared_min=8)[0].tolist() == [1, 2]
    assert visual_map.sharing(np.array([0, 1]))[0].tolist() == [0]


def test_observations_are_those_of_kept_keyframes():
    visual_map = chain()
    visual_map.cull_keyframe(1)
    seen = visual_map.observations()
    assert set(seen.keyframes.tolist()) == {0, 2, 3}
    assert len(seen) == 3 * FEATURES
    assert len(visual_map.observations([])) == 0


def test_a_culled_keyframe_follows_its_parent():
    visual_map = chain()
    visual_map.cull_keyframe(1)
    assert visual_map.keyframes[2].parent == 0
    visual_map.keyframes[0].T_map_camera = np.diag([1.0, 1.0, 1.0, 1.0])
    visual_map.keyframes[0].T_map_camera[:3, 3] = [5.0, 0.0, 1.0]
    np.testing.assert_allclose(visual_map.pose_of(1)[:3, 3], [6.0, 0.0, 1.0])
    with pytest.raises(ValueError, match="first"):
        visual_map.cull_keyframe(0)


def test_a_culled_keyframe_outlives_its_parent():
    visual_map = chain()
    visual_map.cull_keyframe(2)
    visual_map.cull_keyframe(1)
    assert [visual_map.keyframes[k].parent for k in (1, 2, 3)] == [0, 0, 0]
    assert len(visual_map.keyframes[2].features) == 0
    visual_map.keyframes[0].T_map_camera[:3, 3] = [5.0, 0.0, 1.0]
    np.testing.assert_allclose(visual_map.pose_of(2)[:3, 3], [7.0, 0.0, 1.0])


def test_landmarks_close_up_where_culled_ones_were():
    visual_map = chain()
    count = len(visual_map.positions_in_map_m)
    visual_map.positions_in_map_m[:, 0] = np.arange(count)
    visual_map.found_counts[:] = np.arange(count)
    visual_map.cull_landmarks(np.array([1, 4]))
    before = [keyframe.landmarks.copy() for keyframe in visual_map.keyframes]
    seen_by = visual_map.observers_of(5)
    rows = visual_map.drop_culled_landmarks()
    assert rows.tolist() == [0, -1, 1, 2, -1, *range(3, count - 2), NO_LANDMARK]
    np.testing.assert_array_equal(
        visual_map.positions_in_map_m[:, 0], np.delete(np.arange(count), [1, 4])
    )
    np.testing.assert_array_equal(visual_map.found_counts, visual_map.positions_in_map_m[:, 0])
    assert visual_map.observers_of(3) == seen_by
    for keyframe, former in zip(visual_map.keyframes, before, strict=True):
        np.testing.assert_array_equal(keyframe.landmarks, rows[former])
    assert visual_map.add_landmarks(np.zeros((1, 3)), np.zeros((1, 32), np.uint8)) == count - 2


def test_merged_landmarks_are_seen_once():
    visual_map = chain()
    visual_map.merge_landmarks(0, 15)
    assert visual_map.observers_of(0) == {0: 0, 2: 11, 3: 9}
    assert visual_map.is_landmark_culled[15]
    # Keyframe 1 saw neither by another feature.
    visual_map.merge_landmarks(2, 3)
    assert visual_map.keyframes[0].landmarks[3] == NO_LANDMARK
