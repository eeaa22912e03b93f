"""Closed forms: what stands where, for a wall at a known distance."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fusion_core.denoising.correspondence import match_along_curve, match_in_row
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_quaternion,
    rotation_from_yaw_pitch_roll,
    transform_points,
)
from fusion_core.model.rig import Camera, Mount
from fusion_core.model.sensors import CameraIntrinsics, LaserScan
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_match import FrameMatch
from fusion_core.workflows.fuse.pairing import FramePair
from scanloom.scene.camera_views import SceneWindow, stage_extent, step_view
from scanloom.scene.frame_geometry import (
    UnmatchedFrame,
    camera_pose,
    class_marks,
    frame_geometry,
    pair_segments,
    pixel_points,
    repairs,
    scan_geometry,
    unmatched_geometry,
)
from scanloom.scene.geometry import (
    arrow_segments,
    curve_points,
    frustum,
    path_segments,
    polyline,
    quaternion,
    ridge_lines,
    scan_curve,
)

LENS = CameraIntrinsics(width=80, height=60, fx=70.0, fy=70.0, cx=39.5, cy=29.5)
CAMERA = Camera(
    topic="/depth", intrinsics=LENS, T_rig_camera=make_transform(R_BODY_OPTICAL, np.zeros(3))
)
RIG = SimpleNamespace(cameras=(CAMERA,))
MOUNT = Mount(yaw_rad=0.2, delta_z_m=0.3, forward_m=0.1, left_m=-0.05)
ALIGNMENT = SimpleNamespace(mount=MOUNT)
T_LIDAR_CAMERA = MOUNT.T_lidar_rig @ CAMERA.T_rig_camera
WALL_M = 3.0
ALL = frozenset(NoiseClass)


def wall_depth(T_lidar_camera: np.ndarray) -> np.ndarray:
    """(H, W) depth of the plane x = WALL_M of the LiDAR's frame."""
    rows, columns = np.mgrid[0 : LENS.height, 0 : LENS.width]
    ahead = (CAMERA.rays(rows, columns) @ T_lidar_camera[:3, :3].T)[..., 0]
    return ((WALL_M - T_lidar_camera[0, 3]) / ahead).astype(np.float32)


def wall_scan() -> LaserScan:
    angles_rad = -0.8 + 0.01 * np.arange(161)
    return LaserScan(
        stamp_ns=5,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=-0.8,
        angle_increment_rad=0.01,
        range_min_m=0.1,
        range_max_m=10.0,
        ranges_m=WALL_M / np.cos(angles_rad),
    )


def frame_of(pairs, scan, depth_m, lidar_class=None, depth_class=None, lidar_m=None, pixel_m=None):
    """A fused frame with these pairs, by default all good and unrepaired."""
    good = np.zeros(pairs.beam.size, dtype=np.int64)
    classes = SimpleNamespace(
        lidar_class=good if lidar_class is None else lidar_class,
        depth_class=good if depth_class is None else depth_class,
    )
    repair = SimpleNamespace(
        lidar_range_m=pairs.lidar_range_m if lidar_m is None else lidar_m,
        depth_m=pairs.depth_m if pixel_m is None else pixel_m,
    )
    match = FrameMatch(
        pair=FramePair(
            camera_index=0,
            camera=CAMERA,
            image=SimpleNamespace(stamp_ns=7),
            depth_m=depth_m,
            window=SimpleNamespace(scan=scan),
            gap_ns=2,
            aligned_scan=scan,
        ),
        moved=np.zeros(3),
        motion=None,
        search=None,
        curve=None,
        row=None,
        u_of_rig=0.0,
        row_model=pairs.model,
        registration=None,
        refusal="",
        correspondence=pairs,
    )
    return FusedFrame(
        match=match, classes=classes, repair=repair, camera_range_m=pairs.camera_range_m
    )


@pytest.fixture
def wall():
    scan, depth_m = wall_scan(), wall_depth(T_LIDAR_CAMERA)
    return frame_of(
        match_along_curve(scan, depth_m, depth_m, CAMERA, T_LIDAR_CAMERA), scan, depth_m
    )


