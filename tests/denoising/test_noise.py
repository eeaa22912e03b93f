"""Classes: each on a small frame made by hand, counts and the published rule against loops.

A hand-made frame has a beam for each column: a wall two metres ahead, flat to both sensors.
"""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.alignment.moved_scan import move_scan
from fusion_core.denoising.correspondence import Correspondence, match_along_curve
from fusion_core.denoising.neighbourhood import FrameWindow
from fusion_core.denoising.noise import classify
from fusion_core.denoising.noise_scale import NoiseScale
from fusion_core.denoising.noise_settings import NoiseSettings
from fusion_core.denoising.support import count_beam_support, count_pixel_support
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.geometry import make_transform
from fusion_core.model.rig import Camera, Mount
from fusion_core.model.sensors import CameraIntrinsics, LaserScan
from tests.denoising.seen_scans import seen

GOOD, HOLE, BURR, CONFLICT = NoiseClass
BEAMS = 41
ROW = 5
SCALE = NoiseScale(floor_m=0.01, fraction=0.01)
# Not the defaults: what is tested here must hold however those are tuned.
SETTINGS = NoiseSettings(
    epsilon=3.0,
    epsilon_unit="sigma",
    support_sigma=3.0,
    slope_fraction=0.02,
    pixel_tolerance_fraction=0.03,
    burr_criterion="support",
    burr_odds=2.0,
    pixel_support=2,
    pixel_support_fraction=0.3,
    motion_pixels=4,
)
PUBLISHED = NoiseSettings(epsilon=1.2, epsilon_unit="E", burr_criterion="rougher")


def scan_of(ranges_m):
    return LaserScan(
        stamp_ns=0,
        received_ns=None,
        frame_id="lidar",
        angle_min_rad=-np.size(ranges_m) / 256.0 + 1.0 / 256.0,
        angle_increment_rad=1.0 / 128.0,
        range_min_m=0.05,
        range_max_m=8.0,
        ranges_m=np.array(ranges_m, dtype=np.float64),
    )


def wall():
    return np.full(BEAMS, 2.0)


def wall_image():
    return np.full((2 * ROW + 1, BEAMS), 2.0, dtype=np.float32)


def window_of(lidar, image, *, camera=None, row=None, model="curve", **neighbours):
    """A frame with beam k on column k of the middle row; depth counts as range."""
    scan = scan_of(lidar)
    row = np.full(scan.ranges_m.size, ROW) if row is None else row
    beam = np.arange(scan.ranges_m.size)
    depth = np.where(row >= 0, image[ROW, beam], np.nan).astype(np.float64)
    pairs = Correspondence(
        model=model,
        beam=beam,
        row=row,
        column=np.where(row >= 0, beam, -1),
        azimuth_rad=scan.angles_rad,
        lidar_range_m=scan.ranges_m,
        depth_m=depth,
        depth_as_range_m=depth,
        lidar_as_depth_m=scan.ranges_m,
        camera_range_m=depth.copy() if camera is None else camera,
        camera_blocked=np.zeros(scan.ranges_m.size, dtype=np.bool_),
        residual_m=depth - scan.ranges_m,
    )
    return FrameWindow(pairs=pairs, scan=scan, depth_m=image, **neighbours)


def columns_of(value):
    return [(field.name, getattr(value, field.name)) for field in fields(value)]


def classes_of(window, noise=SETTINGS, scale=SCALE, mean_error_m=0.05):
    return classify(window, noise, scale, mean_error_m)


def assert_classes(classes, lidar=None, depth=None):
    """Those named, and good everywhere else."""
    for found, named in ((classes.lidar_class, lidar), (classes.depth_class, depth)):
        expected = np.zeros(BEAMS, dtype=np.int64)
        for where, code in (named or {}).items():
            expected[list(where) if isinstance(where, range | tuple) else where] = code
        np.testing.assert_array_equal(found, expected)


