"""Upright views of rotated or distorted cameras, against OpenCV's projection."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.alignment.upright import UprightView, upright_view
from fusion_core.model.sensors import CameraIntrinsics

PLAIN = CameraIntrinsics(width=64, height=48, fx=55.0, fy=57.0, cx=30.2, cy=25.1)
LENSES = {
    "plain": PLAIN,
    "plumb_bob": CameraIntrinsics(
        width=64,
        height=48,
        fx=55.0,
        fy=57.0,
        cx=30.2,
        cy=25.1,
        distortion=(-0.28, 0.09, 0.002, -0.003, -0.01),
    ),
    "rational": CameraIntrinsics(
        width=64,
        height=48,
        fx=55.0,
        fy=57.0,
        cx=30.2,
        cy=25.1,
        distortion_model="rational_polynomial",
        distortion=(0.6, -2.4, 0.001, -0.0002, 1.5, 0.5, -2.2, 1.4),
    ),
    "equidistant": CameraIntrinsics(
        width=64,
        height=48,
        fx=40.0,
        fy=41.0,
        cx=31.0,
        cy=24.0,
        distortion_model="equidistant",
        distortion=(-0.02, 0.01, -0.004, 0.001),
    ),
}
# The world's up in the stored image, slightly askew, and the turns that bring it to the top.
UPS = {
    0: np.array([0.1, -0.9, 0.2]),
    1: np.array([0.9, 0.1, -0.2]),
    2: np.array([0.2, 0.9, 0.1]),
    3: np.array([-0.9, -0.3, 0.1]),
}


def stored_projection(points: np.ndarray, intrinsics: CameraIntrinsics) -> np.ndarray:
    """(N, 2) stored pixels (u, v) of points in the stored image's optical axes, by OpenCV."""
    K = np.array(
        [[intrinsics.fx, 0.0, intrinsics.cx], [0.0, intrinsics.fy, intrinsics.cy], [0.0, 0.0, 1.0]]
    )
    zero, coefficients = np.zeros(3), np.array(intrinsics.distortion or (0.0, 0.0, 0.0, 0.0))
    if intrinsics.distortion_model == "equidistant":
        return cv2.fisheye.projectPoints(points[:, np.newaxis], zero, zero, K, coefficients)[0][
            :, 0
        ]
    return cv2.projectPoints(points, zero, zero, K, coefficients)[0][:, 0]


@pytest.mark.parametrize("turns", UPS)
@pytest.mark.parametrize("name", LENSES)
def test_a_point_seen_in_the_view_names_its_stored_pixel(name: str, turns: int) -> None:
    intrinsics = LENSES[name]
    view = upright_view(intrinsics, UPS[turns])
    seen = view.intrinsics
    # Points on the centres of the view's pixels, at random depths.
    row, column = (axis.ravel() for axis in np.mgrid[: seen.height, : seen.width])
    z = np.random.default_rng(0).uniform(0.5, 5.0, row.size)
    in_view = np.stack(
        [z * (column - seen.cx) / seen.fx, z * (row - seen.cy) / seen.fy, z], axis=-1
    )
    expected = stored_projection(in_view @ view.R_stored_view.T, intrinsics)
    stored_row, stored_column = view.stored_pixels(row, column)
    inside = stored_row >= 0
    assert inside.mean() > 0.5
    np.testing.assert_allclose(stored_column[inside], expected[inside, 0], atol=0.51)
    np.testing.assert_allclose(stored_row[inside], expected[inside, 1], atol=0.51)
    u, v = expected.T
    clearly_inside = (
        (u > -0.4) & (u < intrinsics.width - 0.6) & (v > -0.4) & (v < intrinsics.height - 0.6)
    )
    clearly_outside = (
        (u < -0.6) | (u > intrinsics.width - 0.4) | (v < -0.6) | (v > intrinsics.height - 0.4)
    )
    assert inside[clearly_inside].all()
    assert not inside[clearly_outside].any()


