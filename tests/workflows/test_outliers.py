"""A lone range or pose far beyond all others costs itself; a map that cannot be drawn costs no
other result."""

import numpy as np
import pytest

from fusion_core.mapping.grid import GridSettings
from fusion_core.recordings.tum_trajectory import read_tum_trajectory
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions
from tests.hostile.drive import ODOMETRY, SCANS, TF, write_drive
from tests.hostile.outliers import far_poses, far_ranges

FAST = FuseOptions(figures=False)
TABLES = {"frames.csv", "samples.parquet", "fused.mcap", "alignment.json", "summary.json"}
MAPS = {
    f"map_{name}.{ending}" for name in ("lidar", "camera", "fused") for ending in ("pgm", "png")
}


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_far_ranges_are_in_no_map_and_it_says_so(tmp_path):
    out = tmp_path / "out"
    summary = fuse(far_ranges(tmp_path / "drive.mcap"), out, FAST)
    assert names(out) >= TABLES | MAPS
    side_m = GridSettings().side_max_m
    assert side_m**2 == pytest.approx(GridSettings().cells_max * GridSettings().resolution_m ** 2)
    for name in ("lidar", "fused"):
        assert any(
            note.startswith(f"{SCANS} ranges are not in the {name} map: they are longer than 400 m")
            for note in summary.notes
        )
    clean = fuse(write_drive(tmp_path / "clean.mcap"), tmp_path / "clean", FAST)
    for name, grid in summary.grids.items():
        assert grid.log_odds.shape == clean.grids[name].log_odds.shape


@pytest.mark.parametrize("tf", [False, True])
def test_a_lone_pose_far_away_costs_itself(tmp_path, tf):
    path = far_poses(tmp_path / "drive.mcap", tf=tf)
    summary = fuse(path, tmp_path / "out", FAST)
    assert names(tmp_path / "out") >= TABLES | MAPS
    topic = TF if tf else ODOMETRY
    said = f"{topic}: 1 of {SCANS} poses of base are left out, as they are lone jumps"
    assert any(note.startswith(said) for note in summary.notes)
    mapped = build_map(path, tmp_path / "map", MapOptions(slam="none"))
    planar = read_tum_trajectory(mapped.output / "trajectory.tum").trajectory.planar_poses
    assert planar.shape == (SCANS, 3)
    assert np.abs(planar[:, :2]).max() < 5.0
    assert any(note.startswith(said) for note in mapped.report["notes"])


def test_poses_that_stay_far_away_cost_the_maps_alone(tmp_path):
    path = far_poses(tmp_path / "drive.mcap", numbers=range(SCANS // 2, SCANS))
    summary = fuse(path, tmp_path / "out", FAST)
    assert names(tmp_path / "out") >= TABLES
    assert not names(tmp_path / "out") & MAPS
    assert summary.paired == SCANS
    for name in ("lidar", "camera", "fused"):
        assert any(note.startswith(f"No {name} map: a scan at") for note in summary.notes)
