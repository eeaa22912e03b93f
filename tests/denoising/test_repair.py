"""Repairs: walls and planes in closed form, and invariants over random frames."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.denoising.correspondence import Correspondence
from fusion_core.denoising.neighbourhood import FrameWindow
from fusion_core.denoising.noise import Classification
from fusion_core.denoising.noise_scale import NoiseScale
from fusion_core.denoising.repair import RepairSettings, repair
from fusion_core.model.classes import NoiseClass, RepairSource
from fusion_core.model.sensors import LaserScan

GOOD, HOLE, BURR, CONFLICT = NoiseClass
RAW, OTHER, NEIGHBOURS, NONE = RepairSource
STEP_RAD = np.deg2rad(0.5)
ROW = 30
SCALE = NoiseScale(floor_m=0.02, fraction=0.0)
# Not the defaults: what is tested here must hold however those are tuned.
SETTINGS = RepairSettings(
    prefer="smaller_error",
    max_gap_deg=8.0,
    narrow_gap_deg=1.5,
    max_gap_pixels=24,
    edge_m=0.25,
    farther_confidence=0.7,
    camera_noise_fraction=0.5,
    lidar_burr_confidence=0.0,
    depth_burr_confidence=0.5,
    lidar_confidence=0.5,
    # What other scans must confirm is tested with those, in test_nearby_returns.py.
    check_nearby=False,
)


def changed(**changes):
    return SETTINGS.model_copy(update=changes)


def nothing(count):
    return np.full(count, np.nan)


def frame(
    lidar, *, lidar_class, camera=None, depth=None, lidar_as_depth=None, azimuth=None, **more
):
    """Pairs and classes; whatever is not given is missing, and every pixel good or a hole."""
    lidar = np.array(lidar, dtype=np.float64)
    count = lidar.size
    azimuth = -STEP_RAD * (np.arange(count) - count // 2) if azimuth is None else azimuth
    depth = nothing(count) if depth is None else depth
    row = more.get("row", np.full(count, ROW))
    pairs = Correspondence(
        model="curve",
        beam=np.arange(count),
        row=row,
        column=more.get("column", np.where(row >= 0, np.arange(count), -1)),
        azimuth_rad=azimuth,
        lidar_range_m=lidar,
        depth_m=depth,
        depth_as_range_m=depth.copy(),
        lidar_as_depth_m=nothing(count) if lidar_as_depth is None else lidar_as_depth,
        camera_range_m=nothing(count) if camera is None else camera,
        camera_blocked=np.zeros(count, dtype=np.bool_),
        residual_m=depth - lidar,
    )
    ones = np.ones(count)
    classes = Classification(
        lidar_class=np.array(lidar_class, dtype=np.int64),
        depth_class=np.asarray(more.get("depth_class", np.where(np.isnan(depth), HOLE, GOOD))),
        lidar_confidence=more.get("lidar_confidence", ones.copy()),
        depth_confidence=more.get("depth_confidence", ones.copy()),
        epsilon_m=0.1 * ones,
        lidar_steady=more.get("lidar_steady", np.zeros(ones.size, dtype=np.bool_)),
        lidar_decided=more.get("lidar_decided", np.zeros(count, dtype=np.bool_)),
        depth_decided=more.get("depth_decided", np.zeros(count, dtype=np.bool_)),
        beam_evidence=more.get("beam_evidence", np.zeros((count, 5))),
        beam_support=np.zeros((count, 3), dtype=np.int64),
        pixel_support=np.zeros((count, 2), dtype=np.int64),
        pixel_unconfirmed=np.zeros(count, dtype=np.bool_),
        pixel_through=np.zeros(count, dtype=np.bool_),
    )
    return pairs, classes


def repair_frame(pairs, classes, image, settings=SETTINGS, *, scale=SCALE):
    """The repair of pairs without a scan before or after, whose scan has one beam more."""
    scan = LaserScan(
        stamp_ns=0,
        received_ns=None,
        frame_id="lidar",
        angle_min_rad=0.0,
        angle_increment_rad=-STEP_RAD,
        range_min_m=0.05,
        range_max_m=8.0,
        ranges_m=np.append(pairs.lidar_range_m, np.nan),
    )
    window = FrameWindow(pairs=pairs, scan=scan, depth_m=image)
    return repair(window, classes, scale, settings)


def lidar_repair(lidar, lidar_class, *, settings=SETTINGS, scale=SCALE, **given):
    """(B,) ranges and sources of a frame whose image shows nothing."""
    pairs, classes = frame(lidar, lidar_class=lidar_class, **given)
    image = np.full((60, pairs.beam.size), np.nan, dtype=np.float32)
    result = repair_frame(pairs, classes, image, settings, scale=scale)
    return result.lidar_range_m, result.lidar_source


def holes(lidar, where):
    """The ranges without those of ``where``, and their classes."""
    lidar = np.array(lidar, dtype=np.float64)
    lidar[where] = np.nan
    return lidar, np.where(np.isnan(lidar), HOLE, GOOD)


# The LiDAR from its own neighbours.


def wall_m(azimuth, distance_m, turn_rad):
    """Range of a straight wall at a distance, its foot at an azimuth."""
    return distance_m / np.cos(azimuth - turn_rad)


@given(
    distance_m=st.floats(1.0, 4.0),
    turn_rad=st.floats(-0.5, 0.5),
    first=st.integers(1, 40),
    width=st.integers(1, 14),
    clockwise=st.booleans(),
)
@settings(max_examples=80)
def test_a_gap_in_a_straight_wall_is_filled_exactly(distance_m, turn_rad, first, width, clockwise):
    azimuth = STEP_RAD * (np.arange(60) - 30.0) * (-1.0 if clockwise else 1.0)
    exact = wall_m(azimuth, distance_m, turn_rad)
    gap = slice(first, first + width)
    lidar, classes = holes(exact, gap)
    value, source = lidar_repair(lidar, classes, azimuth=azimuth)
    np.testing.assert_allclose(value, exact, rtol=1e-9)
    assert (source[gap] == NEIGHBOURS).all()
    assert (np.delete(source, np.r_[gap]) == RAW).all()


def test_the_ends_of_a_gap_are_means_of_three_beams_of_one_surface():
    """Three noisy beams each side; the fourth and a beam of another surface are not used."""
    lidar = np.full(21, 2.0)
    lidar[7:10] = 2.03, 2.00, 1.97
    lidar[11:14] = 1.96, 2.01, 2.03
    lidar[[3, 4, 5, 6, 14, 15]] = 2.05
    without, classes = holes(lidar, [10])
    value, _ = lidar_repair(without, classes, settings=changed(max_gap_deg=2.0))
    assert value[10] == pytest.approx(2.0, abs=2e-3)
    without[12] = without[8] = 1.7
    value, _ = lidar_repair(without, classes, settings=changed(max_gap_deg=2.0))
    assert value[10] == pytest.approx(np.mean([2.03, 1.97, 1.96, 2.03]), abs=4e-3)


def test_at_the_end_of_the_view_there_are_fewer_beams_to_take_the_mean_of():
    lidar, classes = holes(np.full(21, 2.03), [2])
    lidar[:2] = 2.0, 2.06
    value, _ = lidar_repair(lidar, classes)
    assert value[2] == pytest.approx(2.03, abs=2e-3)


def test_no_gap_is_so_wide_that_its_chord_cuts_through_the_room():
    """Across 60 degrees of a round wall the chord runs up to 30 cm before it."""
    azimuth = -np.deg2rad(2.0) * (np.arange(60) - 30)
    lidar, classes = holes(np.full(60, 2.0), slice(16, 45))
    value, _ = lidar_repair(lidar, classes, azimuth=azimuth, settings=changed(max_gap_deg=90.0))
    ahead_m = 2.0 * np.cos(np.deg2rad([30.0, 32.0, 34.0])).mean()
    sagging = ahead_m / np.cos(azimuth[16:45]) < 2.0 - 0.25
    assert 0 < sagging.sum() < 29
    np.testing.assert_array_equal(np.isnan(value[16:45]), sagging)


@pytest.mark.parametrize(("width", "filled"), [(14, True), (16, False)])
def test_no_gap_is_filled_that_is_wider_than_set(width, filled):
    """The good beams around are 7.5 or 8.5 degrees apart."""
    lidar, classes = holes(np.full(60, 2.0), slice(20, 20 + width))
    value, source = lidar_repair(lidar, classes, settings=changed(max_gap_deg=8.0))
    assert np.isfinite(value).all() == filled
    assert (source[20 : 20 + width] == (NEIGHBOURS if filled else NONE)).all()


@pytest.mark.parametrize("flip", [1, -1])
def test_no_gap_is_filled_across_an_edge(flip):
    lidar, classes = holes(np.where(np.arange(60) < 25, 2.0, 2.6)[::flip], slice(22, 38))
    value, source = lidar_repair(lidar, classes, settings=changed(max_gap_deg=20.0))
    assert np.isnan(value[22:38]).all()
    assert (source[22:38] == NONE).all()


def test_no_gap_is_filled_that_has_one_end():
    lidar, classes = holes(np.full(60, 2.0), [0, 1, 58, 59])
    value, source = lidar_repair(lidar, classes)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(value)), [0, 1, 58, 59])
    assert (source[[0, 1, 58, 59]] == NONE).all()
    lidar, classes = holes(np.full(60, 2.0), slice(1, 60))
    assert np.isnan(lidar_repair(lidar, classes)[0][1:]).all()


@pytest.mark.parametrize(
    ("inside_m", "filled"), [(1.2, False), (1.7, False), (1.8, True), (3.0, True)]
)
def test_no_gap_is_filled_past_a_nearer_return_within_it(inside_m, filled):
    """It may be all that is seen of a dark table leg."""
    lidar, classes = holes(np.full(60, 2.0), slice(25, 34))
    lidar[29], classes[29] = inside_m, BURR
    lidar[45], classes[45] = 1.2, BURR
    azimuth = STEP_RAD * (np.arange(60) - 29.0)
    lidar = np.where(classes == GOOD, wall_m(azimuth, 2.0, 0.0), lidar)
    value, source = lidar_repair(lidar, classes, azimuth=azimuth)
    gap = np.r_[25:29, 30:34]
    assert (np.isfinite(value[gap])).all() == filled
    assert (source[gap] == (NEIGHBOURS if filled else NONE)).all()
    assert value[29] == pytest.approx(2.0 if filled else inside_m)
    assert source[29] == (NEIGHBOURS if filled else RAW)


def test_conflicts_bound_a_gap_as_good_beams_do_and_burrs_do_not():
    lidar, classes = holes(np.full(60, 2.0), [30])
    lidar[[27, 28, 29, 31, 32]] = 1.2
    classes[[27, 28, 29, 31, 32]] = CONFLICT
    assert lidar_repair(lidar, classes)[0][30] == pytest.approx(1.2, abs=1e-3)
    classes[classes == CONFLICT] = BURR
    value, source = lidar_repair(lidar, classes)
    assert np.isnan(value[30])
    assert source[30] == NONE


# The LiDAR from the camera.


def test_wide_holes_are_filled_from_the_camera_within_its_noise():
    rng = np.random.default_rng(2)
    azimuth = -STEP_RAD * (np.arange(120) - 60)
    exact = wall_m(azimuth, 2.5, 0.1)
    camera = exact + rng.normal(0.0, 0.01, 120)
    lidar, classes = holes(exact + rng.normal(0.0, 0.01, 120), slice(30, 90))
    value, source = lidar_repair(lidar, classes, camera=camera)
    np.testing.assert_array_equal(value[30:90], camera[30:90])
    assert (source[30:90] == OTHER).all()
    assert np.abs(value - exact).max() < 0.05
    assert np.sqrt(np.mean((value - exact) ** 2)) < 0.012


@pytest.mark.parametrize("width", [3, 11])
@pytest.mark.parametrize("prefer", ["smaller_error", "other_sensor"])
def test_the_source_is_the_one_with_the_smaller_error_or_always_the_other_sensor(width, prefer):
    """The error of a gap's own sides grows with its width; at 2 m they tie at about 2.3 degrees."""
    lidar, classes = holes(np.full(60, 2.0), slice(25, 25 + width))
    camera = np.full(60, 2.03)
    settings_ = changed(camera_noise_fraction=1.0, prefer=prefer)
    value, source = lidar_repair(lidar, classes, camera=camera, settings=settings_)
    own = prefer == "smaller_error" and width == 3
    assert (source[25 : 25 + width] == (NEIGHBOURS if own else OTHER)).all()
    np.testing.assert_allclose(value[25 : 25 + width], 2.0 if own else 2.03, atol=5e-3)


