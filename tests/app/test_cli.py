"""The command line: exit codes, what goes to which stream, and what people are spared."""

import ast
import dataclasses
import importlib.metadata
import io
import json
import os
import re
import subprocess
import sys
import tomllib
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import pytest

from fusion_core.model.errors import MissingStream, RecordingError
from fusion_core.workflows.source import RoomChoice
from scanloom.cli import main
from scanloom.commands.batch import Batch
from scanloom.commands.calibrate_intrinsics import CalibrateIntrinsics
from scanloom.commands.calibrate_planar import CalibratePlanar
from scanloom.commands.convert import Convert
from scanloom.commands.evaluate import (
    EvaluateAlignment,
    EvaluateMap,
    EvaluateNoise,
    EvaluateRepair,
    EvaluateTrajectory,
)
from scanloom.commands.fuse import Fuse
from scanloom.commands.info import Info
from scanloom.commands.labels import Agreement, ExportLabels, ImportLabels, LabelLog
from scanloom.commands.map import Map
from scanloom.commands.sample import Sample
from scanloom.commands.view import View
from scanloom.resources import sample_path
from tests.hostile.files import write_loop, write_pipe

ROOT = Path(__file__).parents[2]
INFO = {
    "format": "ros1",
    "start_ns": 1_000_000_000,
    "end_ns": 3_500_000_000,
    "duration_s": 2.5,
    "topics": [
        {"name": "/scan", "type": "S", "role": "lidar", "count": 20, "rate_hz": 10.0},
        {"name": "/depth", "type": "I", "role": "depth", "count": 1, "rate_hz": None},
    ],
    "can": ["It can be fused: /scan with /depth."],
    "warnings": ["2 messages of /scan were cut off"],
    "check": None,
}


