"""``evaluate trajectory`` and ``evaluate relations`` on files, as tables and as JSON."""

import json
from pathlib import Path
from typing import Any

import pytest

from scanloom.cli import main

REFERENCE = """# timestamp tx ty tz qx qy qz qw
10.0 0 0 0 0 0 0 1
10.1 1 0 0 0 0 0 1
10.2 2 0 0 0 0 0 1
10.3 3 1 0 0 0 0 1
"""
# The reference 2 m farther left, and in its last pose another metre, turned by 90 degrees.
ESTIMATE = """10.0 0 2 0 0 0 0 1
10.1 1 2 0 0 0 0 1
10.2 2 2 0 0 0 0 1
10.3 3 4 0 0 0 0.70710678 0.70710678
"""
RELATIONS = """10.0 10.2 2 0 0 0 0 0
10.0 10.3 3 1 0 0 0 0
9.0 10.3 0 0 0 0 0 0
"""


@pytest.fixture(autouse=True)
def in_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, content in (
        ("reference.tum", REFERENCE),
        ("estimate.tum", ESTIMATE),
        ("log.relations", RELATIONS),
    ):
        Path(name).write_text(content, encoding="utf-8")


TRAJECTORY = ["evaluate", "trajectory", "estimate.tum", "reference.tum"]
RELATION = ["evaluate", "relations", "estimate.tum", "log.relations"]


def run_json(capsys: pytest.CaptureFixture[str], *args: str, code: int = 0) -> dict[str, Any]:
    assert main([*args, "--json"]) == code
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def table(capsys: pytest.CaptureFixture[str], args: list[str]) -> list[str]:
    assert main(args) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    return [" ".join(line.split()) for line in shown.out.splitlines()]


def test_a_trajectory_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    lines = table(capsys, [*TRAJECTORY, "--align", "none", "--delta", "1", "--unit", "frames"])
    assert lines == [
        "compared 4 of 4 poses, against 4",
        "coverage 100.0% of the reference's time, longest gap 0.100 s",
        "path 3.414 m",
        "relative to 1 frames, 3 pairs",
        "",
        "error unit min max mean median variance std rmse",
        "absolute m 2 3 2.25 2 0.1875 0.433 2.291",
        "absolute deg 0 90 22.5 0 1519 38.97 45",
        "relative, 1 frames m 0 1 0.3333 0 0.2222 0.4714 0.5774",
        "relative, 1 frames deg 0 90 30 0 1800 42.43 51.96",
    ]


def test_a_trajectory_for_programs(capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--align", "se2", "--delta", "0.1", "--greatest-gap", "0.5"]
    result = run_json(capsys, *TRAJECTORY, *options)
    assert (result["associated"], result["coverage"], result["alignment"]) == (4, 1.0, "se2")
    assert result["relative"]["pairs"] == 3
    assert (result["relative"]["delta"], result["relative"]["unit"]) == (0.1, "s")
    assert result["absolute"]["translation_m"]["mean"] == pytest.approx(2.25)
    aligned = result["absolute_aligned"]["translation_m"]
    assert aligned["rmse"] < result["absolute"]["translation_m"]["std"]
    assert result["T_reference_estimate"]["scale"] == 1.0
    assert result["warnings"] == []


def test_alignment_and_scale_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    lines = table(capsys, [*TRAJECTORY, "--align", "sim3", "--delta", "0.1"])
    assert any(line.startswith("aligned by sim3, scale 0.") for line in lines)
    assert sum(line.startswith("absolute, aligned ") for line in lines) == 2


def test_what_was_put_right_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    Path("estimate.tum").write_text(ESTIMATE + "10.1 9 9 9 0 0 0 1\n", encoding="utf-8")
    for args in ([*TRAJECTORY, "--delta", "0.1"], RELATION):
        lines = table(capsys, args)
        assert "warning: estimate.tum: its stamps do not ascend; its lines are sorted." in lines
        assert len(run_json(capsys, *args)["warnings"]) == 2


def test_relations_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    """The second is off by a metre and a quarter turn; undone first, it ends at (4, -1)."""
    assert table(capsys, RELATION) == [
        "relations 2 of 3 within the trajectory (66.7%)",
        "",
        "measure error translation (m) std rotation (deg) std",
        "Kümmerle absolute 0.500 0.500 45.000 45.000",
        "Kümmerle squared 0.500 0.500 4050.000 4050.000",
        "Cartographer absolute 2.062 2.062 45.000 45.000",
        "Cartographer squared 8.500 8.500 4050.000 4050.000",
    ]


def test_relations_for_programs(capsys: pytest.CaptureFixture[str]) -> None:
    result = run_json(capsys, *RELATION)
    assert (result["relations"], result["covered"]) == (3, 2)
    assert result["kuemmerle"]["translation_m"] == pytest.approx({"mean": 0.5, "std": 0.5})
    assert result["cartographer"]["rotation_deg"]["mean"] == pytest.approx(45.0)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["trajectory", "none.tum", "reference.tum"], "none.tum: No such file"),
        (["trajectory", "log.relations", "reference.tum"], "log.relations: line 1: the quaternion"),
        ([*TRAJECTORY[1:], "--delta", "0"], "step must be positive and finite, got 0"),
        ([*TRAJECTORY[1:], "--delta", "7"], "No two of the 4 poses compared are 7 s apart"),
        ([*TRAJECTORY[1:], "--greatest-gap", "-1"], "greatest gap must be positive"),
        (["relations", "estimate.tum", "none.relations"], "none.relations: No such file"),
        (["relations", "log.relations", "log.relations"], "log.relations: line 1: the quaternion"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    args: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", *args]) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    (line,) = (line for line in shown.err.splitlines() if line)
    assert words in line
    assert run_json(capsys, "evaluate", *args, code=1)["error"] in line