def test_a_wall_that_both_see_is_good():
    rng = np.random.default_rng(0)
    image = (wall_image() + rng.normal(0.0, 0.005, wall_image().shape)).astype(np.float32)
    classes = classes_of(window_of(wall() + rng.normal(0.0, 0.005, BEAMS), image))
    assert_classes(classes)
    assert classes.lidar_confidence.min() > 0.9


def test_a_burr_of_the_lidar_alone():
    lidar = wall()
    lidar[20] = 1.2
    image = wall_image()
    assert_classes(classes_of(window_of(lidar, image)), lidar={20: BURR})


def test_a_burr_of_the_pixel_alone():
    image = wall_image()
    image[ROW, 20] = 1.2
    assert_classes(classes_of(window_of(wall(), image, camera=wall())), depth={20: BURR})


def test_a_burr_of_both():
    lidar, image = wall(), wall_image()
    lidar[20], image[ROW, 20] = 1.2, 2.9
    classes = classes_of(window_of(lidar, image, camera=wall()))
    assert_classes(classes, lidar={20: BURR}, depth={20: BURR})


def test_a_mixed_beam_and_a_column_of_mixed_pixels_at_an_edge():
    edge = np.where(np.arange(BEAMS) < 20, 2.0, 3.0)
    image = np.tile(edge, (2 * ROW + 1, 1)).astype(np.float32)
    lidar = edge.copy()
    lidar[20] = 2.5
    assert_classes(classes_of(window_of(lidar, image)), lidar={20: BURR})
    # The pixels above and below are mixed alike; they are still few among those around.
    image[:, 20] = 2.5
    assert_classes(classes_of(window_of(edge, image, camera=edge)), depth={20: BURR})


def test_at_an_edge_both_may_mix_alike_and_agree_on_a_point_that_is_on_neither_surface():
    edge = np.where(np.arange(BEAMS) < 20, 2.0, 3.0)
    edge[20] = 2.5
    image = np.tile(edge, (2 * ROW + 1, 1)).astype(np.float32)
    classes = classes_of(window_of(edge, image))
    assert_classes(classes, lidar={20: BURR}, depth={20: BURR})
    # By eq. (6) alone a pair that agrees is good.
    assert_classes(classes_of(window_of(edge, image), PUBLISHED))


@pytest.mark.parametrize(("alike", "code"), [(0, BURR), (1, BURR), (2, CONFLICT)])
def test_a_pixel_among_holes_needs_a_number_of_supporters_whatever_their_fraction(alike, code):
    image = wall_image()
    image[:, 17:24] = np.nan
    image[ROW, 20] = 1.2
    image[ROW - 1, 20 : 20 + alike] = 1.2
    classes = classes_of(window_of(wall(), image, camera=wall()))
    assert classes.depth_class[20] == code


@pytest.mark.parametrize("camera_sees", ["the wall", "nothing"])
def test_a_low_cabinet_that_the_lidar_alone_meets_is_a_conflict_and_no_noise(camera_sees):
    lidar = wall()
    lidar[15:26] = 1.2
    camera = wall() if camera_sees == "the wall" else np.full(BEAMS, np.nan)
    # In a row, the camera looks over it.
    classes = classes_of(window_of(lidar, wall_image(), camera=camera, model="row"))
    cabinet = range(15, 26)
    assert_classes(classes, lidar={cabinet: CONFLICT}, depth={cabinet: CONFLICT})


