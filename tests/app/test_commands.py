"""Commands on real files: from a scene to a recording and what is inside it."""

import json
from pathlib import Path
from typing import Any

import pytest

from fusion_core.simulation.scenes import find_scene
from scanloom.cli import main
from scanloom.resources import sample_path

SHORT = "[scene]\nduration_s = 0.5\ncamera_rate_hz = 10.0\nimage_scale = 0.1\n"
COUNTS = {
    "room_1": {"/scan": 80, "/camera/depth/image_raw": 120},
    "room_2.bag": {"/scan": 80, "/camera/depth/image_raw": 120},
    "room_3": {"/scan": 60, "/camera/depth/image_raw": 90},
}


def run_json(capsys: pytest.CaptureFixture[str], *args: str, code: int = 0) -> dict[str, Any]:
    assert main([*args, "--json"]) == code
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def test_a_scene_becomes_a_recording_with_its_truth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = tmp_path / "short.toml"
    settings.write_text(SHORT, encoding="utf-8")
    file = tmp_path / "room.mcap"
    command = ["sample", "furnished_room", "-o", str(file), "--settings", str(settings)]
    written = run_json(capsys, *command, "--seed", "5")
    given = {"seed": 5, "duration_s": 0.5, "camera_rate_hz": 10.0, "image_scale": 0.1}
    assert written["settings"] == find_scene("furnished_room").settings.model_dump() | given
    truth = Path(written["truth"])
    assert written["recording"] == str(file)
    assert truth.parent == tmp_path

    info = run_json(capsys, "info", str(file))
    assert info["warnings"] == []
    counts = {topic["role"]: topic["count"] for topic in info["topics"]}
    assert (counts["lidar"], counts["depth"]) == (5, 5)

    first = file.read_bytes(), truth.read_bytes()
    refused = run_json(capsys, *command, "--seed", "6", code=1)
    assert refused["file"] == str(file)
    assert "--overwrite" in refused["advice"]
    assert (file.read_bytes(), truth.read_bytes()) == first
    run_json(capsys, *command, "--seed", "6", "--overwrite")
    assert file.read_bytes() != first[0]
    run_json(capsys, *command, "--seed", "5", "--overwrite")
    assert (file.read_bytes(), truth.read_bytes()) == first


@pytest.mark.parametrize(
    ("args", "toml", "words"),
    [
        (["nowhere", "-o", "x.mcap"], SHORT, ["nowhere", "furnished_room"]),
        (["furnished_room", "-o", "x.bag"], SHORT, ["x.bag", ".mcap"]),
        (["furnished_room", "-o", "none/x.mcap"], SHORT, ["x.mcap"]),
        (["furnished_room", "-o", "x.mcap"], "[scene]\nspeed = 1\n", ["short.toml", "speed"]),
        (
            ["furnished_room", "-o", "x.mcap"],
            "[scene]\nduration_s = -1\n",
            ["short.toml", "duration_s", "-1"],
        ),
        (["furnished_room", "-o", "x.mcap"], "[scene", ["short.toml", "TOML"]),
    ],
)
def test_sample_refuses_in_one_line(
    args: list[str],
    toml: str,
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short.toml").write_text(toml, encoding="utf-8")
    assert main(["sample", *args, "--settings", "short.toml"]) == 1
    shown = capsys.readouterr()
    (line,) = (line for line in shown.err.splitlines() if line)
    assert [word for word in words if word not in line] == []
    assert list(tmp_path.iterdir()) == [tmp_path / "short.toml"]


def test_the_list_names_scenes_and_the_built_in_recording(
    capsys: pytest.CaptureFixture[str],
) -> None:
    listed = run_json(capsys, "sample", "--list")
    assert "furnished_room" in {scene["name"] for scene in listed["scenes"]}
    assert listed["built_in"] == str(sample_path())
    assert main(["sample", "--list"]) == 0
    text = capsys.readouterr().out
    assert all(scene["name"] in text for scene in listed["scenes"])
    assert str(sample_path()) in text


@pytest.mark.parametrize("measure", ["alignment", "noise", "repair"])
def test_evaluate_refuses_a_folder_that_is_no_result(
    measure: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = tmp_path / "room.truth.npz"
    truth.write_text("no truth", encoding="utf-8")
    refused = run_json(capsys, "evaluate", measure, str(tmp_path), str(truth), code=1)
    assert refused["file"] == str(truth)
    assert refused["error"]


def test_evaluate_refuses_a_lever_arm_that_is_no_number(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hand = ["--lever-arm", "0", "nan", "0"]
    refused = run_json(capsys, "evaluate", "noise", str(tmp_path), "t.npz", *hand, code=1)
    assert "finite" in refused["error"]


@pytest.mark.data
def test_info_counts_the_messages_of_the_rooms(
    room_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    info = run_json(capsys, "info", str(room_path))
    counts = {topic["name"]: topic["count"] for topic in info["topics"]}
    assert counts | COUNTS[room_path.name] == counts
    assert info["duration_s"] == pytest.approx((info["end_ns"] - info["start_ns"]) / 1e9)
    assert info["warnings"] == []