def test_rows_of_a_wall_are_straight_lines_on_it():
    depth_m = wall_depth(T_LIDAR_CAMERA)
    segments = ridge_lines(depth_m, CAMERA, T_LIDAR_CAMERA, 10)
    assert segments.shape == (6 * (LENS.width - 1), 2, 3)
    assert segments.dtype == np.float32
    np.testing.assert_allclose(segments[..., 0], WALL_M, atol=1e-5)
    row = segments[: LENS.width - 1]
    np.testing.assert_array_equal(row[1:, 0], row[:-1, 1])
    # Left to right as the camera sees it, on a line at one slope.
    assert (np.diff(row[:, 0, 1]) < 0.0).all()
    slopes = np.diff(row[:, :, 2], axis=1) / np.diff(row[:, :, 1], axis=1)
    assert np.ptp(slopes) < 1e-3


def test_rows_agree_with_the_rays_of_their_pixels():
    depth_m = wall_depth(T_LIDAR_CAMERA)
    segments = ridge_lines(depth_m, CAMERA, T_LIDAR_CAMERA, 60)
    rays = CAMERA.rays(np.full(LENS.width, 29), np.arange(LENS.width))
    expected = transform_points(T_LIDAR_CAMERA, depth_m[29, :, np.newaxis] * rays)
    np.testing.assert_allclose(segments[:, 0], expected[:-1], atol=1e-5)
    np.testing.assert_allclose(segments[:, 1], expected[1:], atol=1e-5)


def test_rows_break_at_edges_and_missing_pixels():
    depth_m = np.full((1, LENS.width), 2.0, dtype=np.float32)
    depth_m[0, 20:] = 2.24
    depth_m[0, 40:] = 2.5
    depth_m[0, 60] = np.nan
    segments = ridge_lines(depth_m, CAMERA, T_LIDAR_CAMERA, 1)
    assert len(segments) == LENS.width - 1 - 3
    in_camera = transform_points(invert_transform(T_LIDAR_CAMERA), segments.astype(np.float64))
    columns = np.rint(LENS.cx + LENS.fx * in_camera[:, 0, 0] / in_camera[:, 0, 2])
    assert sorted(set(range(LENS.width - 1)) - set(columns.astype(int))) == [39, 59, 60]


def test_thinned_rows_break_where_any_pixel_between_does():
    wide = CameraIntrinsics(width=640, height=1, fx=500.0, fy=500.0, cx=319.5, cy=0.0)
    camera = Camera(topic="/d", intrinsics=wide, T_rig_camera=CAMERA.T_rig_camera.copy())
    depth_m = np.full((1, 640), 2.0, dtype=np.float32)
    segments = ridge_lines(depth_m, camera, T_LIDAR_CAMERA, 1)
    depth_m[0, 102:] = 2.3
    broken = ridge_lines(depth_m, camera, T_LIDAR_CAMERA, 1)
    assert len(segments) == 159
    assert len(broken) == 158


def test_an_image_without_depth_gives_no_rows():
    depth_m = np.full((60, 80), np.nan, dtype=np.float32)
    assert ridge_lines(depth_m, CAMERA, T_LIDAR_CAMERA, 6).shape == (0, 2, 3)


def test_beams_lie_on_the_wall_in_their_plane():
    scan = wall_scan()
    points = curve_points(scan, scan.ranges_m)
    np.testing.assert_allclose(points[:, 0], WALL_M, rtol=1e-6)
    np.testing.assert_array_equal(points[:, 2], 0.0)
    assert points[-1, 1] > 0.0 > points[0, 1]


def test_a_polyline_leaves_gaps_out():
    points = np.array(
        [[0.0, 0, 0], [0.1, 0, 0], [np.nan] * 3, [0.3, 0, 0], [0.4, 0, 0], [0.9, 0, 0]]
    )
    np.testing.assert_allclose(polyline(points)[:, :, 0], [[0.0, 0.1], [0.3, 0.4]], rtol=1e-6)
    assert polyline(points[:1]).shape == (0, 2, 3)


