"""Pairs of beams and pixels: against OpenCV's projection, analytic scenes, and the paper's loops.

The scenes are boxes, so that the range of a beam and the depth of a pixel are exact. The LiDAR's
plane is z = 0 of the LiDAR frame.
"""

from dataclasses import fields

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.denoising.correspondence import (
    Correspondence,
    compare_samples,
    map_through_A,
    match_along_curve,
    match_by_sample,
    match_in_row,
    planar_points,
)
from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.geometry import make_transform
from fusion_core.model.rig import Camera, Mount
from fusion_core.model.sensors import CameraIntrinsics, LaserScan

LENS = CameraIntrinsics(width=120, height=90, fx=90.0, fy=92.0, cx=58.7, cy=44.2)
CAMERA = Camera(
    topic="/depth", intrinsics=LENS, T_rig_camera=make_transform(R_BODY_OPTICAL, np.zeros(3))
)
MOUNT = Mount(yaw_rad=0.12, delta_z_m=0.6, forward_m=0.08, left_m=-0.05, pitch_rad=0.06)

FLOOR = ((-9.0, -9.0, -0.4), (9.0, 9.0, -0.3))
WALL = ((4.0, -9.0, -0.4), (4.2, 9.0, 2.5))
LEFT_WALL = ((-9.0, 2.4, -0.4), (9.0, 2.6, 2.5))
RIGHT_WALL = ((-9.0, -2.9, -0.4), (9.0, -2.7, 2.5))
ROOM = (FLOOR, WALL, LEFT_WALL, RIGHT_WALL)
# Above the LiDAR's plane and below the camera: it hides the wall from the camera alone.
TABLE_TOP = ((1.5, 0.1, 0.25), (2.9, 1.4, 0.30))
CABINET = ((2.2, -1.1, -0.3), (2.6, -0.4, 0.2))


def T_lidar_camera_of(mount=MOUNT):
    return mount.T_lidar_rig @ CAMERA.T_rig_camera


def scan_of(ranges_m, *, first_rad=-1.3, step_rad=None, range_max_m=8.0):
    ranges_m = np.array(ranges_m, dtype=np.float64)
    if step_rad is None:
        step_rad = -2.0 * first_rad / (ranges_m.size - 1)
    return LaserScan(
        stamp_ns=0,
        received_ns=None,
        frame_id="lidar",
        angle_min_rad=first_rad,
        angle_increment_rad=-2.0 * first_rad / (ranges_m.size - 1)
        if step_rad is None
        else step_rad,
        range_min_m=0.05,
        range_max_m=range_max_m,
        ranges_m=ranges_m,
    )


def first_hit(origin, directions, boxes):
    """(N,) distance, in lengths of ``directions``, to the first box (slab method)."""
    with np.errstate(divide="ignore"):
        inverse = 1.0 / directions
    nearest = np.full(directions.shape[0], np.inf)
    for low, high in boxes:
        a, b = (np.array(low) - origin) * inverse, (np.array(high) - origin) * inverse
        enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
        hit = (enter <= leave) & (enter > 1e-9)
        nearest = np.where(hit, np.minimum(nearest, enter), nearest)
    return nearest


def depth_of(boxes, T_lidar_camera):
    """(H, W) float32 depth of a scene."""
    v, u = np.mgrid[: LENS.height, : LENS.width].astype(np.float64)
    rays = np.stack([(u - LENS.cx) / LENS.fx, (v - LENS.cy) / LENS.fy, np.ones_like(u)], axis=2)
    directions = rays.reshape(-1, 3) @ T_lidar_camera[:3, :3].T
    depth = first_hit(T_lidar_camera[:3, 3], directions, boxes)
    depth[np.isinf(depth)] = np.nan
    return depth.reshape(u.shape).astype(np.float32)


def beams_of(boxes, count=400, first_rad=-1.3):
    """(count,) exact ranges of a scan."""
    angles = scan_of(np.ones(count), first_rad=first_rad).angles_rad
    flat = np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
    ranges = first_hit(np.zeros(3), flat, boxes)
    return np.where(ranges < 8.0, ranges, np.nan)


