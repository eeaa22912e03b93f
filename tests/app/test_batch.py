"""``scanloom batch``: a command over many recordings, as it is typed."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from fusion_core.model.errors import ScanLoomError
from fusion_core.workflows.batch.items import BatchItem
from scanloom.cli import main
from scanloom.commands.batch import split_options
from scanloom.commands.batch_call import parse_call
from scanloom.commands.options import WrongUsage
from scanloom.state.view import view_of_link
from tests.workflows.box_recording import turning, write_boxes

OPTIONS = ("--motion", "none")


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings of two robots, and a truncated one."""
    folder = tmp_path_factory.mktemp("batch") / "data"
    for robot, number in (("robot_1", 1), ("robot_1", 2), ("robot_2", 3)):
        (folder / robot).mkdir(parents=True, exist_ok=True)
        write_boxes(
            folder / robot / f"run_{number}.mcap", drive=turning, duration_s=0.3 + 0.1 * number
        )
    content = (folder / "robot_1" / "run_1.mcap").read_bytes()
    (folder / "robot_2" / "broken.mcap").write_bytes(content[:40])
    return folder


def run_json(capsys: pytest.CaptureFixture[str], *args: object, code: int = 0) -> dict[str, Any]:
    words = [str(arg) for arg in args]
    at = words.index("--") if "--" in words else len(words)
    assert main([*words[:at], "--json", *words[at:]]) == code
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def files_of(folder: Path) -> Iterator[tuple[str, bytes]]:
    for file in sorted(folder.rglob("*")):
        if file.is_file():
            yield str(file.relative_to(folder)), file.read_bytes()


