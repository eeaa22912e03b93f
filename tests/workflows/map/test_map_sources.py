"""``scanloom map`` with each source of scans and motion, and each estimator."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fusion_core.recordings.tum_trajectory import read_tum_trajectory
from fusion_core.simulation.truth import truth_path
from scanloom.cli import main

# The first two hold each option of the others but one: every source is in a quick test of its own.
COMBINATIONS = [
    ("lidar", "laser", "pose-graph"),
    ("merged", "fused", "particle-filter"),
    *(
        pytest.param(*names, marks=pytest.mark.slow)
        for names in (
            ("camera", "wheel", "none"),
            ("repaired", "recorded", "pose-graph"),
            ("merged", "visual", "none"),
        )
    ),
]


@pytest.fixture(scope="module")
def recording(scenes) -> Path:
    return scenes("turtlebot_low", duration_s=3.0)


def run(recording: Path, folder: Path, *options: str) -> int:
    return main(["map", str(recording), "-o", str(folder), *options])


@pytest.fixture(scope="module")
def mapped(recording, tmp_path_factory) -> Callable[[str, str, str], Path]:
    """The results of a source of scans, of motion and an estimator, each made once."""

    @cache
    def results(scan: str, motion: str, slam: str) -> Path:
        folder = tmp_path_factory.mktemp("mapped") / "map"
        assert run(recording, folder, "--scan", scan, "--motion", motion, "--slam", slam) == 0
        return folder

    return results


@pytest.mark.parametrize(("scan", "motion", "slam"), COMBINATIONS)
def test_each_kind_of_mapping_gives_a_trajectory_and_its_maps(mapped, scan, motion, slam):
    folder = mapped(scan, motion, slam)
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert (report["scan"], report["motion"], report["slam"]) == (scan, motion, slam)
    written = {path.name for path in folder.iterdir()}
    assert {f"map_{scan}.yaml", "map_lidar.yaml", "trajectory.png"} <= written
    assert ("map_difference.png" in written) == ("maps.png" in written) == (scan != "lidar")
    assert ("graph.g2o" in written) == (slam == "pose-graph")
    assert ("effective.png" in written) == (slam == "particle-filter") == ("effective" in report)
    assert ("odometry_weights.csv" in written) == (motion == "fused")
    assert (f"odometry_{motion}.tum" in written) == (motion != "recorded")


def test_the_trajectory_is_that_of_the_truth(recording, tmp_path):
    folder = tmp_path / "map"
    assert run(recording, folder, "--scan", "merged", "--motion", "fused") == 0
    estimate = read_tum_trajectory(folder / "trajectory.tum").trajectory
    truth = np.load(truth_path(recording))
    np.testing.assert_array_equal(estimate.stamps_ns, truth["scan_stamp"])
    away = estimate.planar_poses[:, :2] - estimate.planar_poses[0, :2]
    true = truth["pose"][:, :2] - truth["pose"][0, :2]
    # Both begin somewhere; how far they went is the same in any frame.
    np.testing.assert_allclose(np.hypot(*away.T), np.hypot(*true.T), atol=0.03)


@pytest.mark.slow
def test_one_thread_or_two_give_the_same_bytes(recording, mapped, tmp_path):
    # This process has as many threads as there are processors.
    threads = "2" if os.cpu_count() == 1 else "1"
    folders = [mapped("merged", "fused", "particle-filter"), tmp_path / "map"]
    counts = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
    command = [sys.executable, "-m", "scanloom", "map", str(recording), "-o", str(folders[1])]
    options = ["--scan", "merged", "--motion", "fused", "--slam", "particle-filter"]
    subprocess.run(
        [*command, *options],
        env={**os.environ, **dict.fromkeys(counts, threads)},
        check=True,
        capture_output=True,
        timeout=240,
    )
    names = sorted(path.name for path in folders[0].iterdir())
    assert names == sorted(path.name for path in folders[1].iterdir())
    for name in names:
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes(), name


def test_what_is_asked_decides_whether_a_run_is_the_same(recording, tmp_path, capsys):
    folder = tmp_path / "map"
    assert run(recording, folder, "--slam", "particle-filter") == 0
    assert run(recording, folder, "--slam", "particle-filter") == 0
    assert "Nothing was done" in capsys.readouterr().out
    assert run(recording, folder, "--slam", "particle-filter", "--seed", "7") == 0
    assert "Nothing was done" not in capsys.readouterr().out
    settings = (folder / "settings.toml").read_text(encoding="utf-8")
    assert "seed = 7" in settings


def test_the_published_preset_is_kept_in_the_settings(recording, tmp_path):
    folder = tmp_path / "map"
    options = ("--preset", "published", "--scan", "merged", "--motion", "fused")
    assert run(recording, folder, *options) == 0
    settings = (folder / "settings.toml").read_text(encoding="utf-8")
    assert 'preset = "published"' in settings
    assert 'method = "published"' in settings
    assert 'sampling = "stride"' in settings


def test_odometry_is_judged_by_the_truth(scenes, tmp_path, capsys):
    # Errors are those over a metre of way, and the robot drives 0.3 m a second.
    recording, folder = scenes("turtlebot_low", duration_s=5.0), tmp_path / "map"
    assert run(recording, folder, "--motion", "fused") == 0
    capsys.readouterr()
    truth = str(truth_path(recording))
    assert main(["evaluate", "odometry", str(folder), truth, "--json"]) == 0
    tracks = json.loads(capsys.readouterr().out)["tracks"]
    assert set(tracks) == {"wheel", "laser", "visual", "fused", "trajectory"}
    assert tracks["fused"]["distance_error"] < tracks["wheel"]["distance_error"]


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--extrinsics", "missing.toml", "--scan", "merged"], "missing.toml"),
        (["--settings", "missing.toml"], "missing.toml"),
    ],
)
def test_files_that_are_not_there_are_named(recording, tmp_path, capsys, options, word):
    assert run(recording, tmp_path / "map", *options) == 1
    assert word in capsys.readouterr().err


def test_extrinsics_that_nothing_would_read_are_refused(recording, tmp_path, capsys):
    options = ["--scan", "lidar", "--extrinsics", "mount.toml"]
    assert run(recording, tmp_path / "map", *options) == 1
    said = capsys.readouterr().err
    assert "mount.toml: --scan lidar with --motion recorded takes no extrinsics" in said
    assert not (tmp_path / "map").exists()
