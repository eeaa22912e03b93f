"""What other beams and scans saw about a direction, against plain loops; and that no repair fills a
beam behind it, in rooms with glass, low boxes and lost beams."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.alignment.moved_scan import MovedScan
from fusion_core.denoising.correspondence import Correspondence
from fusion_core.denoising.nearby_returns import nearby_returns
from fusion_core.denoising.neighbourhood import FrameWindow
from fusion_core.denoising.noise import Classification
from fusion_core.denoising.noise_scale import NoiseScale
from fusion_core.denoising.repair import RepairSettings, repair
from fusion_core.model.classes import NoiseClass, RepairSource
from fusion_core.model.sensors import LaserScan
from tests.denoising.seen_scans import seen

GOOD, HOLE, BURR, CONFLICT = NoiseClass
RAW, OTHER, NEIGHBOURS, NONE = RepairSource
BEAMS = 80
SCALE = NoiseScale(floor_m=0.02, fraction=0.0)
# Not the defaults: what is tested here must hold however those are tuned.
SETTINGS = RepairSettings(
    max_gap_deg=8.0,
    edge_m=0.25,
    farther_confidence=0.0,
    check_nearby=True,
    confirm_line=0.5,
    confirm_in_time=0.8,
)


def scan_of(ranges_m):
    return LaserScan(
        stamp_ns=0,
        received_ns=None,
        frame_id="lidar",
        angle_min_rad=-0.35,
        angle_increment_rad=np.deg2rad(0.5),
        range_min_m=0.05,
        range_max_m=8.0,
        ranges_m=np.array(ranges_m, dtype=np.float64),
    )


def window_of(lidar, *, before=None, after=None, camera=None, blocked=None):
    """A frame of which beams 10 to 69 are in the camera's view, whose image has no depth."""
    scan = scan_of(lidar)
    beam = np.arange(10, BEAMS - 10)
    missing = np.full(beam.size, np.nan)
    pairs = Correspondence(
        model="curve",
        beam=beam,
        row=np.full(beam.size, -1),
        column=np.full(beam.size, -1),
        azimuth_rad=scan.angles_rad[beam],
        lidar_range_m=scan.ranges_m[beam],
        depth_m=missing,
        depth_as_range_m=missing,
        lidar_as_depth_m=missing,
        camera_range_m=missing if camera is None else camera[beam],
        camera_blocked=np.zeros(beam.size, dtype=np.bool_) if blocked is None else blocked[beam],
        residual_m=missing,
    )
    return FrameWindow(
        pairs=pairs,
        scan=scan,
        depth_m=np.full((4, 4), np.nan, dtype=np.float32),
        scan_before=before if before is None or isinstance(before, MovedScan) else seen(before),
        scan_after=after if after is None or isinstance(after, MovedScan) else seen(after),
    )


def repaired(window, settings_=SETTINGS, burr=()):
    """(BEAMS,) ranges and sources; beams outside the view as they are."""
    beam = window.pairs.beam
    lidar_class = np.where(np.isnan(window.pairs.lidar_range_m), HOLE, GOOD)
    lidar_class[np.isin(beam, burr)] = BURR
    ones = np.ones(beam.size)
    classes = Classification(
        lidar_class=lidar_class,
        depth_class=np.full(beam.size, -1),
        lidar_confidence=ones,
        depth_confidence=ones.copy(),
        epsilon_m=0.1 * ones,
        lidar_steady=np.zeros(beam.size, dtype=np.bool_),
        lidar_decided=np.zeros(beam.size, dtype=np.bool_),
        depth_decided=np.zeros(beam.size, dtype=np.bool_),
        beam_evidence=np.zeros((beam.size, 5)),
        beam_support=np.zeros((beam.size, 3), dtype=np.int64),
        pixel_support=np.zeros((beam.size, 2), dtype=np.int64),
        pixel_unconfirmed=np.zeros(beam.size, dtype=np.bool_),
        pixel_through=np.zeros(beam.size, dtype=np.bool_),
    )
    result = repair(window, classes, SCALE, settings_)
    value, source = window.scan.ranges_m.copy(), np.full(BEAMS, int(RAW))
    value[beam], source[beam] = result.lidar_range_m, result.lidar_source
    return value, source


def wall():
    return np.full(BEAMS, 3.0)


def with_values(values, value, where):
    changed = values.copy()
    changed[where] = value
    return changed


# What was seen.


