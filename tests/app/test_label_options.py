"""The options that name a layer of labels: what reaches the workflow, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from fusion_core.annotation.identity import Author
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.labels import Capture, CaptureLabels, Label
from fusion_core.workflows.labels.open_store import open_labels
from scanloom.cli import main
from scanloom.resources import sample_path

CAPTURE = Capture("lidar", "/scan", 5, 0, 1, 9)
LABELS = CaptureLabels.of_samples(CAPTURE, np.zeros(2, int), np.array([3, 7]), Label.BURR)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    copy = tmp_path / "room.mcap"
    copy.write_bytes(sample_path().read_bytes())
    return copy


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("command", ["fuse", "map"])
def test_the_layer_reaches_the_run(
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: str,
    named: bool,
) -> None:
    address = tmp_path / "team.sqlite" if named else None
    with open_labels(recording, address, create=True) as store:
        store.label("anna", [LABELS], Author("anna"))
    seen = []

    def run(recording_: Path, output: Path, options, progress) -> None:
        found = options.labels.labels_of(CAPTURE)
        seen.append((options.labels.name, found.column.tolist(), found.label.tolist()))
        raise ScanLoomError("stops here.")

    monkeypatch.setattr("fusion_core.workflows.fuse.fuse.fuse", run)
    monkeypatch.setattr("fusion_core.workflows.map.build_map.build_map", run)
    args = [command, str(recording), "-o", str(tmp_path / "out"), "--labels", "anna"]
    args += ["--scan", "repaired"] if command == "map" else []
    args += ["--label-store", str(address)] if named else []
    assert main(args) == 1
    assert "stops here" in capsys.readouterr().err
    assert seen == [("anna", [3, 7], [Label.BURR, Label.BURR])]


def test_a_layer_that_is_not_there_is_named(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    args = ["fuse", str(recording), "-o", str(tmp_path / "out"), "--labels", "ben"]
    assert main(args) == 1
    assert "room.mcap.labels.sqlite" in capsys.readouterr().err
    with open_labels(recording, create=True) as store:
        store.label("anna", [LABELS], Author("anna"))
    assert main(args) == 1
    error = capsys.readouterr().err
    assert "has no layer ben" in error
    assert "anna" in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["fuse", "--label-store", "x.sqlite"], "--label-store goes with --labels"),
        (["fuse", "--labels", "anna", "--home", "alma-s1"], "not of a data set"),
        (["map", "--labels", "anna"], "--labels goes with --scan repaired"),
        (["map", "--scan", "repaired", "--label-store", "x.sqlite"], "goes with --labels"),
    ],
)
def test_options_that_contradict_are_wrong_usage(
    recording: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    args: list[str],
    words: str,
) -> None:
    command, *rest = args
    assert main([command, str(recording), "-o", str(tmp_path / "out"), *rest]) == 2
    assert words in capsys.readouterr().err


def test_a_layer_is_evaluated_with_what_was_asked(
    recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_labels(recording, create=True) as store:
        store.label("anna", [LABELS], Author("anna"))
    seen = []

    def evaluate(recording_: Path, layer, options, *, suggest, progress):
        seen.append((layer.name, options.preset, suggest))
        return {"layer": layer.name, "classes": {"lidar": {"recall": 0.25}}}

    monkeypatch.setattr("fusion_core.workflows.labels.evaluate_layer.evaluate_layer", evaluate)
    args = ["evaluate", "labels", str(recording), "--labels", "anna"]
    assert main(args) == 0
    assert "classes.lidar.recall" in capsys.readouterr().out
    assert main([*args, "--suggest", "--preset", "published", "--json"]) == 0
    assert '"recall": 0.25' in capsys.readouterr().out
    assert seen == [("anna", "default", False), ("anna", "published", True)]
