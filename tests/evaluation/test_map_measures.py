"""Lines and angles of drawn maps: true, stretched, sheared, noisy, and missing."""

import numpy as np
import pytest

from fusion_core.evaluation.map_measures import MapCells, evaluate_measures, fit_face
from fusion_core.model.world_outline import MeasuredLine, WorldOutline
from tests.evaluation.drawn_worlds import WIDTH, occupied_by, room

NONE = np.zeros((0, 2))


def drawn(occupied_m, resolution_m, free_m=NONE):
    return MapCells(occupied_m=occupied_m, free_m=free_m, resolution_m=resolution_m)


def test_the_true_map_measures_true():
    report = evaluate_measures(drawn(occupied_by(room(), 0.02), 0.02), room()).to_json()
    assert report["lines"]["measured"] == report["angles"]["measured"] == 1
    assert report["lines"]["mean_absolute_error_m"] < 0.021
    assert report["angles"]["mean_absolute_error_deg"] < 0.2
    assert report["lines"]["each"][0]["true_m"] == WIDTH


def test_a_stretched_map_measures_longer():
    cells = occupied_by(room(), 0.01) * [1.01, 1.0]
    (line,) = evaluate_measures(drawn(cells, 0.01), room()).lines
    assert line.error == pytest.approx(0.05, abs=0.012)
    report = evaluate_measures(drawn(cells, 0.01), room()).to_json()
    assert report["lines"]["relative_error"] == pytest.approx(abs(line.error) / WIDTH)


def test_a_sheared_map_measures_another_angle():
    slope = np.tan(np.radians(2.0))
    cells = occupied_by(room(), 0.01) @ np.array([[1.0, 0.0], [slope, 1.0]])
    (angle,) = evaluate_measures(drawn(cells, 0.01), room()).angles
    assert angle.value == pytest.approx(88.0, abs=0.2)


def test_scattered_cells_pull_less_than_those_of_the_face():
    """A fit by total least squares over all of them is 10 times worse."""
    rng = np.random.default_rng(3)
    x = np.linspace(0.0, 2.0, 41)
    face = np.array([[0.0, 0.0], [2.0, 0.0]])
    wall = np.stack([x, 0.05 * rng.integers(0, 2, 41) - 0.025], axis=1)
    scattered = np.stack([rng.uniform(1.4, 2.0, 12), rng.uniform(0.08, 0.15, 12)], axis=1)
    cells = np.concatenate([wall, scattered])
    fit = fit_face(face, drawn(cells, 0.05))
    assert fit is not None
    inside = (cells[:, 0] >= 0.1) & (cells[:, 0] <= 1.9)
    slope = np.polyfit(*cells[inside].T, 1)[0]
    assert abs(fit[1][1] / fit[1][0]) < 0.4 * abs(slope)


def test_faces_missing_in_the_map_are_not_measured():
    def without_west(points):
        return points[points[:, 0] > 0.5]

    report = evaluate_measures(
        drawn(occupied_by(room(), 0.05, without_west), 0.05), room()
    ).to_json()
    assert report["lines"]["measured"] == 0
    assert report["lines"]["total"] == 1
    assert report["lines"]["missed"] == ["width"]
    assert report["lines"]["mean_absolute_error_m"] is None
    assert report["lines"]["relative_error"] is None
    assert report["lines"]["each"][0]["measured_m"] is None
    assert report["angles"]["measured"] == 0
    assert report["angles"]["missed"] == ["corner"]


def test_the_error_is_that_of_the_lines_found_and_the_others_are_named():
    """Of three lines, the map shows the first 2 % too long, the second true, and half of the
    third's faces."""
    cells, lines = [], []
    for number, (length, measured) in enumerate([(2.0, 2.04), (3.0, 3.0), (4.0, None)]):
        y = 10.0 * number
        run = y + np.arange(0.0, 2.0, 0.01)
        faces_m = np.array([[(0, y), (0, y + 2)], [(length, y), (length, y + 2)]])
        lines.append(MeasuredLine(name=f"line {number + 1}", faces_m=faces_m))
        shown = (0.0,) if measured is None else (0.0, measured)
        cells += [np.stack([np.full(200, x), run], axis=1) for x in shown]
    world = WorldOutline(robot_height_m=0.55, obstacles=(), lines=tuple(lines))
    report = evaluate_measures(drawn(np.concatenate(cells), 0.05), world).to_json()["lines"]
    assert (report["measured"], report["total"]) == (2, 3)
    assert report["missed"] == ["line 3"]
    assert report["relative_error"] == pytest.approx(0.04 / 5.0)
    assert report["mean_absolute_error_m"] == pytest.approx(0.02)


def test_the_published_sums():
    """Table 4 of Li 2022: errors of three lines over the sum of their lengths is 1.45 %."""
    true, laser_and_camera = [3.25, 5.18, 2.77], [3.181, 5.167, 2.69]
    cells, lines = [], []
    for number, (length, measured) in enumerate(zip(true, laser_and_camera, strict=True)):
        y = 10.0 * number
        run = y + np.arange(0.0, 2.0, 0.01)
        lines.append(
            MeasuredLine(
                name=str(number),
                faces_m=np.array([[(0, y), (0, y + 2)], [(length, y), (length, y + 2)]]),
            )
        )
        cells += [np.stack([np.full(200, x), run], axis=1) for x in (0.0, measured)]
    world = WorldOutline(robot_height_m=0.55, obstacles=(), lines=tuple(lines))
    report = evaluate_measures(drawn(np.concatenate(cells), 0.05), world).to_json()
    assert report["lines"]["relative_error"] == pytest.approx(0.0145, abs=5e-5)
    assert report["lines"]["mean_absolute_error_m"] == pytest.approx(0.054, abs=1e-6)


@pytest.mark.parametrize("turn_rad", [0.0, 0.4])
def test_cells_behind_a_wall_do_not_move_its_face(turn_rad):
    """Two faces 2 m apart, each with a second layer of cells at its back."""
    x = np.arange(0.0, 3.0, 0.05) + 0.025

    def row(y_m):
        return np.stack([x, np.full(x.size, y_m)], axis=1)

    c, s = np.cos(turn_rad), np.sin(turn_rad)
    turn = np.array([[c, s], [-s, c]])
    occupied_m = np.concatenate([row(y) for y in (-0.05, 0.0, 2.0, 2.05, 2.1)]) @ turn
    free_m = np.concatenate([row(0.05 * step) for step in range(1, 40)]) @ turn
    faces_m = np.array([[(0.0, 0.0), (3.0, 0.0)], [(0.0, 2.0), (3.0, 2.0)]]) @ turn
    world = WorldOutline(
        robot_height_m=0.55,
        obstacles=(),
        lines=(MeasuredLine(name="width", faces_m=faces_m),),
    )
    (line,) = evaluate_measures(drawn(occupied_m, 0.05, free_m), world).lines
    assert line.error == pytest.approx(0.0, abs=1e-9)
    (thick,) = evaluate_measures(drawn(occupied_m, 0.05), world).lines
    assert abs(thick.error) > 0.002