@pytest.mark.parametrize(
    ("width", "prefer", "expected"),
    [
        (1, "smaller_error", NEIGHBOURS),
        (1, "other_sensor", OTHER),
        (9, "smaller_error", OTHER),
        (9, "other_sensor", OTHER),
    ],
)
def test_over_a_narrow_gap_a_contradicting_camera_sees_an_edge_that_is_a_beam_off(
    width, prefer, expected
):
    lidar, classes = holes(np.full(60, 2.0), slice(25, 25 + width))
    value, source = lidar_repair(
        lidar, classes, camera=np.full(60, 3.0), settings=changed(prefer=prefer)
    )
    assert (source[25 : 25 + width] == expected).all()
    np.testing.assert_allclose(
        value[25 : 25 + width], 2.0 if expected == NEIGHBOURS else 3.0, atol=1e-2
    )


@pytest.mark.parametrize(
    ("raw_m", "confidence", "moved"),
    [(1.0, 0.69, False), (1.0, 0.7, True), (1.0, 1.0, True), (3.0, 0.0, True)],
)
def test_a_burr_is_moved_farther_only_with_confidence_and_nearer_always(raw_m, confidence, moved):
    lidar, classes = holes(np.full(60, 2.0), [])
    lidar[30], classes[30] = raw_m, BURR
    sure = np.ones(60)
    sure[30] = confidence
    value, source = lidar_repair(lidar, classes, camera=np.full(60, 2.0), lidar_confidence=sure)
    assert value[30] == (2.0 if moved else raw_m)
    assert source[30] == (OTHER if moved else RAW)


