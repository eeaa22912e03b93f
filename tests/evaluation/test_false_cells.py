"""False cells of maps of a square room, counted by hand and against a loop over rays."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.evaluation.false_cells import TrueViews, evaluate_false_cells, true_views
from fusion_core.evaluation.fuse_folder import open_fuse_folder
from fusion_core.evaluation.map_measures import MapCells
from fusion_core.evaluation.truth import load_truth
from fusion_core.model.errors import ScanLoomError

SIDE_M = 4.0
AZIMUTH = np.deg2rad(np.arange(-180.0, 180.0))


def range_to_walls_m(x, y, azimuth):
    """Of a square room about the origin."""
    c, s = np.cos(azimuth), np.sin(azimuth)
    with np.errstate(divide="ignore"):
        to_x = (np.copysign(SIDE_M / 2, c) - x) / c
        to_y = (np.copysign(SIDE_M / 2, s) - y) / s
    return np.minimum(to_x, to_y)


def views_from(*poses):
    return TrueViews(
        pose=np.array(poses),
        azimuth_rad=AZIMUTH,
        range_m=np.array([range_to_walls_m(x, y, AZIMUTH + yaw) for x, y, yaw in poses]),
    )


def cells(free=(), occupied=()):
    return MapCells(
        free_m=np.array(free, dtype=np.float64).reshape(-1, 2),
        occupied_m=np.array(occupied, dtype=np.float64).reshape(-1, 2),
        resolution_m=0.05,
    )


def test_cells_before_and_behind_a_wall():
    found = evaluate_false_cells(
        cells(
            free=[(0.0, 1.0), (1.95, 0.0), (2.05, 0.0), (3.0, 3.0)],
            occupied=[(2.0, 0.0), (2.06, 0.0), (1.92, 0.0), (-2.2, 0.0)],
        ),
        views_from((0.0, 0.0, 0.3)),
    )
    assert found.to_json() == {
        "free": 4,
        "false_free": 2,
        "false_free_fraction": 0.5,
        "occupied": 4,
        # 5 cm and 2 cm are tolerated.
        "false_occupied": 2,
        "false_occupied_fraction": 0.5,
    }


def test_a_map_without_a_cell_has_no_fractions():
    found = evaluate_false_cells(cells(), views_from((0.0, 0.0, 0.0))).to_json()
    assert (found["false_free_fraction"], found["false_occupied_fraction"]) == (None, None)


def test_a_cell_that_one_pose_cannot_see_may_be_free_for_another():
    views = views_from((0.0, 0.0, 0.0), (0.5, -0.5, 2.0))
    hidden = views.range_m.copy()
    hidden[0, (AZIMUTH > 0.0) & (AZIMUTH < 0.5)] = 0.5
    blocked = TrueViews(pose=views.pose, azimuth_rad=AZIMUTH, range_m=hidden)
    alone = TrueViews(pose=views.pose[:1], azimuth_rad=AZIMUTH, range_m=hidden[:1])
    point = np.array([[1.0, 0.25]])
    assert not alone.reaches(point)[0]
    assert blocked.reaches(point)[0]


@given(seed=st.integers(0, 10_000), clockwise=st.booleans())
@settings(max_examples=30)
def test_reaching_equals_a_loop_over_scans_and_points(seed, clockwise):
    rng = np.random.default_rng(seed)
    azimuth = np.deg2rad(np.arange(-100.0, 101.0)) * (-1.0 if clockwise else 1.0)
    pose = rng.uniform(-1.0, 1.0, (3, 3)) * [1.0, 1.0, 4.0]
    range_m = np.where(rng.random((3, 201)) < 0.2, np.nan, rng.uniform(0.2, 3.0, (3, 201)))
    views = TrueViews(pose=pose, azimuth_rad=azimuth, range_m=range_m)
    points = rng.uniform(-3.0, 3.0, (60, 2))
    reached = views.reaches(points)
    for point, found in zip(points, reached, strict=True):
        expected = False
        for (x, y, yaw), ranges in zip(pose, range_m, strict=True):
            towards = np.arctan2(point[1] - y, point[0] - x) - yaw
            off_rad = np.abs(np.angle(np.exp(1j * (azimuth - towards))))
            beam = int(np.argmin(off_rad))
            if off_rad[beam] <= np.deg2rad(0.5):
                expected |= bool(ranges[beam] > np.hypot(point[0] - x, point[1] - y))
        assert found == expected


def test_the_views_of_a_truth_file(by_hand):
    beams = AZIMUTH.size
    folder = by_hand.results(
        [],
        lidar=by_hand.lidar(beams=beams),
        cameras=[by_hand.camera(width=4, height=4, focal=4.0)],
    )
    arrays = {
        "scan_true": range_to_walls_m(0.0, 0.0, AZIMUTH)[np.newaxis],
        "scan_kind": np.zeros((1, beams), np.uint8),
        "depth_true": np.full((1, 4, 4), 2000),
        "depth_kind": np.zeros((1, 4, 4), np.uint8),
    }
    truth = load_truth(by_hand.truth(**arrays, pose=np.zeros((1, 3))))
    surface_m = true_views(truth, open_fuse_folder(folder)).surface_m()
    # The recorded angles begin at -179.5 degrees.
    angle = np.arctan2(surface_m[:, 1], surface_m[:, 0])
    np.testing.assert_allclose(angle[0], np.deg2rad(-179.5))
    np.testing.assert_allclose(np.hypot(*surface_m.T), arrays["scan_true"][0], rtol=1e-6)
    with pytest.raises(ScanLoomError, match="no array 'pose'"):
        true_views(load_truth(by_hand.truth(**arrays)), open_fuse_folder(folder))
    with pytest.raises(ScanLoomError, match="pose"):
        load_truth(by_hand.truth(**arrays, pose=np.zeros((2, 3))))