def test_a_curve_is_broken_at_jumps_and_joined_far_away():
    angles_rad = np.deg2rad(np.arange(-20.0, 21.0))
    range_m = np.full(41, 2.0)
    range_m[20:] = 3.0
    range_m[30] = np.nan
    range_m[10] = 1.0
    points = (range_m * np.stack([np.cos(angles_rad), np.sin(angles_rad), 0 * angles_rad])).T
    curve, alone = scan_curve(points.astype(np.float32), np.deg2rad(1.0))
    # 40 gaps between 41 beams: none at the jump, two at each beam that is alone or missing.
    assert len(curve) == 40 - 1 - 2 - 2
    np.testing.assert_allclose(np.linalg.norm(alone, axis=1), [1.0])
    far, alone = scan_curve(10.0 * points[:10].astype(np.float32), np.deg2rad(1.0))
    assert len(far) == 9
    assert not len(alone)


def test_a_curve_is_smoothed_but_not_at_its_ends():
    rng = np.random.default_rng(3)
    line = np.zeros((200, 3), dtype=np.float32)
    line[:, 0] = 2.0 + rng.normal(0.0, 0.02, 200)
    line[:, 1] = np.linspace(-1.0, 1.0, 200)
    curve, _ = scan_curve(line, 0.005)
    assert curve[:, 0, 0].std() < 0.7 * line[:, 0].std()
    np.testing.assert_array_equal(curve[0, 0], line[0])
    np.testing.assert_array_equal(curve[-1, 1], line[-1])


def test_a_path_has_a_gap_where_poses_are_missing_or_far_apart():
    path = np.zeros((6, 3))
    path[:, 0] = [0.0, 0.5, np.nan, 1.0, 1.5, 9.0]
    np.testing.assert_allclose(path_segments(path)[:, :, 0], [[0.0, 0.5], [1.0, 1.5]])


def test_exact_pairs_coincide(wall):
    pixels_m = pixel_points(wall.match, CAMERA, T_LIDAR_CAMERA, wall.match.correspondence.depth_m)
    segments, codes = pair_segments(wall, pixels_m, ALL)
    assert len(segments) == np.isfinite(pixels_m[:, 0]).sum() > 30
    # A pixel is half a pixel off the beam's point at most.
    half_px_m = 0.6 * WALL_M / LENS.fx
    np.testing.assert_allclose(segments[:, 0], segments[:, 1], atol=half_px_m)
    np.testing.assert_allclose(segments[:, 1, 0], WALL_M, atol=1e-5)
    assert (codes == NoiseClass.GOOD).all()


def test_a_pair_is_what_its_worse_side_is(wall):
    lidar_class = np.zeros(wall.match.correspondence.beam.size, dtype=np.int64)
    depth_class = lidar_class.copy()
    lidar_class[3] = depth_class[4] = NoiseClass.BURR
    lidar_class[5] = depth_class[5] = NoiseClass.CONFLICT
    frame = frame_of(
        wall.match.correspondence, wall.match.scan, wall.match.depth_m, lidar_class, depth_class
    )
    pixels_m = pixel_points(frame.match, CAMERA, T_LIDAR_CAMERA, frame.match.correspondence.depth_m)
    _, codes = pair_segments(frame, pixels_m, ALL)
    assert codes[3:6].tolist() == [NoiseClass.BURR, NoiseClass.BURR, NoiseClass.CONFLICT]
    segments, codes = pair_segments(frame, pixels_m, frozenset({NoiseClass.BURR}))
    assert len(segments) == 2
    assert (codes == NoiseClass.BURR).all()
    assert len(pair_segments(frame, pixels_m, frozenset())[0]) == 0


def test_classes_stand_where_the_beam_ends(wall):
    pairs = wall.match.correspondence
    lidar_class = np.zeros(pairs.beam.size, dtype=np.int64)
    depth_class = lidar_class.copy()
    lidar_class[3], depth_class[4], depth_class[5] = (
        NoiseClass.HOLE,
        NoiseClass.BURR,
        NoiseClass.HOLE,
    )
    range_m = pairs.lidar_range_m.copy()
    range_m[3] = np.nan
    pairs = replace(pairs, lidar_range_m=range_m)
    frame = frame_of(pairs, wall.match.scan, wall.match.depth_m, lidar_class, depth_class)
    pixels_m = np.zeros((pairs.beam.size, 3))
    marks_m, codes = class_marks(frame, pixels_m, ALL)
    assert codes[3:6].tolist() == [NoiseClass.HOLE, NoiseClass.BURR, NoiseClass.HOLE]
    # A missing range is where the camera sees the beam end; a flying pixel is where it is seen.
    np.testing.assert_allclose(marks_m[3, 0], WALL_M, atol=0.1)
    np.testing.assert_array_equal(marks_m[4], 0.0)
    np.testing.assert_allclose(marks_m[5, 0], WALL_M, rtol=1e-5)
    assert len(class_marks(frame, pixels_m, frozenset({NoiseClass.BURR}))[0]) == 1