def test_a_burr_that_three_scans_show_is_kept_and_bounds_no_gap():
    lidar, classes = holes(np.full(60, 2.0), [30])
    lidar[[29, 31]], classes[[29, 31]] = 1.9, BURR
    steady = np.isin(np.arange(60), [29, 30, 31])
    for camera in (np.full(60, 1.5), np.full(60, 2.5), nothing(60)):
        value, source = lidar_repair(lidar, classes, camera=camera, lidar_steady=steady)
        assert value[[29, 31]].tolist() == [1.9, 1.9]
        assert source[[29, 31]].tolist() == [RAW, RAW]
        assert np.isfinite(value[30])
    # Between the good beams around, not between the burrs.
    assert value[30] == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize("behind_m", [-0.4, 0.0])
def test_a_value_behind_the_sensor_repairs_nothing(behind_m):
    """An affine A of few pairs may send a pixel there."""
    lidar, classes = holes(np.full(60, 2.0), [30, 0])
    camera = np.full(60, behind_m)
    value, source = lidar_repair(
        lidar, classes, camera=camera, settings=changed(prefer="other_sensor")
    )
    assert source[[0, 30]].tolist() == [NONE, NEIGHBOURS]
    assert np.isnan(value[0])


@pytest.mark.parametrize("prefer", ["smaller_error", "other_sensor"])
def test_the_expected_errors_explain_the_choice_of_source(prefer):
    lidar, classes = holes(np.full(60, 2.0), np.r_[10:13, 25:40])
    camera = np.full(60, 2.0)
    camera[[11, 30]] = np.nan
    pairs, given = frame(lidar, lidar_class=classes, camera=camera)
    image = np.full((60, 60), np.nan, dtype=np.float32)
    errors = repair_frame(pairs, given, image, changed(prefer=prefer)).lidar_errors_m
    asked = classes == HOLE
    np.testing.assert_array_equal(np.isnan(errors).all(axis=1), ~asked)
    # What is not there has no error; a gap of 8 degrees is the widest with sides of its own.
    np.testing.assert_array_equal(np.flatnonzero(np.isinf(errors[:, 0])), [11, 30])
    assert not np.isinf(errors[asked, 1]).any()
    assert errors[10, 0] == pytest.approx(0.5 * 0.02)
    assert errors[10, 1] == pytest.approx(0.6 * 0.02 + 0.1 * 4 * STEP_RAD * 2.0, rel=0.01)
    _, source = lidar_repair(lidar, classes, camera=camera, settings=changed(prefer=prefer))
    other = (errors[:, 0] <= errors[:, 1]) | (prefer == "other_sensor")
    other &= np.isfinite(errors[:, 0])
    np.testing.assert_array_equal(source[asked], np.where(other[asked], OTHER, NEIGHBOURS))


