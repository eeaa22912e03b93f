"""Associating truth and results: stamps in any order, and truths of other recordings."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.evaluation.associated_truth import (
    AssociatedTruth,
    associate_truth,
    indices_of_stamps,
)
from fusion_core.evaluation.fuse_folder import open_fuse_folder
from fusion_core.evaluation.truth import load_truth
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.geometry import transform_points


@given(st.lists(st.integers(-(2**62), 2**62), unique=True, max_size=30), st.randoms())
def test_positions_find_every_stamp_in_any_order(known: list[int], random: Any) -> None:
    query = random.choices(known, k=10) if known else []
    positions = indices_of_stamps(np.array(known, np.int64), np.array(query, np.int64), "scan", "t")
    assert [known[position] for position in positions] == query


@pytest.mark.parametrize("known", [[], [1, 3], [3, 1, 7]])
@pytest.mark.parametrize("query", [0, 2, 9])
def test_a_stamp_without_a_match_is_an_error(known: list[int], query: int) -> None:
    with pytest.raises(ScanLoomError, match=f"no scan with stamp {query} ns"):
        indices_of_stamps(np.array(known, np.int64), np.array([query]), "scan", "truth.npz")


def _join(by_hand: Any, camera: dict[str, Any] | None = None, **arrays: Any) -> AssociatedTruth:
    own = {
        "scan_true": np.ones((1, 4)),
        "scan_kind": np.zeros((1, 4), np.uint8),
        "depth_true": np.full((1, 3, 5), 1000),
        "depth_kind": np.zeros((1, 3, 5), np.uint8),
    }
    path = by_hand.results(
        [],
        lidar=by_hand.lidar(beams=4),
        cameras=[by_hand.camera(width=5, height=3, focal=2.0) | (camera or {})],
    )
    return associate_truth(load_truth(by_hand.truth(**(own | arrays))), open_fuse_folder(path))


@pytest.mark.parametrize(
    ("camera", "arrays", "message"),
    [
        ({}, {"T_lidar_camera": None}, "no mount of the camera /camera/depth/image_raw"),
        ({"fx": None}, {}, "intrinsics"),
        ({"width": 6}, {}, "5 x 3"),
        ({}, {"camera_topics": np.array(["/other"])}, "has no camera"),
        ({}, {"scan_true": np.ones((1, 5)), "scan_kind": np.zeros((1, 5))}, "5 beams"),
    ],
)
def test_truth_of_another_recording_is_refused(
    by_hand: Any, camera: dict[str, Any], arrays: dict[str, Any], message: str
) -> None:
    with pytest.raises(ScanLoomError, match=message) as caught:
        _join(by_hand, camera, **arrays)
    assert caught.value.advice


def test_angles_and_intrinsics_of_the_truth_take_precedence(by_hand: Any) -> None:
    associated = _join(
        by_hand,
        {"fx": None},
        intrinsics=np.array([3.0, 4.0, 2.5, 1.5]),
        lidar_angle_min=np.float64(-1.0),
        lidar_angle_increment=np.float64(0.5),
    )
    assert associated.cameras[0].intrinsics == (3.0, 4.0, 2.5, 1.5)
    np.testing.assert_allclose(associated.beam_angle_rad, [-1.0, -0.5, 0.0, 0.5])


def test_a_pixels_point_projects_back_onto_the_pixel(by_hand: Any) -> None:
    turned = by_hand.facing_forward.copy()
    turned[:3, 3] = 0.2, -0.1, 0.05
    (camera,) = _join(by_hand, T_lidar_camera=turned).cameras
    row, column = map(np.ravel, np.indices((3, 5)))
    depth_m = np.linspace(0.5, 3.0, row.size)
    points = transform_points(camera.T_lidar_camera, camera.back_project(row, column, depth_m))
    found_row, found_column, inside = camera.project(points)
    assert inside.all()
    np.testing.assert_array_equal(found_row, row)
    np.testing.assert_array_equal(found_column, column)
    np.testing.assert_allclose(
        camera.horizontal_range_m(row, column, depth_m), np.hypot(points[:, 0], points[:, 1])
    )
    behind = points * [-1.0, 1.0, 1.0]
    assert not camera.project(np.vstack([behind, np.full((1, 3), np.nan)]))[2].any()
