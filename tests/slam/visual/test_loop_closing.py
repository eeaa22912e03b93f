"""Loops of maps as a drifting tracker leaves them: true ones are closed, false ones refused."""

import copy

import numpy as np
import pytest

from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.slam.visual.drift import DriftSettings
from fusion_core.slam.visual.global_adjustment import (
    GlobalAdjustmentSettings,
    adjust_globally,
    observation_chi2,
)
from fusion_core.slam.visual.keyframes import NO_LANDMARK
from fusion_core.slam.visual.landmark_fusion import move_landmarks
from fusion_core.slam.visual.loop_closing import LoopCloser, VisualLoopSettings
from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.slam.visual.pinhole import camera_parameters, project
from tests.slam.visual.feature_world import (
    INTRINSICS,
    DriftingTracker,
    hall,
    rooms_trip,
    round_trip,
    two_rooms,
)

# One per cent of the way and half a degree a keyframe: the end is off by most of a metre.
DRIFT = [0.0, 0.004, 0.0, 0.01, 0.0, 0.0]


def closed(seed=1, settings=None):
    """A round trip without loops closed, and the same with them."""
    without = DriftingTracker(hall(), seed, DRIFT)
    tracker = DriftingTracker(hall(), seed, DRIFT)
    closer = LoopCloser(tracker.map, INTRINSICS, settings=settings)
    loops, placed = [], []
    for pose in round_trip(count=36):
        without.add(pose)
        loop = closer.add(tracker.add(pose))
        if loop is not None:
            loops.append(loop)
            placed.append(tracker.map.pose_of(loop.loop.second))
    closer.finish()
    return without, tracker, closer, loops, placed


@pytest.fixture(scope="module")
def round_trip_closed():
    return closed()


@pytest.fixture(scope="module")
def rooms_mapped():
    """Two identical rooms and the way between, with drift."""
    first, way, second = rooms_trip()
    tracker = DriftingTracker(two_rooms(), 1, [0.0, 0.001, 0.0, 0.003, 0.0, 0.0], range_max_m=3.0)
    closer = LoopCloser(tracker.map, INTRINSICS)
    for pose in [*first, *way, *second]:
        closer.add(tracker.add(pose))
    return first, way, second, tracker, closer


def rms(errors):
    return float(np.sqrt(np.mean(errors**2)))


def test_a_round_trip_is_closed_and_its_error_falls_to_a_third(round_trip_closed):
    without, tracker, closer, loops, placed = round_trip_closed
    assert loops
    assert rms(without.errors_m()) > 0.2
    assert rms(tracker.errors_m()) < rms(without.errors_m()) / 3.0
    assert [loop.loop for loop in loops] == tracker.map.loops
    # The ends of the loop now see the same landmarks.
    first, second = loops[0].loop.first, loops[0].loop.second
    shared = dict(zip(*(row.tolist() for row in tracker.map.covisible(first)), strict=True))
    assert shared[second] >= 0.9 * len(loops[0].loop.pose.matches)
    # What it says to have done to the newest keyframe, it did.
    before = without.map.keyframes[second].T_map_camera
    np.testing.assert_allclose(loops[0].T_after_before @ before, placed[0], atol=1e-9)
    assert closer.adjustments >= 1


def test_without_closing_the_map_is_left_alone():
    settings = VisualLoopSettings(loop_closing={"is_used": False})
    without, tracker, closer, loops, _ = closed(settings=settings)
    assert not loops
    np.testing.assert_array_equal(tracker.errors_m(), without.errors_m())
    assert len(closer.index) == len(tracker.map.keyframes)


def test_the_second_of_two_identical_rooms_is_not_joined_with_the_first(rooms_mapped):
    first, way, _, tracker, closer = rooms_mapped
    elsewhere = len(first) + len(way) - 2
    assert tracker.map.loops
    assert all(
        not (loop.first < len(first) and loop.second > elsewhere) for loop in tracker.map.loops
    )
    refused = [loop for loop in closer.refused if loop.inliers > 100]
    assert refused
    assert all("more than the odometry can have drifted" in loop.reason for loop in refused)
    assert tracker.errors_m().max() < 0.3


def test_only_the_gate_tells_the_rooms_apart():
    first, way, second = rooms_trip()
    tracker = DriftingTracker(two_rooms(), 1, range_max_m=3.0)
    drift = DriftSettings(translation_m_per_m=1.0, rotation_rad_per_m=1.0)
    closer = LoopCloser(tracker.map, INTRINSICS, settings=VisualLoopSettings(drift=drift))
    for pose in [*first, *way, *second]:
        closer.add(tracker.add(pose))
    assert tracker.errors_m().max() > 3.0


def test_after_a_loss_time_bounds_the_way(rooms_mapped):
    """The camera is lost in the second room, for a time in which it cannot reach the first."""
    first, way, second, tracker, closer = copy.deepcopy(rooms_mapped)
    count, elsewhere = len(tracker.map.keyframes), len(first) + len(way) - 2
    tracker.forget_landmarks(10**9, T_map_next=np.eye(4))
    for pose in second[:10]:
        closer.add(tracker.add(pose))
    joined = [loop for loop in tracker.map.loops if loop.second >= count]
    assert joined
    assert all(loop.first > elsewhere for loop in joined)
    assert any("its time allows" in loop.reason for loop in closer.refused)
    assert tracker.errors_m().max() < 0.3