def test_a_camera_that_looks_through_what_the_lidar_meets_has_the_burrs():
    lidar = wall()
    lidar[15:26] = 1.2
    image = wall_image()
    # Of what lies behind the pane, no beam nearby measures anything.
    image[:, 15:26] = 2.8
    classes = classes_of(window_of(lidar, image, camera=wall()))
    pane = range(15, 26)
    assert_classes(classes, depth={pane: BURR})
    assert np.flatnonzero(classes.pixel_through).tolist() == list(pane)
    assert (classes.depth_confidence[15:26] > 0.5).all()
    # Where the camera sees the pane's own range about, its edge may lie between both.
    image[ROW + 3, 15:26] = 1.2
    assert not classes_of(window_of(lidar, image, camera=wall())).pixel_through.any()
    # Nor does a single beam make a pane.
    lidar, image = wall(), wall_image()
    lidar[20], image[:, 20] = 1.2, 2.8
    assert not classes_of(window_of(lidar, image, camera=wall())).pixel_through.any()


def test_a_shelf_that_the_camera_alone_sees_is_a_conflict():
    image = wall_image()
    image[:, 15:26] = 1.2
    classes = classes_of(window_of(wall(), image))
    shelf = range(15, 26)
    assert_classes(classes, lidar={shelf: CONFLICT}, depth={shelf: CONFLICT})


def test_behind_glass_scattered_returns_are_burrs():
    lidar, image = wall(), wall_image()
    pane = range(12, 29)
    lidar[12:29] = np.nan
    image[:, 12:29] = np.nan
    lidar[16], lidar[20], lidar[25] = 3.1, 0.9, 4.4
    classes = classes_of(window_of(lidar, image))
    assert_classes(classes, lidar={pane: HOLE, (16, 20, 25): BURR}, depth={pane: HOLE})


def test_behind_glass_two_similar_returns_among_six_others_give_no_support():
    lidar, image = wall(), wall_image()
    image[:, 12:29] = np.nan
    lidar[12:29] = np.nan
    lidar[17:24] = 4.0, 3.0, 1.1, 3.0, 1.3, 3.0, 2.2
    assert classes_of(window_of(lidar, image)).lidar_class[20] == BURR
    lidar[[17, 23]] = np.nan
    lidar[19] = 3.0
    assert classes_of(window_of(lidar, image)).lidar_class[20] == GOOD


def test_a_dark_object_seen_by_a_few_agreeing_beams_is_good():
    lidar, image = wall(), wall_image()
    dark = range(16, 25)
    image[:, 16:25] = np.nan
    lidar[18:23] = 1.5
    lidar[16:18] = lidar[23:25] = np.nan
    classes = classes_of(window_of(lidar, image))
    assert_classes(classes, lidar={(16, 17, 23, 24): HOLE}, depth={dark: HOLE})
    assert (classes.lidar_confidence[18:23] > 0.5).all()


def test_holes_of_either_and_of_both_and_beams_without_a_pixel():
    lidar, image = wall(), wall_image()
    lidar[5] = lidar[10] = np.nan
    image[ROW, 10] = image[ROW, 15] = np.nan
    row = np.full(BEAMS, ROW)
    row[20:24] = -1
    lidar[22] = np.nan
    classes = classes_of(window_of(lidar, image, row=row))
    assert_classes(
        classes,
        lidar={(5, 10, 22): HOLE},
        depth={(10, 15): HOLE, range(20, 24): -1},
    )
    assert (classes.depth_confidence[20:24] == 0.0).all()
    np.testing.assert_array_equal(classes.lidar_confidence[[5, 10, 22]], 1.0)


def post(offset=0):
    """An object of one beam: no adjacent beam supports it."""
    lidar = wall()
    lidar[20 + offset] = 1.2
    return lidar


def class_of_the_post(**neighbours):
    window = window_of(post(), wall_image(), camera=wall(), model="row", **neighbours)
    return classes_of(window).lidar_class[20]


def test_other_scans_support_a_thin_object_while_the_lidar_turns():
    def of_turns(before, after):
        """The neighbours in time as seen after turns of so many beams."""
        scans = {"scan_before": (post(6), before), "scan_after": (post(-7), after)}
        return {
            name: move_scan(scan_of(ranges_m), np.array([0.0, 0.0, beams / 128.0]), 0.15)
            for name, (ranges_m, beams) in scans.items()
        }

    assert class_of_the_post(**of_turns(6, -7)) == CONFLICT
    assert class_of_the_post() == BURR
    assert class_of_the_post(**of_turns(0, 0)) == BURR
    assert class_of_the_post(**of_turns(-6, 7)) == BURR


