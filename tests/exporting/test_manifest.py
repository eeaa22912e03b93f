"""When an output folder is skipped, replaced or refused, and what its manifest says."""

import hashlib
import json
from pathlib import Path

import pytest

from fusion_core.exporting import manifest as manifest_module
from fusion_core.exporting.manifest import (
    OutputPlan,
    digest_input,
    plan_output,
    results_folder,
    sha256_of_file,
)
from fusion_core.model.errors import ExportError, RecordingError

FRAMES, FIGURE = "frames.csv", "figures/3.png"
RESULTS = {FRAMES: "1", FIGURE: "2"}


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "in" / "room.bag"
    path.parent.mkdir()
    path.write_bytes(b"recorded")
    return path


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"


def plan(
    out: Path,
    recording: Path,
    *,
    settings: str = "a = 1\n",
    seed: int = 0,
    force: bool = False,
    overwrite: bool = False,
) -> OutputPlan:
    return plan_output(
        out,
        inputs=[recording],
        settings_text=settings,
        seed=seed,
        force=force,
        overwrite=overwrite,
    )


def run(plan: OutputPlan, results: dict[str, str] = RESULTS) -> None:
    with results_folder(plan) as work:
        for name, content in results.items():
            (work / name).parent.mkdir(exist_ok=True)
            (work / name).write_text(content)


def content(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): path.read_text()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "manifest.json"
    }


def test_the_manifest_names_all_and_nothing_of_this_machine(out: Path, recording: Path) -> None:
    run(plan(out, recording, seed=7))
    text = (out / "manifest.json").read_text()
    manifest = json.loads(text)
    assert manifest["inputs"] == [
        {"name": "room.bag", "sha256": {"room.bag": hashlib.sha256(b"recorded").hexdigest()}}
    ]
    assert manifest["files"] == {
        FIGURE: hashlib.sha256(b"2").hexdigest(),
        FRAMES: hashlib.sha256(b"1").hexdigest(),
    }
    assert manifest["seed"] == 7
    assert manifest["settings_sha256"] == hashlib.sha256(b"a = 1\n").hexdigest()
    assert manifest["project"] == "scanloom"
    assert manifest["versions"].keys() == {
        "python",
        "numpy",
        "scipy",
        "opencv-python-headless",
        "numba",
        "gtsam",
    }
    assert str(recording.parent) not in text
    assert str(out) not in text


def test_two_runs_give_the_same_bytes(tmp_path: Path, recording: Path) -> None:
    for name in ("a", "b"):
        run(plan(tmp_path / name, recording))
    a, b = ((tmp_path / name / "manifest.json").read_bytes() for name in ("a", "b"))
    assert a == b


def test_a_second_run_is_skipped_unless_forced(out: Path, recording: Path) -> None:
    assert not plan(out, recording).skip
    run(plan(out, recording))
    assert plan(out, recording).skip
    assert not plan(out, recording, force=True).skip


def test_a_moved_input_is_the_same_input(out: Path, recording: Path, tmp_path: Path) -> None:
    run(plan(out, recording))
    elsewhere = tmp_path / "elsewhere"
    recording.parent.rename(elsewhere)
    assert plan(out, elsewhere / recording.name).skip