# Depth.


def plane_image(a, b, c, shape=(61, 81), centre=(30, 40)):
    """(H, W) float32 depth whose inverse is linear in the pixel."""
    v, u = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return (1.0 / (a + b * (u - centre[1]) + c * (v - centre[0]))).astype(np.float32)


def depth_repair(
    image, *, expected_m=np.nan, raw_m=np.nan, row=30, column=40, settings=SETTINGS, **given
):
    """Value and source of one pixel of an image, its beam good."""
    lidar_class = given.pop("lidar_class", [GOOD])
    pairs, classes = frame(
        [2.0],
        lidar_class=lidar_class,
        depth=np.array([raw_m]),
        lidar_as_depth=np.array([expected_m]),
        row=np.array([row]),
        column=np.array([column]),
        depth_class=[HOLE if np.isnan(raw_m) else BURR],
        **given,
    )
    result = repair_frame(pairs, classes, image, settings)
    return result.depth_m[0], result.depth_source[0]


@given(
    a=st.floats(0.25, 1.0),
    slope=st.tuples(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02)),
    seed=st.integers(0, 1000),
    hole=st.integers(0, 6),
)
@settings(max_examples=40)
def test_a_hole_in_a_plane_is_filled_exactly(a, slope, seed, hole):
    """Lone pixels and holes up to 13 pixels wide, among scattered others."""
    b, c = a * a * slope[0] / 2.0, a * a * slope[1] / 2.0
    image = plane_image(a, b, c)
    image[np.random.default_rng(seed).random(image.shape) < 0.2] = np.nan
    image[30 - hole : 31 + hole, 40 - hole : 41 + hole] = np.nan
    value, source = depth_repair(image)
    assert value == pytest.approx(1.0 / a, rel=1e-5)
    assert source == NEIGHBOURS