def test_two_adjacent_beams_before_all_else_are_an_object_unless_another_scan_lacks_it():
    lidar = wall()
    lidar[20:22] = 1.2

    def classes_with(**neighbours):
        window = window_of(lidar, wall_image(), camera=wall(), model="row", **neighbours)
        return classes_of(window).lidar_class[20:22].tolist()

    assert classes_with() == [CONFLICT, CONFLICT]
    assert classes_with(scan_before=seen(wall())) == [BURR, BURR]
    assert classes_with(scan_before=seen(lidar)) == [CONFLICT, CONFLICT]


def test_a_camera_in_whose_sight_a_beam_ends_speaks_against_it():
    lidar = wall()
    lidar[20:22] = 1.2
    seen = classes_of(window_of(lidar, wall_image(), camera=wall()))
    assert seen.lidar_class[20:22].tolist() == [BURR, BURR]
    # A shelf hides two beams that go on below it.
    image = wall_image()
    image[:, 15:26] = 1.2
    lidar = wall()
    lidar[20:22] = 2.6
    nothing = np.full(BEAMS, np.nan)
    hidden = classes_of(window_of(lidar, image, camera=nothing))
    assert hidden.lidar_class[20:22].tolist() == [CONFLICT, CONFLICT]
    in_sight = classes_of(window_of(lidar, image))
    assert in_sight.lidar_class[20:22].tolist() == [BURR, BURR]


def test_a_pixel_whose_surface_a_beam_nearby_measures_is_no_burr():
    lidar, image = wall(), wall_image()
    image[:, 20] = np.nan
    image[ROW - 1 : ROW + 1, 20] = 1.2
    alone = classes_of(window_of(lidar, image, camera=wall()))
    assert alone.depth_class[20] == BURR
    lidar[22] = 1.2
    measured = classes_of(window_of(lidar, image, camera=wall()))
    assert measured.depth_class[20] == CONFLICT


def test_a_steady_beam_is_confirmed_by_both_other_scans():
    lidar, once = wall(), wall()
    lidar[20] = once[20] = 1.2
    lidar[30] = np.nan
    lidar[10], once[11] = 1.2, 1.2

    def steady(**neighbours):
        classes = classes_of(window_of(lidar, wall_image(), camera=wall(), **neighbours))
        return np.flatnonzero(~classes.lidar_steady).tolist()

    both = {"scan_before": seen(once), "scan_after": seen(once)}
    # A surface may have moved by a beam.
    assert steady(**both) == [30]
    assert steady(scan_before=seen(once), scan_after=seen(wall())) == [10, 20, 30]
    assert steady(scan_before=seen(once)) == list(range(BEAMS))


def speckled(first):
    """A speckle of 3 x 3 pixels: large enough to support itself within one image."""
    image = wall_image()
    image[ROW - 1 : ROW + 2, first : first + 3] = 1.2
    return image


def class_of_the_speckle(before=None, columns=0.0):
    window = window_of(
        wall(), speckled(15), camera=wall(), depth_before_m=before, columns_before=columns
    )
    classes = classes_of(window)
    return classes.lidar_class[16], classes.depth_class[16]


def test_a_speckle_that_the_image_before_lacks_is_a_burr():
    assert class_of_the_speckle() == (CONFLICT, CONFLICT)
    assert class_of_the_speckle(wall_image()) == (GOOD, BURR)
    assert class_of_the_speckle(speckled(25), 10.3) == (CONFLICT, CONFLICT)
    assert class_of_the_speckle(speckled(25), -10.3) == (GOOD, BURR)
    # An image before without depths there, or without that place, is no evidence.
    assert class_of_the_speckle(np.full_like(wall_image(), np.nan)) == (CONFLICT, CONFLICT)
    assert class_of_the_speckle(wall_image(), 30.0) == (CONFLICT, CONFLICT)