def test_any_change_runs_again(out: Path, recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(plan(out, recording))
    assert not plan(out, recording, settings="a = 2\n").skip
    assert not plan(out, recording, seed=1).skip
    (out / FRAMES).write_text("edited")
    assert not plan(out, recording).skip
    (out / FRAMES).unlink()
    assert not plan(out, recording).skip
    (out / FRAMES).write_text(RESULTS[FRAMES])
    assert plan(out, recording).skip
    with monkeypatch.context() as patched:
        patched.setattr(manifest_module, "project_version", lambda: "9.9")
        assert not plan(out, recording).skip
    recording.write_bytes(b"changed")
    assert not plan(out, recording).skip


def test_new_results_replace_the_old_ones(out: Path, recording: Path) -> None:
    run(plan(out, recording))
    again = plan(out, recording, settings="a = 2\n")
    run(again, {FRAMES: "new", "map.png": "3"})
    assert content(out) == {FRAMES: "new", "map.png": "3"}


def test_unknown_files_are_refused_and_named(out: Path, recording: Path) -> None:
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    with pytest.raises(ExportError, match=r"out: holds files .*: notes\.txt\. .*--overwrite"):
        plan(out, recording)
    run(plan(out, recording, overwrite=True))
    assert content(out) == {**RESULTS, "notes.txt": "mine"}
    with pytest.raises(ExportError, match="notes"):
        plan(out, recording, force=True)
    # Nothing would be written, so nothing is in danger.
    assert plan(out, recording).skip


def test_an_error_keeps_the_earlier_results(out: Path, recording: Path) -> None:
    def fail(plan: OutputPlan) -> None:
        with results_folder(plan) as work:
            (work / FRAMES).write_text("half")
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        fail(plan(out, recording))
    assert not out.exists()
    run(plan(out, recording))
    with pytest.raises(RuntimeError, match="stop"):
        fail(plan(out, recording, force=True))
    assert content(out) == RESULTS
    assert plan(out, recording).skip


@pytest.mark.parametrize("moves", [0, 1])
def test_a_run_killed_while_it_publishes_is_simply_repeated(
    out: Path, recording: Path, monkeypatch: pytest.MonkeyPatch, moves: int
) -> None:
    run(plan(out, recording))
    replace = Path.replace
    moved: list[Path] = []

    def killed(self: Path, target: Path) -> Path:
        if target.name != "manifest.json":
            if len(moved) == moves:
                raise KeyboardInterrupt
            moved.append(target)
        return replace(self, target)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            run(plan(out, recording, seed=1), {"a.csv": "1", "b.csv": "2"})
    again = plan(out, recording, seed=1)
    assert not again.skip
    run(again, {"a.csv": "1", "b.csv": "2"})
    assert content(out) == {"a.csv": "1", "b.csv": "2"}


def test_what_a_killed_run_left_is_cleared(out: Path, recording: Path) -> None:
    left = out / ".scanloom-unfinished"
    left.mkdir(parents=True)
    (left / "half.mcap").write_text("half")
    run(plan(out, recording))
    assert content(out) == RESULTS


@pytest.mark.parametrize("name", ["../in/room.bag", "figures/../../in/room.bag"])
def test_a_forged_manifest_removes_nothing_outside(out: Path, recording: Path, name: str) -> None:
    out.mkdir()
    absolute = str(recording.resolve())
    files = {name: sha256_of_file(recording), absolute: sha256_of_file(recording)}
    (out / "manifest.json").write_text(json.dumps({"files": files}))
    run(plan(out, recording))
    assert recording.read_bytes() == b"recorded"


@pytest.mark.parametrize("text", ["{", "\xff\xfe", "[" * 100_000])
def test_a_damaged_manifest_is_refused(out: Path, recording: Path, text: str) -> None:
    out.mkdir()
    (out / "manifest.json").write_text(text, encoding="latin-1")
    with pytest.raises(ExportError, match=r"manifest\.json: cannot be read as a manifest"):
        plan(out, recording)


@pytest.mark.parametrize("text", ["[]", "{}", '{"files": [1]}', '{"files": {"frames.csv": 1}}'])
def test_a_manifest_that_says_nothing_knows_no_files(out: Path, recording: Path, text: str) -> None:
    out.mkdir()
    (out / "manifest.json").write_text(text)
    (out / FRAMES).write_text("mine")
    with pytest.raises(ExportError, match=FRAMES):
        plan(out, recording)


def test_an_input_is_never_written_into(recording: Path) -> None:
    with pytest.raises(ExportError, match="lies inside the input in"):
        plan(recording.parent / "out", recording.parent)
    with pytest.raises(ExportError, match="is not a folder"):
        plan(recording, recording.parent / "other")


def test_an_input_folder_is_hashed_file_by_file(recording: Path) -> None:
    folder = recording.parent
    (folder / "sub").mkdir()
    (folder / "sub" / "manifest.json").write_text("{}")
    (folder / "manifest.json").write_text("{}")
    calls: list[tuple[int, int | None, str]] = []
    digest = digest_input(folder, lambda *call: calls.append(call))
    assert list(digest.sha256) == ["manifest.json", "room.bag", "sub/manifest.json"]
    assert digest.name == "in"
    assert calls[-1][:2] == (12, 12)
    with pytest.raises(RecordingError, match="cannot be read: No such file"):
        digest_input(folder / "nowhere")


def test_a_large_file_is_hashed_in_chunks(tmp_path: Path) -> None:
    path = tmp_path / "large"
    data = bytes(range(256)) * 10_000
    path.write_bytes(data)
    assert sha256_of_file(path) == hashlib.sha256(data).hexdigest()