@given(
    seed=st.integers(0, 10_000),
    scans=st.tuples(st.booleans(), st.booleans()),
)
@settings(max_examples=60)
def test_nearby_returns_equal_a_loop_over_the_beams(seed, scans):
    rng = np.random.default_rng(seed)
    lidar, before, after = np.where(
        rng.random((3, BEAMS)) < 0.4, np.nan, rng.choice([1.0, 1.1, 2.0], (3, BEAMS))
    )
    present = [
        seen(scan, np.isfinite(scan) | (rng.random(BEAMS) < 0.6)) if is_there else None
        for scan, is_there in zip((before, after), scans, strict=True)
    ]
    window = window_of(lidar, before=present[0], after=present[1])
    nearby = nearby_returns(window).about(window.pairs.beam)
    probe_m = rng.choice([0.9, 1.05, 2.05], window.pairs.beam.size)
    tolerance_m = np.full(probe_m.size, 0.07)
    before_probe = nearby.any_before(probe_m)
    fraction = nearby.confirmed_fraction(probe_m, tolerance_m)
    between_m = nearby.between_scans_m()
    for i, beam in enumerate(window.pairs.beam):
        returns = [lidar[beam - 1], lidar[beam + 1]]
        looked = agreeing = about = returned = 0
        medians = []
        for scan in present:
            own = []
            for step in range(-3, 4):
                other = beam + step
                if scan is None or not 0 <= other < BEAMS or not scan.looked[other]:
                    continue
                about += 1
                value = scan.ranges_m[other]
                returned += bool(np.isfinite(value))
                if abs(step) <= 1:
                    looked += 1
                    agreeing += bool(abs(value - probe_m[i]) <= 0.07)
                    own.append(value)
            returns += own
            known = [value for value in own if np.isfinite(value)]
            medians.append(np.median(known) if known else np.nan)
        assert before_probe[i] == any(value < probe_m[i] for value in returns)
        assert fraction[i] == (agreeing / looked if looked else 0.0)
        assert nearby.returned_fraction[i] == (returned / about if about else 0.0)
        np.testing.assert_allclose(between_m[i], np.mean(medians))


# What is filled.


def test_a_line_is_filled_where_the_scans_before_and_after_return_it():
    lidar = with_values(wall(), np.nan, slice(30, 36))
    value, source = repaired(window_of(lidar, before=wall(), after=wall()))
    np.testing.assert_allclose(value[30:36], 3.0, atol=0.01)
    assert (source[30:36] == NEIGHBOURS).all()


def test_what_is_lost_in_every_scan_stays_a_hole():
    """A pane or a dark cupboard stands before the wall, which both sides of the gap show."""
    lost = with_values(wall(), np.nan, slice(30, 36))
    value, source = repaired(window_of(lost, before=lost, after=lost))
    assert np.isnan(value[31:35]).all()
    assert (source[31:35] == NONE).all()
    value, _ = repaired(window_of(lost, before=lost, after=lost), without_check())
    np.testing.assert_allclose(value[30:36], 3.0, atol=0.01)


def without_check():
    return SETTINGS.model_copy(update={"check_nearby": False})


def test_behind_a_pane_through_which_some_beams_pass_next_to_nothing_is_filled():
    """A sixth of the beams on the pane return the wall behind it, in each scan others."""
    rng = np.random.default_rng(1)
    pane = slice(20, 60)
    filled = lost = filled_unchecked = 0
    for _ in range(200):
        scans = np.tile(wall(), (3, 1))
        through = rng.random((3, BEAMS)) < 1.0 / 6.0
        scans[:, pane] = np.where(through[:, pane], 3.0, np.nan)
        window = window_of(scans[0], before=scans[1], after=scans[2])
        inner = slice(24, 56)
        lost += np.isnan(scans[0][inner]).sum()
        filled += np.isin(repaired(window)[1][inner], (OTHER, NEIGHBOURS)).sum()
        unchecked = repaired(window, without_check())[1][inner]
        filled_unchecked += np.isin(unchecked, (OTHER, NEIGHBOURS)).sum()
    assert filled_unchecked / lost > 0.3
    assert filled / lost < 0.01


def test_no_camera_looks_past_a_box_that_the_lidar_alone_meets():
    """At the edge of the box a mixed pixel lies between it and the wall that the camera sees."""
    lidar = with_values(with_values(wall(), 1.5, slice(30, 45)), 2.2, 30)
    window = window_of(lidar, before=lidar, after=lidar, camera=wall())
    value, source = repaired(window, burr=(30,))
    assert (value[30], source[30]) == (2.2, RAW)
    assert repaired(window, without_check(), burr=(30,))[0][30] == 3.0


@pytest.mark.parametrize("where", ["before", "after"])
def test_a_return_in_a_neighbouring_scan_bounds_the_camera(where):
    lost = with_values(wall(), np.nan, slice(30, 36))
    scans = {"before": lost, "after": lost} | {where: with_values(lost, 2.0, 33)}
    value, source = repaired(window_of(lost, **scans, camera=wall()))
    np.testing.assert_array_equal(source[30:36], [OTHER, OTHER, NONE, NONE, NONE, OTHER])
    # A return less than the depth of an edge before it is the same surface.
    scans[where] = with_values(lost, 2.8, 33)
    assert (repaired(window_of(lost, **scans, camera=wall()))[1][30:36] == OTHER).all()
    assert np.isnan(value[32:35]).all()


def test_a_camera_whose_way_passed_behind_something_fills_nothing():
    lost = with_values(wall(), np.nan, slice(30, 36))
    blocked = np.zeros(BEAMS, dtype=np.bool_)
    blocked[33:36] = True
    window = window_of(lost, before=lost, after=lost, camera=wall(), blocked=blocked)
    np.testing.assert_array_equal(repaired(window)[1][30:36], [OTHER] * 3 + [NONE] * 3)


