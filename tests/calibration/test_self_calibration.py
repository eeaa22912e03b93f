"""The mounting of a turning LiDAR from planes, and the turns that do not tell it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion_core.calibration.turning.half_turn_planes import FrameSettings
from fusion_core.calibration.turning.planes import PlaneSettings
from fusion_core.calibration.turning.self_calibration import SelfCalibrationSettings, self_calibrate
from fusion_core.model.errors import CalibrationFailed
from tests.calibration.box_turns import CEILING, FLOOR, ROOM, SOMEWHERE, WALLS, make_turn

FRAMES = FrameSettings(frames=24, groups=6, frame_deg=10.0)
PLANES = PlaneSettings(points_min=120)


def calibrate(turn, method="bundle"):
    settings = SelfCalibrationSettings(method=method, points_max=100000)
    return self_calibrate(turn, settings, FRAMES, PLANES)


@pytest.fixture(scope="module")
def noisy():
    return make_turn(sigma_m=0.01, seed=3, scans=80, columns=48)


@pytest.fixture(scope="module")
def result(noisy):
    return calibrate(noisy)


def test_the_default_is_within_its_deviations(result):
    error = result.parameters - SOMEWHERE
    assert (np.abs(error) < 3.5 * result.sd).all()
    assert np.rad2deg(result.sd[:2]).max() < 0.02
    assert result.sd[2:].max() < 0.001
    assert len(result.planes) == len(ROOM)
    assert result.notes == ()


def test_the_published_method_is_near(noisy):
    published = calibrate(noisy, "half_turns")
    error = np.abs(published.parameters - SOMEWHERE)
    assert np.rad2deg(error[:2]).max() < 0.15
    assert error[2:].max() < 0.005
    assert published.covariance.shape == (4, 4)


def test_what_each_plane_is_good_for(result):
    """The floor moves with β and θ alone, the walls with the offset."""
    names = [plane.name for plane in result.planes]
    assert sorted(name.split(",")[0] for name in names) == [
        "above",
        "below",
        "upright at -90 deg",
        "upright at 0 deg",
        "upright at 180 deg",
        "upright at 90 deg",
    ]
    shares = np.stack([plane.shares for plane in result.planes])
    np.testing.assert_allclose(shares.sum(axis=0), 1.0)
    flat = np.array([not name.startswith("upright") for name in names])
    assert shares[flat].sum(axis=0)[:2].min() > 0.5
    assert shares[~flat].sum(axis=0)[2:].min() > 0.9


def test_both_halves_agree_afterwards(result):
    assert result.mismatch_before_m > 0.008
    assert result.mismatch_after_m < 0.003


def test_the_repeatability_is_that_of_song(result):
    """(19), written out."""
    groups = result.groups
    assert groups.shape == (6, 4)
    total = sum(
        (group[0] - groups[:, 0].mean()) ** 2 + (group[1] - groups[:, 1].mean()) ** 2
        for group in groups
    )
    assert result.E_r_rad == pytest.approx(np.sqrt(total / 6))
    assert np.rad2deg(result.E_r_rad) < 0.1
    assert result.E_t_m < 0.002


def test_the_same_turn_gives_the_same_bytes(noisy, result):
    again = calibrate(noisy)
    assert again.parameters.tobytes() == result.parameters.tobytes()
    assert again.covariance.tobytes() == result.covariance.tobytes()


def test_the_cloud_may_be_turned_about_the_axis(noisy, result):
    """Where the axis has its zero changes the room's bearing, and nothing of the mounting."""
    turned = replace(noisy, axis_angles_rad=noisy.axis_angles_rad + 0.7)
    # The voxels and draws are other ones.
    assert (np.abs(calibrate(turned).parameters - result.parameters) < result.sd).all()


def refused(turn, *words):
    for method in ("bundle", "half_turns"):
        with pytest.raises(CalibrationFailed) as caught:
            calibrate(turn, method)
        line = str(caught.value)
        assert "\n" not in line
        for word in words:
            assert word in line
        assert caught.value.advice


def test_floor_and_ceiling_alone_are_refused():
    refused(make_turn([FLOOR, CEILING], scans=60), "parallel", "below, 1.40 m")


def test_two_parallel_walls_are_refused():
    refused(make_turn(WALLS[:2], scans=60), "parallel")


def test_half_a_turn_is_refused():
    refused(make_turn(scans=60, turn_deg=180.0), "180 deg")


def test_an_axis_that_stands_still_is_refused():
    refused(make_turn(scans=20, turn_deg=0.0), "stands still")


def test_millimetres_are_refused():
    turn = make_turn(scans=20)
    refused(replace(turn, points_in_lidar_m=1000.0 * turn.points_in_lidar_m), "not metres")


def test_points_without_planes_are_refused():
    turn = make_turn(scans=20)
    clutter = np.random.default_rng(0).normal(0.0, 2.0, turn.points_in_lidar_m.shape)
    refused(replace(turn, points_in_lidar_m=clutter), "planes")


def test_what_is_wrong_beside_the_mounting_is_noted():
    """Points whose instants are late by a part of their scan: the halves of the fan turn apart."""
    turn = make_turn(scans=80, columns=48, sigma_m=0.005)
    first = np.array([turn.axis_angles_rad[turn.scan_indices == k].min() for k in range(80)])
    late = 0.7 * turn.axis_angles_rad + 0.3 * first[turn.scan_indices]
    smeared = replace(turn, axis_angles_rad=late)
    assert any("apart" in note for note in calibrate(smeared).notes)


def test_a_wall_that_is_not_upright_is_named_so():
    tilted = Rotation.from_euler("y", 30, degrees=True).apply([1.0, 0.0, 0.0])
    planes = [*ROOM[:2], (tuple(tilted), 2.4), *WALLS[1:]]
    names = [plane.name for plane in calibrate(make_turn(planes, sigma_m=0.005, scans=80)).planes]
    assert any(name.startswith("sloping at 0 deg") for name in names)


@pytest.mark.parametrize("scans", [24, 8])
def test_an_axis_that_stops_at_few_angles(scans):
    """Each scan at one angle: the room is turned the other way instead of the axis."""
    parts = []
    for k in range(scans):
        angle = 2.0 * np.pi * k / scans
        back = Rotation.from_euler("z", -angle)
        turned = [(tuple(back.apply(normal)), offset) for normal, offset in ROOM]
        scan = make_turn(turned, scans=1, columns=180, turn_deg=0.0, sigma_m=0.01, seed=k)
        count = len(scan.scan_indices)
        parts.append(
            replace(scan, axis_angles_rad=np.full(count, angle), scan_indices=np.full(count, k))
        )
    turn = replace(
        parts[0],
        points_in_lidar_m=np.concatenate([part.points_in_lidar_m for part in parts]),
        axis_angles_rad=np.concatenate([part.axis_angles_rad for part in parts]),
        scan_indices=np.concatenate([part.scan_indices for part in parts]),
    )
    found = calibrate(turn)
    error = np.abs(found.parameters - SOMEWHERE)
    assert np.rad2deg(error[:2]).max() < 0.03
    assert error[2:].max() < 0.002


def test_more_noise_than_was_expected(noisy):
    """5 cm, where what is left beside a plane of 6 cm to either side looks like another."""
    found = calibrate(make_turn(sigma_m=0.05, seed=1, scans=80, columns=48))
    assert len(found.planes) >= 5
    assert (np.abs(found.parameters - SOMEWHERE) < 4.5 * found.sd).all()