@pytest.mark.parametrize("turns", UPS)
@pytest.mark.parametrize("name", LENSES)
def test_the_view_holds_the_stored_pixels_values(name: str, turns: int) -> None:
    intrinsics = LENSES[name]
    view = upright_view(intrinsics, UPS[turns])
    depth_m = np.random.default_rng(1).uniform(0.3, 8.0, (48, 64)).astype(np.float32)
    depth_m[10:14, 20:30] = np.nan
    seen = view.remap(depth_m)
    assert seen.shape == (view.intrinsics.height, view.intrinsics.width)
    assert seen.dtype == np.float32
    row, column = np.mgrid[: seen.shape[0], : seen.shape[1]]
    stored_row, stored_column = view.stored_pixels(row, column)
    for place in np.ndindex(seen.shape):
        if stored_row[place] < 0:
            assert stored_column[place] == -1
            assert np.isnan(seen[place])
        else:
            np.testing.assert_equal(seen[place], depth_m[stored_row[place], stored_column[place]])


@pytest.mark.parametrize("turns", UPS)
def test_turns_are_rotations_that_bring_up_to_the_top(turns: int) -> None:
    view = upright_view(PLAIN, UPS[turns])
    R = view.R_stored_view
    np.testing.assert_array_equal(R @ R.T, np.eye(3))
    assert np.linalg.det(R) == pytest.approx(1.0)
    up_in_view = R.T @ UPS[turns]
    assert -up_in_view[1] >= abs(up_in_view[0])
    depth_m = np.arange(48 * 64, dtype=np.float32).reshape(48, 64)
    np.testing.assert_array_equal(view.remap(depth_m), np.rot90(depth_m, turns))


def test_an_upright_image_is_passed_through() -> None:
    for up in (None, UPS[0]):
        view = upright_view(PLAIN, up)
        depth_m = np.ones((48, 64), dtype=np.float32)
        assert view.remap(depth_m) is depth_m
        assert view.intrinsics == PLAIN
        row, column = np.array([3, -1]), np.array([5, -1])
        np.testing.assert_array_equal(view.stored_pixels(row, column), [row, column])


def test_a_distortion_of_zeros_counts_as_none() -> None:
    intrinsics = CameraIntrinsics(
        width=64, height=48, fx=55.0, fy=57.0, cx=30.2, cy=25.1, distortion=(0.0,) * 5
    )
    assert upright_view(intrinsics, None).stored_index is None


@pytest.mark.parametrize("name", LENSES)
def test_no_pixel_stays_no_pixel(name: str) -> None:
    view = upright_view(LENSES[name], UPS[1])
    row, column = view.stored_pixels(np.array([-1, 4]), np.array([-1, 4]))
    assert (row[0], column[0]) == (-1, -1)
    assert row[1] >= 0


@given(row=st.integers(0, 63), column=st.integers(0, 47))
def test_stored_pixels_undo_a_quarter_turn(row: int, column: int) -> None:
    view: UprightView = upright_view(PLAIN, UPS[1])
    stored_row, stored_column = view.stored_pixels(np.array([row]), np.array([column]))
    assert (stored_row[0], stored_column[0]) == (column, 63 - row)


def test_points_that_a_distortion_moves_far_outside_have_no_pixel() -> None:
    intrinsics = CameraIntrinsics(
        width=64,
        height=48,
        fx=0.05,
        fy=0.05,
        cx=31.0,
        cy=24.0,
        distortion=(1e9, 1e9, 0.0, 0.0, 1e9),
    )
    index = upright_view(intrinsics, None).stored_index
    assert index is not None
    assert (index < 0).mean() > 0.9


@pytest.mark.parametrize("turns", UPS)
@pytest.mark.parametrize("name", LENSES)
def test_a_stored_pixel_is_found_where_the_view_first_shows_it(name: str, turns: int) -> None:
    view = upright_view(LENSES[name], UPS[turns])
    stored_row, stored_column = view.stored_pixel_maps()
    numbers = np.arange(48 * 64, dtype=np.float32).reshape(48, 64)
    shown = stored_row >= 0
    np.testing.assert_array_equal(
        view.remap(numbers)[shown], numbers[stored_row[shown], stored_column[shown]]
    )
    assert np.isnan(view.remap(numbers)[~shown]).all()
    first: dict[tuple[int, int], tuple[int, int]] = {}
    for row, column in np.argwhere(shown).tolist():
        first.setdefault(
            (int(stored_row[row, column]), int(stored_column[row, column])), (row, column)
        )
    row, column = np.indices((48, 64))
    found = view.view_pixels(row.ravel(), column.ravel())
    expected = [first.get(place, (-1, -1)) for place in np.ndindex(48, 64)]
    np.testing.assert_array_equal(np.stack(found, axis=1), expected)
    nothing = np.array([-1])
    assert view.view_pixels(nothing, nothing) == (nothing, nothing)
