"""The dense cloud: (6) against a loop over pixels, colours against lists, outliers, depth edges."""

import math
from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.mapping import voxel_cloud
from fusion_core.mapping.dense_cloud import (
    DenseCloudBuilder,
    DenseCloudSettings,
    back_project,
    points_in_map,
)
from fusion_core.mapping.depth_filter import (
    DepthFilterSettings,
    depth_off_edges,
    depth_within_range,
)
from fusion_core.model.errors import MappingFailed
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.workflows.map.keyframe_images import KeyframeImages

NAN = float("nan")
ALL = DenseCloudSettings(voxel_m=0.125, outlier_neighbours_min=0)
INTRINSICS = CameraIntrinsics(width=9, height=7, fx=8.0, fy=6.0, cx=4.2, cy=2.9)


def depth_image(seed, height=7, width=9):
    random = np.random.default_rng(seed)
    depth_m = random.uniform(0.5, 4.0, (height, width)).astype(np.float32)
    depth_m[random.random((height, width)) < 0.2] = NAN
    return depth_m


def test_six_for_each_pixel():
    depth_m = depth_image(0)
    rays = KeyframeImages(INTRINSICS).geometry(depth_m).rays
    points_m, has_depth = back_project(depth_m, rays)
    expected = []
    for v in range(7):
        for u in range(9):
            z = float(depth_m[v, u])
            if not math.isnan(z):
                expected.append([z * (u - 4.2) / 8.0, z * (v - 2.9) / 6.0, z])
    assert np.allclose(points_m, expected, atol=1e-9)
    assert np.array_equal(has_depth, ~np.isnan(depth_m))
    with pytest.raises(ValueError, match="rays"):
        back_project(depth_m, rays[:-1])


def test_five_leads_back_to_the_pixel():
    """z (u, v, 1) = K (R | t) (X, 1), with R, t the inverse of the camera's pose."""
    depth_m = depth_image(1)
    T_map_camera = make_transform(
        rotation_from_yaw_pitch_roll(0.4, -1.0, 2.0), np.array([1, -2, 3.0])
    )
    rays = KeyframeImages(INTRINSICS).geometry(depth_m).rays
    points_m, has_depth = points_in_map(depth_m, rays, T_map_camera)
    R_t = np.linalg.inv(T_map_camera)[:3]
    homogeneous = np.column_stack([points_m, np.ones(len(points_m))])
    imaged = homogeneous @ R_t.T @ INTRINSICS.matrix.T
    v, u = np.nonzero(has_depth)
    assert np.allclose(imaged[:, 2], depth_m[has_depth])
    assert np.allclose(imaged[:, :2] / imaged[:, 2:], np.column_stack([u, v]), atol=1e-6)


@given(seed=st.integers(0, 99))
def test_the_mean_colour_of_each_voxel_whatever_the_order(seed):
    random = np.random.default_rng(seed)
    points_m = random.normal(size=(60, 3))
    rgb = random.integers(0, 256, (60, 3)).astype(np.uint8)
    voxels = defaultdict(list)
    for point, color in zip(points_m, rgb, strict=True):
        voxels[tuple(np.floor(point / 0.125)[::-1])].append((point, color))
    for order in (np.arange(60), random.permutation(60)):
        builder = DenseCloudBuilder(ALL)
        builder.add(points_m[order[:20]], rgb[order[:20]])
        builder.add(points_m[order[20:]], rgb[order[20:]])
        cloud = builder.build()
        assert len(cloud.rgb) == len(voxels)
        for i, place in enumerate(sorted(voxels)):
            points, colors = zip(*voxels[place], strict=True)
            assert np.allclose(cloud.points_in_map_m[i], np.mean(points, axis=0))
            assert np.abs(cloud.rgb[i] - np.mean(colors, axis=0)).max() <= 0.5 + 1e-9


@given(
    seed=st.integers(0, 99),
    turns=st.integers(0, 3),
    shift=st.tuples(*[st.integers(-50, 50)] * 3),
)
def test_a_motion_that_keeps_the_raster_moves_the_cloud(seed, turns, shift):
    random = np.random.default_rng(seed)
    # Multiples of a power of two inside their voxels: the motion is exact and meets no border.
    points_m = (np.floor(random.normal(size=(50, 3)) * 64) + 0.5) / 64
    rgb = random.integers(0, 256, (50, 3)).astype(np.uint8)
    R = np.linalg.matrix_power(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), turns)
    moved_m = points_m @ R.T + np.array(shift) * 0.125
    clouds = []
    for given_m in (points_m, moved_m):
        builder = DenseCloudBuilder(ALL)
        builder.add(given_m, rgb)
        clouds.append(builder.build())
    expected_m = clouds[0].points_in_map_m @ R.T + np.array(shift) * 0.125
    rows = np.column_stack([expected_m, clouds[0].rgb])
    found = np.column_stack([clouds[1].points_in_map_m, clouds[1].rgb])
    assert np.allclose(np.array(sorted(rows.tolist())), np.array(sorted(found.tolist())))