def test_a_burr_does_not_influence_its_own_repair():
    image = plane_image(0.5, 0.001, -0.001)
    image[30, 40] = 1.9
    value, source = depth_repair(image, raw_m=1.9)
    assert value == pytest.approx(2.0, rel=1e-5)
    assert source == NEIGHBOURS


@pytest.mark.parametrize(
    ("expected_m", "found_m"), [(np.nan, np.nan), (2.02, 2.0), (3.02, 3.0), (1.0, np.nan)]
)
def test_a_hole_at_an_edge_is_filled_from_the_surface_at_the_lidars_depth(expected_m, found_m):
    """As many pixels at 2 m as at 3 m: neither surface is the hole's."""
    image = np.full((61, 81), 2.0, dtype=np.float32)
    image[:, 41:] = 3.0
    image[:, 40] = np.nan
    value, source = depth_repair(image, expected_m=expected_m)
    if np.isnan(expected_m):
        assert np.isnan(value)
        assert source == NONE
    elif np.isnan(found_m):
        # The image has no surface there: only the LiDAR's value remains.
        assert value == 1.0
        assert source == OTHER
    else:
        assert value == pytest.approx(found_m, abs=0.03)


def test_beside_an_edge_a_hole_is_filled_from_the_surface_of_most():
    image = np.full((61, 81), 2.0, dtype=np.float32)
    image[:, 43:] = 3.0
    image[28:33, 38:43] = np.nan
    value, source = depth_repair(image)
    assert value == pytest.approx(2.0, rel=1e-6)
    assert source == NEIGHBOURS


