"""Virtual scans, against the published rule written as a loop and against a room's true ranges."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from fusion_core.mapping.beam_surfaces import nearest_surfaces
from fusion_core.mapping.camera_points import project_to_cloud
from fusion_core.mapping.virtual_scan import (
    PUBLISHED,
    VirtualScanSettings,
    make_camera_scan,
    merge_camera_cloud,
)
from fusion_core.model.conventions import wrap_angle
from fusion_core.model.sensors import CameraIntrinsics
from tests.mapping.box_room import INTRINSICS, LIDAR_HEIGHT_M, BoxRoom, camera_pose

DEFAULT = VirtualScanSettings()
POSE = np.array([1.0, 2.5, 0.0])
# Behind it walls; a low box that a LiDAR at 0.3 m misses, a shelf over it, a tall cabinet.
ROOM = BoxRoom(
    size_m=(5.5, 5.0, 2.5),
    boxes=(
        (2.9, 2.2, 0.0, 3.2, 2.6, 0.2),
        (3.0, 3.2, 0.7, 3.6, 3.8, 0.75),
        (4.2, 1.2, 0.0, 4.8, 1.8, 1.8),
    ),
)


def by_loop(points, first, step, beams, half_width=0.0, thickness=0.0):
    """Each beam's nearest point, and the mean of those just behind it."""
    result = np.full(beams, np.nan)
    angles = first + step * np.arange(beams)
    members = [[] for _ in range(beams)]
    for x, y in points:
        r = np.hypot(x, y)
        off = np.abs(wrap_angle(np.arctan2(y, x) - angles))
        for beam in range(beams):
            if off[beam] <= max(0.5 * abs(step), 0.0) or off[beam] <= np.arctan(half_width / r):
                members[beam].append(r)
    for beam, found in enumerate(members):
        if found:
            behind = [r for r in found if r <= min(found) + thickness]
            result[beam] = np.mean(behind)
    return result


clouds = st.integers(0, 10_000).map(
    lambda seed: np.random.default_rng(seed).normal(scale=2.0, size=(60, 2))
)


@given(
    clouds,
    st.floats(-7.0, 7.0),
    st.sampled_from([0.3, -0.3, 0.05, -0.02, 2 * np.pi / 90]),
    st.integers(1, 60),
    st.sampled_from([0.0, 0.02, 0.4]),
    st.sampled_from([0.0, 0.5]),
)
def test_each_angle_takes_its_nearest_point(points, first, step, beams, half_width, thickness):
    beams = min(beams, int(2 * np.pi / abs(step) + 1e-9))
    found, _ = nearest_surfaces(
        np.column_stack([points, np.zeros(len(points))]),
        first,
        step,
        beams,
        half_width_m=half_width,
        thickness_m=np.full(len(points), thickness),
    )
    expected = by_loop(points, first, step, beams, half_width, thickness)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_published_preset_is_the_papers_six_steps(seed):
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.3, 4.0, (INTRINSICS.height, INTRINSICS.width)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.3] = np.nan
    # Dense enough that the radius filter keeps some and drops some.
    depth = np.where(rng.random(depth.shape) < 0.5, np.float32(2.0), depth)
    P = camera_pose(0.4, pitch=0.05, roll=0.02)[:3]
    lidar_m = np.where(rng.random(200) < 0.5, 2.0, rng.uniform(1.0, 3.0, 200))
    scan = replace(ROOM.scan(POSE, beams=200), ranges_m=lidar_m, range_max_m=2.9)
    cloud = []
    for v in range(0, 240, 64):
        for u in range(0, 320, 4):
            z = float(depth[v, u])
            if not np.isfinite(z):
                continue
            ray = np.array(
                [(u - INTRINSICS.cx) / INTRINSICS.fx, (v - INTRINSICS.cy) / INTRINSICS.fy, 1.0]
            )
            p = P[:, :3] @ (z * ray) + P[:, 3]
            if 0.01 < p[2] < 0.55:
                cloud.append(p)
    angles = scan.angles_rad
    joined = list(cloud)
    lidar = {}
    for beam in range(200):
        if abs(angles[beam]) <= np.pi / 4 and scan.ranges_m[beam] <= 2.9:
            r = scan.ranges_m[beam]
            lidar[beam] = np.array([r * np.cos(angles[beam]), r * np.sin(angles[beam]), 0.3])
            joined.append(lidar[beam])
    joined = np.array(joined)

    def stays(p):
        return (np.linalg.norm(joined - p, axis=1) <= PUBLISHED.radius_m).sum() - 1 >= 2

    expected = np.full(200, np.nan)
    expected[(np.abs(angles) <= np.pi / 4) & (scan.ranges_m > 2.9)] = 0.0
    far = expected == 0.0
    expected[far] = scan.ranges_m[far]
    for p in [p for p in cloud if stays(p)] + [p for p in lidar.values() if stays(p)]:
        beam = int(np.argmin(np.abs(wrap_angle(np.arctan2(p[1], p[0]) - angles))))
        r = np.hypot(p[0], p[1])
        if r <= 2.9:
            expected[beam] = np.fmin(expected[beam], r)
    assert len(cloud) > 20
    assert 0 < sum(map(stays, cloud)) < len(cloud)
    assert 0 < sum(map(stays, lidar.values())) < len(lidar)
    found = merge_camera_cloud(
        scan, project_to_cloud(depth, INTRINSICS, P, PUBLISHED), PUBLISHED, 0.3
    )
    np.testing.assert_allclose(found.ranges_m, expected, atol=1e-6)