def test_a_repaired_burr_moves_and_a_filled_hole_appears(wall):
    scan = wall_scan()
    ranges_m = scan.ranges_m.copy()
    burr, hole = int(wall.match.correspondence.beam[10]), int(wall.match.correspondence.beam[20])
    ranges_m[burr] -= 1.0
    ranges_m[hole] = np.nan
    noisy = scan.with_ranges(ranges_m, None)
    pairs = match_along_curve(noisy, wall.match.depth_m, wall.match.depth_m, CAMERA, T_LIDAR_CAMERA)
    at = {int(beam): index for index, beam in enumerate(pairs.beam)}
    lidar_class = np.zeros(pairs.beam.size, dtype=np.int64)
    lidar_class[at[burr]], lidar_class[at[hole]] = NoiseClass.BURR, NoiseClass.HOLE
    frame = frame_of(
        pairs, noisy, wall.match.depth_m, lidar_class, lidar_m=scan.ranges_m[pairs.beam].copy()
    )
    moved_m, moved_class, filled_m, filled_class = repairs(frame, CAMERA, T_LIDAR_CAMERA, ALL)
    assert moved_class.tolist() == [NoiseClass.BURR]
    np.testing.assert_allclose(np.linalg.norm(moved_m[0, 1] - moved_m[0, 0]), 1.0, rtol=1e-5)
    np.testing.assert_allclose(moved_m[0, 1, 0], WALL_M, rtol=1e-5)
    assert filled_class.tolist() == [NoiseClass.HOLE]
    np.testing.assert_allclose(filled_m[0, [0, 2]], [WALL_M, 0.0], atol=1e-5)
    only_holes = repairs(frame, CAMERA, T_LIDAR_CAMERA, frozenset({NoiseClass.HOLE}))
    assert (len(only_holes[0]), len(only_holes[2])) == (0, 1)

    shown = frame_geometry(frame, RIG, ALIGNMENT, row_step=6)
    raw = frame_geometry(frame, RIG, ALIGNMENT, row_step=6, repaired=False)
    np.testing.assert_allclose(shown.beams_m[:, 0], WALL_M, rtol=1e-5)
    assert np.isnan(raw.beams_m[hole]).all()
    assert raw.beams_m[burr, 0] < WALL_M - 0.5


def test_a_row_is_drawn_in_the_lidars_plane():
    level = make_transform(
        rotation_from_yaw_pitch_roll(0.3, 0.0, 0.0) @ R_BODY_OPTICAL, np.zeros(3)
    )
    scan, depth_m = wall_scan(), wall_depth(level)
    frame = frame_of(match_in_row(scan, depth_m, depth_m, CAMERA, level, 45), scan, depth_m)
    T_lidar_camera = camera_pose(frame.match, RIG, ALIGNMENT)
    # The yaw is that of the pairs to half a pixel, whatever the mount says.
    np.testing.assert_allclose(T_lidar_camera[:3, :3], level[:3, :3], atol=0.5 / LENS.fx)
    # A pixel of row 45 lies below the axis; the camera is drawn as much higher.
    below = float(np.median(depth_m[45])) * (45 - LENS.cy) / LENS.fy
    assert T_lidar_camera[2, 3] == pytest.approx(below, abs=0.05)
    pixels_m = pixel_points(frame.match, CAMERA, T_lidar_camera, frame.match.correspondence.depth_m)
    np.testing.assert_allclose(pixels_m[:, 0], WALL_M, atol=0.05)
    np.testing.assert_array_equal(pixels_m[:, 2], 0.0)


