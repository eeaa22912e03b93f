"""When an output folder is skipped, replaced or refused, and what its manifest says."""

import hashlib
import json
from pathlib import Path

import pytest

from fusion_core.exporting import manifest as manifest_module
from fusion_core.exporting import output_folder
from fusion_core.exporting.manifest import digest_input, require_intact, sha256_of_file
from fusion_core.exporting.output_folder import OutputPlan, RunRequest, plan_output, results_folder
from fusion_core.model.errors import ExportError, RecordingError, ScanLoomError

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
    command: str = "fuse",
    also_read: tuple[Path, ...] = (),
    settings: str = "a = 1\n",
    seed: int = 0,
    force: bool = False,
    overwrite: bool = False,
) -> OutputPlan:
    request = RunRequest(
        command=command,
        inputs=[recording],
        also_read=also_read,
        settings_text=settings,
        seed=seed,
    )
    return plan_output(out, request, force=force, overwrite=overwrite)


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


def test_the_manifest_names_the_run_and_nothing_of_this_machine(out: Path, recording: Path) -> None:
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
    assert not plan(out, recording).is_done
    run(plan(out, recording))
    assert plan(out, recording).is_done
    assert not plan(out, recording, force=True).is_done


def test_a_moved_input_is_the_same_input(out: Path, recording: Path, tmp_path: Path) -> None:
    run(plan(out, recording))
    elsewhere = tmp_path / "elsewhere"
    recording.parent.rename(elsewhere)
    assert plan(out, elsewhere / recording.name).is_done


