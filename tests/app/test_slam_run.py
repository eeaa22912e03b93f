"""A run of SLAM: what it asks for, what it reads back, and what it leaves behind."""

import shlex
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fusion_core.model.errors import ExportError, MappingFailed
from fusion_core.model.progress import Progress, silent
from fusion_core.model.slam_view import SlamView, no_observer
from fusion_core.workflows.fuse.settings import PRESETS, PresetName
from fusion_core.workflows.map.result_folder import TrajectoryPoses, read_map_results
from fusion_core.workflows.map.settings import map_settings, map_settings_toml
from scanloom import cli
from scanloom.jobs import slam_run as job
from scanloom.jobs.long_job import Cancelled
from scanloom.jobs.slam_run import (
    SlamRequest,
    SlamRun,
    keep,
    map_options,
    resampling_at,
    run_slam,
    settings_of,
)
from scanloom.panels.command_line import map_command
from scanloom.state.slam_choices import SlamChoices
from scanloom.state.slam_runs import MAX_RUNS, SlamRuns
from scanloom.state.view import View
from tests.app import slam_runs
from tests.app.slam_runs import LOOPS, LOST, SCANS, FakeMap

RECORDING = Path("room one.mcap")


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeMap:
    fake = FakeMap()
    monkeypatch.setattr(job, "build_map", fake)
    return fake


def view_with(**choices: object) -> View:
    return View(recording=RECORDING.name, slam=SlamChoices.model_validate(choices))


def run(root: Path, number: int = 1, progress: Progress = silent, **choices: object) -> SlamRun:
    return run_slam(
        SlamRequest(number=number, view=view_with(**choices), recording=RECORDING),
        root,
        progress,
        no_observer,
    )


@pytest.mark.usefixtures("fake")
def test_a_run_reads_back_what_was_written(tmp_path: Path) -> None:
    made = run(tmp_path)
    files = made.files
    assert made.name == "1: lidar, recorded, pose-graph"
    # To the nanosecond, for two runs are compared at their stamps.
    assert np.array_equal(files.trajectory.stamps_ns, slam_runs.stamps_ns())
    poses = slam_runs.poses()
    assert np.allclose(files.trajectory.planar_poses[:, :2], poses[:, :2], atol=1e-8)
    assert np.allclose(
        np.exp(1j * files.trajectory.planar_poses[:, 2]), np.exp(1j * poses[:, 2]), atol=1e-8
    )
    assert np.flatnonzero(~files.trusted).tolist() == list(range(LOST.start, LOST.stop))
    ends = [[*poses[first, :2], *poses[second, :2]] for first, second in LOOPS]
    assert np.allclose(files.loops_m, ends, atol=1e-8)
    assert files.grid is not None
    room = slam_runs.room()
    assert files.grid.origin_m == room.origin_m
    assert np.array_equal(files.grid.known, room.known)
    assert np.array_equal(files.grid.log_odds > 0.0, room.log_odds > 0.0)
    assert files.effective.shape == (0, 2)
    assert files.weight_stamps_s.size == 0


@pytest.mark.usefixtures("fake")
def test_particles_and_weights_come_with_their_times(tmp_path: Path) -> None:
    files = run(tmp_path, estimator="particle-filter", motion="fused").files
    known = np.isfinite(slam_runs.effective())
    assert np.allclose(files.effective[:, 1], slam_runs.effective()[known])
    assert np.allclose(files.effective[:, 0], slam_runs.stamps_ns()[known] / 1e9)
    assert list(files.translation_weights) == ["wheel", "laser"]
    wheel = files.translation_weights["wheel"]
    assert np.flatnonzero(np.isnan(wheel)).tolist() == [2]
    assert np.allclose(wheel[3:], np.arange(3, SCANS - 1) / SCANS)
    assert np.allclose(files.rotation_weights["laser"], 0.75)
    stamps_ns = slam_runs.stamps_ns()
    assert np.allclose(files.weight_stamps_s, (stamps_ns[:-1] + 5e7) / 1e9)