def test_a_few_scattered_pixels_are_no_surface():
    """Their plane must be at the LiDAR's depth, and is not."""
    image = np.full((61, 81), 3.0, dtype=np.float32)
    image[::3, ::3] = 2.0
    image[28:33, 38:43] = np.nan
    assert depth_repair(image, expected_m=2.02) == (2.02, OTHER)


def test_a_slanted_wall_is_not_extrapolated_far():
    image = plane_image(1.0 / 2.6, -0.03, 0.0)
    image[:, 36:] = np.nan
    value, source = depth_repair(image)
    assert np.isnan(value)
    assert source == NONE


def test_the_window_reaches_as_far_up_as_down():
    image = np.full((61, 81), np.nan, dtype=np.float32)
    image[[28, 32]] = 2.0
    value, _ = depth_repair(image, settings=changed(max_gap_pixels=2))
    assert value == pytest.approx(2.0, rel=1e-6)
    for column in (38, 39):
        image = np.full((61, 81), np.nan, dtype=np.float32)
        image[:, [column, 80 - column]] = 2.0
        value, _ = depth_repair(image, settings=changed(max_gap_pixels=2))
        assert value == pytest.approx(2.0, rel=1e-6)


@pytest.mark.parametrize(("image_m", "found_m"), [(1.2, 1.2), (3.0, 2.0)])
def test_what_the_image_alone_shows_may_hide_the_beams_end_and_never_lie_behind_it(
    image_m, found_m
):
    """A table top over the LiDAR's plane hides the wall; a wall does not hide a table leg."""
    # Rough, so that the LiDAR's error would be the smaller one.
    rng = np.random.default_rng(0)
    image = (image_m + rng.uniform(-0.15, 0.15, (61, 81))).astype(np.float32)
    image[28:33, 38:43] = np.nan
    value, source = depth_repair(image, expected_m=2.0)
    assert value == pytest.approx(found_m, abs=0.05)
    assert source == (NEIGHBOURS if image_m < 2.0 else OTHER)


def test_a_hole_is_not_filled_from_a_corner_alone():
    for rows, columns in ((slice(0, 28), slice(0, 38)), (slice(33, 61), slice(0, 38))):
        image = np.full((61, 81), np.nan, dtype=np.float32)
        image[rows, columns] = 2.0
        value, source = depth_repair(image)
        assert np.isnan(value)
        assert source == NONE


@pytest.mark.parametrize(("reach", "filled"), [(16, True), (8, False)])
def test_no_hole_is_filled_from_farther_than_set(reach, filled):
    image = np.full((61, 81), 2.0, dtype=np.float32)
    image[20:41, 30:51] = np.nan
    value, source = depth_repair(image, settings=changed(max_gap_pixels=reach))
    assert np.isfinite(value) == filled
    assert source == (NEIGHBOURS if filled else NONE)


@pytest.mark.parametrize("place", [(0, 0), (0, 40), (60, 80), (30, 80)])
def test_at_the_border_of_the_image_no_pixel_outside_is_read(place):
    image = plane_image(0.5, 0.001, 0.001)
    exact = float(image[place])
    image[place] = np.nan
    value, _ = depth_repair(image, row=place[0], column=place[1])
    # In a corner there is nothing on both sides.
    if place in {(0, 0), (60, 80)}:
        assert np.isnan(value)
    else:
        assert value == pytest.approx(exact, rel=1e-5)


def test_of_two_sources_a_pixel_takes_the_smaller_error_or_always_the_lidar():
    rng = np.random.default_rng(0)
    clean = plane_image(0.5, 0.0, 0.0)
    rough = (clean + rng.uniform(-0.2, 0.2, clean.shape)).astype(np.float32)
    clean[30, 40] = rough[30, 40] = np.nan
    assert depth_repair(clean, expected_m=2.05)[1] == NEIGHBOURS
    assert depth_repair(rough, expected_m=2.05) == (2.05, OTHER)
    published = changed(prefer="other_sensor")
    assert depth_repair(clean, expected_m=2.05, settings=published) == (2.05, OTHER)