def projected(points, T_lidar_camera):
    """(N, 2) pixels and (N,) depths of points in the LiDAR frame, by OpenCV."""
    T_camera_lidar = np.linalg.inv(T_lidar_camera)
    matrix = np.array([[LENS.fx, 0.0, LENS.cx], [0.0, LENS.fy, LENS.cy], [0.0, 0.0, 1.0]])
    rotation, _ = cv2.Rodrigues(T_camera_lidar[:3, :3])
    pixels, _ = cv2.projectPoints(points, rotation, T_camera_lidar[:3, 3], matrix, None)
    homogeneous = np.column_stack([points, np.ones(len(points))])
    return pixels[:, 0], (homogeneous @ T_camera_lidar.T)[:, 2]


def test_along_curve_equals_a_loop_over_the_beams():
    """All beams have a range, some points fall on holes, some below the image or out of view."""
    boxes = (*ROOM, TABLE_TOP, CABINET, ((0.5, 0.1, -0.3), (0.7, 0.25, 0.1)))
    T = T_lidar_camera_of()
    depth = depth_of(boxes, T)
    depth[48:60, 70:80] = np.nan
    scan = scan_of(beams_of(boxes))
    pairs = match_along_curve(scan, depth, depth, CAMERA, T)
    assert pairs.model == "curve"

    expected = []
    for beam, (range_m, azimuth) in enumerate(zip(scan.ranges_m, scan.angles_rad, strict=True)):
        point = np.array([[range_m * np.cos(azimuth), range_m * np.sin(azimuth), 0.0]])
        pixels, ahead = projected(point, T)
        column, row = (int(np.floor(value + 0.5)) for value in pixels[0])
        if ahead[0] < 0.15 or not 0 <= column < LENS.width:
            continue
        seen = seen_range = np.nan
        if not 0 <= row < LENS.height:
            row = column = -1
        else:
            seen = float(depth[row, column])
            optical = seen * np.array([(column - 58.7) / 90.0, (row - 44.2) / 92.0, 1.0])
            there = T[:3, :3] @ optical + T[:3, 3]
            seen_range = np.linalg.norm(there[:2])
        expected.append((beam, row, column, azimuth, range_m, seen, seen_range, ahead[0]))
    columns = np.array(expected).T
    for name, values in zip(
        ("beam", "row", "column", "azimuth_rad", "lidar_range_m", "depth_m", "depth_as_range_m"),
        columns,
        strict=False,
    ):
        np.testing.assert_allclose(getattr(pairs, name), values, rtol=1e-9, err_msg=name)
    np.testing.assert_allclose(pairs.lidar_as_depth_m, columns[7], rtol=1e-9)
    np.testing.assert_allclose(pairs.residual_m, columns[6] - columns[4], atol=1e-9)
    # The scene must have shown every case.
    assert pairs.beam.size < scan.ranges_m.size
    assert (pairs.row == -1).any()
    assert np.isnan(pairs.depth_m[pairs.row >= 0]).any()


def patches(depth, row, column, reach=2):
    """The pixels around each of (B,) pixels."""
    for r, c in zip(row, column, strict=True):
        yield depth[max(0, r - reach) : r + reach + 1, max(0, c - reach) : c + reach + 1]


def smooth(patch, step_m=0.1):
    """Whether pixels belong to one surface."""
    steps = [np.abs(np.diff(patch, axis=axis)).max(initial=0.0) for axis in (0, 1)]
    return bool(np.isfinite(patch).all() and max(steps) < step_m)