def test_any_change_runs_again(out: Path, recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(plan(out, recording))
    assert not plan(out, recording, settings="a = 2\n").is_done
    assert not plan(out, recording, seed=1).is_done
    (out / FRAMES).write_text("edited")
    assert not plan(out, recording).is_done
    (out / FRAMES).unlink()
    assert not plan(out, recording).is_done
    (out / FRAMES).write_text(RESULTS[FRAMES])
    assert plan(out, recording).is_done
    with monkeypatch.context() as patched:
        patched.setattr(manifest_module, "project_version", lambda: "9.9")
        assert not plan(out, recording).is_done
    recording.write_bytes(b"changed")
    assert not plan(out, recording).is_done


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
    assert plan(out, recording).is_done


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
    assert plan(out, recording).is_done


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
    assert not again.is_done
    run(again, {"a.csv": "1", "b.csv": "2"})
    assert content(out) == {"a.csv": "1", "b.csv": "2"}


def test_what_a_killed_run_left_is_cleared(out: Path, recording: Path) -> None:
    left = out / ".scanloom-unfinished"
    left.mkdir(parents=True)
    (left / "half.mcap").write_text("half")
    run(plan(out, recording))
    assert content(out) == RESULTS


def test_a_run_killed_while_clearing_up_is_done_and_cleared(out: Path, recording: Path) -> None:
    run(plan(out, recording))
    left = out / ".scanloom-unfinished"
    left.mkdir()
    (left / "lock").touch()
    assert plan(out, recording).is_done
    assert not left.exists()


@pytest.mark.parametrize("name", ["../in/room.bag", "figures/../../in/room.bag"])
def test_a_forged_manifest_removes_nothing_outside(out: Path, recording: Path, name: str) -> None:
    out.mkdir()
    absolute = str(recording.resolve())
    files = {name: sha256_of_file(recording), absolute: sha256_of_file(recording)}
    forged = {"project": "scanloom", "command": "fuse", "files": files}
    (out / "manifest.json").write_text(json.dumps(forged))
    run(plan(out, recording))
    assert recording.read_bytes() == b"recorded"


@pytest.mark.parametrize("text", ["{", "\xff\xfe", "[" * 100_000])
def test_a_damaged_manifest_is_refused(out: Path, recording: Path, text: str) -> None:
    out.mkdir()
    (out / "manifest.json").write_text(text, encoding="latin-1")
    with pytest.raises(ExportError, match=r"manifest\.json: cannot be read as a manifest"):
        plan(out, recording)


@pytest.mark.parametrize("text", ["[]", "{}", '{"files": [1]}', '{"files": {"frames.csv": 1}}'])
def test_a_manifest_without_content_lists_no_files(out: Path, recording: Path, text: str) -> None:
    out.mkdir()
    (out / "manifest.json").write_text(text)
    (out / FRAMES).write_text("mine")
    with pytest.raises(ExportError, match=FRAMES):
        plan(out, recording)


def test_an_input_is_never_written_into(recording: Path) -> None:
    with pytest.raises(ExportError, match="lies inside the input in"):
        plan(recording.parent / "out", recording.parent)
    with pytest.raises(ExportError, match=r"holds the input room\.bag"):
        plan(recording.parent, recording, overwrite=True)
    with pytest.raises(ExportError, match="is not a folder"):
        plan(recording, recording.parent / "other")


def test_files_read_besides_the_inputs_are_never_overwritten(out: Path, recording: Path) -> None:
    run(plan(out, recording))
    settings = out / FRAMES
    # Nothing would be written, so nothing is in danger.
    assert plan(out, recording, also_read=(settings,)).is_done
    with pytest.raises(ExportError, match=r"holds the input frames\.csv"):
        plan(out, recording, also_read=(settings,), force=True, overwrite=True)


def test_the_results_of_another_command_are_refused(out: Path, recording: Path) -> None:
    run(plan(out, recording))
    with pytest.raises(ExportError, match=r"out: holds results of fuse\. .*--overwrite"):
        plan(out, recording, command="map", force=True)
    assert content(out) == RESULTS
    run(plan(out, recording, command="map", overwrite=True), {"report.json": "{}"})
    assert content(out) == {"report.json": "{}"}


def test_results_of_a_version_that_named_no_command_are_refused(out: Path, recording: Path) -> None:
    run(plan(out, recording))
    manifest = json.loads((out / "manifest.json").read_text())
    del manifest["command"]
    (out / "manifest.json").write_text(json.dumps(manifest))
    require_intact(out, RESULTS, "fuse")
    with pytest.raises(ExportError, match="holds results of an earlier version"):
        plan(out, recording)


@pytest.mark.parametrize("name", [FRAMES, "manifest.json", "figures"])
def test_a_foreign_file_is_never_replaced(out: Path, recording: Path, name: str) -> None:
    out.mkdir()
    (out / name).write_text("{}")
    with pytest.raises(ExportError, match=name.replace(".", r"\.")):
        run(plan(out, recording, overwrite=True))
    assert {path.name: path.read_text() for path in out.iterdir()} == {name: "{}"}


def test_results_do_not_leave_the_folder_by_a_link(out: Path, recording: Path) -> None:
    out.mkdir()
    (out / "figures").symlink_to(recording.parent)
    with pytest.raises(ExportError, match="leads out of the output folder"):
        run(plan(out, recording, overwrite=True))
    assert [path.name for path in recording.parent.iterdir()] == ["room.bag"]


@pytest.mark.parametrize("name", ["figures", FRAMES, "manifest.json"])
def test_a_link_to_itself_is_refused_as_a_place_for_a_result(
    out: Path, recording: Path, name: str
) -> None:
    out.mkdir()
    (out / name).symlink_to(name)
    with pytest.raises(ExportError, match=name.replace(".", r"\.")):
        run(plan(out, recording, overwrite=True))
    assert [path.name for path in out.iterdir()] == [name]


def test_a_second_run_into_the_folder_is_refused(out: Path, recording: Path) -> None:
    first, second = plan(out, recording), plan(out, recording, seed=1)
    with results_folder(first) as work:
        (work / FRAMES).write_text("1")
        with pytest.raises(ExportError, match=r"out: is being written by another run\. Wait"):
            run(second)
    assert content(out) == {FRAMES: "1"}
    # It was planned for another folder than the one that is there now.
    with pytest.raises(ExportError, match="was written by another run in the meantime"):
        run(second)
    assert content(out) == {FRAMES: "1"}


def test_a_mix_of_two_runs_is_not_a_result(out: Path, recording: Path) -> None:
    run(plan(out, recording))
    (out / FIGURE).write_text("of another run")
    require_intact(out, [FRAMES, "never written.csv"], "fuse")
    with pytest.raises(ScanLoomError, match=r"3\.png: is not as the run .* wrote it"):
        require_intact(out, [FIGURE], "fuse")
    with pytest.raises(ScanLoomError, match="holds results of fuse, not of map"):
        require_intact(out, [FRAMES], "map")


def test_an_unwritable_place_is_found_before_any_file_is_changed(
    out: Path, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(plan(out, recording))
    # As for a user who may not write into figures/; the tests may run as one who may do all.
    monkeypatch.setattr(output_folder.os, "access", lambda path, mode: Path(path).name != "figures")
    with pytest.raises(ExportError, match=r"3\.png: cannot be written"):
        run(plan(out, recording, seed=1), {FRAMES: "new", FIGURE: "new"})
    assert content(out) == RESULTS
    require_intact(out, RESULTS, "fuse")


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
