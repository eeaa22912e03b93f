"""``scanloom labels``: into files and back, from store to store, compared, and read."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion_core.annotation.identity import Author
from fusion_core.exporting.labels.formats import FORMATS
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, Label
from fusion_core.workflows.labels.open_store import open_labels
from scanloom.cli import main

SCANS = tuple(Capture("lidar", "/scan", stamp_ns, 0, 1, 8) for stamp_ns in range(4))
IMAGE = Capture("depth", "/depth", 1, 0, 3, 4)
FILES = {name: f"anna{format.suffix or ''}" for name, format in FORMATS.items()}

LABELS = 22
"""How many ``annas_codes`` has."""

Codes = dict[Capture, list[list[int]]]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Any file: labels need its digest alone."""
    path = tmp_path / "room.mcap"
    path.write_bytes(b"beams and pixels")
    return path


def of_codes(codes: Codes) -> list[CaptureLabels]:
    found = []
    for capture, image in codes.items():
        row, column = np.indices((capture.rows, capture.columns)).reshape(2, -1)
        found.append(CaptureLabels.of_samples(capture, row, column, np.ravel(image)))
    return found


def state(recording: Path, layer: str, address: Path | None = None) -> Codes:
    with open_labels(recording, address, create=False) as store:
        return {one.capture: one.as_image().tolist() for one in store.labelled(layer)}


def journal_length(recording: Path, address: Path | None = None) -> int:
    with open_labels(recording, address, create=False) as store:
        return store.head()


def label(
    recording: Path, layer: str, codes: Codes, address: Path | None = None, annotator: str = "anna"
) -> None:
    with open_labels(recording, address, create=True) as store:
        assert store.label(layer, of_codes(codes), Author(annotator)) is not None


def annas_codes() -> Codes:
    codes: Codes = {scan: [[0, 0, 1, 1, 2, -1, 3, 4]] for scan in SCANS[:2]}
    codes[IMAGE] = [[0, 0, 1, -1], [2, 2, 2, 3], [-1, -1, -1, 4]]
    return dict(sorted(codes.items()))


def run_json(capsys: pytest.CaptureFixture[str], *args: str | Path, code: int = 0) -> Any:
    assert main(["labels", *map(str, args), "--json"]) == code
    return json.loads(capsys.readouterr().out)


def run_text(capsys: pytest.CaptureFixture[str], *args: str | Path, code: int = 0) -> str:
    assert main(["labels", *map(str, args)]) == code
    shown = capsys.readouterr()
    return shown.out if code == 0 or shown.out else shown.err