@pytest.mark.parametrize("missing", ["none", "every other", "all"])
def test_a_cast_beam_meets_its_own_surface_as_the_camera_sees_it(missing):
    """Where the camera sees the beam's end, it predicts the true range; where a table top hides it,
    nothing; whether the beam has a range of its own or not."""
    boxes = (*ROOM, TABLE_TOP, CABINET)
    T = T_lidar_camera_of()
    depth = depth_of(boxes, T)
    true_m = beams_of(boxes)
    given_m = true_m.copy()
    if missing == "every other":
        given_m[::2] = np.nan
    elif missing == "all":
        given_m[:] = np.nan
    scan = scan_of(given_m)
    pairs = match_along_curve(scan, depth, depth, CAMERA, T)

    ends = true_m[pairs.beam, np.newaxis] * np.stack(
        [np.cos(pairs.azimuth_rad), np.sin(pairs.azimuth_rad), np.zeros(pairs.beam.size)], axis=1
    )
    pixels, ahead = projected(ends, T)
    column, row = np.floor(pixels + 0.5).astype(int).T
    inside = (row >= 0) & (row < LENS.height) & (column >= 0) & (column < LENS.width)
    row, column = np.where(inside, row, 0), np.where(inside, column, 0)
    around = list(patches(depth, row, column))
    hidden = inside & (np.array([patch.max() for patch in around]) < ahead - 0.3)
    visible = inside & np.array([smooth(patch) for patch in around])
    visible &= np.abs(depth[row, column] - ahead) < 0.1
    assert visible.sum() > 60
    error_m = np.abs(pairs.camera_range_m - true_m[pairs.beam])[visible]
    assert error_m.max() < 0.06
    assert np.median(error_m) < 0.01
    assert np.isnan(pairs.camera_range_m[hidden]).all()
    if missing == "all":
        # The pixel of such a beam is known only from the camera's prediction.
        assert (pairs.row >= 0)[visible].all()
        assert np.abs(pairs.row - row)[visible].max() <= 1
        assert np.abs(pairs.column - column)[visible].max() <= 1
        assert np.isnan(pairs.lidar_as_depth_m).all()
    else:
        assert hidden.sum() > 30


def test_a_wall_across_the_axis_is_met_exactly():
    """The seen depth is constant, so that the crossing is linear in the range."""
    mount = Mount(yaw_rad=0.3, delta_z_m=0.4, forward_m=0.1, left_m=0.05)
    T = T_lidar_camera_of(mount)
    depth = np.full((LENS.height, LENS.width), 2.57, dtype=np.float32)
    scan = scan_of(np.full(200, np.nan))
    pairs = match_along_curve(scan, depth, depth, CAMERA, T)
    axis = T[:3, 2]
    flat = np.stack([np.cos(pairs.azimuth_rad), np.sin(pairs.azimuth_rad)], axis=1)
    exact = (float(np.float32(2.57)) + axis @ T[:3, 3]) / (flat @ axis[:2])
    np.testing.assert_allclose(pairs.camera_range_m, exact, atol=1e-9)
    assert pairs.beam.size > 40


def test_a_ray_that_passes_behind_something_may_reappear():
    shelf = ((1.5, -0.5, 0.25), (1.8, 0.5, 0.30))
    T = T_lidar_camera_of(Mount(yaw_rad=0.0, delta_z_m=0.6))
    boxes = (FLOOR, WALL, shelf)
    depth = depth_of(boxes, T)
    scan = scan_of(beams_of(boxes))
    pairs = match_along_curve(scan, depth, depth, CAMERA, T)
    middle = np.abs(pairs.azimuth_rad) < 0.1
    np.testing.assert_allclose(
        pairs.camera_range_m[middle], scan.ranges_m[pairs.beam][middle], atol=0.03
    )
    under = np.array([[2.9 * np.cos(0.0), 0.0, 0.0]])
    pixels, ahead = projected(under, T)
    assert depth[round(pixels[0, 1]), round(pixels[0, 0])] < ahead[0], "the shelf must hide a part"
    assert pairs.camera_blocked[middle].all()
    beside = np.abs(pairs.azimuth_rad) > np.arctan2(0.55, 1.5)
    assert beside.any()
    assert not pairs.camera_blocked[beside].any()