def test_a_part_that_a_loop_alone_connects_is_placed_by_it():
    tracker = DriftingTracker(hall(), 1)
    closer = LoopCloser(tracker.map, INTRINSICS)
    poses = round_trip(count=20, turns=0.4)
    for pose in poses:
        closer.add(tracker.add(pose))
    tracker.forget_landmarks(60 * 10**9, T_map_next=np.eye(4))
    for pose in poses[::-1][5:15]:
        closer.add(tracker.add(pose))
    assert tracker.map.loops
    assert tracker.errors_m().max() < 0.1


def test_the_same_input_gives_the_same_bytes(round_trip_closed):
    results = [round_trip_closed[1].map, closed()[1].map]
    poses = [np.array([m.pose_of(i) for i in range(len(m.keyframes))]) for m in results]
    assert poses[0].tobytes() == poses[1].tobytes()
    assert results[0].positions_in_map_m.tobytes() == results[1].positions_in_map_m.tobytes()
    assert results[0].loops[0].pose.matches.tobytes() == results[1].loops[0].pose.matches.tobytes()


def test_a_closed_loop_moves_the_landmarks_too():
    settings = VisualLoopSettings(global_adjustment={"is_used": False})
    _, tracker, closer, loops, _ = closed(settings=settings)
    assert loops
    assert closer.adjustments == 0
    off_px = []
    for keyframe in tracker.map.keyframes[1:]:
        seen = np.flatnonzero(keyframe.landmarks != NO_LANDMARK)
        points = transform_points(
            invert_transform(keyframe.T_map_camera),
            tracker.map.positions_in_map_m[keyframe.landmarks[seen]],
        )
        away = project(points, camera_parameters(INTRINSICS)) - keyframe.features.pixels[seen]
        off_px.append(float(np.nanmedian(np.linalg.norm(away, axis=1))))
    # The imitated tracker itself is off by some pixels: its steps are, and it adjusts nothing.
    assert max(off_px) < 12.0


def test_landmarks_move_with_the_keyframe_that_saw_them_first():
    tracker = DriftingTracker(hall(), 1)
    for pose in round_trip(count=5, turns=0.1):
        tracker.add(pose)
    visual_map = tracker.map
    before = np.array([visual_map.pose_of(i) for i in range(5)])
    positions = visual_map.positions_in_map_m.copy()
    for keyframe in visual_map.keyframes[2:]:
        keyframe.T_map_camera = keyframe.T_map_camera.copy()
        keyframe.T_map_camera[2, 3] += 0.5
    move_landmarks(visual_map, before)
    for landmark in range(0, len(positions), 37):
        first = min(visual_map.observers_of(landmark))
        rise = visual_map.positions_in_map_m[landmark] - positions[landmark]
        np.testing.assert_allclose(rise, [0.0, 0.0, 0.5 if first >= 2 else 0.0], atol=1e-9)


def test_the_adjustment_of_all_lessens_the_error_and_keeps_the_first():
    tracker = DriftingTracker(hall(), 3, [0.0, 0.003, 0.0, 0.01, 0.0, 0.0])
    for pose in round_trip(count=10, turns=0.15):
        tracker.add(pose)
    before, start = rms(tracker.errors_m()), tracker.map.keyframes[0].T_map_camera.copy()
    noise = ObservationNoise(pixel_sigma=0.5, depth_sigma_per_m2=0.0015)
    result = adjust_globally(tracker.map, INTRINSICS, noise, GlobalAdjustmentSettings())
    assert result is not None
    assert result.cost[1] < 0.5 * result.cost[0]
    assert rms(tracker.errors_m()) < before / 3.0
    np.testing.assert_allclose(tracker.map.keyframes[0].T_map_camera, start, atol=1e-5)
    assert result.is_inlier.mean() > 0.9
    # A sighting that does not fit is one no more.
    seen = sum(np.count_nonzero(k.landmarks != NO_LANDMARK) for k in tracker.map.keyframes)
    assert seen == len(tracker.map.observations())


def test_the_sparse_adjustment_agrees_with_the_dense_one():
    from fusion_core.slam.visual import global_adjustment as sparse
    from fusion_core.slam.visual.bundle_adjustment import adjust_bundle

    kept = {}

    def keep(problem, iterations):
        kept["problem"] = problem
        return adjust(problem, iterations)

    adjust = sparse.adjust_sparse
    tracker = DriftingTracker(hall(), 4, [0.0, 0.001, 0.0, 0.002, 0.0, 0.0])
    for pose in round_trip(count=6, turns=0.08):
        tracker.add(pose)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sparse, "adjust_sparse", keep)
        adjust_globally(tracker.map, INTRINSICS, ObservationNoise(), GlobalAdjustmentSettings())
    problem = kept["problem"]
    a, b = adjust(problem, 50), adjust_bundle(problem, 50, rounds=1)
    np.testing.assert_allclose(a.T_camera_map, b.T_camera_map, atol=2e-4)
    chi2 = observation_chi2(problem, b.T_camera_map, b.points_in_map_m)
    np.testing.assert_array_equal(
        chi2 <= np.where(np.isnan(problem.depths_m), 5.991, 7.815), b.is_inlier
    )