def random_frame(rng, beams=BEAMS, noise=0.01):
    """A scan and an image with surfaces, noise, burrs and holes."""
    surface = np.repeat(rng.uniform(1.0, 3.0, 6), 7)[:beams]
    lidar = surface + rng.normal(0.0, noise, beams)
    image = np.tile(surface, (2 * ROW + 1, 1)) + rng.normal(0.0, noise, (2 * ROW + 1, beams))
    burr = rng.random(beams) < 0.15
    lidar[burr] = rng.uniform(0.5, 4.0, burr.sum())
    lidar[rng.random(beams) < 0.15] = np.nan
    speckle = rng.random(image.shape) < 0.1
    image[speckle] = rng.uniform(0.5, 4.0, speckle.sum())
    image[rng.random(image.shape) < 0.15] = np.nan
    return lidar, image.astype(np.float32)


def test_the_evidence_for_the_classes_is_reported():
    lidar, image = wall(), speckled(15)
    lidar[30] = 1.2
    classes = classes_of(
        window_of(
            lidar,
            image,
            camera=wall(),
            scan_before=seen(wall()),
            scan_after=seen(wall()),
            depth_before_m=wall_image(),
        )
    )
    np.testing.assert_array_equal(
        classes.beam_support[[10, 29, 30, 31]], [[2, 4, 2], [1, 4, 2], [0, 0, 0], [1, 4, 2]]
    )
    np.testing.assert_array_equal(classes.pixel_support[[10, 16]], [[24, 24], [8, 24]])
    np.testing.assert_array_equal(np.flatnonzero(classes.pixel_unconfirmed), [15, 16, 17])


# Epsilon and confidences.


def test_epsilon_in_its_three_units():
    lidar = np.linspace(1.0, 4.0, BEAMS)
    lidar[3] = np.nan
    window = window_of(lidar, wall_image())

    def epsilon_m(unit, mean_error_m=0.07):
        noise = replace_settings(epsilon=2.0, epsilon_unit=unit)
        return classes_of(window, noise, mean_error_m=mean_error_m).epsilon_m

    sigma = np.sqrt(0.01**2 + (0.01 * np.nan_to_num(lidar)) ** 2)
    np.testing.assert_allclose(epsilon_m("sigma"), 2.0 * sigma, rtol=1e-12)
    np.testing.assert_array_equal(epsilon_m("E"), np.full(BEAMS, 2.0 * 0.07))
    np.testing.assert_array_equal(epsilon_m("m"), np.full(BEAMS, 2.0))
    # A frame without A has no E: nothing exceeds it.
    failed = classes_of(window, replace_settings(epsilon_unit="E"), mean_error_m=float("nan"))
    assert np.isnan(failed.epsilon_m).all()
    assert not (failed.lidar_class == CONFLICT).any()


def replace_settings(**changes):
    return SETTINGS.model_copy(update=changes)


@pytest.mark.parametrize("criterion", ["support", "rougher"])
def test_a_pair_is_noise_beyond_epsilon_and_not_at_it(criterion):
    lidar = wall()
    noise = replace_settings(epsilon=0.5, epsilon_unit="m", burr_criterion=criterion)
    lidar[20] = 1.5
    assert_classes(classes_of(window_of(lidar, wall_image()), noise))
    lidar[20] = 1.49
    assert_classes(classes_of(window_of(lidar, wall_image()), noise), lidar={20: BURR})


