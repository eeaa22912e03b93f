"""``scanloom map`` on a simulated log: results, determinism, what is reported, what is refused."""

import json

import numpy as np
import pytest

from fusion_core.model.errors import MappingFailed, MissingStream
from fusion_core.recordings.tum_trajectory import read_tum_trajectory
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.report import untrusted_intervals
from scanloom.cli import main
from tests.slam.ring import drive, error_m

FILES = {
    "graph.g2o",
    "manifest.json",
    "map_lidar.pgm",
    "map_lidar.png",
    "map_lidar.yaml",
    "report.json",
    "settings.toml",
    "trajectory.png",
    "trajectory.tum",
}
SCANS = 120


@pytest.fixture(scope="module")
def ring():
    return drive(SCANS)


def write_log(path, ring, *, blind=()):
    """CARMEN's text: 81.9 m is its word for no echo."""
    lines = []
    for number, (scan, pose) in enumerate(zip(ring.scans, ring.odometry, strict=True)):
        ranges_m = np.where(np.isnan(scan.ranges_m), 81.9, scan.ranges_m)
        if number in blind:
            ranges_m = np.full_like(ranges_m, 81.9)
        words = [f"{value:.3f}" for value in ranges_m]
        place = " ".join(f"{value:.6f}" for value in pose)
        stamp = f"{scan.stamp_ns / 1e9:.6f}"
        lines.append(f"FLASER {len(words)} {' '.join(words)} {place} {place} {stamp} sim {stamp}\n")
    path.write_text("".join(lines), encoding="ascii")
    return path


@pytest.fixture(scope="module")
def log(ring, tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("log") / "ring.clf", ring)


@pytest.fixture(scope="module")
def mapped(log, tmp_path_factory):
    folder = tmp_path_factory.mktemp("out") / "map"
    return build_map(log, folder, MapOptions())


def test_the_folder_holds_all_results(mapped, ring):
    assert {path.name for path in mapped.output.iterdir()} == FILES
    trajectory = read_tum_trajectory(mapped.output / "trajectory.tum").trajectory
    np.testing.assert_array_equal(trajectory.stamps_ns, ring.stamps_ns)
    assert error_m(trajectory.planar_poses, ring.truth) < 0.2
    report = json.loads((mapped.output / "report.json").read_text(encoding="utf-8"))
    assert report == mapped.report
    assert report["scans"] == SCANS
    assert report["trusted_share"] == 1.0
    assert report["untrusted"] == []
    assert report["path_m"] == pytest.approx(0.1 * (SCANS - 1), rel=0.03)
    assert len(report["loop_closures"]) == report["loops"]


def test_the_same_run_gives_the_same_bytes(mapped, log, tmp_path):
    build_map(log, tmp_path / "again", MapOptions())
    for name in FILES:
        assert (tmp_path / "again" / name).read_bytes() == (mapped.output / name).read_bytes(), name


def test_a_run_that_is_done_is_skipped(mapped, log):
    again = build_map(log, mapped.output, MapOptions())
    assert again.is_skipped
    assert again.seconds == {} != mapped.seconds
    assert again.report == mapped.report
    assert any("Nothing was done" in line for line in again.lines())
    other = build_map(log, mapped.output, MapOptions(force=True))
    assert not other.is_skipped


def test_without_slam_the_poses_are_those_recorded(log, ring, tmp_path):
    summary = build_map(log, tmp_path / "map", MapOptions(slam="none", motion="wheel"))
    assert not (summary.output / "graph.g2o").exists()
    assert "loops" not in summary.report
    trajectory = read_tum_trajectory(summary.output / "trajectory.tum").trajectory
    np.testing.assert_allclose(trajectory.planar_poses, ring.odometry, atol=1e-5)


