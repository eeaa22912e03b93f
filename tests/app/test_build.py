"""Builds: what the workbench writes into its output root, and what it never touches."""

import io
import json
import shlex
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.errors import ExportError, ScanLoomError
from fusion_core.model.geometry import invert_transform
from fusion_core.model.given_extrinsics import CameraPose, GivenExtrinsics
from fusion_core.model.progress import silent
from fusion_core.workflows.fuse.settings import PRESETS, chain_settings, settings_toml
from scanloom import cli
from scanloom.jobs import build as building
from scanloom.jobs.build import Build, build, folder_name, free_folder, zipped
from scanloom.jobs.long_job import Cancelled
from scanloom.jobs.slam_run import map_options
from scanloom.panels.command_line import fuse_command
from scanloom.state.hand_pose import HandPose
from scanloom.state.slam_choices import SlamChoices
from scanloom.state.view import View

VIEW = View(recording="small room.mcap")


def files_below(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.fixture(scope="module")
def built(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Build:
    """A build with one setting changed."""
    root = tmp_path_factory.mktemp("root") / "not there yet"
    view = VIEW.with_setting("grid", "resolution_m", 0.1)
    return build(view, small_scene, root, silent, figures=False)


def test_a_build_writes_the_bytes_that_its_command_writes(
    built: Build, small_scene: Path, tmp_path: Path
) -> None:
    assert built.folder.name == "small_room"
    command = shlex.split(fuse_command(small_scene, tmp_path / "again", built.options))
    assert cli.main(command[1:]) == 0
    by_command = files_below(tmp_path / "again")
    assert files_below(built.results) == by_command
    assert {"frames.csv", "fused.mcap", "map_fused.pgm", "map_difference.png"} <= by_command.keys()
    assert b"resolution: 0.1\n" in by_command["map_fused.yaml"]


def test_a_build_with_a_pose_by_hand_is_placed_by_it_and_its_command_too(
    small_scene: Path, tmp_path: Path
) -> None:
    pose = HandPose(yaw_deg=6.0, pitch_deg=1.0, roll_deg=2.0, forward_m=0.05, up_m=0.6)
    view = VIEW.changed(extrinsics=pose)
    topic = "/camera/depth/image_raw"
    camera = CameraPose(T_camera_lidar=invert_transform(pose.T_lidar_camera))
    by_hand = GivenExtrinsics(source="by hand", cameras={topic: camera})
    made = build(view, small_scene, tmp_path / "root", silent, figures=False, given=by_hand)
    assert made.options.extrinsics_file == made.folder / "extrinsics.json"
    document = json.loads((made.results / "alignment.json").read_text())
    (placed,) = document["cameras"]
    np.testing.assert_allclose(placed["T_lidar_camera"], pose.T_lidar_camera, atol=1e-9)
    command = shlex.split(fuse_command(small_scene, tmp_path / "again", made.options))
    assert cli.main(command[1:]) == 0
    assert files_below(made.results) == files_below(tmp_path / "again")


def test_extrinsics_with_a_file_are_read_from_it(tmp_path: Path) -> None:
    camera = CameraPose(T_camera_lidar=np.eye(4))
    own = GivenExtrinsics(source="x.json", cameras={None: camera}, file=Path("x.json"))
    options = building.fuse_options(VIEW, tmp_path / "settings.toml", given=own)
    assert options.extrinsics_file == Path("x.json")
    building.write_extrinsics_in(tmp_path, own)
    assert list(tmp_path.iterdir()) == []
    # Where no camera takes part, SLAM has no use for it.
    for scan, used in (("lidar", None), ("merged", Path("x.json"))):
        slam = View(recording="a", slam=SlamChoices(scan=scan))
        assert map_options(slam, tmp_path / "settings.toml", given=own).extrinsics_file == used


@pytest.mark.parametrize("pairing", ["mount", "frame"])
@pytest.mark.parametrize("preset", PRESETS)
def test_the_settings_file_says_all_that_the_view_says(
    preset: str, pairing: str, tmp_path: Path
) -> None:
    view = View(recording="a", preset=preset, settings=PRESETS[preset])
    view = view.with_setting("", "pairing", pairing).with_setting("noise", "epsilon", 2.25)
    file = tmp_path / "settings.toml"
    options = building.fuse_options(view, file)
    file.write_text(settings_toml(building.base_preset(view), view.settings), encoding="utf-8")
    _, settings = chain_settings(options.preset, options.settings_file, options.seed)
    assert settings == view.settings


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_needs_no_settings_file(preset: str) -> None:
    view = View(recording="a", preset=preset, settings=PRESETS[preset])
    options = building.fuse_options(view, Path("settings.toml"))
    assert (options.preset, options.settings_file) == (preset, None)


@pytest.mark.parametrize(
    "step", ["hashing the input", "matching scans with images", "fusing", "done"]
)
def test_a_cancelled_build_leaves_nothing(step: str, small_scene: Path, tmp_path: Path) -> None:
    def cancel(done: int, total: int | None, what: str) -> None:
        if what == step:
            raise Cancelled

    view = VIEW.with_setting("noise", "epsilon", 2.25)
    (tmp_path / "small_room").mkdir()
    (tmp_path / "small_room" / "mine.txt").write_text("kept")
    with pytest.raises(Cancelled):
        build(view, small_scene, tmp_path, cancel, figures=False)
    assert files_below(tmp_path) == {"small_room/mine.txt": b"kept"}
    assert [path.name for path in tmp_path.iterdir()] == ["small_room"]


def test_a_failed_build_leaves_nothing(small_scene: Path, tmp_path: Path) -> None:
    view = VIEW.changed(lidar_topic="/nowhere")
    with pytest.raises(ScanLoomError, match="/nowhere"):
        build(view, small_scene, tmp_path, silent)
    assert list(tmp_path.iterdir()) == []


def test_an_output_root_that_is_a_file_is_named(small_scene: Path, tmp_path: Path) -> None:
    root = tmp_path / "root"
    root.write_text("a file")
    with pytest.raises(ExportError, match="root"):
        build(VIEW, small_scene, root, silent)
    assert root.read_text() == "a file"


NAMES = st.text(max_size=300) | st.sampled_from(
    [
        "..",
        ".",
        "",
        "/",
        "../../etc",
        "a/../..",
        "..\\..",
        "C:\\x",
        "a b",
        "房间 1",
        "é" * 300,
        ".x",
    ]
)


@given(NAMES)
def test_no_name_leads_out_of_the_output_root(name: str) -> None:
    root = Path("/root/of/outputs")
    folder = root / folder_name(name)
    assert folder.resolve().parent == root
    assert len(folder.name.encode()) <= 255
    assert not set(folder.name) & set(" /\\:\0\n\"'$`")
    assert folder.name[0] not in ".-"


def test_names_stay_readable() -> None:
    names = {"room_1": "room_1", "房间 1": "房间_1", "../a b": "a_b", "..": "recording"}
    assert {name: folder_name(name) for name in names} == names


def test_what_is_there_is_not_written_to(tmp_path: Path) -> None:
    recording = tmp_path / "hall.v2.bag"
    recording.touch()
    root = tmp_path / "root"
    assert free_folder(root, recording) == root / "hall.v2"
    (root / "hall.v2").mkdir(parents=True)
    (root / "hall.v2-2").touch()
    # A link that leads nowhere, and would be written through.
    (root / "hall.v2-3").symlink_to(tmp_path / "elsewhere")
    assert free_folder(root, recording) == root / "hall.v2-4"
    assert free_folder(root, tmp_path / "folder.of.images") == root / "folder.of.images"


def test_two_builds_at_once_get_folders_of_their_own(
    small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def free_when_asked(root: Path, recording: Path) -> Path:
        folder = free_folder(root, recording)
        if not asked:
            folder.mkdir(parents=True)
        asked.append(folder.name)
        return folder

    monkeypatch.setattr(building, "free_folder", free_when_asked)
    with building.new_folder(tmp_path, small_scene) as folder:
        assert folder.name == "small_room-2"
    assert asked == ["small_room", "small_room-2"]


def test_the_download_holds_the_small_results(
    built: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = zipped(built)
    assert content == zipped(built)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        packed = {name: archive.read(name) for name in archive.namelist()}
    results = files_below(built.results)
    assert results.keys() - {name.removeprefix("small_room/") for name in packed} == {
        "fused.mcap",
        "samples.parquet",
    }
    assert all(results[name.removeprefix("small_room/")] == packed[name] for name in packed)
    monkeypatch.setattr(building, "MAX_DOWNLOAD_BYTES", 1000)
    with pytest.raises(ExportError, match="MB"):
        zipped(built)
