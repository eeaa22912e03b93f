"""Rooms of known size, furnished, noisy and in any pose."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.evaluation.room_dimensions import RoomDimensions, measure_room
from fusion_core.model.errors import EvaluationFailed
from tests.evaluation.scanned_box import FURNITURE, SIZE_M, scan_box


def errors_m(room: RoomDimensions) -> np.ndarray:
    return np.array([room.length.value_m, room.width.value_m, room.height.value_m]) - SIZE_M


@pytest.mark.parametrize("noise_m", [0.01, 0.03])
@given(seed=st.integers(0, 10_000), yaw=st.floats(-3.2, 3.2), tilt=st.floats(-0.08, 0.08))
@settings(max_examples=2)
def test_within_a_centimetre(noise_m: float, seed: int, yaw: float, tilt: float) -> None:
    rng = np.random.default_rng(seed)
    points_m = scan_box(rng, rays=20_000, noise_m=noise_m, yaw_rad=yaw, tilt_rad=tilt)
    room = measure_room(points_m)
    assert np.abs(errors_m(room)).max() < 0.01
    # The scatter is that of the noise, less where a wall is seen at a slant.
    for dimension in (room.length, room.width, room.height):
        for wall in dimension.walls:
            assert 0.5 * noise_m < wall.scatter_m < 1.1 * noise_m
        assert 0.0 < dimension.sd_m < 0.003
        assert dimension.parallel_deg < 0.5
        assert dimension.value_m == dimension.walls[1].offset_m - dimension.walls[0].offset_m
    truth = Rotation.from_euler("xyz", [tilt, -0.7 * tilt, yaw]).as_matrix()
    assert np.abs(np.abs(np.sum(truth * room.axes, axis=0)) - 1.0).max() < 1e-4
    assert np.linalg.det(room.axes) == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("noise_m", [0.01, 0.03])
def test_twenty_rooms_within_a_centimetre(noise_m: float) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        yaw, tilt = rng.uniform(-np.pi, np.pi), rng.uniform(-0.08, 0.08)
        points_m = scan_box(rng, rays=15_000, noise_m=noise_m, yaw_rad=yaw, tilt_rad=tilt)
        assert np.abs(errors_m(measure_room(points_m))).max() < 0.01


@pytest.mark.parametrize(
    "options",
    [
        {"furniture": ()},
        {"outliers": 0.2},
        {"rays": 6000},
        {"holes": [(0, 1, (-2.0, -0.5), (2.0, 1.0)), (1, -1, (-2.0, -1.3), (-1.0, 0.8))]},
    ],
    ids=lambda options: next(iter(options)),
)
def test_other_rooms(options: dict) -> None:
    points_m = scan_box(np.random.default_rng(1), **{"rays": 15_000, "noise_m": 0.02, **options})
    assert np.abs(errors_m(measure_room(points_m))).max() < 0.01


@pytest.mark.parametrize("thickness_m", [0.1, 0.11])
def test_boards_on_half_of_a_wall_are_not_the_wall(thickness_m: float) -> None:
    end_m = SIZE_M[0] / 2.0
    board = (end_m - thickness_m, -2.6, -1.0), (end_m, -0.9, 1.3)
    thinner = (end_m - thickness_m / 2.0, -0.9, -1.3), (end_m, 0.7, 0.8)
    points_m = scan_box(
        np.random.default_rng(8),
        rays=15_000,
        noise_m=0.01,
        furniture=(*FURNITURE[:4], board, thinner),
    )
    assert np.abs(errors_m(measure_room(points_m))).max() < 0.005


def test_the_order_of_points_and_lost_points_do_not_matter() -> None:
    rng = np.random.default_rng(2)
    points_m = scan_box(rng, rays=10_000)
    room = measure_room(points_m)
    mixed = rng.permutation(np.concatenate([points_m, np.full((500, 3), np.nan)]))
    np.testing.assert_allclose(errors_m(measure_room(mixed)), errors_m(room), atol=1e-4)
    assert measure_room(mixed).points == room.points


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_missing_wall_is_refused(axis: int, sign: int) -> None:
    # At one of the ends a cupboard stands before the wall that is not there.
    points_m = scan_box(np.random.default_rng(3), rays=15_000, without=[(axis, sign)])
    with pytest.raises(EvaluationFailed, match="the room is no whole box") as caught:
        measure_room(points_m)
    if axis == 2:
        assert ("floor", "ceiling")[sign > 0] in str(caught.value)


def test_a_wall_of_the_next_room_is_left_out() -> None:
    rng = np.random.default_rng(4)
    opening = (-1.0, -1.3), (0.0, 0.8)
    points_m = scan_box(rng, rays=15_000, yaw_rad=0.0, tilt_rad=0.0, holes=[(0, 1, *opening)])
    # Through the door, on a wall 2 m behind it.
    through = rng.uniform(*opening, (1500, 2))
    seen = np.column_stack([np.full(1500, SIZE_M[0] / 2.0), through]) - (0.3, -0.2, 0.1)
    beyond = seen * ((seen[:, :1] + 2.0) / seen[:, :1])
    room = measure_room(np.concatenate([points_m, beyond]))
    assert np.abs(errors_m(room)).max() < 0.01
    # And through a wide one.
    wide = rng.uniform((-2.5, -1.3), (2.5, 1.2), (3000, 2))
    far = np.column_stack([np.full(3000, SIZE_M[0] / 2.0 + 2.0), wide]) - (0.3, -0.2, 0.1)
    room = measure_room(np.concatenate([points_m, beyond, far + np.array([1.0, 0.0, 0.0]), far]))
    assert np.abs(errors_m(room)).max() < 0.01


@pytest.mark.parametrize(
    ("points_m", "problem"),
    [
        (np.empty((0, 3)), "0 points with a position"),
        (np.full((5000, 3), np.nan), "0 points with a position"),
        (np.zeros((5000, 3)), "only 1 cubes of 0.05 m hold points"),
        (1000.0 * scan_box(np.random.default_rng(5), rays=5000), "only . cubes of 0.05 m"),
        (np.random.default_rng(6).normal(size=(5000, 3)), "no whole box|at right angles"),
        (
            np.random.default_rng(7).uniform((-3, -3, 0), (3, 3, 0.01), (5000, 3)),
            "no surfaces at right angles",
        ),
    ],
)
def test_what_is_no_room_is_one_line(points_m: np.ndarray, problem: str) -> None:
    with pytest.raises(EvaluationFailed, match=problem) as caught:
        measure_room(points_m)
    assert "\n" not in str(caught.value)