def test_a_frame_without_pairs_in_view_is_drawn_at_the_mount():
    scan, depth_m = wall_scan(), wall_depth(T_LIDAR_CAMERA)
    nothing = scan.with_ranges(np.full(scan.ranges_m.size, np.nan), None)
    empty = np.full_like(depth_m, np.nan)
    pairs = match_along_curve(nothing, empty, empty, CAMERA, T_LIDAR_CAMERA)
    shown = frame_geometry(frame_of(pairs, nothing, empty), RIG, ALIGNMENT, row_step=6)
    assert not len(shown.rows_m)
    assert not len(shown.surface.points_m)
    assert not len(shown.pairs_m)
    assert np.isnan(shown.lowest_m)
    np.testing.assert_allclose(shown.frustum.position_m, T_LIDAR_CAMERA[:3, 3])


def test_an_unmatched_frame_shows_its_depth_and_scan():
    depth_m = wall_depth(T_LIDAR_CAMERA)
    with_scan = unmatched_geometry(
        UnmatchedFrame(camera=0, stamp_ns=7, depth_m=depth_m, scan=wall_scan(), mount=MOUNT),
        RIG,
        row_step=6,
    )
    alone = unmatched_geometry(
        UnmatchedFrame(camera=0, stamp_ns=7, depth_m=depth_m, scan=None, mount=MOUNT),
        RIG,
        row_step=6,
    )
    np.testing.assert_allclose(with_scan.rows_m[..., 0], WALL_M, atol=1e-5)
    np.testing.assert_allclose(with_scan.surface.points_m[:, 0], WALL_M, atol=1e-5)
    np.testing.assert_allclose(with_scan.curve_m[..., 0], WALL_M, rtol=1e-5)
    assert alone.beams_m.shape == (0, 3)
    assert len(alone.rows_m)


def test_a_scan_alone_shows_its_curve():
    shown = scan_geometry(wall_scan())
    assert shown.camera is None
    assert shown.frustum is None
    np.testing.assert_allclose(shown.curve_m[..., 0], WALL_M, rtol=1e-5)
    assert shown.beams_m.shape == shown.pixels_m.shape == (161, 3)
    extent = stage_extent(shown)
    assert extent.yaw_rad == 0.0
    assert len(extent.sensors_m) == 1
    view = step_view("Recording", extent, SceneWindow(width_px=85.0, height_px=100.0))
    assert view.position_m[2] > 1.0 > view.position_m[0]


def test_the_frustum_is_the_cameras():
    shown = frustum(CAMERA, T_LIDAR_CAMERA)
    half = np.tan(0.5 * shown.fov_rad)
    assert half == pytest.approx(0.5 * LENS.height / LENS.fy)
    assert half * shown.aspect == pytest.approx(0.5 * LENS.width / LENS.fx)
    w, x, y, z = shown.wxyz
    np.testing.assert_allclose(
        rotation_from_quaternion(x, y, z, w), T_LIDAR_CAMERA[:3, :3], atol=1e-12
    )


@pytest.mark.parametrize(
    "R",
    [
        np.eye(3),
        np.diag([1.0, -1.0, -1.0]),
        np.diag([-1.0, 1.0, -1.0]),
        np.diag([-1.0, -1.0, 1.0]),
        R_BODY_OPTICAL,
        rotation_from_yaw_pitch_roll(3.0, -0.4, 2.0),
    ],
)
def test_quaternions_turn_as_their_rotation(R):
    w, x, y, z = quaternion(R)
    assert w >= 0.0
    np.testing.assert_allclose(rotation_from_quaternion(x, y, z, w), R, atol=1e-12)


def test_arrows_point_at_their_end():
    lines, codes = arrow_segments(
        np.array([[[0, 0, 0], [1, 0, 0]], [[0, 0, 1], [0, 0.01, 1]]], dtype=np.float32),
        np.array([2, 1]),
    )
    assert codes.tolist() == [2, 2, 2, 1, 1, 1]
    np.testing.assert_allclose(lines[:3, 1], [[1, 0, 0]] * 3)
    np.testing.assert_allclose(lines[0, 0], [0, 0, 0])
    # One barb to each side, shorter than the arrow.
    np.testing.assert_allclose(lines[1:3, 0, 0], 0.94, rtol=1e-5)
    assert lines[1, 0, 1] == pytest.approx(-lines[2, 0, 1])
    assert (lines[4:, 0, 1] >= 0.0).all()
