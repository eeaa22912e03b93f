"""Visual SLAM before two textured walls, whose images are drawn at known poses."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from fusion_core.model.errors import MappingFailed
from fusion_core.model.geometry import invert_transform
from fusion_core.slam.visual.features import FeatureSettings
from fusion_core.slam.visual.keyframe_policy import KeyframePolicy
from fusion_core.slam.visual.visual_slam import VisualSlamSettings, visual_slam
from tests.slam.visual.textured_corner import INTRINSICS, frame, poses

COUNT = 45
POSES = poses(COUNT)
SETTINGS = VisualSlamSettings(
    features=FeatureSettings(features_max=500), keyframes=KeyframePolicy(images_max=10)
)


@cache
def images():
    return tuple(frame(T, k) for k, T in enumerate(POSES))


@cache
def mapped():
    return visual_slam(images(), INTRINSICS, SETTINGS)


def off_m(result, chosen=slice(None)):
    """Distances from the truth, both relative to the first pose."""
    true = invert_transform(POSES[0]) @ POSES[chosen]
    return np.linalg.norm(result.T_map_camera[chosen, :3, 3] - true[:, :3, 3], axis=1)


def test_each_image_has_a_pose_near_the_truth():
    result = mapped()
    assert result.is_tracked.all()
    assert result.lost == result.jumps == ()
    # 1.7 px at the walls' distance.
    assert off_m(result).max() < 0.02
    turned = np.linalg.inv(invert_transform(POSES[0]) @ POSES) @ result.T_map_camera
    assert np.trace(turned[:, :3, :3], axis1=1, axis2=2).min() > 3.0 - 0.01**2
    assert 3 < len(result.visual_map.kept_keyframes) < COUNT // 3
    assert len(result.stamps_ns) == COUNT


def test_rotations_stay_rotations():
    R = mapped().T_map_camera[:, :3, :3]
    np.testing.assert_allclose(
        R @ R.transpose(0, 2, 1), np.eye(3)[None].repeat(COUNT, 0), atol=1e-9
    )


@pytest.mark.slow
def test_pacing_to_and_fro_does_not_grow_the_map():
    passes, period = 10, 2 * (COUNT - 1)
    places = [min(n % period, period - n % period) for n in range(passes * (COUNT - 1) + 1)]
    paced = [replace(images()[place], stamp_ns=number) for number, place in enumerate(places)]
    after_two = visual_slam(paced[:period], INTRINSICS, SETTINGS).visual_map
    result = visual_slam(paced, INTRINSICS, SETTINGS)
    assert result.is_tracked.all()
    grown = result.visual_map
    assert len(grown.keyframes) > 3 * len(after_two.keyframes)
    assert len(grown.kept_keyframes) < 1.5 * len(after_two.kept_keyframes)
    kept, kept_before = (np.count_nonzero(~m.is_landmark_culled) for m in (grown, after_two))
    assert kept < 1.5 * kept_before
    # Rows of what is culled are given back.
    assert len(grown.positions_in_map_m) < 3 * kept
    assert all(len(k.features) == 0 for k in grown.keyframes if k.is_culled)


def test_mapping_on_a_thread_of_its_own_gives_the_same_bytes():
    with ThreadPoolExecutor(1) as executor:
        behind = visual_slam(images(), INTRINSICS, SETTINGS, executor=executor)
    between = mapped()
    assert behind.T_map_camera.tobytes() == between.T_map_camera.tobytes()
    first, second = behind.visual_map, between.visual_map
    assert first.positions_in_map_m.tobytes() == second.positions_in_map_m.tobytes()
    assert [k.stamp_ns for k in first.keyframes] == [k.stamp_ns for k in second.keyframes]


def test_dark_images_are_lost_by_name_and_the_camera_is_found_again():
    dark = range(18, 22)
    result = visual_slam(
        (frame(T, k, light=0.0 if k in dark else 1.0, noise=0.5) for k, T in enumerate(POSES)),
        INTRINSICS,
        SETTINGS,
    )
    np.testing.assert_array_equal(np.flatnonzero(~result.is_tracked), dark)
    (stretch,) = result.lost
    assert (stretch.first, stretch.last) == (18, 21)
    assert "too few features" in stretch.reason
    assert np.isnan(result.T_map_camera[18:22]).all()
    assert off_m(result, result.is_tracked).max() < 0.015


def test_images_left_out_do_not_end_it():
    kept = [k for k in range(COUNT) if not 15 <= k < 21]
    result = visual_slam([images()[k] for k in kept], INTRINSICS, SETTINGS)
    assert result.is_tracked.all()
    true = invert_transform(POSES[0]) @ POSES[kept]
    assert np.linalg.norm(result.T_map_camera[:, :3, 3] - true[:, :3, 3], axis=1).max() < 0.02


def test_another_place_is_lost_and_said():
    """The walls are gone: other textures, upside down."""
    other = [frame(T, k) for k, T in enumerate(POSES[20:26], start=20)]
    for view in other:
        view.gray.setflags(write=True)
        view.gray[:] = np.random.default_rng(1).permutation(view.gray.ravel()).reshape(240, 320)
    result = visual_slam([*images()[:20], *other], INTRINSICS, SETTINGS)
    assert not result.is_tracked[21:].any()
    assert result.lost[-1].last == 25
    assert "too few" in result.lost[-1].reason


def test_a_map_begins_where_there_is_something_to_see():
    dark = [frame(POSES[0], k, light=0.0, noise=0.5) for k in range(3)]
    result = visual_slam([*dark, *images()[3:12]], INTRINSICS, SETTINGS)
    np.testing.assert_array_equal(result.is_tracked, [False] * 3 + [True] * 9)
    assert "start a map" in result.lost[0].reason
    np.testing.assert_allclose(result.T_map_camera[3], np.eye(4), atol=1e-12)


def test_nothing_to_see_is_an_error():
    dark = [frame(POSES[0], k, light=0.0, noise=0.5) for k in range(3)]
    with pytest.raises(MappingFailed, match="no image can start a map: too few features"):
        visual_slam(dark, INTRINSICS, SETTINGS)
    with pytest.raises(MappingFailed, match="there are no images"):
        visual_slam([], INTRINSICS, SETTINGS)


def test_a_view_at_each_keyframe():
    views = []
    result = visual_slam(images()[:25], INTRINSICS, SETTINGS, observer=views.append)
    assert len(views) == len(result.visual_map.keyframes)
    last = views[-1]
    assert len(last.stamps_ns) == len(last.T_map_camera) > 10
    assert len(last.keyframe_stamps_ns) == len(views)
    assert len(last.points_in_map_m) == len(last.rgb) > 500
    # The walls meet 3.5 m ahead of the first camera.
    assert 2.0 < np.median(last.points_in_map_m[:, 2]) < 4.0
