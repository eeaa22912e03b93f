"""No command changes, moves or removes a file that is given to it as input."""

import itertools
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fusion_core.exporting.output_folder import RunRequest, plan_output, results_folder
from fusion_core.model.errors import ExportError
from scanloom import cli
from tests.hostile.places import PLACES, snapshot
from tests.workflows.box_recording import write_boxes

FLAGS = [[], ["--overwrite"], ["--force"], ["--force", "--overwrite"]]
QUICK = ["--no-figures", "--no-maps"]


@pytest.fixture(scope="module")
def fused(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that ``fuse`` has written, whose fused.mcap is a recording as well."""
    folder = tmp_path_factory.mktemp("inputs")
    write_boxes(folder / "room.mcap", duration_s=0.4)
    out = folder / "fused"
    assert cli.main(["fuse", str(folder / "room.mcap"), "-o", str(out), *QUICK]) == 0
    return out


COMMANDS: dict[str, Callable[[Path, Path], list[str]]] = {
    "fuse": lambda recording, out: ["fuse", str(recording), "-o", str(out), *QUICK],
    "map": lambda recording, out: ["map", str(recording), "-o", str(out), "--motion=none"],
    "convert": lambda recording, out: ["convert", str(recording), "-o", str(out)],
}
# What each command knows of the flags.
KNOWN = {"fuse": FLAGS, "map": FLAGS, "convert": FLAGS[:2]}


@pytest.mark.parametrize("kind", ["file", "folder"])
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("place", PLACES)
def test_a_recording_is_kept(
    fused: Path, tmp_path: Path, command: str, place: str, kind: str
) -> None:
    for number, flags in enumerate(KNOWN[command]):
        # A folder of results, as if an earlier run had made the recording there.
        folder = tmp_path / str(number) / "quite" / "deep" / "results"
        shutil.copytree(fused, folder)
        recording = folder / "fused.mcap" if kind == "file" else folder
        before = snapshot(recording)
        output = PLACES[place](recording)
        code = cli.main([*COMMANDS[command](recording, output), *flags])
        assert (code, snapshot(recording)) == (code, before)
        assert code in (0, 1)


def test_a_recording_named_by_a_link_keeps_its_link(fused: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    link = out / "fused.mcap"
    link.symlink_to(fused / "fused.mcap")
    before = snapshot(fused)
    for command, flags in itertools.product(("fuse", "map"), FLAGS):
        assert cli.main([*COMMANDS[command](link, out), *flags]) == 1
        assert link.is_symlink()
    assert cli.main(["convert", str(link), "-o", str(link), "--overwrite"]) == 1
    assert link.is_symlink()
    assert snapshot(fused) == before


@pytest.mark.parametrize(
    ("command", "option", "name"),
    [
        ("fuse", "--settings", "settings.toml"),
        ("fuse", "--truth", "frames.csv"),
        ("map", "--settings", "settings.toml"),
        ("map", "--extrinsics", "report.json"),
    ],
)
def test_what_else_is_read_is_kept(
    fused: Path, tmp_path: Path, command: str, option: str, name: str
) -> None:
    folder = tmp_path / "results"
    shutil.copytree(fused, folder)
    (folder / "report.json").write_text(json.dumps({"T_camera_lidar": [[1.0]]}))
    before = snapshot(folder / name)
    words = COMMANDS[command](fused.parent / "room.mcap", folder)
    for flags in FLAGS:
        assert cli.main([*words, option, str(folder / name), "--seed=7", *flags]) == 1
        assert snapshot(folder / name) == before


def test_settings_and_world_of_a_sample_are_kept(tmp_path: Path) -> None:
    settings_file = tmp_path / "a.world.json"
    settings_file.write_text("[scene]\nduration_s = 0.5\n")
    words = ["sample", "bedroom", "-o", str(tmp_path / "a.mcap"), "--settings", str(settings_file)]
    assert cli.main([*words, "--overwrite"]) == 1
    assert settings_file.read_text() == "[scene]\nduration_s = 0.5\n"


def test_a_foreign_recording_is_not_replaced(fused: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    foreign = out / "fused.mcap"
    foreign.write_bytes(b"foreign")
    words = COMMANDS["fuse"](fused.parent / "room.mcap", out)
    for flags in FLAGS:
        assert cli.main([*words, *flags]) == 1
    assert [path.name for path in out.iterdir()] == ["fused.mcap"]
    assert foreign.read_bytes() == b"foreign"


NAMES = st.sampled_from(["fused.mcap", "figures/3.png", "settings.toml", "manifest.json", "a/b/c"])


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    results=st.sets(NAMES, min_size=1),
    there=st.sets(NAMES),
    read=NAMES,
    overwrite=st.booleans(),
    is_linked=st.booleans(),
    runs=st.integers(0, 2),
)
def test_whatever_is_in_the_folder_inputs_and_foreign_files_are_kept(
    tmp_path_factory: pytest.TempPathFactory,
    results: set[str],
    there: set[str],
    read: str,
    overwrite: bool,
    is_linked: bool,
    runs: int,
) -> None:
    root = tmp_path_factory.mktemp("root")
    out = root / "out"
    out.mkdir()
    if is_linked:
        (root / "link").symlink_to(out)
        out = root / "link"
    elsewhere = root / "elsewhere"
    elsewhere.write_bytes(b"input")

    def run(given_path: Path) -> None:
        request = RunRequest(command="fuse", inputs=[given_path], settings_text="", seed=0)
        plan = plan_output(out, request, force=True, overwrite=overwrite)
        with results_folder(plan) as work:
            for name in results - {"manifest.json"}:
                (work / name).parent.mkdir(parents=True, exist_ok=True)
                (work / name).write_bytes(b"result")

    for _ in range(runs):
        run(elsewhere)
    foreign = [name for name in there if not (out / name).exists()]
    for name in foreign:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(b"foreign")
    given_path = out / read if (out / read).exists() else elsewhere
    before = snapshot(elsewhere, given_path, *(out / name for name in foreign))
    try:
        run(given_path)
    except ExportError:
        assert given_path != elsewhere or foreign
    assert snapshot(elsewhere, given_path, *(out / name for name in foreign)) == before