def scanloom(*args: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own, from the checkout."""
    return subprocess.run(
        [sys.executable, "-m", "scanloom", *args],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        **options,
    )


@pytest.fixture
def stub(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Put functions in the place of a workflow: ``stub("info", info=...)``."""

    def put(workflow: str, **functions: Any) -> None:
        module = types.ModuleType(f"fusion_core.workflows.{workflow}")
        module.__dict__.update(functions)
        monkeypatch.setitem(sys.modules, module.__name__, module)
        monkeypatch.setattr("fusion_core.workflows." + workflow, module, raising=False)

    return put


def raising(error: BaseException) -> Callable[..., Any]:
    def work(*args: Any, **kwargs: Any) -> Any:
        raise error

    return work


def test_help_is_quick_because_nothing_heavy_is_imported() -> None:
    heavy = {"numpy", "open3d", "matplotlib", "numba", "pyarrow", "scipy", "cv2", "rosbags", "rich"}
    code = (
        "import sys\n"
        "from scanloom.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit as leave:\n    assert leave.code == 0\n"
        f"print(sorted({heavy!r} & sys.modules.keys()), file=sys.stderr)"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert run.stderr.strip() == "[]"
    for command in ("info", "convert", "fuse", "evaluate", "sample", "--version"):
        assert command in run.stdout


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["info"], ["RECORDING", "--json"]),
        (
            ["convert"],
            [
                "RECORDING",
                "-o FILE",
                "--topic TOPIC",
                "--start S",
                "--end S",
                "--overwrite",
                "--room ROOM",
            ],
        ),
        (
            ["fuse"],
            [
                *("RECORDING", "-o DIR", "--preset {default,published}", "--settings FILE"),
                *("--virtual-lidar ROW", "--lidar TOPIC", "--depth TOPIC", "--pose TOPIC"),
                *("--force", "--overwrite", "--seed INT", "--json", "--truth TRUTH.npz"),
            ],
        ),
        (["evaluate"], ["alignment", "noise", "repair", "trajectory", "relations"]),
        (["evaluate", "alignment"], ["FUSE_DIR", "TRUTH.npz", "--json"]),
        (["evaluate", "noise"], ["FUSE_DIR", "TRUTH.npz", "--lever-arm FORWARD LEFT UP"]),
        (["evaluate", "repair"], ["FUSE_DIR", "TRUTH.npz", "--json"]),
        (
            ["evaluate", "trajectory"],
            [
                *("ESTIMATE", "REFERENCE", "--align {se3,se2,sim3,none}", "--delta STEP"),
                *("--unit {s,m,frames}", "--greatest-gap S", "--json"),
            ],
        ),
        (["evaluate", "relations"], ["TRAJECTORY", "RELATIONS", "--json"]),
        (["labels"], ["export", "import", "merge", "agreement", "log", "stats"]),
        (
            ["labels", "export"],
            [
                *("RECORDING", "-o PATH", "--layer LAYER", "--labels ADDRESS", "--overwrite"),
                "{csv,jsonl,parquet,coco,png,semantic-kitti}",
            ],
        ),
        (["labels", "import"], ["RECORDING", "FILE", "--annotator NAME", "--replace"]),
        (["labels", "merge"], ["RECORDING", "OTHER", "--layer LAYER", "--replace"]),
        (["labels", "agreement"], ["RECORDING", "--layer LAYER", "--resamples N", "--seed INT"]),
        (["labels", "log"], ["RECORDING", "--last N", "--layer LAYER", "--json"]),
        (["sample"], ["SCENE", "-o FILE", "--list", "--seed INT", "--json"]),
    ],
)
def test_help_names_every_option(
    command: list[str], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as leave:
        main([*command, "--help"])
    assert leave.value.code == 0
    shown = capsys.readouterr().out
    assert [word for word in words if word not in shown] == []


def test_version_is_that_of_the_distribution(capsys: pytest.CaptureFixture[str]) -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert importlib.metadata.version("scanloom") == declared["version"]
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"scanloom {declared['version']}\n"


@pytest.mark.parametrize(
    "args",
    [
        [],
        ["weave"],
        ["info"],
        ["info", "a.bag", "b.bag"],
        ["info", "a.bag", "--jsn"],
        ["convert", "a.bag"],
        ["convert", "a.bag", "-o", "a.mcap", "--start", "now"],
        ["fuse", "a.bag"],
        ["fuse", "a.bag", "-o", "out", "--preset", "better"],
        ["fuse", "a.bag", "-o", "out", "--seed", "x"],
        ["evaluate"],
        ["evaluate", "noise", "out"],
        ["evaluate", "noise", "out", "t.npz", "--lever-arm", "1", "2"],
        ["evaluate", "trajectory", "a.tum"],
        ["evaluate", "trajectory", "a.tum", "b.tum", "--align", "se4"],
        ["evaluate", "relations", "a.tum"],
        ["labels"],
        ["labels", "export", "a.bag"],
        ["labels", "export", "a.bag", "-o", "a.xml", "--format", "voc"],
        ["labels", "import", "a.bag"],
    ],
    ids=" ".join,
)
def test_wrong_usage_leaves_with_2(args: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leave:
        main(args)
    assert leave.value.code == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "--help" in shown.err


@pytest.mark.parametrize("args", [["sample"], ["sample", "room"], ["sample", "-o", "x.mcap"]])
def test_sample_without_scene_and_file_is_wrong_usage(
    args: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(args) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.count("\n") == 1
    assert "SCENE" in shown.err


@pytest.mark.parametrize(
    "args",
    [
        ["fuse", "a.bag", "-o", "out", "--seed", "-1"],
        ["fuse", "a.bag", "-o", "out", "--virtual-lidar", "-1"],
        ["sample", "furnished_room", "-o", "x.mcap", "--seed", "-1"],
    ],
    ids=" ".join,
)
def test_a_number_below_zero_is_wrong_usage(
    args: list[str], stub: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    stub("fuse.session", FuseOptions=None)
    stub("fuse.fuse", fuse=None)
    stub("sample", write=None)
    assert main(args) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err == f"{args[-2]} must be 0 or more, got -1\n"


def test_advice_names_options_that_exist() -> None:
    commands = [View, Info, Convert, Fuse, Sample, Map, EvaluateAlignment, EvaluateNoise]
    commands += [EvaluateRepair, EvaluateTrajectory, EvaluateMap]
    commands += [ExportLabels, ImportLabels, Agreement, LabelLog, Batch]
    commands += [CalibratePlanar, CalibrateIntrinsics]
    known = {f"--{f.name.replace('_', '-')}" for c in commands for f in dataclasses.fields(c)}
    named = {
        option
        for package in ("app/scanloom", "fusion_core")
        for file in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]+", node.value)
    }
    # A field cannot have the name of the method "run".
    assert named - known == {"--help", "--version", "--run"}


SEED = ["--seed", str(2**63)]


@pytest.mark.parametrize(
    "args",
    [
        ["fuse", "a.bag", "-o", "out", *SEED],
        ["fuse", "a.bag", "-o", "out", "--seed", "9" * 4000],
        ["fuse", "a.bag", "-o", "out", "--virtual-lidar", "1000000000"],
        ["fuse", "a.bag", "-o", "out", "--subsession", "0"],
        ["map", "a.bag", "-o", "out", *SEED],
        *(["map", "a.bag", "-o", "o", "--clock-offset-ms", n] for n in ("inf", "nan", "1e300")),
        ["sample", "furnished_room", "-o", "x.mcap", *SEED],
        ["view", "a.bag", "--port", "65536"],
        ["info", "a.bag", "--subsession", "-4"],
        ["convert", "a.bag", "-o", "a.mcap", "--start", "1e300"],
        ["convert", "a.bag", "-o", "a.mcap", "--end", "inf"],
    ],
    ids=lambda args: " ".join(args)[:60],
)
def test_a_number_out_of_range_is_wrong_usage(
    args: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(args) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    option = next(arg for arg in args if arg.startswith("--"))
    assert shown.err.startswith(f"{option} must be ")
    assert shown.err.count("\n") == 1
    assert len(shown.err) < 200


@pytest.mark.parametrize("command", [["view", "a.bag"], ["fuse", "a.bag", "-o", "out"]])
def test_extrinsics_of_a_lidar_that_is_cut_from_the_camera_are_wrong_usage(
    command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command, "--extrinsics", "a.json", "--virtual-lidar", "3"]) == 2
    assert capsys.readouterr().err.startswith("--extrinsics has no LiDAR to place")


def test_an_argument_without_end_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fuse", "a.bag", "-o", "out", "--seed", "9" * 10_000]) == 2
    assert capsys.readouterr().err == "an argument is longer than 4096 characters\n"


@pytest.mark.parametrize("command", ["fuse", "map"])
def test_an_output_folder_that_leads_to_itself_is_refused(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    loop = write_loop(tmp_path / "loop")
    assert main([command, str(sample_path()), "-o", str(loop)]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == (
        f"{loop}: is not a folder. Name another output folder."
    )
    assert main([command, str(sample_path()), "-o", str(loop / "inner")]) == 1
    assert str(loop) in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    "args",
    [
        ["fuse", str(sample_path()), "-o", "{}/o", "--settings", "{}/pipe"],
        ["fuse", str(sample_path()), "-o", "{}/o", "--truth", "{}/pipe"],
        ["fuse", str(sample_path()), "-o", "{}/o", "--extrinsics", "{}/pipe"],
        ["map", str(sample_path()), "-o", "{}/o", "--scan", "merged", "--extrinsics", "{}/pipe"],
        ["evaluate", "alignment", "{}/o", "{}/pipe"],
        ["evaluate", "trajectory", "{}/pipe", "{}/pipe"],
        ["evaluate", "relations", "{}/pipe", "{}/pipe"],
        ["evaluate", "map", "{}/pipe", "{}/pipe"],
        ["evaluate", "odometry", "{}/o", "{}/pipe"],
        ["evaluate", "odometry", "{}/o", "{}/pipe.npz"],
        ["evaluate", "room", "{}/pipe"],
        ["info", "{}/pipe"],
        ["info", "{}"],
    ],
    ids=lambda args: " ".join(args).replace(str(sample_path()), "S"),
)
def test_nothing_waits_for_a_pipe(
    args: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / "trajectory.tum").write_text("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n")
    for name in ("pipe", "pipe.npz", "pipe.mcap"):
        write_pipe(tmp_path / name)
    assert main([arg.format(tmp_path) for arg in args]) == 1
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith(str(tmp_path))
    assert "Traceback" not in said


def test_info_for_people_and_for_programs(
    stub: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    asked = []
    stub("info", info=lambda path, room, session, **options: asked.append(path) or INFO)
    assert main(["info", "a.bag", "--json"]) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out) == INFO
    assert main(["info", "a.bag"]) == 0
    text = capsys.readouterr().out
    for word in ("/scan", "lidar", "10.00", "2.500 s", "It can be fused", "2 messages of /scan"):
        assert word in text
    assert asked == [Path("a.bag")] * 2


def test_info_of_a_format_without_a_clock(
    stub: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    nothing_timed = {"start_ns": None, "end_ns": None, "duration_s": None}
    stub("info", info=lambda path, room, session, **options: {**INFO, **nothing_timed})
    assert main(["info", "frames"]) == 0
    assert "time      none in this format" in capsys.readouterr().out


@pytest.mark.parametrize(
    "times", [["--start", "-1"], ["--end", "0"], ["--start", "2", "--end", "1"], ["--end", "nan"]]
)
def test_a_range_without_time_in_it_is_wrong_usage(
    times: list[str], stub: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    stub("convert", ConvertOptions=None, convert=None)
    assert main(["convert", "a.bag", "-o", "a.mcap", *times]) == 2
    assert capsys.readouterr().err == "--start must be 0 or more, and --end later\n"


def test_convert_takes_one_room(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["convert", "data", "-o", "a.mcap", "--home", "alma-s1"]) == 2
    assert capsys.readouterr().err == "--home needs --room, the one to convert\n"


def test_options_of_convert_reach_the_workflow(
    stub: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[tuple[Path, Path, dict[str, Any]]] = []
    result = {
        "file": "a.mcap",
        "format": "ROS 1 bag",
        "start_ns": 1_000_000_000,
        "end_ns": 3_500_000_000,
        "topics": [{"name": "/scan", "type": "S", "count": 19, "left_out": 1}],
        "skipped": [{"name": "/log", "type": "L", "count": 4, "reason": "it is JSON"}],
        "written": 19,
        "left_out": 5,
        "notes": ["the first is broken"],
    }

    def convert(recording: Path, output: Path, options: dict[str, Any], progress: Any) -> Any:
        progress(1, 2, "messages")
        calls.append((recording, output, options))
        return result

    stub("convert", ConvertOptions=dict, convert=convert)
    command = ["convert", "a.bag", "-o", "a.mcap"]
    assert main(command) == 0
    shown = capsys.readouterr()
    assert shown.err == "messages\n"
    for words in (
        *("from      ROS 1 bag", "1.000 s to 3.500 s, 2.500 s", "messages  19, left out 5"),
        *("/scan  19       1         S", "skipped: /log: it is JSON", "note: the first is broken"),
    ):
        assert words in shown.out
    options = {"room": None, "topics": (), "start_s": None, "end_s": None, "overwrite": False}
    assert calls.pop() == (Path("a.bag"), Path("a.mcap"), options)
    more = ["--topic", "/a", "--topic", "/b", "--start", "0", "--end", "1.5", "--overwrite"]
    assert main([*command, *more, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == result
    options |= {"topics": ("/a", "/b"), "start_s": 0.0, "end_s": 1.5, "overwrite": True}
    assert calls.pop() == (Path("a.bag"), Path("a.mcap"), options)


def test_options_of_fuse_reach_the_workflow(
    stub: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[tuple[Path, Path, dict[str, Any]]] = []

    def fuse(recording: Path, output: Path, options: dict[str, Any], progress: Any) -> Any:
        progress(1, 2, "frames")
        calls.append((recording, output, options))
        return types.SimpleNamespace(to_json=lambda: {"frames": 3}, lines=lambda: ["3 frames"])

    def fuse_rooms(
        root: Path, home: str, output: Path, options: dict[str, Any], progress: Any
    ) -> Any:
        return fuse(root / home, output, options, progress)

    stub("fuse.session", FuseOptions=dict)
    stub("fuse.fuse", fuse=fuse, FuseSummary=object)
    stub("fuse.rooms", fuse_rooms=fuse_rooms, RoomsSummary=object)
    assert main(["fuse", "a.bag", "-o", "out"]) == 0
    shown = capsys.readouterr()
    assert shown.out == "3 frames\n"
    assert shown.err == "frames\n"
    assert calls.pop() == (
        Path("a.bag"),
        Path("out"),
        {
            "preset": "default",
            "settings_file": None,
            "room": None,
            "virtual_lidar_row": None,
            "lidar_topic": None,
            "depth_topics": (),
            "pose_topic": None,
            "extrinsics_file": None,
            "apply_clock_offset": False,
            "maps": True,
            "figures": True,
            "truth": None,
            "labels": None,
            "seed": None,
            "workers": None,
            "force": False,
            "overwrite": False,
        },
    )
    every = (
        "--preset published --settings s.toml --home alma-s1 --room bedroom1 --subsession 2 "
        "--virtual-lidar 240 --lidar /s --depth /a --depth /b "
        "--pose /p --apply-clock-offset --no-maps --no-figures --truth t.npz --seed 7 "
        "--workers 3 --force --overwrite --json --output"
    )
    assert main(["fuse", *every.split(), "out", "a.bag"]) == 0
    assert json.loads(capsys.readouterr().out) == {"frames": 3}
    assert calls.pop() == (
        Path("a.bag"),
        Path("out"),
        {
            "preset": "published",
            "settings_file": Path("s.toml"),
            "room": RoomChoice(session="alma-s1", room="bedroom1", subsession=2),
            "virtual_lidar_row": 240,
            "lidar_topic": "/s",
            "depth_topics": ("/a", "/b"),
            "pose_topic": "/p",
            "extrinsics_file": None,
            "apply_clock_offset": True,
            "maps": False,
            "figures": False,
            "truth": Path("t.npz"),
            "labels": None,
            "seed": 7,
            "workers": 3,
            "force": True,
            "overwrite": True,
        },
    )
    # There is no LiDAR to place where one is cut from the images.
    assert main(["fuse", "a.bag", "-o", "out", "--extrinsics", "e.json"]) == 0
    assert calls.pop()[2]["extrinsics_file"] == Path("e.json")
    with_virtual = ["--extrinsics", "e.json", "--virtual-lidar", "240"]
    assert main(["fuse", "a.bag", "-o", "out", *with_virtual]) == 2
    # A session without a room is all its rooms.
    assert main(["fuse", "root", "--home", "alma-s1", "-o", "out"]) == 0
    assert calls.pop()[0] == Path("root/alma-s1")
    assert main(["fuse", "root", "--room", "bedroom1", "-o", "out"]) == 2


@pytest.mark.parametrize("measure", ["alignment", "noise", "repair"])
def test_each_measure_is_its_own_function(
    measure: str, stub: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    def answer(name: str) -> Callable[..., dict[str, Any]]:
        return lambda *args, **options: {
            "measure": name,
            "args": [str(arg) for arg in args],
            "u": {"share": 0.98765, "none": None},
            "curve": [1.0, 2.0],
            **{name: value for name, value in options.items() if name != "recording"},
        }

    names = ("alignment", "noise", "repair")
    stub("evaluate.evaluate", **{name: answer(name) for name in names})
    hand = ["--lever-arm", "0.05", "-0.03", "0.61", "--pitch", "-0.1", "--clock-offset-ms", "40"]
    assert main(["evaluate", measure, "out", "t.npz", *hand, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["measure"] == measure
    assert result["args"] == ["out", "t.npz"]
    assert result["lever_arm_m"] == [0.05, -0.03, 0.61]
    assert (result["pitch_rad"], result["clock_offset_ms"]) == (-0.1, 40.0)
    assert main(["evaluate", measure, "out", "t.npz"]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["u.share", "0.9877"] in lines
    assert ["u.none", "-"] in lines
    assert not any(line[0] == "curve" for line in lines)


@pytest.mark.parametrize(
    ("error", "line", "result"),
    [
        (
            RecordingError("is cut off at byte 7.", file="a.bag", advice="Run rosbag reindex."),
            "a.bag: is cut off at byte 7. Run rosbag reindex.",
            {
                "error": "is cut off at byte 7.",
                "file": "a.bag",
                "advice": "Run rosbag reindex.",
            },
        ),
        (
            MissingStream("no LaserScan."),
            "no LaserScan.",
            {"error": "no LaserScan.", "file": None, "advice": ""},
        ),
        (
            PermissionError(13, "Permission denied", "a.bag"),
            "a.bag: Permission denied.",
            {"error": "Permission denied.", "file": "a.bag", "advice": ""},
        ),
        (
            OSError("odd"),
            "odd.",
            {"error": "odd.", "file": None, "advice": ""},
        ),
        (
            RecordingError("topic \x1b[2J\nnever ends."),
            "topic \\x1b[2J\\nnever ends.",
            {"error": "topic \x1b[2J\nnever ends.", "file": None, "advice": ""},
        ),
    ],
)
def test_a_failure_is_one_line_or_one_object(
    error: Exception,
    line: str,
    result: dict[str, str | None],
    stub: Callable[..., None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    stub("info", info=raising(error))
    assert main(["info", "a.bag"]) == 1
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == ("", f"{line}\n")
    assert main(["info", "a.bag", "--json"]) == 1
    shown = capsys.readouterr()
    assert (json.loads(shown.out), shown.err) == (result, "")


def test_a_defect_is_not_dressed_up_as_bad_input(stub: Callable[..., None]) -> None:
    stub("info", info=raising(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        main(["info", "a.bag"])


def test_an_interrupt_is_one_line(
    stub: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    stub("info", info=raising(KeyboardInterrupt()))
    assert main(["info", "a.bag"]) == 130
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == ("", "interrupted\n")


def test_names_from_a_recording_cannot_steer_the_terminal(
    stub: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    stub(
        "info",
        info=lambda path, room, session, **options: {
            **INFO,
            "warnings": ["\x1b]0;title\x07 [red]é\udc80"],
        },
    )
    assert main(["info", "a.bag"]) == 0
    shown = capsys.readouterr().out
    assert "warning: \\x1b]0;title\\x07 [red]é\\x80" in shown


def test_a_narrow_encoding_of_stdout_is_no_failure(
    stub: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    stdout = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr("sys.stdout", stdout)
    stub("info", info=lambda path, room, session, **options: {**INFO, "warnings": ["σ"]})
    assert main(["info", "a.bag"]) == 0
    assert b"warning: \\u03c3\n" in stdout.buffer.getvalue()  # type: ignore[attr-defined]


def test_a_missing_recording_is_refused_without_a_traceback(tmp_path: Path) -> None:
    missing = str(tmp_path / "none.bag")
    run = scanloom("info", missing)
    assert (run.returncode, run.stdout) == (1, "")
    assert run.stderr.count("\n") == 1
    assert missing in run.stderr
    run = scanloom("info", missing, "--json")
    assert (run.returncode, run.stderr) == (1, "")
    assert json.loads(run.stdout).keys() == {"error", "file", "advice"}
    assert json.loads(run.stdout)["file"] == missing


def version_into(stdout: BinaryIO) -> subprocess.CompletedProcess[str]:
    """Its return code and stderr; stdout is buffered, so that it fails late, and again at exit."""
    return subprocess.run(
        [sys.executable, "-m", "scanloom", "--version"],
        cwd=ROOT,
        env={name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"},
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )


def test_a_reader_that_has_gone_is_no_traceback() -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    with os.fdopen(write_end, "wb") as gone:
        run = version_into(gone)
    assert (run.returncode, run.stderr) == (141, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_behind_stdout_is_one_line() -> None:
    with Path("/dev/full").open("wb") as full:
        run = version_into(full)
    assert run.returncode == 1
    assert run.stderr.count("\n") == 1
    assert run.stderr.startswith("stdout: ")
