"""Drift of odometry on paths whose errors are known."""

import numpy as np
import pytest

from fusion_core.evaluation.odometry import evaluate_odometry
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
    figures = evaluate_odometry(estimate, reference, stretch_m=2.0).to_json()
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


def test_where_the_map_lies_counts_for_nothing() -> None:
    path = Trajectory.from_planar(STAMPS_NS.copy(), random_walk(STAMPS_NS.copy(), seed=1).planar)
    elsewhere = Trajectory(
        stamps_ns=STAMPS_NS.copy(),
        T_map_body=transform_from_planar(np.array([7.0, -3.0, 2.0])) @ path.T_map_body,
    )
    figures = evaluate_odometry(elsewhere, path).to_json()
    assert figures["distance_error"] < 1e-9
    for name in ("end", "over_stretches"):
        assert figures[name]["translation_error"] < 1e-9
        assert figures[name]["rotation_deg_per_m"] < 1e-5


def test_a_path_shorter_than_a_stretch_is_refused() -> None:
    with pytest.raises(ScanLoomError, match="are 50 m apart"):
        evaluate_odometry(circle(1.0, 1.0), circle(1.0, 1.0), stretch_m=50.0)
    with pytest.raises(SettingsError, match="step must be positive"):
        evaluate_odometry(circle(1.0, 1.0), circle(1.0, 1.0), stretch_m=0.0)
