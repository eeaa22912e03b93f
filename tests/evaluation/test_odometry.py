"""Drift of odometry on paths whose errors are known."""

from itertools import pairwise

import numpy as np
import pytest

from fusion_core.evaluation.odometry import StraightSegments, evaluate_odometry
from fusion_core.model.errors import ScanLoomError, SettingsError
from fusion_core.model.geometry import transform_from_planar
from fusion_core.model.trajectory import Trajectory
from tests.evaluation.random_poses import random_walk

STAMPS_NS = np.arange(41, dtype=np.int64) * 100_000_000


def circle(radius_m: float, turn_rad: float) -> Trajectory:
    """An arc to the left from the origin, the same time whatever its length."""
    heading = np.linspace(0.0, turn_rad, STAMPS_NS.size)
    x_m, y_m = radius_m * np.sin(heading), radius_m * (1.0 - np.cos(heading))
    return Trajectory.from_planar(STAMPS_NS.copy(), np.stack([x_m, y_m, heading], axis=1))


def test_a_longer_wheel_is_an_error_of_distance() -> None:
    """10 m straight on, of which the odometry makes 10.2 m."""
    x_m, flat = np.linspace(0.0, 10.0, STAMPS_NS.size), np.zeros(STAMPS_NS.size)
    reference, estimate = (
        Trajectory.from_planar(STAMPS_NS.copy(), np.stack([factor * x_m, flat, flat], axis=1))
        for factor in (1.0, 1.02)
    )
    figures = evaluate_odometry(estimate, reference, segment_m=2.0).to_json()
    assert figures["path_m"] == pytest.approx(10.0)
    assert figures["estimated_path_m"] == pytest.approx(10.2)
    assert figures["distance_error"] == pytest.approx(0.02)
    assert figures["end"] == pytest.approx(
        {"translation_error": 0.02, "rotation_deg_per_m": 0.0}, abs=1e-9
    )
    assert figures["over_stretches"]["translation_error"] == pytest.approx(0.02)
    # They begin every 0.25 m from 0 m to 8 m.
    assert (figures["stretches"], figures["stretch_m"]) == (33, 2.0)


def test_a_wheel_that_turns_too_far_is_an_error_of_angle() -> None:
    """A quarter of a circle of 4 m; the odometry turns 9 degrees more on the same distance."""
    turn_rad, extra_rad = np.pi / 2, np.radians(9.0)
    reference = circle(4.0, turn_rad)
    estimate = circle(4.0 * turn_rad / (turn_rad + extra_rad), turn_rad + extra_rad)
    figures = evaluate_odometry(estimate, reference).to_json()
    path_m = 4.0 * turn_rad
    assert figures["path_m"] == pytest.approx(path_m, rel=1e-3)
    assert figures["distance_error"] < 1e-3
    per_m = 9.0 / path_m
    assert figures["end"]["rotation_deg_per_m"] == pytest.approx(per_m, rel=1e-3)
    # Stretches are whole poses, up to a tenth off.
    assert figures["over_stretches"]["rotation_deg_per_m"] == pytest.approx(per_m, rel=0.1)


def test_drift_does_not_depend_on_the_map_frame() -> None:
    path = Trajectory.from_planar(
        STAMPS_NS.copy(), random_walk(STAMPS_NS.copy(), seed=1).planar_poses
    )
    elsewhere = Trajectory(
        stamps_ns=STAMPS_NS.copy(),
        T_map_body=transform_from_planar(np.array([7.0, -3.0, 2.0])) @ path.T_map_body,
    )
    figures = evaluate_odometry(elsewhere, path).to_json()
    assert figures["distance_error"] < 1e-9
    for name in ("end", "over_stretches"):
        assert figures[name]["translation_error"] < 1e-9
        assert figures[name]["rotation_deg_per_m"] < 1e-5


def test_a_path_shorter_than_a_segment_is_refused() -> None:
    with pytest.raises(ScanLoomError, match="are 50 m apart"):
        evaluate_odometry(circle(1.0, 1.0), circle(1.0, 1.0), segment_m=50.0)
    with pytest.raises(SettingsError, match="step must be positive"):
        evaluate_odometry(circle(1.0, 1.0), circle(1.0, 1.0), segment_m=0.0)


def polyline(corners: list[tuple[float, float]], factor: float = 1.0) -> Trajectory:
    """Straight from corner to corner in steps of 5 cm, turning on the spot; the odometry's ways
    are longer by ``factor``."""
    poses = []
    for (x, y), (to_x, to_y) in pairwise(corners):
        heading = np.arctan2(to_y - y, to_x - x)
        for fraction in np.linspace(0.0, 1.0, 1 + round(np.hypot(to_x - x, to_y - y) / 0.05)):
            poses.append((x + fraction * (to_x - x), y + fraction * (to_y - y), heading))
    planar = np.array(poses)
    planar[:, :2] *= factor
    return Trajectory.from_planar(np.arange(len(planar), dtype=np.int64) * 100_000_000, planar)


def test_straight_segments_are_those_of_table_5() -> None:
    """Ways of 3.13 m, 2.05 m and 3 m as Li drove them, of which the odometry makes 1 % more; the
    half metre between two of them is too short to count."""
    corners = [(0.0, 0.0), (3.13, 0.0), (3.13, 2.05), (2.63, 2.05), (2.63, 5.05)]
    report = evaluate_odometry(polyline(corners, 1.01), polyline(corners))
    np.testing.assert_allclose(report.straight.true_m, [3.13, 2.05, 3.0], atol=0.15)
    assert report.straight.error == pytest.approx(0.01)
    assert report.to_json()["straight"]["stretches"] == 3


def test_errors_of_either_sign_do_not_cancel() -> None:
    """Li's own numbers: 3, 6, 1, 10 and 6 mm; Σ |error| / Σ distance is 0.23 % and 0.11 %."""
    true = np.array([3.130, 2.045, 3.000])
    for estimated, percent in (([3.127, 2.051, 2.990], 0.23), ([3.132, 2.044, 3.006], 0.11)):
        straight = StraightSegments(
            begin_ns=np.arange(3), true_m=true.copy(), estimated_m=np.array(estimated)
        )
        assert straight.error is not None
        assert round(100.0 * straight.error, 2) == percent


def test_a_circle_has_no_straight_segment() -> None:
    report = evaluate_odometry(circle(1.5, 4.0), circle(1.5, 4.0))
    assert report.straight.error is None
    assert report.to_json()["straight"]["error"] is None