@given(seed=st.integers(0, 10_000), criterion=st.sampled_from(["support", "rougher"]))
@settings(max_examples=50)
def test_confidences_lie_in_0_to_1_and_classes_are_those_of_their_values(seed, criterion):
    rng = np.random.default_rng(seed)
    lidar, image = random_frame(rng)
    row = np.where(rng.random(BEAMS) < 0.1, -1, ROW)
    window = window_of(
        lidar, image, row=row, scan_before=seen(lidar), scan_after=seen(random_frame(rng)[0])
    )
    classes = classes_of(window, replace_settings(burr_criterion=criterion))
    for confidence in (classes.lidar_confidence, classes.depth_confidence):
        assert confidence.min() >= 0.0
        assert confidence.max() <= 1.0
    depth = window.pairs.depth_m
    np.testing.assert_array_equal(classes.lidar_class == HOLE, np.isnan(lidar))
    np.testing.assert_array_equal(classes.depth_class == -1, row < 0)
    np.testing.assert_array_equal(classes.depth_class == HOLE, np.isnan(depth) & (row >= 0))
    # A conflict is on both sides; a burr beside a valid pixel makes that less confident.
    np.testing.assert_array_equal(classes.lidar_class == CONFLICT, classes.depth_class == CONFLICT)
    beyond = np.abs(window.pairs.residual_m) > classes.epsilon_m
    named = (classes.lidar_class >= BURR) | (classes.depth_class >= BURR)
    assert named[beyond].all()
    assert (beyond | np.isnan(lidar) | np.isnan(depth))[classes.lidar_class == CONFLICT].all()


@pytest.mark.parametrize("case", ["lidar burr", "pixel burr", "conflict"])
def test_confidence_falls_with_the_residual_for_good_and_grows_for_noise(case):
    lidar, image = wall(), wall_image()
    if case == "lidar burr":
        lidar[20] = 1.2
    elif case == "pixel burr":
        image[ROW, 20] = 1.2
    else:
        lidar[15:26] = 1.2
    model = "row" if case == "conflict" else "curve"
    window = window_of(lidar, image, camera=wall(), model=model)
    residuals_m = np.linspace(0.0, 1.5, 61)
    found = []
    for residual_m in residuals_m:
        values = window.pairs.residual_m.copy()
        values[20] = residual_m
        found.append(classes_of(replace(window, pairs=replace(window.pairs, residual_m=values))))
    kinds = []
    for side in ("lidar", "depth"):
        codes = np.array([getattr(classes, f"{side}_class")[20] for classes in found])
        confidence = np.array([getattr(classes, f"{side}_confidence")[20] for classes in found])
        kinds.append(codes[-1])
        assert codes[0] == GOOD
        assert confidence[0] > 0.9
        assert (np.diff(confidence[codes == GOOD]) <= 0.0).all()
        for code in (BURR, CONFLICT):
            assert (np.diff(confidence[codes == code]) >= 0.0).all()
    expected = {"lidar burr": [BURR, GOOD], "pixel burr": [GOOD, BURR]}
    assert kinds == expected.get(case, [CONFLICT, CONFLICT])


def test_a_burr_that_other_scans_confirm_has_less_confidence():
    lidar = wall()
    lidar[20] = 1.2

    def confidence(**neighbours):
        classes = classes_of(window_of(lidar, wall_image(), camera=wall(), **neighbours))
        assert classes.lidar_class[20] == BURR
        return classes.lidar_confidence[20]

    once = confidence(scan_before=seen(lidar), scan_after=seen(wall()))
    never = confidence(scan_before=seen(wall()), scan_after=seen(wall()))
    assert 1.0 - once > 5.0 * (1.0 - never)
    assert never > 0.9


# Against loops.