# Of the paper's camera, whose every 64th row is meant.
WIDE = CameraIntrinsics(width=1280, height=1024, fx=1145.0, fy=1145.0, cx=639.5, cy=511.5)


def seen(room, settings):
    intrinsics = INTRINSICS if settings is DEFAULT else WIDE
    depth_m = room.depth(POSE, camera_pose(), intrinsics=intrinsics, noise=np.random.default_rng(5))
    return project_to_cloud(depth_m, intrinsics, camera_pose()[:3], settings)


def in_view(angles):
    """Azimuths that the camera's whole width sees from the LiDAR at any distance beyond 1.5 m."""
    return np.abs(wrap_angle(angles - 0.1)) < np.deg2rad(25.0)


@pytest.mark.parametrize("settings", [DEFAULT, PUBLISHED], ids=["default", "published"])
def test_the_merged_scan_has_the_true_obstacles_of_the_band(settings):
    scan = ROOM.scan(POSE)
    merged = merge_camera_cloud(scan, seen(ROOM, settings), settings, LIDAR_HEIGHT_M)
    angles = scan.angles_rad
    # Clear of edges, where half a beam decides.
    true = ROOM.nearest_in_band(POSE, angles, 0.06, 0.55)
    plain = np.maximum(np.abs(true - np.roll(true, 1)), np.abs(true - np.roll(true, -1))) < 0.1
    shown = in_view(angles) & plain
    error = merged.ranges_m[shown] - true[shown]
    low = true < scan.ranges_m - 0.3
    assert (low & shown).sum() >= 6
    assert (merged.ranges_m < scan.ranges_m - 0.3)[low & shown].sum() >= 3
    assert np.nanmin(error) > -4.0 * 1.4e-3 * 4.5**2
    if settings is DEFAULT:
        # The published rows miss some low obstacles, and the filter drops far walls.
        assert np.abs(error).max() < 0.02
    # The shelf at 0.7 m lets the robot pass.
    passed = np.abs(angles - np.arctan2(1.0, 2.2)) < 0.1
    np.testing.assert_allclose(
        merged.ranges_m[passed], scan.ranges_m[passed], atol=0.0 if settings is DEFAULT else 0.15
    )
    if settings is DEFAULT:
        # The camera does not make the LiDAR's own ranges less precise.
        np.testing.assert_array_equal(merged.ranges_m[~low & shown], scan.ranges_m[~low & shown])


def test_the_camera_alone_draws_walls_where_they_are():
    scan = make_camera_scan(
        seen(ROOM, DEFAULT), DEFAULT, stamp_ns=7, received_ns=None, frame_id="laser"
    )
    assert (scan.stamp_ns, scan.frame_id, scan.ranges_m.size) == (7, "laser", 720)
    angles = scan.angles_rad
    true = ROOM.nearest_in_band(POSE, angles, 0.06, 0.55)
    plain = np.maximum(np.abs(true - np.roll(true, 1)), np.abs(true - np.roll(true, -1))) < 0.05
    shown = in_view(angles) & plain & (true < 4.9)
    error = scan.ranges_m[shown] - true[shown]
    assert shown.sum() > 60
    assert np.isfinite(error).all()
    # The nearest of the noisy depths alone would be two standard deviations too near.
    assert abs(np.median(error)) < 0.006
    assert np.abs(error).max() < 0.04
    assert np.isnan(scan.ranges_m[np.abs(wrap_angle(angles - 0.1)) > np.deg2rad(40.0)]).all()


def test_noise_on_the_floor_is_no_obstacle():
    room = BoxRoom(size_m=(40.0, 40.0, 2.5))
    pose = np.array([20.0, 20.0, 0.3])
    # The mount is off by half a degree: the floor seems to rise.
    T = camera_pose(1.0, pitch=0.2)
    cloud = project_to_cloud(
        room.depth(pose, T, noise=np.random.default_rng(3)),
        INTRINSICS,
        camera_pose(1.0, pitch=0.2 - np.deg2rad(0.5))[:3],
        DEFAULT,
    )
    scan = make_camera_scan(cloud, DEFAULT, stamp_ns=0, received_ns=0, frame_id="laser")
    assert np.isnan(scan.ranges_m).all()


def test_an_isolated_depth_is_dropped_and_a_thin_post_is_not():
    room = BoxRoom(boxes=((2.5, 2.6, 0.0, 2.53, 2.63, 1.0),))
    depth = room.depth(POSE, camera_pose()).copy()
    depth[150, 60] = 1.1
    cloud = project_to_cloud(depth, INTRINSICS, camera_pose()[:3], DEFAULT)
    scan = make_camera_scan(cloud, DEFAULT, stamp_ns=0, received_ns=0, frame_id="laser")
    assert np.nanmin(scan.ranges_m) == pytest.approx(np.hypot(1.5, 0.1), abs=0.03)