def test_the_poses_of_a_run_are_those_of_its_scans_and_none_beyond(
    fake: FakeMap, tmp_path: Path
) -> None:
    found = TrajectoryPoses("a run", run(tmp_path).files.trajectory)
    stamps_ns, poses = slam_runs.stamps_ns(), slam_runs.poses()
    pose = found.at(int(stamps_ns[7]))
    assert pose is not None
    assert pose[:2] == pytest.approx(poses[7, :2])
    between = found.at(int(stamps_ns[7] + stamps_ns[8]) // 2)
    assert between is not None
    assert between[:2] == pytest.approx((poses[7, :2] + poses[8, :2]) / 2)
    assert found.at(int(stamps_ns[0]) - 1) is None
    assert found.at(int(stamps_ns[-1]) + 1) is None


def test_the_defaults_need_no_settings_file(fake: FakeMap, tmp_path: Path) -> None:
    run(tmp_path)
    run(tmp_path, 2, estimator="particle-filter", particles=30)
    assert [options.settings_file for _, _, options in fake.calls] == [None, None]


def test_the_settings_file_says_how_many_particles(fake: FakeMap, tmp_path: Path) -> None:
    made = run(tmp_path, estimator="particle-filter", particles=77)
    file = made.options.settings_file
    assert file == made.folder / "settings.toml"
    assert file is not None
    assert tomllib.loads(file.read_text())["particles"]["particles"] == 77
    assert resampling_at(made.view) == 38.5
    # Of no use to the others.
    assert map_options(view_with(estimator="pose-graph", particles=77), file).settings_file is None


@pytest.mark.parametrize("preset", PRESETS)
def test_the_settings_file_says_all_that_the_view_says(preset: PresetName, tmp_path: Path) -> None:
    view = view_with(estimator="particle-filter", particles=50).changed(
        preset=preset, settings=PRESETS[preset]
    )
    view = view.with_setting("noise", "epsilon", 2.25).with_setting("grid", "resolution_m", 0.1)
    file = tmp_path / "settings.toml"
    options = map_options(view, file)
    assert options.settings_file == file
    file.write_text(map_settings_toml(settings_of(view), options.preset), encoding="utf-8")
    _, read = map_settings(options.preset, file)
    assert read.stages() == settings_of(view).stages()
    assert {name: read.stages()[name] for name in view.settings.stages()} == view.settings.stages()


def test_the_topic_of_the_view_goes_into_the_options() -> None:
    view = view_with(scan="camera", motion="none").changed(lidar_topic="/front")
    options = map_options(view, Path("settings.toml"))
    assert (options.scan, options.motion, options.slam) == ("camera", "none", "pose-graph")
    assert options.lidar_topic == "/front"


def stopping(at: int) -> tuple[Progress, list[int]]:
    """A progress that is told to stop after so many calls, and how often it was called."""
    calls: list[int] = []

    def report(done: int, total: int | None, what: str) -> None:
        calls.append(done)
        if len(calls) > at:
            raise Cancelled

    return report, calls


def test_a_cancelled_run_leaves_nothing(fake: FakeMap, tmp_path: Path) -> None:
    progress, calls = stopping(20)
    with pytest.raises(Cancelled):
        run(tmp_path, progress=progress)
    assert list(tmp_path.iterdir()) == []
    # At the very next moment, which is one that is watched.
    assert len(calls) == 21


def test_a_run_stops_where_only_its_picture_moves(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    seen: list[SlamView] = []

    def only_watched(*args: object) -> None:
        progress, watch = args[3:5]
        assert callable(progress)
        assert callable(watch)
        progress(0, None, "closing loops")
        for _ in range(100):
            watch(slam_runs.view_at(SCANS, "closing loops", map_options(view_with(), Path("x"))))

    monkeypatch.setattr(job, "build_map", only_watched)
    progress, _ = stopping(5)
    with pytest.raises(Cancelled):
        run_slam(
            SlamRequest(number=1, view=view_with(), recording=RECORDING),
            tmp_path,
            progress,
            seen.append,
        )
    assert len(seen) == 4
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_does_not_fit_is_kept_with_its_problem(fake: FakeMap, tmp_path: Path) -> None:
    fake.fits = False
    made = run(tmp_path)
    assert made.problem is not None
    assert "17 %" in str(made.problem)
    assert made.summary is None
    assert made.files.trajectory.stamps_ns.size == SCANS


def failing(error: Exception) -> Callable[..., None]:
    def fail(*args: object) -> None:
        raise error

    return fail


def test_a_run_that_wrote_nothing_fails(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(job, "build_map", failing(MappingFailed("there is no scan to place.")))
    with pytest.raises(MappingFailed, match="no scan"):
        run(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("fake")
def test_a_damaged_result_is_reported(tmp_path: Path) -> None:
    results = run(tmp_path).folder / "results"
    (results / "report.json").write_text("{}")
    with pytest.raises(ExportError, match=r"KeyError.*'scan'"):
        read_map_results(results)
    (results / "trajectory.tum").write_text("1 2\n")
    with pytest.raises(ExportError, match="cannot be read back"):
        read_map_results(results)


def files_below(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.parametrize("estimator", ["pose-graph", "particle-filter"])
def test_a_run_writes_the_bytes_that_its_command_writes(
    estimator: str, small_scene: Path, tmp_path: Path
) -> None:
    seen: list[SlamView] = []
    view = view_with(motion="wheel", estimator=estimator, particles=5)
    made = run_slam(
        SlamRequest(number=1, view=view, recording=small_scene), tmp_path, silent, seen.append
    )
    command = shlex.split(map_command(small_scene, tmp_path / "again", made.options))
    assert cli.main(command[1:]) == 0
    by_command = files_below(tmp_path / "again")
    assert files_below(made.folder / "results") == by_command
    assert {"map_lidar.pgm", "trajectory.tum", "report.json"} <= by_command.keys()
    # What is read back is what was watched last.
    assert np.array_equal(seen[-1].stamps_ns, made.files.trajectory.stamps_ns)
    assert np.allclose(
        seen[-1].poses_map_scan[:, :2], made.files.trajectory.planar_poses[:, :2], atol=1e-8
    )
    weighed = seen[-1].effective[np.isfinite(seen[-1].effective)]
    assert np.allclose(made.files.effective[:, 1], weighed)
    assert (weighed.size > 0) == (estimator == "particle-filter")


@pytest.mark.usefixtures("fake")
def test_a_saved_run_is_a_copy_in_a_folder_of_its_own(tmp_path: Path) -> None:
    made = run(tmp_path / "runs", estimator="particle-filter", particles=77)
    out = tmp_path / "out"
    recording = tmp_path / RECORDING
    recording.touch()
    first, second = keep(made, recording, out), keep(made, recording, out)
    assert [first.name, second.name] == ["room_one", "room_one-2"]
    for folder in (first, second):
        for path in (made.folder).rglob("*"):
            if path.is_file():
                copied = folder / path.relative_to(made.folder)
                assert copied.read_bytes() == path.read_bytes()


@pytest.mark.usefixtures("fake")
def test_the_last_runs_are_kept(tmp_path: Path) -> None:
    runs = SlamRuns()
    gone = []
    for _ in range(MAX_RUNS + 2):
        oldest = runs.add(run(tmp_path, runs.next_number()))
        gone += [] if oldest is None else [oldest.number]
    assert gone == [1, 2]
    assert [one.number for one in runs.of(RECORDING.name)] == list(range(3, MAX_RUNS + 3))
    assert runs.of("another") == []