@given(seed=st.integers(0, 10_000))
@settings(max_examples=60)
def test_the_support_of_beams_equals_a_loop(seed):
    rng = np.random.default_rng(seed)
    ranges = random_frame(rng, noise=0.05)[0]
    in_time = np.stack([random_frame(rng, noise=0.05)[0], ranges + rng.normal(0.0, 0.1, BEAMS)])
    beams = np.sort(rng.choice(BEAMS, 30, replace=False))
    camera = ranges[beams] + rng.normal(0.0, 0.05, 30)
    camera[rng.random(30) < 0.3] = np.nan
    floor_m, fraction, slope = 0.04, 0.02, 0.01
    support, neighbours = count_beam_support(
        ranges, in_time, beams, camera, floor_m, fraction, slope
    )
    by_camera = dict(zip(beams.tolist(), camera.tolist(), strict=True))
    for i, beam in enumerate(beams.tolist()):
        own = ranges[beam]
        near = beyond = later = valid = valid_in_time = 0
        if not np.isnan(own):
            tolerance = (floor_m**2 + (fraction * own) ** 2) ** 0.5
            for step in (-3, -2, -1, 1, 2, 3):
                if not 0 <= beam + step < BEAMS or np.isnan(ranges[beam + step]):
                    continue
                valid += 1
                slant = by_camera.get(beam + step, np.nan) - by_camera[beam]
                change = ranges[beam + step] - own
                if np.isnan(slant):
                    same = abs(change) <= tolerance + slope * own * abs(step)
                elif abs(slant) > 0.03 * own * abs(step):
                    same = abs(change) <= tolerance
                else:
                    same = abs(change - slant) <= tolerance
                near += same and abs(step) == 1
                beyond += same and abs(step) > 1
            for other in in_time:
                places = range(beam - 1, beam + 2)
                met = [other[k] for k in places if 0 <= k < BEAMS and not np.isnan(other[k])]
                valid_in_time += bool(met)
                later += any(abs(value - own) <= tolerance for value in met)
        assert support[i].tolist() == [near, beyond, later]
        assert neighbours[i].tolist() == [valid, valid_in_time]


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40)
def test_the_support_of_pixels_equals_a_loop(seed):
    rng = np.random.default_rng(seed)
    image = random_frame(rng, noise=0.03)[1]
    rows, columns = rng.integers(-1, 2 * ROW + 1, 60), rng.integers(0, BEAMS, 60)
    support, neighbours = count_pixel_support(image, rows, columns, 0.02)
    for i, (row, column) in enumerate(zip(rows.tolist(), columns.tolist(), strict=True)):
        around = []
        if row >= 0 and not np.isnan(image[row, column]):
            own = float(image[row, column])
            around = [
                abs(float(image[r, c]) - own) <= 0.03 + 0.02 * own
                for r in range(row - 2, row + 3)
                for c in range(column - 2, column + 3)
                if 0 <= r < image.shape[0] and 0 <= c < BEAMS and (r, c) != (row, column)
                if not np.isnan(image[r, c])
            ]
        assert (support[i], neighbours[i]) == (sum(around), len(around))


@given(seed=st.integers(0, 10_000), mean_error_m=st.floats(0.02, 0.6))
@settings(max_examples=50)
def test_the_published_reading_equals_a_loop(seed, mean_error_m):
    rng = np.random.default_rng(seed)
    lidar, image = random_frame(rng)
    window = window_of(lidar, image)
    classes = classes_of(window, PUBLISHED, mean_error_m=mean_error_m)
    depth = image[ROW].astype(float)

    def roughness(values, i):
        left, right = values[max(i - 1, 0)], values[min(i + 1, BEAMS - 1)]
        rough = abs(values[i] - (left + right) / 2.0)
        return 0.0 if np.isnan(rough) else rough

    for i in range(BEAMS):
        expected = [HOLE if np.isnan(value) else GOOD for value in (lidar[i], depth[i])]
        if abs(depth[i] - lidar[i]) > 1.2 * mean_error_m:
            lidar_at_fault = roughness(lidar, i) >= roughness(depth, i)
            expected[0 if lidar_at_fault else 1] = BURR
        assert [classes.lidar_class[i], classes.depth_class[i]] == expected


# Symmetry.