def test_a_beam_without_a_return_stays_unless_the_camera_saw_something_nearer():
    scan = replace(ROOM.scan(POSE), ranges_m=np.full(360, 81.9))
    merged = merge_camera_cloud(scan, np.empty((0, 3)), DEFAULT, LIDAR_HEIGHT_M)
    np.testing.assert_array_equal(merged.ranges_m, 81.9)
    merged = merge_camera_cloud(scan, seen(ROOM, DEFAULT), DEFAULT, LIDAR_HEIGHT_M)
    ahead = np.abs(scan.angles_rad) < 0.02
    assert merged.ranges_m[ahead] == pytest.approx(1.9, abs=0.03)
    assert (merged.ranges_m[np.abs(scan.angles_rad) > 1.0] == 81.9).all()


def test_beams_without_a_return_take_what_the_camera_saw():
    scan = replace(ROOM.scan(POSE), ranges_m=np.full(360, np.nan))
    merged = merge_camera_cloud(scan, seen(ROOM, DEFAULT), DEFAULT, LIDAR_HEIGHT_M)
    shown = np.abs(wrap_angle(scan.angles_rad - 0.1)) < np.deg2rad(20.0)
    assert np.isfinite(merged.ranges_m[shown]).mean() > 0.9
    assert np.isnan(merged.ranges_m[np.abs(scan.angles_rad) > 1.0]).all()


def test_a_hole_between_beams_that_met_a_surface_is_closed_by_the_camera():
    holes = np.arange(360) % 3 != 0
    # Over a low box whose front the LiDAR has met, the camera sees the wall behind as well.
    room = BoxRoom(size_m=ROOM.size_m, boxes=((2.9, 1.5, 0.0, 3.2, 3.5, 0.35),))
    scan = replace(room.scan(POSE), ranges_m=np.where(holes, np.nan, room.scan(POSE).ranges_m))
    merged = merge_camera_cloud(scan, seen(room, DEFAULT), DEFAULT, LIDAR_HEIGHT_M)
    true = room.nearest_in_band(POSE, scan.angles_rad, 0.06, 0.55)
    front = in_view(scan.angles_rad) & (true < 2.2)
    assert (front & holes).sum() > 20
    np.testing.assert_allclose(merged.ranges_m[front], true[front], atol=0.03)


def patch(range_m):
    """A dense piece of wall at a constant distance, 0.4 rad wide."""
    azimuth, height = np.meshgrid(np.linspace(-0.2, 0.2, 60), np.linspace(0.1, 0.5, 20))
    return np.stack(
        [range_m * np.cos(azimuth), range_m * np.sin(azimuth), height], axis=-1
    ).reshape(-1, 3)


def test_what_lies_behind_the_lidars_surface_adds_nothing():
    scan = ROOM.scan(POSE)
    ranges = np.full(360, 2.0)
    ranges[180] = 4.5
    scan = replace(scan, ranges_m=ranges)
    cloud = np.concatenate([patch(2.0), patch(3.5)])
    merged = merge_camera_cloud(scan, cloud, DEFAULT, LIDAR_HEIGHT_M)
    np.testing.assert_array_equal(merged.ranges_m, ranges)


def test_nothing_is_added_beyond_the_lidars_range():
    scan = replace(ROOM.scan(POSE), ranges_m=np.full(360, np.nan), range_max_m=3.0)
    assert np.isnan(merge_camera_cloud(scan, patch(3.5), DEFAULT, None).ranges_m).all()
    assert np.isfinite(merge_camera_cloud(scan, patch(2.5), DEFAULT, None).ranges_m).sum() > 15


def test_where_heights_cannot_be_compared_the_clouds_do_not_support_each_other():
    scan = replace(ROOM.scan(POSE, beams=720), ranges_m=np.full(720, 2.0))
    lone = np.array([[2.0, 0.1, 0.3], [2.0, -0.1, 0.3]])
    settings = DEFAULT.model_copy(update={"same_surface_m": 0.001, "same_surface_per_m2": 0.0})
    near = lone - [0.03, 0.0, 0.0]
    beside = merge_camera_cloud(scan, near, settings, 0.3)
    assert (beside.ranges_m < 1.99).sum() > 0
    unknown = merge_camera_cloud(scan, near, settings, None)
    np.testing.assert_array_equal(unknown.ranges_m, scan.ranges_m)


@pytest.mark.parametrize(
    "wrong",
    [
        {"height_min_m": 0.6},
        {"depth_min_m": 6.0},
        {"lidar_half_width_deg": 181.0},
        {"sampling": "all"},
        {"lidar_height_m": 0.0},
    ],
)
def test_settings_that_contradict_themselves_are_refused(wrong):
    with pytest.raises(ValidationError):
        VirtualScanSettings(**wrong)