@pytest.mark.parametrize("lidar_class", [HOLE, BURR, CONFLICT])
def test_a_pixel_is_repaired_from_a_good_beam_alone(lidar_class):
    image = np.full((61, 81), np.nan, dtype=np.float32)
    assert depth_repair(image, expected_m=2.0) == (2.0, OTHER)
    value, source = depth_repair(image, expected_m=2.0, lidar_class=[lidar_class])
    assert np.isnan(value)
    assert source == NONE


def test_an_uncertain_beam_repairs_no_pixel_and_an_uncertain_burr_stays():
    image = np.full((61, 81), np.nan, dtype=np.float32)
    doubt = np.array([0.4])
    assert depth_repair(image, expected_m=2.0, lidar_confidence=doubt)[1] == NONE
    assert depth_repair(image, expected_m=2.0, raw_m=2.5)[1] == OTHER
    assert depth_repair(image, expected_m=2.0, raw_m=2.5, depth_confidence=doubt) == (2.5, RAW)


# Invariants of every repair.


def random_frame(seed):
    rng = np.random.default_rng(seed)
    count = 40
    surface = np.repeat(rng.uniform(1.0, 3.0, 4), 10)
    image = np.tile(surface, (60, 1)) + rng.normal(0.0, 0.02, (60, count))
    image[rng.random(image.shape) < 0.3] = np.nan
    image = image.astype(np.float32)
    row = np.where(rng.random(count) < 0.1, -1, rng.integers(0, 60, count))
    column = np.where(row >= 0, rng.integers(0, count, count), -1)
    lidar = surface + rng.normal(0.0, 0.3, count) * (rng.random(count) < 0.3)
    lidar[rng.random(count) < 0.2] = np.nan
    depth = np.where(row >= 0, image[row, column], np.nan).astype(np.float64)
    valid_lidar, valid_depth = np.isfinite(lidar), np.isfinite(depth)
    lidar_class = np.where(valid_lidar, rng.choice([GOOD, GOOD, BURR, CONFLICT], count), HOLE)
    depth_class = np.where(valid_depth, rng.choice([GOOD, GOOD, BURR, CONFLICT], count), HOLE)
    camera = surface + rng.normal(0.0, 0.1, count)
    camera[rng.random(count) < 0.3] = np.nan
    return image, *frame(
        lidar,
        lidar_class=lidar_class,
        camera=camera,
        depth=depth,
        lidar_as_depth=0.95 * lidar,
        row=row,
        column=column,
        depth_class=np.where(row >= 0, depth_class, -1),
        lidar_confidence=rng.random(count),
        depth_confidence=rng.random(count),
        lidar_steady=rng.random(count) < 0.3,
    )


