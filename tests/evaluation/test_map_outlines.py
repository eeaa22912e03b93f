"""Detection rates: of maps drawn from the outline, and against a loop over all pairs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.evaluation.map_measures import MapCells
from fusion_core.evaluation.map_outlines import evaluate_outlines
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.world_outline import WorldOutline
from tests.evaluation.drawn_worlds import DEPTH, WIDTH, obstacle, occupied_by, rectangle, room

NONE = np.zeros((0, 2))


def drawn(occupied_m, resolution_m=0.05, free_m=NONE):
    return MapCells(occupied_m=occupied_m, free_m=free_m, resolution_m=resolution_m)


@pytest.mark.parametrize("resolution_m", [0.02, 0.05, 0.1])
def test_a_map_drawn_from_the_outline_finds_all_of_it(resolution_m):
    world = room()
    cells = drawn(occupied_by(world, resolution_m), resolution_m)
    report = evaluate_outlines(cells, world).to_json()
    for part in ("all", "visible", "visible_to_lidar", "visible_to_camera"):
        assert report[part]["rate"] == 1.0
    assert report["all"]["outline_m"] == pytest.approx(2 * (WIDTH + DEPTH) + 1.8 + 1.0)
    assert report["visible"]["outline_m"] == pytest.approx(2 * (WIDTH + DEPTH) + 1.8)
    assert report["visible_to_lidar"]["outline_m"] == pytest.approx(2 * (WIDTH + DEPTH))
    assert report["false_obstacles"] == 0.0
    assert report["reach_m"] == pytest.approx(resolution_m + 0.02)


def test_half_of_the_map_finds_half():
    """The western half, and what the reach adds beyond it."""
    world = WorldOutline(
        robot_height_m=0.55, obstacles=(obstacle("walls", rectangle(0.0, 0.0, WIDTH, DEPTH)),)
    )
    west = occupied_by(world, 0.05, lambda points: points[points[:, 0] < WIDTH / 2])
    report = evaluate_outlines(drawn(west), world).to_json()
    beyond = 2 * 0.05 / (2 * (WIDTH + DEPTH))
    assert 0.5 <= report["all"]["rate"] <= 0.5 + beyond + 0.001
    assert report["visible"] == {"outline_m": 0.0, "found_m": 0.0, "rate": None}


def test_a_map_of_found_missing_and_false_parts_has_the_rates_of_their_lengths():
    """Four walls of 4 m, of which the sensors could see three and the map shows one and a half,
    and 1 m of wall where there is none. The cells lie on the walls, a cell apart."""
    both = {"lidar": True, "camera": True}
    ends = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0), (0.0, 0.0)]
    world = WorldOutline(
        robot_height_m=0.55,
        obstacles=tuple(
            obstacle(f"wall {number}", [ends[number], ends[number + 1]], both if number else None)
            for number in range(4)
        ),
    )
    steps_m = np.arange(0.0, 4.0, 0.05) + 0.025
    found_m = np.concatenate(
        [
            np.stack([np.full(80, 4.0), steps_m], axis=1),
            np.stack([steps_m[:40], np.full(40, 4.0)], axis=1),
        ]
    )
    false_m = np.stack([np.full(20, 2.0), 1.5 + steps_m[:20]], axis=1)
    middles = np.arange(0.2, 3.8, 0.05) + 0.025
    free_m = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
    cells = drawn(np.concatenate([found_m, false_m]), free_m=free_m)
    report = evaluate_outlines(cells, world).to_json()
    # Up to 7 cm from a cell a sample is found: 4.5 cm beyond the end of the wall that is drawn
    # half, and 6.5 cm around the corners to three undrawn ends; a centimetre is a sample. One of
    # the corners belongs to the wall that no sensor could see.
    around_m = np.sqrt(0.07**2 - 0.025**2)
    assert report["all"]["outline_m"] == pytest.approx(16.0)
    assert report["all"]["found_m"] == pytest.approx(6.045 + 3 * around_m, abs=0.02)
    assert report["all"]["rate"] == pytest.approx(report["all"]["found_m"] / 16.0)
    assert report["visible"]["outline_m"] == pytest.approx(12.0)
    assert report["visible"]["found_m"] == pytest.approx(6.045 + 2 * around_m, abs=0.015)
    assert report["visible"]["rate"] == pytest.approx(report["visible"]["found_m"] / 12.0)
    assert report["false_cells"] == 20
    assert report["false_obstacles"] == pytest.approx(20 / 140)
    assert report["mapped_m2"] == pytest.approx((140 + 72**2) * 0.05**2)
    assert report["false_cells_per_m2"] == pytest.approx(20 / report["mapped_m2"])


@pytest.mark.parametrize(("away_m", "false"), [(0.069, 0), (0.071, 1)])
def test_an_outline_that_no_sensor_could_see_makes_a_cell_true_within_the_tolerance(away_m, false):
    world = WorldOutline(
        robot_height_m=0.55, obstacles=(obstacle("hidden", [(0.0, 0.0), (2.0, 0.0)]),)
    )
    report = evaluate_outlines(drawn(np.array([[1.0, away_m]])), world)
    assert report.false_cells == false


def test_an_empty_map_finds_nothing():
    report = evaluate_outlines(drawn(NONE), room()).to_json()
    assert report["all"]["rate"] == 0.0
    assert report["false_obstacles"] is None
    assert report["false_cells_per_m2"] is None


def test_a_world_without_obstacles_is_refused():
    with pytest.raises(ScanLoomError, match="no obstacles"):
        evaluate_outlines(drawn(NONE), WorldOutline(robot_height_m=0.5, obstacles=()))


points = st.tuples(st.floats(-1.0, 3.0), st.floats(-1.0, 3.0))


@given(
    st.lists(st.lists(points, min_size=2, max_size=4, unique=True), min_size=1, max_size=3),
    st.lists(points, max_size=12),
    st.sampled_from([0.05, 0.3]),
    st.integers(0, 2**16),
)
def test_the_rates_equal_those_of_a_loop(polylines, occupied, resolution_m, seed):
    rng = np.random.default_rng(seed)
    world = WorldOutline(
        robot_height_m=0.55,
        obstacles=tuple(
            obstacle(f"o{i}", line, {"lidar": rng.random() < 0.5, "camera": rng.random() < 0.5})
            for i, line in enumerate(polylines)
            if np.linalg.norm(np.diff(line, axis=0), axis=1).sum() > 1e-3
        )
        or (obstacle("o", [(0, 0), (1, 0)]),),
    )
    cells = np.array(occupied, dtype=float).reshape(-1, 2)
    report = evaluate_outlines(drawn(cells, resolution_m), world).to_json()
    found_m = total_m = visible_m = visible_found_m = 0.0
    for own in world.obstacles:
        samples = own.samples_m()
        piece_m = own.length_m / len(samples)
        assert piece_m <= 0.01 + 1e-9
        for sample, lidar, camera in zip(
            samples, own.seen_samples("lidar"), own.seen_samples("camera"), strict=True
        ):
            near = any(np.hypot(*(cell - sample)) <= resolution_m + 0.02 for cell in cells)
            total_m += piece_m
            found_m += piece_m * near
            visible_m += piece_m * (lidar or camera)
            visible_found_m += piece_m * (near and (lidar or camera))
    assert report["all"]["outline_m"] == pytest.approx(total_m)
    assert report["all"]["found_m"] == pytest.approx(found_m)
    assert report["visible"]["outline_m"] == pytest.approx(visible_m)
    assert report["visible"]["found_m"] == pytest.approx(visible_found_m)
    assert sum(o["all"]["found_m"] for o in report["obstacles"]) == pytest.approx(found_m)


def test_samples_stand_for_pieces_of_equal_length():
    bent = obstacle("bent", [(0.0, 0.0), (0.03, 0.0), (0.03, 0.025)])
    np.testing.assert_allclose(
        bent.samples_m(),
        [
            [0.0045833, 0],
            [0.01375, 0],
            [0.0229167, 0],
            [0.03, 0.0020833],
            [0.03, 0.01125],
            [0.03, 0.0204167],
        ],
        atol=1e-6,
    )
    assert bent.sample_count == 6