@pytest.mark.parametrize("name", FORMATS)
def test_export_then_import_gives_the_same_state(
    name: str, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    label(recording, "anna", annas_codes())
    output, other = tmp_path / FILES[name], tmp_path / "other.sqlite"
    exported = run_json(capsys, "export", recording, "-o", output, "--format", name)
    expected = {
        capture: codes
        for capture, codes in annas_codes().items()
        if capture.sensor in FORMATS[name].sensors
    }
    written = sum(exported["written"].values())
    assert written == sum(np.sum(np.array(codes) != NO_LABEL) for codes in expected.values())
    assert written + sum(exported["left_out"].values()) == LABELS
    arguments = ("import", recording, output, "--labels", other)
    imported = run_json(capsys, *arguments)
    assert imported["done"] is True
    assert imported["difference"]["added"] == written
    assert state(recording, "anna", other) == expected
    again = run_json(capsys, *arguments)
    assert again["difference"]["samples"] == []
    assert journal_length(recording, other) == 1
    with open_labels(recording, other, create=False) as store:
        (action,) = store.actions()
        assert (action.source, action.annotator) == ("imported", "import")
        assert action.comment == f"import of {output.name}"


def test_a_folder_is_replaced_where_export_wrote_it_and_nowhere_else(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    label(recording, "anna", annas_codes())
    folder = tmp_path / "masks"
    arguments = ("export", recording, "-o", folder, "--format", "png")
    run_json(capsys, *arguments)
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    assert set(manifest["files"]) == {"index.jsonl", "depth/1.png"}
    label(recording, "anna", {IMAGE: [[NO_LABEL] * 4] * 3})
    run_json(capsys, *arguments)
    assert not (folder / "depth/1.png").exists()
    (folder / "notes.txt").write_text("mine", encoding="utf-8")
    refused = run_json(capsys, *arguments, code=1)
    assert "notes.txt" in refused["error"]
    run_json(capsys, *arguments, "--overwrite")
    assert (folder / "notes.txt").read_text(encoding="utf-8") == "mine"


def test_a_file_is_replaced_only_when_asked(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    label(recording, "anna", annas_codes())
    file = tmp_path / "anna.csv"
    file.write_text("mine", encoding="utf-8")
    assert "--overwrite" in run_text(capsys, "export", recording, "-o", file, code=1)
    assert file.read_text(encoding="utf-8") == "mine"
    run_text(capsys, "export", recording, "-o", file, "--overwrite")
    assert file.read_text(encoding="utf-8").startswith("# scanloom labels")
    store = tmp_path / "room.mcap.labels.sqlite"
    before = store.read_bytes()
    for place in (recording, store):
        arguments = ("export", recording, "-o", place, "--format", "csv", "--overwrite")
        assert "never changed" in run_text(capsys, *arguments, code=1)
    assert (recording.read_bytes(), store.read_bytes()) == (b"beams and pixels", before)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["-o", "x.txt"], "--format"),
        (["-o", "x.csv", "--layer", "carl"], "has no layer carl"),
        (["-o", "x.csv"], "has 2 layers"),
        (["-o", "none/x.csv", "--layer", "anna"], "x.csv"),
    ],
)
def test_export_refuses_in_one_line(
    args: list[str],
    words: str,
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    label(recording, "anna", annas_codes())
    label(recording, "ben", annas_codes(), annotator="ben")
    (line,) = run_text(capsys, "export", recording, *args, code=1).splitlines()[-1:]
    assert words in line
    assert not (tmp_path / "x.csv").exists()


def later_codes() -> Codes:
    """Anna's, after one label is taken away and two are changed."""
    codes = annas_codes()
    codes[SCANS[0]] = [[NO_LABEL, 0, 1, 2, 2, -1, 3, 4]]
    codes[IMAGE] = [[0, 0, 1, -1], [2, 2, 2, 0], [-1, -1, -1, 4]]
    return codes


def test_import_never_loses_a_label_unasked(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, other = tmp_path / "anna.jsonl", tmp_path / "other.sqlite"
    label(recording, "anna", later_codes(), other)
    run_json(capsys, "export", recording, "-o", file, "--labels", other)
    label(recording, "anna", annas_codes() | {SCANS[3]: [[1] * 8]})
    before = state(recording, "anna")
    text = run_text(capsys, "import", recording, file, code=1)
    assert "0 labels added, 2 altered, 9 missing, in 3 captures" in text
    assert "--replace" in text
    rows = {tuple(line.split()) for line in text.splitlines()}
    assert {("hole", "burr", "1"), ("conflict", "good", "1"), ("hole", "none", "8")} <= rows
    assert state(recording, "anna") == before
    assert journal_length(recording) == 1

    replaced = run_json(capsys, "import", recording, file, "--replace", "--annotator", "anna")
    assert replaced["difference"]["missing"] == 9
    assert state(recording, "anna") == later_codes()
    with open_labels(recording, create=False) as store:
        assert store.undo("anna", "anna") is not None
    assert state(recording, "anna") == before


@pytest.mark.parametrize(
    "codes",
    [{SCANS[3]: [[1] * 8]}, {SCANS[0]: [[0, 0, 1, 2, 2, -1, 3, 4]]}],
    ids=["missing in the file", "altered"],
)
def test_one_label_less_or_another_is_enough_to_refuse(
    codes: Codes, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "anna.parquet"
    label(recording, "anna", annas_codes())
    run_json(capsys, "export", recording, "-o", file)
    label(recording, "anna", codes)
    assert run_json(capsys, "import", recording, file, code=1)["done"] is False
    assert state(recording, "anna") == annas_codes() | codes


def test_a_format_of_one_sensor_leaves_the_others_labels_alone(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    label(recording, "anna", annas_codes())
    folder = tmp_path / "kitti"
    run_json(capsys, "export", recording, "-o", folder, "--format", "semantic-kitti")
    label(recording, "anna", {SCANS[0]: [[2] * 8]})
    run_json(capsys, "import", recording, folder, code=1)
    run_json(capsys, "import", recording, folder, "--replace")
    assert state(recording, "anna") == annas_codes()


def change_recording(recording: Path, file: Path) -> None:
    recording.write_bytes(b"another recording")


def damage(recording: Path, file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-30])


@pytest.mark.parametrize(
    ("change", "words"), [(change_recording, "another recording"), (damage, "no whole file")]
)
def test_what_is_refused_leaves_no_store_behind(
    change: Callable[[Path, Path], None],
    words: str,
    recording: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    label(recording, "anna", annas_codes())
    file, other = tmp_path / "anna.csv", tmp_path / "other.sqlite"
    run_json(capsys, "export", recording, "-o", file)
    change(recording, file)
    refused = run_json(capsys, "import", recording, file, "--labels", other, code=1)
    assert words in refused["error"]
    assert refused["file"] == str(file)
    assert not other.exists()


def test_merging_takes_layers_under_their_names(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.sqlite"
    label(recording, "anna", annas_codes())
    label(recording, "anna", {SCANS[3]: [[1] * 8]} | {IMAGE: annas_codes()[IMAGE]}, other)
    label(recording, "ben", later_codes(), other, annotator="ben")
    merged = run_json(capsys, "merge", recording, other)
    assert merged["done"] is True
    assert state(recording, "anna") == annas_codes() | {SCANS[3]: [[1] * 8]}
    assert state(recording, "ben") == later_codes()
    assert journal_length(recording) == 3
    run_json(capsys, "merge", recording, other)
    assert journal_length(recording) == 3


def test_merging_changes_no_label_unasked(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.sqlite"
    label(recording, "anna", annas_codes())
    label(recording, "anna", later_codes(), other)
    label(recording, "ben", annas_codes(), other, annotator="ben")
    text = run_text(capsys, "merge", recording, other, code=1)
    assert "2 altered" in text
    assert "--replace" in text
    with open_labels(recording, create=False) as store:
        assert store.layers == ("anna",)
    run_json(capsys, "merge", recording, other, "--layer", "ben")
    assert state(recording, "ben") == annas_codes()
    run_json(capsys, "merge", recording, other, "--replace")
    # What only this store has stays.
    expected = later_codes()
    expected[SCANS[0]][0][0] = Label.GOOD
    assert state(recording, "anna") == expected


def test_merging_refuses_itself_and_other_recordings(
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    label(recording, "anna", annas_codes())
    monkeypatch.chdir(tmp_path)
    own = "room.mcap.labels.sqlite"
    assert "with itself" in run_json(capsys, "merge", recording, own, code=1)["error"]
    hall = tmp_path / "hall.mcap"
    hall.write_bytes(b"a hall")
    label(hall, "anna", annas_codes())
    refused = run_json(capsys, "merge", recording, f"{hall}.labels.sqlite", code=1)
    assert "hall.mcap" in refused["error"]
    assert run_json(capsys, "merge", recording, tmp_path / "none.sqlite", code=1)["error"]
    assert journal_length(recording) == 1


def test_agreement_is_shown_by_layer_class_and_pair(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    label(recording, "anna", annas_codes())
    label(recording, "ben", later_codes(), annotator="ben")
    found = run_json(capsys, "agreement", recording, "--seed", "3")
    assert found["seed"] == 3
    # LABELS, of which three are UNSURE and one is taken away; two differ.
    assert found["percent"]["value"] == pytest.approx(16 / 18)
    (pair,) = found["pairs"]
    assert (pair["first"], pair["second"], pair["samples"]) == ("anna", "ben", 18)
    assert pair["confusion"][Label.HOLE][Label.BURR] == 1
    text = run_text(capsys, "agreement", recording, "--layer", "anna", "--layer", "ben")
    for words in ("Krippendorff's alpha", "0.889 [", "anna and ben: 18 samples", "anna \\ ben"):
        assert words in text
    refused = run_json(capsys, "agreement", recording, "--layer", "anna", code=1)
    assert "two layers" in refused["error"]


def test_the_log_ends_with_the_newest_action(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    label(recording, "ben", annas_codes(), annotator="ben")
    for code in (0, 1, 2, 3):
        label(recording, "anna", {SCANS[0]: [[code] * 8]})
    with open_labels(recording, create=False) as store:
        store.undo("anna", "anna")
    actions = run_json(capsys, "log", recording)["actions"]
    assert [action["id"] for action in actions] == [1, 2, 3, 4, 5, 6]
    assert (actions[-1]["kind"], actions[-1]["target"]) == ("undo", 5)
    assert (actions[0]["annotator"], actions[0]["samples"], actions[0]["captures"]) == (
        "ben",
        LABELS,
        3,
    )
    last = run_json(capsys, "log", recording, "--last", "2")["actions"]
    assert last == actions[-2:]
    # Far from the end of the journal.
    assert (
        run_json(capsys, "log", recording, "--layer", "ben", "--last", "1")["actions"]
        == actions[:1]
    )
    lines = run_text(capsys, "log", recording).splitlines()
    assert "undo 5" in lines[-1]
    assert "8 in 1" in lines[-1]
    assert main(["labels", "log", str(recording), "--last", "0"]) == 2


def test_statistics_count_labels_and_work(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    label(recording, "anna", annas_codes())
    label(recording, "anna", {SCANS[0]: [[1] * 8]})
    label(recording, "ben", {SCANS[2]: [[3] * 8]}, annotator="ben")
    found = run_json(capsys, "stats", recording)
    assert found["layers"]["ben"] == {"good": 0, "hole": 0, "burr": 0, "conflict": 8, "unsure": 0}
    assert sum(found["layers"]["anna"].values()) == LABELS + 1
    anna, ben = found["annotators"]
    assert (anna["annotator"], anna["layer"], anna["actions"]) == ("anna", "anna", 2)
    # Two of the scan's beams were holes before.
    assert anna["samples"] == LABELS + 6
    assert anna["actions_per_minute"] > 0
    assert (ben["minutes"], ben["actions_per_minute"]) == (0.0, None)
    text = run_text(capsys, "stats", recording)
    assert [line.split()[:2] for line in text.splitlines() if line.startswith("ben")] == [
        ["ben", "0"],
        ["ben", "ben"],
    ]


@pytest.mark.parametrize("command", ["agreement", "log", "stats", "export"])
def test_a_recording_without_labels_is_said_so(
    command: str, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = ["-o", tmp_path / "x.csv"] if command == "export" else []
    refused = run_json(capsys, command, recording, *output, code=1)
    assert refused["file"] == str(tmp_path / "room.mcap.labels.sqlite")
    assert sorted(tmp_path.iterdir()) == [recording]