@given(
    seed=st.integers(0, 100_000),
    prefer=st.sampled_from(["smaller_error", "other_sensor"]),
    farther=st.floats(0.0, 1.0),
)
@settings(max_examples=80)
def test_invariants_of_every_repair(seed, prefer, farther):
    image, pairs, classes = random_frame(seed)
    image_before = image.copy()
    result = repair_frame(pairs, classes, image, changed(prefer=prefer, farther_confidence=farther))
    np.testing.assert_array_equal(image, image_before)
    # The published preset knows no other scans: it repairs every burr.
    steady = (classes.lidar_class == BURR) & classes.lidar_steady & (prefer == "smaller_error")
    assert result.lidar_range_m[steady].tobytes() == pairs.lidar_range_m[steady].tobytes()
    reliable = (classes.lidar_class == GOOD) & (classes.lidar_confidence >= 0.5)
    for raw, value, source, code, confidence, other in (
        (
            pairs.lidar_range_m,
            result.lidar_range_m,
            result.lidar_source,
            classes.lidar_class,
            classes.lidar_confidence,
            pairs.camera_range_m,
        ),
        (
            pairs.depth_m,
            result.depth_m,
            result.depth_source,
            classes.depth_class,
            classes.depth_confidence,
            np.where(reliable, pairs.lidar_as_depth_m, np.nan),
        ),
    ):
        # Good, conflicting and absent samples keep their bits.
        kept = (code == GOOD) | (code == CONFLICT) | (code == -1)
        assert value[kept].tobytes() == raw[kept].tobytes()
        assert (source[kept & (code != -1)] == RAW).all()
        # Sources say where a value is from.
        assert value[source == RAW].tobytes() == raw[source == RAW].tobytes()
        np.testing.assert_array_equal(source == NONE, np.isnan(value))
        # A beam is smoothed along its wall before a pixel takes it, and stays near itself.
        smoothing = 0.0 if prefer == "other_sensor" or raw is pairs.lidar_range_m else 2.5
        taken = source == OTHER
        limit = smoothing * SCALE.floor_m
        assert (np.abs(value[taken] - other[taken]) <= limit + 1e-12).all()
        assert ((code == HOLE) | (code == BURR))[(source == OTHER) | (source == NEIGHBOURS)].all()
        # A valid return is never lost, and moved farther only as a burr of the set confidence.
        assert np.isfinite(value[np.isfinite(raw)]).all()
        with np.errstate(invalid="ignore"):
            moved = value > raw
        assert (code[moved] == BURR).all()
        assert (confidence[moved] >= farther).all()
        assert (value[np.isfinite(value)] > 0.0).all()


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25)
def test_mirrored_input_gives_a_mirrored_repair_of_the_lidar(seed):
    image, pairs, classes = random_frame(seed)
    result = repair_frame(pairs, classes, image)
    value, source = lidar_repair(
        pairs.lidar_range_m[::-1],
        classes.lidar_class[::-1],
        camera=pairs.camera_range_m[::-1].copy(),
        azimuth=-pairs.azimuth_rad[::-1],
        lidar_confidence=classes.lidar_confidence[::-1].copy(),
        lidar_steady=classes.lidar_steady[::-1].copy(),
    )
    np.testing.assert_array_equal(source[::-1], result.lidar_source)
    np.testing.assert_allclose(value[::-1], result.lidar_range_m, rtol=1e-12)


def burr_beside_a_pixel(confidence, seen, settings):
    """The range of a burr whose pixel and the other beams show a wall two metres ahead."""
    lidar = np.full(41, 2.0)
    lidar[20] = 1.6
    codes = np.where(lidar < 2.0, BURR, GOOD)
    evidence = np.zeros((41, 5))
    evidence[20] = -1.0, -1.0, -1.0, -1.0, seen
    value, _ = lidar_repair(
        lidar,
        codes,
        depth=np.full(41, 2.0),
        camera=np.full(41, 2.0),
        lidar_confidence=np.full(41, confidence),
        beam_evidence=evidence,
        settings=settings,
    )
    return value[20]


def test_a_beam_that_disagrees_is_changed_only_by_a_burr_of_enough_confidence():
    strict = changed(lidar_burr_confidence=0.9)
    assert burr_beside_a_pixel(0.91, -1.0, strict) == pytest.approx(2.0)
    assert burr_beside_a_pixel(0.89, -1.0, strict) == 1.6
    assert burr_beside_a_pixel(0.89, -1.0, changed(lidar_burr_confidence=0.8)) == pytest.approx(2.0)


def test_a_beam_whose_range_the_camera_sees_beside_it_is_kept():
    assert burr_beside_a_pixel(0.99, 0.1, SETTINGS) == 1.6
    preferring = changed(prefer="other_sensor")
    assert burr_beside_a_pixel(0.99, 0.1, preferring) == pytest.approx(2.0)


def test_a_frame_without_a_beam_in_view_has_no_repairs():
    value, source = lidar_repair([], [])
    assert value.size == source.size == 0


def test_repairs_cannot_be_changed():
    image, pairs, classes = random_frame(0)
    result = repair_frame(pairs, classes, image)
    for field in fields(result):
        with pytest.raises(ValueError, match="read-only"):
            getattr(result, field.name)[0] = 0
