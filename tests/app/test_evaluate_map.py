"""``evaluate map`` on files: a sample's world, and maps drawn from it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion_core.exporting.ros_map import write_ros_map
from fusion_core.model.conventions import FloatArray
from fusion_core.model.grids import OccupancyGrid
from fusion_core.recordings.world_file import read_world
from fusion_core.simulation.scenes import SceneSettings, find_scene, write_scene
from scanloom.cli import main

CELL_M = 0.05


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short sample, and its map in the world's frame and in the robot's own."""
    made = tmp_path_factory.mktemp("maps")
    settings = find_scene("arena").settings.model_dump()
    short = {"duration_s": 33.0, "camera_rate_hz": 1.0, "image_scale": 0.1}
    write_scene("arena", made / "arena.mcap", settings=SceneSettings(**(settings | short)))
    world = read_world(made / "arena.world.json")
    seen = [
        obstacle.samples_m()[obstacle.seen_samples("lidar") | obstacle.seen_samples("camera")]
        for obstacle in world.obstacles
    ]
    points = np.concatenate(seen)
    draw(made, "whole", points)
    draw(made, "half", points[points[:, 0] < 2.8])
    turned = points @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + [4.0, -1.0]
    draw(made, "turned", turned)
    return made


def draw(folder: Path, name: str, points: FloatArray) -> None:
    origin = np.floor(points.min(axis=0)) - 0.5
    column, row = np.floor((points - origin) / CELL_M).astype(int).T
    log_odds = np.full((row.max() + 5, column.max() + 5), -2.0)
    log_odds[row, column] = 2.0
    x, y = origin
    grid = OccupancyGrid(resolution_m=CELL_M, origin_m=(float(x), float(y)), log_odds=log_odds)
    write_ros_map(folder, name, grid)


def run_json(capsys: pytest.CaptureFixture[str], *args: str, code: int = 0) -> dict[str, Any]:
    assert main(["evaluate", "map", *args, "--json"]) == code
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def files(folder: Path, name: str) -> list[str]:
    return [str(folder / f"{name}.yaml"), str(folder / "arena.world.json")]


def test_the_whole_map_finds_what_can_be_seen(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for options in ([], ["--align", "none"]):
        result = run_json(capsys, *files(folder, "whole"), *options)
        assert result["visible"]["rate"] > 0.995
        # What no sensor could see may lie beside what one could.
        assert result["visible"]["outline_m"] < result["all"]["found_m"] < 30.4
        assert result["all"]["outline_m"] == pytest.approx(30.47, abs=0.1)
        assert result["false_obstacles"] < 0.01
        assert result["lines"]["measured"] == 3
        assert result["lines"]["mean_absolute_error_m"] < 0.04
        assert result["angles"]["mean_absolute_error_deg"] < 1.0
    assert result["alignment"] is None


def test_half_of_the_map_finds_half(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = run_json(capsys, *files(folder, "half"), "--align", "none")
    assert 0.4 < result["visible"]["rate"] < 0.65
    by_name = {obstacle["name"]: obstacle for obstacle in result["obstacles"]}
    assert by_name["east wall"]["all"]["rate"] == 0.0
    assert by_name["C"]["visible"]["rate"] == 1.0
    assert result["lines"]["each"][1]["measured_m"] is None


def test_a_map_in_a_frame_of_its_own_is_laid_over_the_world(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = files(folder, "turned")
    assert run_json(capsys, *where, "--align", "none")["visible"]["rate"] < 0.5
    found = run_json(capsys, *where)
    assert found["visible"]["rate"] > 0.99
    assert found["alignment"]["yaw_deg"] == pytest.approx(-90.0, abs=0.3)
    assert found["alignment"]["x_m"] == pytest.approx(1.0, abs=0.03)
    assert found["alignment"]["y_m"] == pytest.approx(4.0, abs=0.03)
    guessed = run_json(capsys, *where, "--pose", "1.2", "3.8", "-1.4")
    assert guessed["visible"]["rate"] > 0.99
    given = run_json(capsys, *where, "--align", "none", "--pose", "1", "4", "-1.5707963")
    assert given["visible"]["rate"] > 0.99


def test_the_lines_for_people(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "map", *files(folder, "half")]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    lines = [" ".join(line.split()) for line in shown.out.splitlines()]
    assert lines[0].startswith("aligned by ")
    assert "outline length (m) found (m) rate" in lines
    assert any(line.startswith("east wall 3.18 0.00 0.00%") for line in lines)
    assert "line 2 5.6 - -" in lines
    assert any(
        line.startswith("1 of 3 found; mean absolute error of these ") and "relative" in line
        for line in lines
    )
    assert any(line.startswith("false 0.") and "a square metre" in line for line in lines)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["none.yaml", "arena.world.json"], "none.yaml: cannot be read"),
        (["whole.yaml", "none.json"], "none.json"),
        (["arena.world.json", "arena.world.json"], "image is missing"),
        (["whole.yaml", "whole.yaml"], "whole.yaml: Invalid JSON"),
        (["whole.yaml", "arena.world.json", "--pose", "nan", "0", "0"], "pose must be finite"),
        (["whole.yaml", "arena.world.json", "--pose", "900", "0", "0"], "fits nowhere"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    folder: Path,
    args: list[str],
    words: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(folder)
    assert main(["evaluate", "map", *args]) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    (line,) = (line for line in shown.err.splitlines() if line)
    assert words in line
    assert run_json(capsys, *args, code=1)["error"] in line
