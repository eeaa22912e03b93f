"""Clouds of one point a voxel, against a dictionary of lists."""

from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.mapping import voxel_cloud
from fusion_core.mapping.voxel_cloud import VoxelCloud
from fusion_core.model.errors import MappingFailed


@given(
    sizes=st.lists(st.integers(0, 40), max_size=8),
    voxel_m=st.sampled_from([0.02, 0.3, 5.0]),
    waiting=st.sampled_from([1, 25, 10_000]),
    seed=st.integers(0, 99),
)
def test_the_mean_of_the_points_in_each_voxel(sizes, voxel_m, waiting, seed):
    random = np.random.default_rng(seed)
    parts = [random.normal(size=(size, 3)) for size in sizes]
    cloud = VoxelCloud(voxel_m)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(voxel_cloud, "_BUFFERED_MIN", waiting)
        for part in parts:
            cloud.add(part)
        found = cloud.points_m()
    voxels = defaultdict(list)
    for point in (point for part in parts for point in part):
        voxels[tuple(np.floor(point / voxel_m)[::-1])].append(point)
    expected = [np.mean(voxels[place], axis=0) for place in sorted(voxels)]
    assert found.shape == (len(voxels), 3)
    assert np.allclose(found, np.array(expected).reshape(-1, 3), atol=1e-12)
    assert np.array_equal(found, cloud.points_m())


def test_memory_is_bounded_and_added_points_are_copied():
    cloud = VoxelCloud(1.0, voxels_max=3)
    points_m = np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5], [2.5, 0.5, 0.5]])
    cloud.add(points_m)
    points_m += 10.0
    assert cloud.points_m()[:, 0].tolist() == [0.5, 1.5, 2.5]
    cloud.add(np.array([[-0.5, 0.0, 0.0]]))
    with pytest.raises(MappingFailed, match="3 voxels of 1 m"):
        cloud.points_m()


@pytest.mark.parametrize("far_m", [1.1e6, -1.1e6, 1e300])
def test_a_point_too_far_away_is_named(far_m):
    cloud = VoxelCloud(1.0)
    cloud.add(np.array([[0.0, far_m, 0.0]]))
    with pytest.raises(MappingFailed, match="from the map's origin"):
        cloud.points_m()


@pytest.mark.parametrize("points_m", [np.zeros(3), np.zeros((2, 2)), np.full((1, 3), np.nan)])
def test_what_is_no_cloud_is_refused(points_m):
    with pytest.raises(ValueError, match="finite"):
        VoxelCloud(1.0).add(points_m)
    with pytest.raises(ValueError, match="positive"):
        VoxelCloud(0.0)