def test_points_without_neighbours_are_left_out():
    grid = np.stack(np.meshgrid(*[np.arange(4) * 0.01 + 0.005] * 2, [0.005]), axis=-1).reshape(
        -1, 3
    )
    points_m = np.vstack([grid, [[0.5, 0.5, 0.5]]])
    rgb = np.zeros((len(points_m), 3), dtype=np.uint8)
    builder = DenseCloudBuilder(DenseCloudSettings())
    builder.add(points_m, rgb)
    assert builder.build().points_in_map_m[:, 2].max() < 0.01
    lonely = DenseCloudBuilder(DenseCloudSettings())
    lonely.add(points_m[-1:], rgb[-1:])
    with pytest.raises(MappingFailed, match="enough neighbours"):
        lonely.build()


def test_no_points_at_all():
    builder = DenseCloudBuilder(ALL)
    with pytest.raises(MappingFailed, match="no points"):
        builder.build()
    builder.add(np.empty((0, 3)), np.empty((0, 3), dtype=np.uint8))
    with pytest.raises(MappingFailed, match="no points") as raised:
        builder.build()
    assert "\n" not in str(raised.value)


def test_a_large_cloud_becomes_coarser_instead_of_failing(monkeypatch):
    # Points come before and after the voxels are doubled.
    monkeypatch.setattr(voxel_cloud, "_BUFFERED_MIN", 2500)
    random = np.random.default_rng(3)
    points_m = random.uniform(-4.0, 4.0, (30_000, 3))
    rgb = random.integers(0, 256, points_m.shape).astype(np.uint8)
    coarse = DenseCloudBuilder(ALL.model_copy(update={"voxels_max": 1000}))
    for start in range(0, 30_000, 1000):
        coarse.add(points_m[start : start + 1000], rgb[start : start + 1000])
    found = coarse.build()
    assert coarse.voxel_m == 1.0
    plain = DenseCloudBuilder(ALL.model_copy(update={"voxel_m": 1.0}))
    plain.add(points_m, rgb)
    expected = plain.build()
    assert np.allclose(found.points_in_map_m, expected.points_in_map_m)
    assert np.abs(found.rgb.astype(int) - expected.rgb).max() <= 1


def brute_force_filter(depth_m, settings):
    height, width = depth_m.shape
    kept = np.full(depth_m.shape, np.nan, dtype=np.float32)

    def usable(v, u):
        inside = 0 <= v < height and 0 <= u < width
        return inside and settings.depth_min_m <= depth_m[v, u] < np.inf

    for v in range(height):
        for u in range(width):
            alike = 0
            for dv in (-1, 0, 1):
                for du in (-1, 0, 1):
                    if (dv or du) and usable(v, u) and usable(v + dv, u + du):
                        here, there = depth_m[v, u], depth_m[v + dv, u + du]
                        step = np.float32(settings.edge_step) * min(here, there)
                        alike += abs(here - there) <= step
            if usable(v, u) and alike >= settings.edge_neighbours_min:
                kept[v, u] = depth_m[v, u]
    return kept


@given(seed=st.integers(0, 99), neighbours=st.integers(0, 8))
def test_depth_edges_against_a_loop(seed, neighbours):
    random = np.random.default_rng(seed)
    depth_m = random.choice([0.1, 1.0, 1.02, 1.04, 3.0, np.inf, NAN], (6, 8)).astype(np.float32)
    settings = DepthFilterSettings(edge_neighbours_min=neighbours)
    before = depth_m.copy()
    assert np.array_equal(
        depth_off_edges(depth_m, settings), brute_force_filter(depth_m, settings), equal_nan=True
    )
    assert np.array_equal(depth_m, before, equal_nan=True)


def test_mixed_pixels_go_and_surfaces_stay():
    """A box before a wall with a column of pixels between both, beside a slanted floor."""
    depth_m = np.full((40, 60), 3.0, dtype=np.float32)
    depth_m[10:30, 20:40] = 1.5
    depth_m[10:30, 19] = 2.2
    kept = np.isfinite(depth_off_edges(depth_m, DepthFilterSettings()))
    assert not kept[11:29, 19].any()
    # All of the box but its four corners, and of the wall what does not touch the image's corners.
    assert kept[10:30, 20:40].sum() >= 400 - 4
    assert kept[:, 41:-1].all()
    # 585 px, 1 m above a floor, up to 4 m: the depth of one row to the next grows with its square.
    rows = np.arange(150, 400)
    floor_m = np.repeat((585.0 / rows)[:, np.newaxis], 30, axis=1).astype(np.float32)
    kept = np.isfinite(depth_off_edges(floor_m, DepthFilterSettings()))
    assert kept[1:-1, 1:-1].all()


def test_the_range_is_cut_after_the_edges():
    depth_m = np.array([[3.99, 4.0, 4.01, NAN]], dtype=np.float32)
    settings = DepthFilterSettings(edge_neighbours_min=0)
    cut_m = depth_within_range(depth_off_edges(depth_m, settings), settings)
    assert np.isfinite(cut_m).tolist() == [[True, True, False, False]]


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (1, 5), (5, 1)])
def test_tiny_images(shape):
    depth_m = np.ones(shape, dtype=np.float32)
    assert depth_off_edges(depth_m, DepthFilterSettings()).shape == shape