def test_a_hole_in_the_image_predicts_no_range_and_has_no_pixel_value():
    T = T_lidar_camera_of()
    depth = depth_of(ROOM, T)
    whole = match_along_curve(scan_of(beams_of(ROOM)), depth, depth, CAMERA, T)
    holed = depth.copy()
    holed[:, 50:62] = np.nan
    pairs = match_along_curve(scan_of(beams_of(ROOM)), holed, holed, CAMERA, T)
    np.testing.assert_array_equal(pairs.column, whole.column)
    inside = (pairs.column >= 50) & (pairs.column < 62)
    assert inside.sum() > 5
    for name in ("depth_m", "depth_as_range_m", "residual_m", "camera_range_m"):
        values, before = getattr(pairs, name), getattr(whole, name)
        assert np.isnan(values[inside]).all(), name
        away = (pairs.column < 48) | (pairs.column > 63)
        np.testing.assert_array_equal(values[away], before[away], err_msg=name)


def test_a_beam_of_unknown_range_is_kept_without_a_pixel():
    """Neither a range nor a seen surface: it is inside the view where its neighbours are."""
    T = T_lidar_camera_of()
    depth = depth_of(ROOM, T)
    ranges = beams_of(ROOM)
    whole = match_along_curve(scan_of(ranges), depth, depth, CAMERA, T)
    lost = whole.beam[20:23]
    ranges[lost] = np.nan
    holed = depth.copy()
    holed[:, whole.column[16:27].min() : whole.column[16:27].max() + 1] = np.nan
    pairs = match_along_curve(scan_of(ranges), holed, holed, CAMERA, T)
    np.testing.assert_array_equal(pairs.beam, whole.beam)
    np.testing.assert_array_equal(np.flatnonzero(pairs.row == -1), [20, 21, 22])
    np.testing.assert_array_equal(pairs.column[20:23], -1)


def test_without_any_value_no_beam_is_in_view():
    depth = np.full((LENS.height, LENS.width), np.nan, dtype=np.float32)
    pairs = match_along_curve(
        scan_of(np.full(50, np.nan)), depth, depth, CAMERA, T_lidar_camera_of()
    )
    assert all(getattr(pairs, field.name).size == 0 for field in fields(pairs)[1:])


@pytest.mark.parametrize("range_max_m", [1e9, np.inf])
def test_rays_end_behind_the_farthest_depth_whatever_the_lidars_range(range_max_m):
    """Converted point clouds state an unlimited range."""
    T = T_lidar_camera_of()
    depth = depth_of((*ROOM, TABLE_TOP), T)
    ranges = beams_of((*ROOM, TABLE_TOP))
    near = match_along_curve(scan_of(ranges), depth, depth, CAMERA, T)
    far = match_along_curve(scan_of(ranges, range_max_m=range_max_m), depth, depth, CAMERA, T)
    np.testing.assert_array_equal(far.camera_range_m, near.camera_range_m)
    # Beams that look away from the image end too.
    around = scan_of(np.full(90, np.nan), first_rad=-3.1, range_max_m=range_max_m)
    assert match_along_curve(around, depth, depth, CAMERA, T).beam.size > 10


def test_rays_end_at_the_range_of_the_lidar():
    T = T_lidar_camera_of(Mount(yaw_rad=0.0, delta_z_m=0.3))
    depth = np.full((LENS.height, LENS.width), 3.0, dtype=np.float32)
    lost = np.full(100, np.nan)
    inside = match_along_curve(scan_of(lost, range_max_m=3.6), depth, depth, CAMERA, T)
    assert np.nanmax(inside.camera_range_m) <= 3.6
    short = match_along_curve(scan_of(lost, range_max_m=2.9), depth, depth, CAMERA, T)
    assert short.beam.size == 0