def test_a_batch_writes_what_single_runs_write_and_is_resumed(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out"
    command = ("batch", recordings, "-o", output, "--run", "map", "--workers", 2, "--", *OPTIONS)
    told = run_json(capsys, *command, code=1)
    assert (told["recordings"], told["done"], told["skipped"]) == (4, 3, 0)
    (failure,) = told["failures"]
    assert failure["name"] == "robot_2-broken.mcap"
    assert Path(told["table"]) == output / "batch.parquet"
    rows = pq.read_table(told["table"]).to_pylist()
    assert [(row["name"], row["robot"], row["state"]) for row in rows] == [
        ("robot_1-run_1.mcap", "robot_1", "done"),
        ("robot_1-run_2.mcap", "robot_1", "done"),
        ("robot_2-broken.mcap", "robot_2", "failed"),
        ("robot_2-run_3.mcap", "robot_2", "done"),
    ]
    assert rows[2]["error"] == failure["error"]
    assert all(row["frames"] > 0 and row["start_ns"] > 0 for row in rows if not row["error"])
    assert "robot_2/broken.mcap" in Path(told["report"]).read_text(encoding="utf-8")

    names = sorted(path.name for path in (output / "runs").iterdir())
    assert names == ["robot_1-run_1.mcap", "robot_1-run_2.mcap", "robot_2-run_3.mcap"]

    single = tmp_path / "single"
    assert main(["map", str(recordings / "robot_2/run_3.mcap"), "-o", str(single), *OPTIONS]) == 0
    capsys.readouterr()
    assert dict(files_of(output / "runs" / "robot_2-run_3.mcap")) == dict(files_of(single))

    times = {path: path.stat().st_mtime_ns for path in (output / "runs").rglob("*")}
    (recordings / "robot_2" / "broken.mcap").rename(tmp_path / "broken.mcap")
    told = run_json(capsys, *command)
    assert (told["done"], told["skipped"], told["failures"]) == (3, 3, [])
    assert {path: path.stat().st_mtime_ns for path in (output / "runs").rglob("*")} == times


def test_the_lines_name_each_failure_with_its_reason(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / "data"
    shutil.copytree(recordings / "robot_1", data)
    (data / "empty.bag").write_bytes(b"")
    assert main(["batch", str(data), "-o", str(tmp_path / "out"), "--run", "info"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "recordings  3: 2 done (0 of them before), 1 failed"
    assert lines[1] == "failed      empty.bag  is empty."


def test_each_recording_is_the_work_of_one_process(tmp_path: Path, recordings: Path) -> None:
    """Those of a cluster may start none."""
    given: dict[str, Any] = {}

    def note(recording: Path, output: Path, options: Any, progress: Any) -> Any:
        given.update(workers=options.workers)
        raise ScanLoomError("was noted.")

    item = BatchItem(name="a", place=str(recordings), recording="a", robot="")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fusion_core.workflows.fuse.fuse.fuse", note)
        with pytest.raises(ScanLoomError, match="was noted"):
            parse_call("fuse", []).run(item, recordings, tmp_path)
    assert given == {"workers": 1}


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        (["--run", "map", "--", "--scan", "sonar"], "sonar"),
        (["--run", "map", "--", "--seed", "-1"], "--seed must be 0 or more"),
        (["--run", "fuse", "--", "--label-store", "a.db"], "--label-store goes with --labels"),
        (["--run", "fuse", "--", "--home", "alma-s1"], "each room of a data set"),
        (["--run", "fuse", "--", "-o", "elsewhere"], "one -o"),
        (["--run", "fuse", "--", "--workers", "2"], "one --workers"),
        (["--run", "evaluate", "--", "noise", "fused", "truth.npz"], "the same for each"),
        (["--run", "evaluate", "--", "noise", "{run}", "truth.npz"], "stands for nothing"),
        (["--run", "info", "--workers", "0"], "--workers must be 1 or more"),
    ],
)
def test_wrong_usage_is_found_before_anything_runs(
    given: list[str],
    problem: str,
    recordings: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    output = tmp_path / "out"
    try:
        code: object = main(["batch", str(recordings), "-o", str(output), *given])
    except SystemExit as left:
        code = left.code
    assert code == 2
    assert problem in capsys.readouterr().err
    assert not output.exists()


@pytest.mark.parametrize("place", [".", "inside", "robot_1/out"])
def test_an_output_among_the_recordings_is_one_error(
    place: str, recordings: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = recordings / place
    assert main(["batch", str(recordings), "-o", str(output), "--run", "info"]) == 1
    captured = capsys.readouterr()
    assert "which is never changed" in captured.err
    assert captured.err.count("\n") == 1


def test_placeholders_stand_for_each_recording(tmp_path: Path) -> None:
    call = parse_call("evaluate", ["noise", "fused/runs/{name}", "/truths/{stem}.truth.npz"])
    item = BatchItem(
        name="robot_1-run_1.mcap", place="/data/robot_1/run_1.mcap", recording="", robot=""
    )
    folder, truth = call.files(item)
    assert folder == Path.cwd() / "fused/runs/robot_1-run_1.mcap"
    assert truth == Path("/truths/run_1.truth.npz")


def test_what_follows_two_dashes_is_the_commands_own() -> None:
    assert split_options(["batch", "a", "--run", "fuse", "--", "--seed", "3", "--"]) == (
        ["batch", "a", "--run", "fuse"],
        ("--seed", "3", "--"),
    )
    assert split_options(["info", "--", "a"]) == (["info", "--", "a"], ())


def test_rules_for_the_whole_batch_stand_before_the_dashes() -> None:
    with pytest.raises(WrongUsage, match="one -o"):
        parse_call("map", ["-o", "elsewhere"])


def test_help_is_fast_to_load() -> None:
    script = "import sys; sys.argv[1:] = ['batch', '--help']\nfrom scanloom.cli import main\n"
    script += "try: main()\nexcept SystemExit: pass\nassert 'distributed' not in sys.modules"
    subprocess.run([sys.executable, "-c", script], check=True, stdout=subprocess.DEVNULL)


@pytest.mark.parametrize("address", ["127.0.0.1:8080", "javascript:alert(1)", "http://"])
def test_an_address_that_is_none_is_told_before_anything_runs(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], address: str
) -> None:
    output = tmp_path / "out"
    command = ["batch", str(recordings), "-o", str(output), "--run", "info"]
    assert main([*command, "--workbench", address]) == 2
    assert f"--workbench {address}" in capsys.readouterr().err
    assert not output.exists()


def test_the_settings_of_the_fleet_come_from_a_file(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, settings = tmp_path / "out", tmp_path / "fleet.toml"
    command = ("batch", recordings / "robot_1", "-o", output, "--run", "info", "--workers", 1)
    settings.write_text("[fleet]\nrecordings_min = 2\n", encoding="utf-8")
    assert main([*map(str, command), "--settings", str(settings)]) == 1
    assert "recordings_min" in capsys.readouterr().err
    assert not output.exists()
    settings.write_text("[fleet]\nfalse_alarm_rate = 0.01\n", encoding="utf-8")
    link = ("--workbench", "http://127.0.0.1:8080/")
    told = run_json(capsys, *command, "--settings", settings, *link)
    metadata = pq.read_schema(told["table"]).metadata
    assert json.loads(metadata[b"fleet_settings"])["false_alarm_rate"] == 0.01
    page = Path(told["report"]).read_text(encoding="utf-8")
    (view, *_) = re.findall(r'href="http://127.0.0.1:8080/go\?view=([^"]+)"', page)
    assert view_of_link(view).recording == "run_1.mcap"