# A pane in the wall, or in the wall's stead between two boxes of different range.
OPENING = np.arange(30, 50)


def scans_through_opening(sides_m, returning=()):
    """Scans before, at and after an instant: the opening returns nothing but, in one of the scans,
    5 m from beyond it."""
    left_m, right_m = sides_m
    surface = np.where(np.arange(BEAMS) < 40, left_m, right_m)
    scans = [with_values(surface, np.nan, OPENING) for _ in range(3)]
    for scan, beams in zip(scans, np.array_split(np.array(returning, dtype=int), 3), strict=True):
        scan[beams] = 5.0
    return scans


@pytest.mark.parametrize("sides_m", [(3.0, 3.0), (2.0, 3.5)], ids=["wall", "boxes"])
@pytest.mark.parametrize("returning", [(), (31, 33, 30, 49, 48, 41)], ids=["none", "few"])
def test_what_the_camera_sees_through_a_pane_fills_nothing(sides_m, returning):
    before, lidar, after = scans_through_opening(sides_m, returning)
    camera = with_values(wall(), 5.0, OPENING)
    value, _ = repaired(window_of(lidar, before=before, after=after, camera=camera))
    lost = OPENING[np.isnan(lidar[OPENING])]
    assert np.isnan(value[lost]).all()


def test_what_the_camera_sees_before_a_gap_or_in_it_fills_the_gap():
    for seen_m in (1.5, 3.0, 3.2):
        before, lidar, after = scans_through_opening((3.0, 3.0))
        camera = with_values(wall(), seen_m, OPENING)
        value, source = repaired(window_of(lidar, before=before, after=after, camera=camera))
        assert value[OPENING] == pytest.approx(seen_m)
        assert (source[OPENING] == OTHER).all()


def test_beams_lost_once_in_an_open_door_are_filled_from_the_camera():
    beyond = with_values(wall(), 5.0, OPENING)
    lidar = with_values(beyond, np.nan, OPENING)
    value, source = repaired(window_of(lidar, before=beyond, after=beyond, camera=beyond))
    # The outer beams lie beside the wall.
    inner = OPENING[1:-1]
    assert value[inner] == pytest.approx(5.0)
    assert (source[inner] == OTHER).all()


def test_an_opening_at_the_end_of_a_scan_has_no_sides():
    before, lidar, after = (with_values(wall(), np.nan, np.arange(60, BEAMS)) for _ in range(3))
    camera = with_values(wall(), 5.0, np.arange(60, BEAMS))
    value, _ = repaired(window_of(lidar, before=before, after=after, camera=camera))
    assert value[61:70] == pytest.approx(5.0)


def test_where_no_line_crosses_the_gap_the_scans_before_and_after_fill_it():
    """The gap ends at the edge between a cupboard and the wall; the robot approaches by 4 cm."""
    scene = np.where(np.arange(BEAMS) < 40, 2.0, 3.0)
    lidar = with_values(scene, np.nan, slice(30, 40))
    window = window_of(lidar, before=scene + 0.02, after=scene - 0.02)
    value, source = repaired(window)
    np.testing.assert_allclose(value[30:39], 2.0, atol=1e-9)
    assert (source[30:39] == NEIGHBOURS).all()


def test_scans_before_and_after_fill_no_beam_whose_neighbour_sees_past_them():
    """Something near has moved over this direction: at its edge the other scans are off."""
    lost = with_values(wall(), np.nan, slice(29, 41))
    near = with_values(wall(), 2.0, slice(20, 40))
    # The gap is too wide for a line, and the wall is seen on its right alone.
    narrow = SETTINGS.model_copy(update={"max_gap_deg": 1.0})
    value, source = repaired(window_of(lost, before=near, after=near), narrow)
    assert (source[29:38] == NEIGHBOURS).tolist() == [False] + [True] * 8
    lost[34] = 3.0
    value, source = repaired(window_of(lost, before=near, after=near), narrow)
    assert (source[[33, 35]] == NONE).all()
    np.testing.assert_allclose(value[[31, 32, 36, 37]], 2.0)


@given(seed=st.integers(0, 100_000))
@settings(max_examples=60)
def test_no_beam_is_filled_behind_what_was_seen_about_its_direction(seed):
    """Three scans of random surfaces with lost beams, a camera that says anything."""
    rng = np.random.default_rng(seed)
    surface = np.repeat(rng.uniform(1.0, 4.0, 8), 10)
    scans = surface + rng.normal(0.0, 0.02, (3, BEAMS))
    scans[rng.random((3, BEAMS)) < 0.3] = np.nan
    camera = np.where(rng.random(BEAMS) < 0.5, surface, rng.uniform(0.5, 6.0, BEAMS))
    value, source = repaired(window_of(scans[0], before=scans[1], after=scans[2], camera=camera))
    for beam in np.flatnonzero((source == OTHER) | (source == NEIGHBOURS)):
        about = [scans[0][beam - 1], scans[0][beam + 1], *scans[1:, beam - 1 : beam + 2].ravel()]
        assert value[beam] - np.nanmin([*about, np.inf]) <= SETTINGS.edge_m + 1e-12
