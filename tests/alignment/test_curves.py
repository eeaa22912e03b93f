"""Samples of LiDAR curves and depth rows against angles one by one, and against a known room."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.alignment.curves import (
    CurveSampling,
    RowSampling,
    SamplingSettings,
    curve_samples_m,
    offset_of_yaw,
    row_samples_m,
    sample_curve,
    sample_row,
    yaw_of_offset_rad,
)
from fusion_core.alignment.similarity import similarity_field
from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.geometry import (
    make_transform,
    rotation_from_yaw_pitch_roll,
    transform_points,
)
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import CameraIntrinsics, LaserScan

BY_ANGLE = SamplingSettings(by="angle", step_deg=1.0)
BY_INDEX = SamplingSettings(by="index", step_deg=1.0)


def scan_of(angle_min_deg: float, increment_deg: float, beams: int) -> LaserScan:
    """A scan whose ranges are its beam numbers."""
    return LaserScan(
        stamp_ns=0,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=float(np.deg2rad(angle_min_deg)),
        angle_increment_rad=float(np.deg2rad(increment_deg)),
        range_min_m=0.05,
        range_max_m=30.0,
        ranges_m=np.arange(beams, dtype=np.float64),
    )


def level_camera(yaw_deg: float = 0.0, width: int = 640, **intrinsics: float) -> Camera:
    values = {"fx": 525.0, "fy": 525.0, "cx": 0.5 * (width - 1), "cy": 3.5} | intrinsics
    yaw = rotation_from_yaw_pitch_roll(float(np.deg2rad(yaw_deg)), 0.0, 0.0)
    return Camera(
        topic="depth",
        intrinsics=CameraIntrinsics(width=width, height=8, **values),
        T_rig_camera=make_transform(yaw @ R_BODY_OPTICAL, np.zeros(3)),
    )


SCANS = {
    "counter-clockwise": scan_of(-119.8, 0.3515625, 682),
    "clockwise": scan_of(119.8, -0.3515625, 682),
    "full circle": scan_of(-180.0, 0.5, 720),
    "coarse": scan_of(-90.0, 2.0, 91),
    "off centre": scan_of(-30.0, 0.25, 541),
}


@pytest.mark.parametrize("name", SCANS)
def test_each_sample_is_the_beam_nearest_to_its_azimuth(name: str) -> None:
    scan = SCANS[name]
    sampling = sample_curve(scan, BY_ANGLE)
    step = abs(scan.angle_increment_rad)
    for index, beam in enumerate(sampling.beams):
        wanted = sampling.left_rad - index * sampling.step_rad
        distances = [abs(angle - wanted) for angle in scan.angles_rad]
        assert distances[beam] <= min(distances) + 1e-9
        assert distances[beam] <= 0.5 * step + 1e-9
    assert sampling.step_rad == np.deg2rad(1.0)
    # Centred on the field of view: what is left over is the same on both sides.
    centre = sampling.left_rad - 0.5 * (sampling.beams.size - 1) * sampling.step_rad
    assert centre == pytest.approx(0.5 * (scan.angles_rad[0] + scan.angles_rad[-1]), abs=1e-12)


@pytest.mark.parametrize("shift", [0.25, 0.5, 0.75])
def test_a_shifted_curve_lies_a_fraction_of_a_sample_to_the_right(shift: float) -> None:
    scan = SCANS["off centre"]
    plain, shifted = sample_curve(scan, BY_ANGLE), sample_curve(scan, BY_ANGLE, shift=shift)
    assert shifted.beams.size == plain.beams.size
    assert plain.left_rad - shifted.left_rad == pytest.approx(shift * plain.step_rad)
    wanted = shifted.left_rad - shifted.step_rad * np.arange(shifted.beams.size)
    off = np.abs(scan.angles_rad[shifted.beams] - wanted)
    # Half a beam; the last sample may have been shifted beyond the last beam.
    assert off[:-1].max() <= 0.5 * scan.angle_increment_rad + 1e-9
    assert off[-1] <= shift * shifted.step_rad


@pytest.mark.parametrize("settings", [BY_ANGLE, BY_INDEX], ids=["angle", "index"])
@pytest.mark.parametrize("name", SCANS)
def test_curves_run_left_to_right(name: str, settings: SamplingSettings) -> None:
    scan = SCANS[name]
    azimuths = scan.angles_rad[sample_curve(scan, settings).beams]
    assert (np.diff(azimuths) <= 0.0).all()
    assert azimuths[0] > azimuths[-1]


def test_both_directions_of_rotation_give_the_same_curve() -> None:
    left = SCANS["counter-clockwise"]
    right = LaserScan(
        stamp_ns=0,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=float(left.angles_rad[-1]),
        angle_increment_rad=-left.angle_increment_rad,
        range_min_m=0.05,
        range_max_m=30.0,
        ranges_m=left.ranges_m[::-1].copy(),
    )
    for settings in (BY_ANGLE, BY_INDEX):
        one, other = sample_curve(left, settings), sample_curve(right, settings)
        assert one.left_rad == pytest.approx(other.left_rad, abs=1e-12)
        np.testing.assert_array_equal(curve_samples_m(left, one), curve_samples_m(right, other))


def test_the_papers_curve_has_240_of_682_beams() -> None:
    sampling = sample_curve(SCANS["counter-clockwise"], BY_INDEX)
    assert sampling.beams.size == np.unique(sampling.beams).size == 240
    assert (sampling.beams[0], sampling.beams[-1]) == (681, 0)
    assert set(np.diff(sampling.beams)) <= {-2, -3}


def test_samples_are_the_beams_values_and_holes_stay_holes() -> None:
    scan = SCANS["off centre"]
    ranges_m = scan.ranges_m.copy()
    ranges_m[100:140] = np.nan
    holed = scan.with_ranges(ranges_m, None)
    sampling = sample_curve(holed, BY_ANGLE)
    np.testing.assert_array_equal(curve_samples_m(holed, sampling), ranges_m[sampling.beams])
    assert np.isnan(curve_samples_m(holed, sampling)).any()


@given(azimuth=st.floats(-3.0, 3.0))
def test_sample_of_azimuth_inverts_the_azimuth_of_a_sample(azimuth: float) -> None:
    sampling = CurveSampling(beams=np.arange(3), left_rad=1.2, step_rad=0.017)
    sample = sampling.sample_of_azimuth(np.array([azimuth]))[0]
    assert sampling.left_rad - sample * sampling.step_rad == pytest.approx(azimuth, abs=1e-12)


@pytest.mark.parametrize("yaw_deg", [-50.0, 0.0, 90.0])
@pytest.mark.parametrize("cx", [319.5, 300.0])
def test_each_row_sample_is_the_column_nearest_to_its_azimuth(yaw_deg: float, cx: float) -> None:
    camera = level_camera(yaw_deg, cx=cx)
    sampling = sample_row(camera, BY_ANGLE)
    intrinsics = camera.intrinsics
    for index, column in enumerate(sampling.columns):
        wanted = sampling.left_rad - index * sampling.step_rad - np.deg2rad(yaw_deg)
        place = intrinsics.cx - intrinsics.fx * np.tan(wanted)
        assert abs(column - place) <= 0.5 + 1e-9
        assert -0.5 <= place <= intrinsics.width - 0.5
    assert (np.diff(sampling.columns) > 0).all()
    # No further sample would fit: less than one and a quarter steps are left over.
    fov = np.arctan((intrinsics.cx + 0.5) / intrinsics.fx) + np.arctan(
        (intrinsics.width - 0.5 - intrinsics.cx) / intrinsics.fx
    )
    assert -0.25 <= fov / sampling.step_rad - sampling.columns.size < 0.75


@pytest.mark.parametrize("yaw_deg", [0.0, 35.0])
def test_row_samples_are_horizontal_ranges_of_the_pixels(yaw_deg: float) -> None:
    camera = level_camera(yaw_deg)
    intrinsics = camera.intrinsics
    depth_m = np.random.default_rng(0).uniform(0.5, 6.0, (8, 640)).astype(np.float32)
    depth_m[2, 50:90] = np.nan
    sampling = sample_row(camera, BY_ANGLE)
    found = row_samples_m(depth_m, sampling)
    for v in range(8):
        z = depth_m[v, sampling.columns].astype(np.float64)
        u = sampling.columns
        points = np.stack(
            [z * (u - intrinsics.cx) / intrinsics.fx, z * (v - intrinsics.cy) / intrinsics.fy, z],
            axis=-1,
        )
        in_rig = transform_points(camera.T_rig_camera, points)
        # The azimuth is the sample's, the depth the pixel's: half a pixel of tangent apart.
        np.testing.assert_allclose(found[v], np.hypot(*in_rig[:, :2].T), rtol=0.5 / 525.0 * 0.62)
        azimuths = sampling.left_rad - sampling.step_rad * np.arange(u.size)
        valid = np.isfinite(z)
        np.testing.assert_allclose(
            np.arctan2(in_rig[valid, 1], in_rig[valid, 0]), azimuths[valid], atol=0.5 / 525.0
        )


def test_rows_by_index_are_depths_as_they_come() -> None:
    camera = level_camera(0.0, width=960, fx=514.0)
    depth_m = np.random.default_rng(0).uniform(0.5, 6.0, (8, 960)).astype(np.float32)
    sampling = sample_row(camera, BY_INDEX)
    assert (sampling.columns[0], sampling.columns[-1]) == (0, 959)
    assert np.ptp(np.diff(sampling.columns)) <= 1
    np.testing.assert_array_equal(
        row_samples_m(depth_m, sampling), depth_m[:, sampling.columns].astype(np.float64)
    )


@given(
    u=st.floats(-300.0, 300.0),
    left=st.floats(-3.0, 3.0),
    step=st.floats(0.002, 0.08),
    row_left=st.floats(-3.0, 3.0),
)
def test_offset_and_yaw_are_inverse(u: float, left: float, step: float, row_left: float) -> None:
    curve = CurveSampling(beams=np.arange(30), left_rad=left, step_rad=step)
    row = RowSampling(
        columns=np.arange(10), left_rad=row_left, step_rad=step, range_per_depth=np.ones(10)
    )
    yaw = yaw_of_offset_rad(u, curve, row_left)
    found = offset_of_yaw(yaw, curve, row)
    turns = (found - u) * step / (2.0 * np.pi)
    assert turns == pytest.approx(round(turns), abs=1e-6)
    assert abs(yaw) <= np.pi + 1e-9
    # Of the offsets whole turns apart, the one at which the row is nearest to the curve's middle.
    middle = 0.5 * (30 - 10)
    assert all(
        abs(found - middle) <= abs(found + turn * 2.0 * np.pi / step - middle) + 1e-6
        for turn in (-1, 1)
    )


def room_range_m(azimuths: np.ndarray) -> np.ndarray:
    """Ranges to the walls of a 6 m by 5 m room from (2.2, 1.7), in closed form."""
    c, s = np.cos(azimuths), np.sin(azimuths)
    with np.errstate(divide="ignore"):
        return np.minimum(np.where(c > 0, 3.8, -2.2) / c, np.where(s >= 0, 3.3, -1.7) / s)


def offset_in_room(yaw_rad: float, settings: SamplingSettings = BY_ANGLE) -> tuple[float, float]:
    """(u found by similarity, u by the yaw) of a camera at the LiDAR's origin."""
    scan = scan_of(-135.0, 0.25, 1081)
    scan = scan.with_ranges(room_range_m(scan.angles_rad), None)
    camera = level_camera()
    intrinsics = camera.intrinsics
    azimuths = np.arctan((intrinsics.cx - np.arange(intrinsics.width)) / intrinsics.fx)
    depth_m = (room_range_m(yaw_rad + azimuths) * np.cos(azimuths)).astype(np.float32)
    curve, row = sample_curve(scan, settings), sample_row(camera, settings)
    rows_m = row_samples_m(np.tile(depth_m, (intrinsics.height, 1)), row)
    field = similarity_field(curve_samples_m(scan, curve), rows_m, metric="euclidean")
    found = field.u_first + int(np.nanargmax(field.scores[3]))
    return found, offset_of_yaw(yaw_rad, curve, row)


@pytest.mark.parametrize("yaw_deg", [-70.0, -33.3, 0.0, 12.0, 61.7])
def test_similarity_finds_the_offset_of_the_yaw(yaw_deg: float) -> None:
    found, expected = offset_in_room(np.deg2rad(yaw_deg))
    assert found == pytest.approx(expected, abs=0.51)


def test_turning_the_camera_by_one_sample_moves_the_offset_by_one() -> None:
    offsets = [offset_in_room(np.deg2rad(yaw_deg))[0] for yaw_deg in np.arange(-20.0, 21.0)]
    assert (np.diff(offsets) == -1).all()


def test_by_index_the_middle_of_the_row_keeps_its_azimuth() -> None:
    """Equal columns are not equal angles; the nominal azimuths agree with the image's middle."""
    camera = level_camera(20.0)
    sampling = sample_row(camera, BY_INDEX)
    count = sampling.columns.size
    assert sampling.left_rad - 0.5 * (count - 1) * sampling.step_rad == pytest.approx(
        np.deg2rad(20.0), abs=1e-12
    )
    assert count * sampling.step_rad == pytest.approx(2.0 * np.arctan(320.0 / 525.0))