def test_without_motion_it_begins_at_the_origin_and_bare_corridors_are_not_trusted(log, tmp_path):
    with pytest.raises(MappingFailed, match="of the scans fit"):
        build_map(log, tmp_path / "map", MapOptions(motion="none"))
    trajectory = read_tum_trajectory(tmp_path / "map" / "trajectory.tum").trajectory
    np.testing.assert_array_equal(trajectory.planar_poses[0], np.zeros(3))
    report = json.loads((tmp_path / "map" / "report.json").read_text(encoding="utf-8"))
    assert any("bare corridor" in note for note in report["notes"])


def test_a_lost_stretch_is_reported(ring, tmp_path):
    log = write_log(tmp_path / "blind.clf", ring, blind=range(50, 60))
    report = build_map(log, tmp_path / "map", MapOptions()).report
    stamps_s = ring.stamps_ns / 1e9
    assert report["untrusted"][0]["from_s"] == pytest.approx(stamps_s[50])
    assert report["untrusted"][0]["to_s"] >= stamps_s[59] - 1e-6
    assert report["trusted_share"] < 1.0


def test_more_lost_than_not_fails_but_leaves_its_results(ring, tmp_path, capsys):
    log = write_log(tmp_path / "blind.clf", ring, blind=range(40, SCANS))
    code = main(["map", str(log), "-o", str(tmp_path / "map"), "--json"])
    assert code == 1
    assert "of the scans fit the map" in json.loads(capsys.readouterr().out)["error"]
    assert {path.name for path in (tmp_path / "map").iterdir()} == FILES
    with pytest.raises(MappingFailed, match="of the scans fit"):
        build_map(log, tmp_path / "map", MapOptions())


def test_settings_of_a_file_are_used_and_kept(log, tmp_path):
    file = tmp_path / "coarse.toml"
    file.write_text("[grid]\nresolution_m = 0.1\n", encoding="utf-8")
    summary = build_map(log, tmp_path / "map", MapOptions(settings_file=file))
    assert "resolution: 0.1\n" in (summary.output / "map_lidar.yaml").read_text(encoding="utf-8")
    assert "resolution_m = 0.1" in (summary.output / "settings.toml").read_text(encoding="utf-8")


def test_a_map_that_is_too_large_has_coarser_cells_and_a_note(log, tmp_path):
    file = tmp_path / "small.toml"
    file.write_text("[grid]\ncells_max = 100000\n", encoding="utf-8")
    summary = build_map(log, tmp_path / "map", MapOptions(settings_file=file))
    assert any("Cells of 0.4 m and not 0.05 m" in note for note in summary.report["notes"])
    assert "resolution: 0.4\n" in (summary.output / "map_lidar.yaml").read_text(encoding="utf-8")


def test_the_command_says_what_it_did(log, tmp_path, capsys):
    assert main(["map", str(log), "-o", str(tmp_path / "map"), "--motion", "wheel"]) == 0
    said = capsys.readouterr().out
    assert f"{SCANS} of 23.8 s" in said
    assert "Motion from wheel" in said


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--slam", "none", "--motion", "none"], "--motion"),
        (["--motion", "none", "--pose", "/odom"], "--pose"),
        (["--home", "alma-s1"], "--room"),
    ],
)
def test_options_that_do_not_go_together_are_wrong_usage(log, tmp_path, capsys, options, word):
    assert main(["map", str(log), "-o", str(tmp_path / "map"), *options]) == 2
    assert word in capsys.readouterr().err


def test_nothing_to_place_scans_by_is_refused(tmp_path):
    with pytest.raises(MissingStream, match="without SLAM and without motion"):
        build_map(tmp_path / "none", tmp_path / "map", MapOptions(slam="none", motion="none"))


def test_stretches_are_runs_of_scans_that_are_not_trusted():
    stamps_ns = np.arange(6) * 10**9
    trusted = np.array([False, True, False, False, True, False])
    assert untrusted_intervals(stamps_ns, trusted) == [
        {"from_s": 0.0, "to_s": 0.0, "scans": 1},
        {"from_s": 2.0, "to_s": 3.0, "scans": 2},
        {"from_s": 5.0, "to_s": 5.0, "scans": 1},
    ]
