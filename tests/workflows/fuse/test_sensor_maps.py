"""The fused map: returns that one sensor has once clear nothing."""

from types import SimpleNamespace

import numpy as np
import pytest

from fusion_core.denoising.noise_scale import NoiseScale
from fusion_core.mapping.grid import GridSettings
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.frame_result import confirmed_beams
from fusion_core.workflows.fuse.sensor_maps import Confirmation, SensorMaps

BEAMS = 90
GOOD, HOLE, BURR, CONFLICT = range(4)
CONFIRMATION = Confirmation(scale=NoiseScale(floor_m=0.02, fraction=0.0), least=0.5)


class StandingStill:
    source = "a test"

    def at(self, stamp_ns):
        return None if stamp_ns < 0 else np.zeros(3)


def scan_of(ranges_m, stamp_ns=0):
    return LaserScan(
        stamp_ns=stamp_ns,
        received_ns=None,
        frame_id="lidar",
        angle_min_rad=0.0,
        angle_increment_rad=np.deg2rad(1.0),
        range_min_m=0.05,
        range_max_m=8.0,
        ranges_m=np.array(ranges_m, dtype=np.float64),
    )


def wall():
    return np.full(BEAMS, 3.0)


def with_value(value, *beams):
    ranges_m = wall()
    ranges_m[list(beams)] = value
    return ranges_m


def built(scans, tmp_path, *, repaired=None, confirmation=CONFIRMATION, frames=()):
    """Maps of scans (K, BEAMS), all from one pose. ``frames``: a scan's number, its beams that a
    camera sees and, where there is one, the class that a person gives them."""
    maps = SensorMaps(StandingStill(), GridSettings(), confirmation)
    raw = [scan_of(ranges_m, k) for k, ranges_m in enumerate(scans)]
    for number, beams, *decided in frames:
        maps.add_camera(raw[number], result_of(raw[number], np.array(beams), *decided))
    for number, scan in enumerate(raw):
        values = (repaired or {}).get(number, scan.ranges_m)
        codes = np.where(np.isfinite(scan.ranges_m), float(GOOD), float(HOLE))
        maps.add_scan(scan, scan.with_ranges(values, codes))
    grids, _ = maps.write(tmp_path)
    return grids


def result_of(scan, beams, decided=None):
    """The fields of a frame's result that the maps read: good beams that the camera saw too or,
    with a class that a person has ``decided``, has not."""
    frame = SimpleNamespace(
        match=SimpleNamespace(
            correspondence=SimpleNamespace(
                residual_m=np.full(beams.size, 0.0 if decided is None else np.nan)
            )
        ),
        classes=SimpleNamespace(
            lidar_class=np.full(beams.size, GOOD if decided is None else decided),
            lidar_decided=np.full(beams.size, decided is not None),
        ),
    )
    return SimpleNamespace(
        beam=beams,
        azimuth_rad=scan.angles_rad[beams],
        is_confirmed=confirmed_beams(frame),
        camera_range_m=scan.ranges_m[beams],
    )


def cell(grid, beam, range_m):
    """The log odds at a range on a beam, NaN where unknown or outside the map."""
    azimuth = np.deg2rad(beam)
    point = range_m * np.array([np.cos(azimuth), np.sin(azimuth)]) - grid.origin_m
    column, row = np.floor(point / grid.resolution_m).astype(int)
    inside = 0 <= row < grid.log_odds.shape[0] and 0 <= column < grid.log_odds.shape[1]
    return grid.log_odds[row, column] if inside else np.nan


@pytest.mark.parametrize("place", [0, 2, 4])
def test_a_spurious_return_behind_a_wall_clears_nothing_and_is_marked(tmp_path, place):
    """In the first scan, in one between others and in the last."""
    scans = [wall() for _ in range(5)]
    scans[place] = with_value(6.0, 45)
    grids = built(scans, tmp_path)
    assert cell(grids["lidar"], 45, 4.0) < 0.0
    assert cell(grids["lidar"], 45, 6.0) > 0.0
    assert np.isnan(cell(grids["fused"], 45, 4.0))
    assert cell(grids["fused"], 45, 6.0) == 0.0
    assert cell(grids["fused"], 45, 3.0) > 0.0


def test_what_several_scans_return_is_in_the_map(tmp_path):
    grids = built([with_value(2.0, *range(40, 50))] * 3, tmp_path)
    assert cell(grids["fused"], 45, 2.0) > 1.0
    assert cell(grids["fused"], 45, 1.0) < -1.0


def test_what_the_camera_sees_too_needs_no_other_scan(tmp_path):
    scans = [wall(), with_value(2.0, 45), wall()]
    assert cell(built(scans, tmp_path)["fused"], 45, 2.0) <= 0.0
    grids = built(scans, tmp_path, frames=[(1, [44, 45])])
    alone = built(scans, tmp_path)
    assert cell(grids["fused"], 45, 2.0) > cell(alone["fused"], 45, 2.0)


def test_what_a_person_calls_real_needs_no_other_scan(tmp_path):
    scans = [wall(), with_value(2.0, 45), wall()]
    alone = built(scans, tmp_path)
    for decided, is_believed in ((GOOD, True), (CONFLICT, True), (BURR, False)):
        grids = built(scans, tmp_path, frames=[(1, [44, 45], decided)])
        higher = cell(grids["fused"], 45, 2.0) > cell(alone["fused"], 45, 2.0)
        assert higher == is_believed


def test_a_repaired_beam_is_in_the_map(tmp_path):
    scans = [with_value(np.nan, *range(40, 50))] * 3
    grids = built(scans, tmp_path, repaired={1: wall()})
    assert cell(grids["fused"], 45, 3.0) > 0.0
    assert np.isnan(cell(grids["lidar"], 45, 3.0))


def test_without_confirmation_and_in_a_single_scan_all_returns_are_rays(tmp_path):
    scans = [wall(), with_value(6.0, 45), wall()]
    everything = built(scans, tmp_path, confirmation=None)
    np.testing.assert_array_equal(everything["fused"].log_odds, everything["lidar"].log_odds)
    single = built([with_value(6.0, 45)], tmp_path)
    np.testing.assert_array_equal(single["fused"].log_odds, single["lidar"].log_odds)