def mirrored_frames(seed):
    """A frame of random surfaces along the curve, and the same in a mirror."""
    rng = np.random.default_rng(seed)
    yaw, left, forward, up, pitch = rng.uniform(-0.2, 0.2, 5)
    surface = np.repeat(rng.uniform(1.0, 3.0, 8), 9)[:70]
    image = np.tile(surface, (50, 1)) + rng.normal(0.0, 0.01, (50, 70))
    burr = rng.random(image.shape) < 0.1
    smooth = image.astype(np.float32)
    image[burr] = rng.uniform(0.5, 4.0, burr.sum())
    image[rng.random(image.shape) < 0.1] = np.nan
    raw = image.astype(np.float32)
    ranges = np.repeat(rng.uniform(1.0, 3.0, 30), 7)[:200] + rng.normal(0.0, 0.01, 200)
    ranges[rng.random(200) < 0.15] = np.nan
    others = [ranges + rng.normal(0.0, 0.05, 200) for _ in range(2)]
    columns = float(rng.uniform(-5.0, 5.0))
    before = np.roll(smooth, 3, axis=1)
    for sign in (1, -1):
        cx = 33.3 if sign == 1 else 69.0 - 33.3
        intrinsics = CameraIntrinsics(width=70, height=50, fx=60.0, fy=60.0, cx=cx, cy=23.1)
        camera = Camera(
            topic="/depth",
            intrinsics=intrinsics,
            T_rig_camera=make_transform(R_BODY_OPTICAL, np.zeros(3)),
        )
        mount = Mount(
            yaw_rad=sign * yaw, left_m=sign * left, forward_m=forward, delta_z_m=up, pitch_rad=pitch
        )
        T_lidar_camera = mount.T_lidar_rig @ camera.T_rig_camera
        views = [np.ascontiguousarray(view[:, ::sign]) for view in (raw, smooth, before)]
        scan = scan_of(ranges[::sign])
        yield FrameWindow(
            pairs=match_along_curve(scan, views[0], views[1], camera, T_lidar_camera),
            scan=scan,
            depth_m=views[0],
            scan_before=seen(others[0][::sign]),
            scan_after=seen(others[1][::sign]),
            depth_before_m=views[2],
            columns_before=sign * columns,
        )


@pytest.mark.parametrize("noise", [SETTINGS, PUBLISHED], ids=["support", "rougher"])
@pytest.mark.parametrize("seed", range(8))
def test_mirrored_input_gives_mirrored_classes(seed, noise):
    window, mirror = mirrored_frames(seed)
    classes, reflected = classes_of(window, noise), classes_of(mirror, noise)
    assert window.pairs.beam.size > 60
    np.testing.assert_array_equal(mirror.pairs.beam, 199 - window.pairs.beam[::-1])
    for name in ("lidar_class", "depth_class"):
        np.testing.assert_array_equal(getattr(reflected, name)[::-1], getattr(classes, name))
        assert np.unique(getattr(classes, name)).size >= 3
    for name in ("lidar_confidence", "depth_confidence", "epsilon_m"):
        np.testing.assert_allclose(
            getattr(reflected, name)[::-1], getattr(classes, name), atol=1e-9
        )


@pytest.mark.parametrize("noise", [SETTINGS, PUBLISHED], ids=["support", "rougher"])
def test_a_frame_without_a_beam_in_view_has_no_classes(noise):
    window = window_of(wall(), wall_image())
    columns = {name: value[:0] for name, value in columns_of(window.pairs) if np.ndim(value)}
    classes = classes_of(replace(window, pairs=replace(window.pairs, **columns)), noise)
    assert all(getattr(classes, field.name).size == 0 for field in fields(classes))


def test_classes_cannot_be_changed():
    classes = classes_of(window_of(wall(), wall_image()))
    for field in fields(classes):
        with pytest.raises(ValueError, match="read-only"):
            getattr(classes, field.name)[0] = 0
