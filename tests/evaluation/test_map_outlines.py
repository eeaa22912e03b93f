"""Detection rates: of maps drawn from the outline, and against a loop over all pairs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.evaluation.map_outlines import evaluate_outlines
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.world_outline import WorldOutline
from tests.evaluation.drawn_worlds import DEPTH, WIDTH, obstacle, occupied_by, rectangle, room


@pytest.mark.parametrize("resolution_m", [0.02, 0.05, 0.1])
def test_a_map_drawn_from_the_outline_finds_all_of_it(resolution_m):
    world = room()
    report = evaluate_outlines(occupied_by(world, resolution_m), resolution_m, world).to_json()
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
    report = evaluate_outlines(west, 0.05, world).to_json()
    beyond = 2 * 0.05 / (2 * (WIDTH + DEPTH))
    assert 0.5 <= report["all"]["rate"] <= 0.5 + beyond + 0.001
    assert report["visible"] == {"outline_m": 0.0, "found_m": 0.0, "rate": None}


def test_cells_far_from_any_outline_are_false_obstacles():
    world = room()
    drawn = occupied_by(world, 0.05)
    stray = np.array([[2.0, 2.0], [4.0, 0.5], [-1.0, 1.0]])
    report = evaluate_outlines(np.concatenate([drawn, stray]), 0.05, world)
    assert report.false_cells == 3
    assert report.to_json()["false_obstacles"] == pytest.approx(3 / (len(drawn) + 3))


def test_an_empty_map_finds_nothing():
    report = evaluate_outlines(np.zeros((0, 2)), 0.05, room()).to_json()
    assert report["all"]["rate"] == 0.0
    assert report["false_obstacles"] is None


def test_a_world_without_obstacles_is_refused():
    with pytest.raises(ScanLoomError, match="no obstacles"):
        evaluate_outlines(np.zeros((1, 2)), 0.05, WorldOutline(robot_height_m=0.5, obstacles=()))


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
    report = evaluate_outlines(cells, resolution_m, world).to_json()
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
