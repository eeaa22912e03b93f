"""Planes of clouds whose planes are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.calibration.turning.plane_members import assign_planes
from fusion_core.calibration.turning.planes import Plane, PlaneSettings, extract_planes, fit_plane
from tests.calibration.box_turns import ROOM, SOMEWHERE, make_turn


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_the_planes_of_a_room_are_found(seed):
    cloud = make_turn(sigma_m=0.02, seed=seed, scans=30).in_rig(SOMEWHERE)
    planes = extract_planes(cloud, PlaneSettings(points_min=200), np.random.default_rng(seed))
    assert len(planes) == len(ROOM)
    for normal, offset in ROOM:
        errors = [np.linalg.norm(plane.normal - normal) for plane in planes]
        nearest = planes[int(np.argmin(errors))]
        assert min(errors) < 0.01
        assert abs(nearest.offset_m - offset) < 0.01
    members = np.concatenate([plane.members for plane in planes])
    assert np.unique(members).size == members.size


def test_a_plane_is_fitted_as_by_singular_values():
    points = np.random.default_rng(2).standard_normal((50, 3)) * [2.0, 1.0, 0.1] + [0, 0, 4.0]
    normal, offset = fit_plane(points)
    expected = np.linalg.svd(points - points.mean(axis=0))[2][2]
    np.testing.assert_allclose(abs(normal @ expected), 1.0, atol=1e-12)
    assert offset == pytest.approx(normal @ points.mean(axis=0))
    assert offset > 0.0


def test_noise_without_planes_has_none():
    cloud = np.random.default_rng(0).uniform(-3.0, 3.0, (3000, 3))
    assert extract_planes(cloud, PlaneSettings(), np.random.default_rng(0)) == ()


def test_what_stands_on_the_floor_is_no_floor():
    """The foot of a wall lies within the tolerance of the floor, on one side of it."""
    rng = np.random.default_rng(4)
    floor = np.column_stack([rng.uniform(0, 2, (4000, 2)), 0.003 * rng.standard_normal(4000)])
    box = np.column_stack([rng.uniform(1, 1.3, (1500, 2)), rng.uniform(0.0, 0.5, 1500)])
    plane = Plane(np.array([0.0, 0.0, 1.0]), 0.0, np.zeros(0, dtype=np.int64))
    plane_of = assign_planes(np.concatenate([floor, box]), (plane,), 0.02)
    of_floor, of_box = plane_of[:4000], plane_of[4000:]
    assert (of_box == -1).all()
    beside = ((floor[:, :2] < 0.85) | (floor[:, :2] > 1.5)).any(axis=1)
    assert np.mean(of_floor[beside] == 0) > 0.95