def test_the_curve_follows_the_smooth_image_and_reads_the_raw_one():
    T = T_lidar_camera_of()
    smooth = depth_of(ROOM, T)
    raw = smooth.copy()
    raw[::2, ::3] = 0.7
    scan = scan_of(beams_of(ROOM))
    pairs = match_along_curve(scan, raw, smooth, CAMERA, T)
    clean = match_along_curve(scan, smooth, smooth, CAMERA, T)
    np.testing.assert_array_equal(pairs.camera_range_m, clean.camera_range_m)
    inside = pairs.row >= 0
    np.testing.assert_array_equal(
        pairs.depth_m[inside], raw[pairs.row[inside], pairs.column[inside]].astype(np.float64)
    )
    assert (pairs.depth_m == np.float32(0.7)).any()


@given(yaw_rad=st.floats(-1.0, 1.0), seed=st.integers(0, 1000))
@settings(max_examples=30)
def test_a_level_camera_in_the_lidars_axis_pairs_alike_along_the_curve_and_in_its_row(
    yaw_rad, seed
):
    rng = np.random.default_rng(seed)
    intrinsics = CameraIntrinsics(width=160, height=7, fx=120.0, fy=120.0, cx=79.3, cy=3.0)
    camera = Camera(
        topic="/depth",
        intrinsics=intrinsics,
        T_rig_camera=make_transform(R_BODY_OPTICAL, np.zeros(3)),
    )
    T = Mount(yaw_rad=yaw_rad).T_lidar_rig @ camera.T_rig_camera
    column = np.arange(160.0)
    wave = 2.5 + 0.4 * np.sin(column / 25.0 + rng.uniform(0.0, 6.0))
    depth = np.tile(wave, (7, 1)).astype(np.float32)
    depth[:, 90:95] = np.nan
    ranges = rng.uniform(1.0, 4.0, 400)
    scan = scan_of(ranges, first_rad=-2.0)
    curve = match_along_curve(scan, depth, depth, camera, T)
    row = match_in_row(scan, depth, depth, camera, T, 3)
    assert row.model == "row"
    for name in ("beam", "row", "column", "azimuth_rad", "lidar_range_m", "depth_m"):
        np.testing.assert_array_equal(getattr(curve, name), getattr(row, name), err_msg=name)
    np.testing.assert_allclose(curve.lidar_as_depth_m, row.lidar_as_depth_m, rtol=1e-12)
    # One takes the azimuth of the pixel's centre, the other that of the beam: half a pixel.
    half_pixel = 0.5 / 120.0 * 3.0
    for name in ("depth_as_range_m", "residual_m"):
        np.testing.assert_allclose(
            getattr(curve, name), getattr(row, name), atol=half_pixel, err_msg=name
        )
    both = np.isfinite(curve.camera_range_m) & np.isfinite(row.camera_range_m)
    assert both.sum() > 0.9 * np.isfinite(row.camera_range_m).sum()
    assert np.abs(curve.camera_range_m - row.camera_range_m)[both].max() < 0.03


def test_in_row_by_hand():
    """Three beams at the azimuths of three pixel centres of a camera that looks 0.1 to the left."""
    intrinsics = CameraIntrinsics(width=3, height=2, fx=10.0, fy=10.0, cx=1.0, cy=0.5)
    camera = Camera(
        topic="/depth",
        intrinsics=intrinsics,
        T_rig_camera=make_transform(R_BODY_OPTICAL, np.zeros(3)),
    )
    T = Mount(yaw_rad=0.1, delta_z_m=0.4, forward_m=0.2).T_lidar_rig @ camera.T_rig_camera
    step = float(np.arctan(0.1))
    scan = scan_of([9.0, 2.0, np.nan, 4.0, 9.0], first_rad=0.1 - 2 * step, step_rad=step)
    depth = np.array([[1.0, 2.0, 3.0], [5.0, np.nan, 7.0]], dtype=np.float32)
    pairs = match_in_row(scan, depth, 10.0 * depth, camera, T, 1)
    longer = np.hypot(1.0, 0.1)
    # Azimuths run counter-clockwise and columns to the right.
    np.testing.assert_array_equal(pairs.beam, [1, 2, 3])
    np.testing.assert_array_equal(pairs.column, [2, 1, 0])
    np.testing.assert_array_equal(pairs.row, [1, 1, 1])
    np.testing.assert_array_equal(pairs.depth_m, [7.0, np.nan, 5.0])
    np.testing.assert_allclose(pairs.depth_as_range_m, [7.0 * longer, np.nan, 5.0 * longer])
    np.testing.assert_allclose(pairs.camera_range_m, [70.0 * longer, np.nan, 50.0 * longer])
    np.testing.assert_allclose(pairs.lidar_as_depth_m, [2.0 / longer, np.nan, 4.0 / longer])
    np.testing.assert_allclose(
        pairs.residual_m, [7.0 * longer - 2.0, np.nan, 5.0 * longer - 4.0], rtol=1e-12
    )


