"""A scan cut from a depth image against its back-projected pixels."""

import numpy as np
import pytest

from fusion_core.alignment.curves import SamplingSettings, sample_curve, sample_row
from fusion_core.alignment.upright import upright_view
from fusion_core.alignment.virtual_lidar import crop_view, cut_scan, mask_cut_rows
from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.errors import SettingsError
from fusion_core.model.geometry import make_transform, transform_points
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import CameraIntrinsics, DepthImage

LENS = CameraIntrinsics(width=320, height=24, fx=260.0, fy=260.0, cx=150.3, cy=11.0)
CAMERA = Camera(
    topic="depth", intrinsics=LENS, T_rig_camera=make_transform(R_BODY_OPTICAL, np.zeros(3))
)


def image_of(depth_m: np.ndarray) -> DepthImage:
    return DepthImage(
        stamp_ns=17, received_ns=None, frame_id="camera", depth_m=depth_m.astype(np.float32)
    )


def test_ranges_are_horizontal_ranges_of_the_rows_pixels() -> None:
    depth_m = np.random.default_rng(0).uniform(0.5, 6.0, (24, 320)).astype(np.float32)
    depth_m[7, 40:60] = np.nan
    scan = cut_scan(image_of(depth_m), CAMERA, 7)
    z = depth_m[7].astype(np.float64)
    u = np.arange(320)
    points = np.stack([z * (u - LENS.cx) / LENS.fx, z * (7 - LENS.cy) / LENS.fy, z], axis=-1)
    in_rig = transform_points(CAMERA.T_rig_camera, points)
    azimuths = np.arctan((LENS.cx - u) / LENS.fx)
    half_pixel = 0.5 / LENS.fx
    for angle, range_m in zip(scan.angles_rad, scan.ranges_m, strict=True):
        nearest = int(np.abs(np.tan(angle) - (LENS.cx - u) / LENS.fx).argmin())
        assert abs(azimuths[nearest] - angle) <= half_pixel + 1e-9
        if np.isnan(z[nearest]):
            assert np.isnan(range_m)
        else:
            own = float(np.hypot(*in_rig[nearest, :2]))
            assert range_m == pytest.approx(own, rel=half_pixel * 0.66)


def test_beams_span_the_image_counter_clockwise() -> None:
    scan = cut_scan(image_of(np.full((24, 320), 2.0)), CAMERA, 0)
    assert scan.stamp_ns == 17
    assert scan.ranges_m.size == 320
    assert scan.angle_increment_rad > 0.0
    assert scan.angles_rad[0] == pytest.approx(-np.arctan((319 - LENS.cx) / LENS.fx))
    assert scan.angles_rad[-1] == pytest.approx(np.arctan(LENS.cx / LENS.fx))


def test_a_wall_ahead_is_straight_in_the_scan() -> None:
    scan = cut_scan(image_of(np.full((24, 320), 3.0)), CAMERA, 12)
    np.testing.assert_allclose(scan.ranges_m * np.cos(scan.angles_rad), 3.0, rtol=1e-6)


def test_what_lies_beyond_the_scans_range_is_missing() -> None:
    scan = cut_scan(image_of(np.full((24, 320), 9.5)), CAMERA, 12)
    far = 9.5 / np.cos(scan.angles_rad) > scan.range_max_m
    assert 0 < far.sum() < far.size
    np.testing.assert_array_equal(np.isnan(scan.ranges_m), far)


@pytest.mark.parametrize("row", [-1, 24, 1000])
def test_a_row_that_the_image_lacks_is_refused(row: int) -> None:
    with pytest.raises(SettingsError, match="rows 0 to 23"):
        cut_scan(image_of(np.ones((24, 320))), CAMERA, row)


@pytest.mark.parametrize(
    ("row", "missing"), [(10, range(7, 14)), (1, range(5)), (23, range(20, 24))]
)
def test_rows_around_the_cut_are_left_out(row: int, missing: range) -> None:
    depth_m = np.ones((24, 320), dtype=np.float32)
    kept = mask_cut_rows(depth_m, row)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(kept).all(axis=1)), list(missing))
    assert np.isfinite(kept).sum() == (24 - len(missing)) * 320
    assert np.isfinite(depth_m).all()


@pytest.mark.parametrize("up", [None, np.array([1.0, 0.0, 0.0])], ids=["upright", "on its side"])
@pytest.mark.parametrize("width", [320, 321])
def test_the_crop_is_the_middle_of_the_view_under_the_same_rays(
    up: np.ndarray | None, width: int
) -> None:
    intrinsics = CameraIntrinsics(width=width, height=240, fx=260.0, fy=250.0, cx=150.3, cy=118.0)
    full = upright_view(intrinsics, up)
    cropped = crop_view(full)
    depth_m = np.random.default_rng(2).uniform(1.0, 4.0, (240, width)).astype(np.float32)
    whole, middle = full.remap(depth_m), cropped.remap(depth_m)
    left = round(full.intrinsics.cx - cropped.intrinsics.cx)
    assert middle.shape == (cropped.intrinsics.height, cropped.intrinsics.width)
    np.testing.assert_array_equal(middle, whole[:, left : left + middle.shape[1]])
    right = whole.shape[1] - left - middle.shape[1]
    assert left == right
    assert middle.shape[1] == pytest.approx(0.6 * whole.shape[1], abs=1.0)
    row, column = np.mgrid[: middle.shape[0], : middle.shape[1]]
    np.testing.assert_array_equal(
        cropped.stored_pixels(row, column), full.stored_pixels(row, column + left)
    )


def test_the_scan_is_wider_than_the_cropped_rows() -> None:
    """So that alignment has offsets to choose from, and the true one lies inside."""
    scan = cut_scan(image_of(np.full((24, 320), 2.0)), CAMERA, 5)
    cropped = Camera(
        topic="depth",
        intrinsics=crop_view(upright_view(LENS, None)).intrinsics,
        T_rig_camera=CAMERA.T_rig_camera,
    )
    curve = sample_curve(scan, SamplingSettings())
    row = sample_row(cropped, SamplingSettings())
    true_u = curve.sample_of_azimuth(np.array([row.left_rad]))[0]
    assert 5 < true_u < curve.beams.size - row.columns.size - 5


@pytest.mark.parametrize("width", [1, 40_001])
def test_an_image_whose_rows_are_no_sweep_is_refused(width: int) -> None:
    intrinsics = CameraIntrinsics(width=width, height=1, fx=260.0, fy=260.0, cx=0.0, cy=0.0)
    camera = Camera(topic="depth", intrinsics=intrinsics, T_rig_camera=CAMERA.T_rig_camera)
    with pytest.raises(SettingsError, match=f"of the depth image {width} pixels"):
        cut_scan(image_of(np.ones((1, width))), camera, 0)
