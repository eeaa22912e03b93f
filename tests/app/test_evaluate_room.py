"""``evaluate room`` on a cloud, as a table and as JSON."""

import json
from pathlib import Path

import numpy as np
import pytest

from fusion_core.exporting.clouds import write_cloud
from scanloom.cli import main
from tests.evaluation.scanned_box import SIZE_M, scan_box


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    path = tmp_path / "room.ply"
    write_cloud(path, scan_box(np.random.default_rng(1), rays=15_000))
    return path


def test_for_people(cloud: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "room", str(cloud), "--true", *map(str, SIZE_M)]) == 0
    header, *rows, empty, count = capsys.readouterr().out.splitlines()
    assert header.split()[-4:] == ["true", "(m)", "error", "(mm)"]
    for row, name, true_m in zip(rows, ("length", "width", "height"), SIZE_M, strict=True):
        cells = row.split()
        assert cells[0] == name
        assert float(cells[1]) == pytest.approx(true_m, abs=0.01)
        assert float(cells[-2]) == true_m
        assert float(cells[-1]) == pytest.approx(1e3 * (float(cells[1]) - true_m), abs=0.06)
    assert empty == ""
    assert count.endswith(" points")


def test_as_json(cloud: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "room", str(cloud), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["length"]["m"] == pytest.approx(SIZE_M[0], abs=0.01)
    assert result["length"]["inliers"] > 1000
    assert "error_m" not in result["length"]
    assert result["warnings"] == []


def test_settings_and_refusals(
    cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text("[room]\ncoverage_fraction = 1.0\n")
    for args, problem in (
        ([str(cloud), "--settings", str(settings)], "room.ply: the room is no whole box: one"),
        ([str(cloud), "--true", "1", "2", "nan"], "true dimensions must be positive"),
        ([str(settings)], "settings.toml: is no cloud that can be read"),
    ):
        assert main(["evaluate", "room", *args]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert problem in line