def test_in_row_has_no_beam_from_behind():
    intrinsics = CameraIntrinsics(width=40, height=1, fx=20.0, fy=20.0, cx=19.5, cy=0.0)
    camera = Camera(
        topic="/depth",
        intrinsics=intrinsics,
        T_rig_camera=make_transform(R_BODY_OPTICAL, np.zeros(3)),
    )
    T = Mount(yaw_rad=3.0).T_lidar_rig @ camera.T_rig_camera
    scan = scan_of(np.ones(720), first_rad=-np.pi)
    pairs = match_in_row(
        scan, np.ones((1, 40), np.float32), np.ones((1, 40), np.float32), camera, T, 0
    )
    turned = np.angle(np.exp(1j * (pairs.azimuth_rad - 3.0)))
    assert np.abs(turned).max() <= np.arctan(1.0) + 1e-9
    assert pairs.beam.size == pytest.approx(720 / 4, abs=2)


# The paper's pairs.

AFFINE = np.array([[1.02, 0.03, 0.0], [-0.04, 0.97, 0.0], [0.11, -0.07, 1.0]])


def paper_frame(seed=3, u=4.2):
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(1.0, 5.0, 60)
    ranges[rng.random(60) < 0.2] = np.nan
    scan = scan_of(ranges)
    depth = rng.uniform(1.0, 5.0, (6, 44)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = np.nan
    curve_beams = np.arange(58, 0, -3)
    row_columns = np.arange(2, 44, 4)
    return scan, depth, curve_beams, row_columns, u


@pytest.mark.parametrize("u", [0.0, 4.2, -3.0, 12.0])
def test_the_papers_pairs_and_points_equal_a_loop(u):
    scan, depth, curve_beams, row_columns, _ = paper_frame()
    pairs, L, D = match_by_sample(scan, depth, curve_beams, row_columns, u, 2.6)
    ranges = scan.ranges_m
    per_sample_rad = scan.angle_increment_rad * 60 / curve_beams.size
    samples = []
    for w, column in enumerate(row_columns):
        if 0 <= round(u) + w < curve_beams.size:
            samples.append((curve_beams[round(u) + w], column))
    values = [ranges[beam] for beam, _ in samples if ranges[beam] == ranges[beam]]
    spacing_m = np.median(values) * per_sample_rad
    assert len(samples) == pairs.beam.size > 0
    for i, (beam, column) in enumerate(samples):
        lidar, seen = ranges[beam], float(depth[3, column])
        assert (pairs.beam[i], pairs.row[i], pairs.column[i]) == (beam, 3, column)
        assert pairs.azimuth_rad[i] == scan.angles_rad[beam]
        np.testing.assert_equal((pairs.lidar_range_m[i], pairs.depth_m[i]), (lidar, seen))
        np.testing.assert_allclose(L[i], (i * spacing_m, 0.0 if np.isnan(lidar) else lidar))
        np.testing.assert_allclose(D[i], (i * spacing_m, 0.0 if np.isnan(seen) else seen))
    assert np.isnan(pairs.residual_m).all()


def test_the_papers_pairs_mapped_through_a_equal_a_loop():
    scan, depth, curve_beams, row_columns, u = paper_frame()
    pairs, L, D = match_by_sample(scan, depth, curve_beams, row_columns, u, 3.0)
    inverse = np.linalg.inv(AFFINE)
    # (6), over all pairs: a hole counts as a zero there.
    residual_m = np.array(
        [np.hypot(*((np.append(a, 1.0) @ AFFINE)[:2] - b)) for a, b in zip(L, D, strict=True)]
    )
    result = compare_samples(pairs, L, D, AFFINE, inverse, residual_m)
    for i in range(pairs.beam.size):
        has_lidar, has_depth = np.isfinite((pairs.lidar_range_m[i], pairs.depth_m[i]))
        back = D[i, 0] * inverse[0, 1] + D[i, 1] * inverse[1, 1] + inverse[2, 1]
        there = L[i, 0] * AFFINE[0, 1] + L[i, 1] * AFFINE[1, 1] + AFFINE[2, 1]
        np.testing.assert_allclose(result.depth_as_range_m[i], back if has_depth else np.nan)
        np.testing.assert_allclose(result.camera_range_m[i], back if has_depth else np.nan)
        np.testing.assert_allclose(result.lidar_as_depth_m[i], there if has_lidar else np.nan)
        np.testing.assert_allclose(
            result.residual_m[i], residual_m[i] if has_lidar and has_depth else np.nan
        )
    np.testing.assert_array_equal(result.lidar_range_m, pairs.lidar_range_m)
    np.testing.assert_array_equal(result.depth_m, pairs.depth_m)


def test_without_a_single_range_the_papers_points_keep_an_axis():
    scan, depth, curve_beams, row_columns, u = paper_frame()
    lost = scan.with_ranges(np.full(60, np.nan), None)
    _, L, _ = match_by_sample(lost, depth, curve_beams, row_columns, u, 3.0)
    assert (np.diff(L[:, 0]) > 0.0).all()
    assert (L[:, 1] == 0.0).all()


def row_pairs(seed=0, count=41):
    """Pairs in the row with random values, some missing."""
    rng = np.random.default_rng(seed)
    intrinsics = CameraIntrinsics(width=60, height=3, fx=50.0, fy=50.0, cx=29.5, cy=1.0)
    camera = Camera(
        topic="/depth",
        intrinsics=intrinsics,
        T_rig_camera=make_transform(R_BODY_OPTICAL, np.zeros(3)),
    )
    depth = rng.uniform(1.0, 4.0, (3, 60)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = np.nan
    ranges = rng.uniform(1.0, 4.0, count)
    ranges[rng.random(count) < 0.1] = np.nan
    scan = scan_of(ranges, first_rad=-0.4)
    T = Mount(yaw_rad=0.05).T_lidar_rig @ camera.T_rig_camera
    return match_in_row(scan, depth, depth, camera, T, 1)


def test_planar_points_lie_ahead_and_to_the_right_as_their_beams_do():
    pairs = row_pairs()
    points = planar_points(pairs, np.ones(pairs.beam.size))
    middle = np.median(pairs.azimuth_rad)
    for (x, z), azimuth in zip(points, pairs.azimuth_rad, strict=True):
        assert np.hypot(x, z) == pytest.approx(1.0)
        # Counter-clockwise azimuths: a greater one lies to the left.
        assert np.arctan2(x, z) == pytest.approx(middle - azimuth)


RIGID = st.builds(
    lambda turn, x, z: np.array(
        [[np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), np.cos(turn), 0.0], [x, z, 1.0]]
    ),
    st.floats(-0.3, 0.3),
    st.floats(-0.4, 0.4),
    st.floats(-0.4, 0.4),
)


@given(A=RIGID, seed=st.integers(0, 100))
@settings(max_examples=50)
def test_mapped_equals_a_loop_over_eqs_7_and_8(A, seed):
    pairs = row_pairs(seed)
    inverse = np.linalg.inv(A)
    result = map_through_A(pairs, A, inverse)
    middle = np.median(pairs.azimuth_rad)

    def length(range_m, azimuth, matrix):
        right, ahead = range_m * np.sin(middle - azimuth), range_m * np.cos(middle - azimuth)
        x, z, w = np.array([right, ahead, 1.0]) @ matrix
        return np.hypot(x / w, z / w)

    for i, azimuth in enumerate(pairs.azimuth_rad):
        lidar, seen = pairs.lidar_range_m[i], pairs.depth_as_range_m[i]
        back = length(seen, azimuth, inverse)
        np.testing.assert_allclose(result.depth_as_range_m[i], back)
        np.testing.assert_allclose(
            result.camera_range_m[i], length(pairs.camera_range_m[i], azimuth, inverse)
        )
        np.testing.assert_allclose(result.residual_m[i], back - lidar, atol=1e-12)
        scale = length(lidar, azimuth, A) / lidar
        np.testing.assert_allclose(result.lidar_as_depth_m[i], pairs.lidar_as_depth_m[i] * scale)
    np.testing.assert_array_equal(result.lidar_range_m, pairs.lidar_range_m)
    np.testing.assert_array_equal(result.depth_m, pairs.depth_m)


@given(A=RIGID, seed=st.integers(0, 100))
@settings(max_examples=50)
def test_a_rigid_map_is_undone_by_its_inverse(A, seed):
    """What the LiDAR's points are to the camera, seen from there and mapped back, is the range."""
    pairs = row_pairs(seed)
    there = np.column_stack([planar_points(pairs, pairs.lidar_range_m), np.ones(pairs.beam.size)])
    moved = (there @ A)[:, :2]
    # The same points as ranges on beams of the camera's own; its middle beam is ahead.
    bearing = -np.arctan2(moved[:, 0], moved[:, 1])
    known = np.isfinite(bearing)
    middle = np.median(bearing[known])
    fields_of = {field.name: getattr(pairs, field.name)[known] for field in fields(pairs)[1:]}
    fields_of |= {
        "azimuth_rad": bearing[known],
        "depth_as_range_m": np.linalg.norm(moved[known], axis=1),
    }
    turn = np.array(
        [
            [np.cos(middle), np.sin(middle), 0.0],
            [-np.sin(middle), np.cos(middle), 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    seen = Correspondence(model="row", **fields_of)
    # ``turn`` transforms points from the middle beam's axes to the camera's, or back.
    for to_axes in (turn, turn.T):
        ahead = np.array([0.0, 1.0, 1.0]) @ to_axes
        if np.allclose(-np.arctan2(ahead[0], ahead[1]), middle):
            break
    result = map_through_A(seen, A @ to_axes.T, to_axes @ np.linalg.inv(A))
    np.testing.assert_allclose(result.residual_m, 0.0, atol=1e-9)


def test_the_identity_changes_nothing():
    pairs = row_pairs()
    result = map_through_A(pairs, np.eye(3), np.eye(3))
    for field in fields(pairs)[1:]:
        np.testing.assert_allclose(getattr(result, field.name), getattr(pairs, field.name))


def test_a_point_beyond_the_horizon_of_a_homography_has_no_image():
    pairs = row_pairs()
    horizon = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
    result = map_through_A(pairs, horizon, horizon)
    for raw, image in (
        (pairs.depth_as_range_m, result.depth_as_range_m),
        (pairs.lidar_range_m, result.lidar_as_depth_m),
    ):
        beyond = planar_points(pairs, raw)[:, 1] >= 2.0
        assert 5 < beyond.sum() < raw.size - 5
        assert np.isnan(image[beyond]).all()
        assert np.isfinite(image[np.isfinite(raw) & ~beyond]).all()


def test_pairs_cannot_be_changed():
    scan, depth, curve_beams, row_columns, u = paper_frame()
    pairs, _, _ = match_by_sample(scan, depth, curve_beams, row_columns, u, 3.0)
    for frozen in (pairs, row_pairs()):
        for field in fields(frozen)[1:]:
            with pytest.raises(ValueError, match="read-only"):
                getattr(frozen, field.name)[0] = 0
