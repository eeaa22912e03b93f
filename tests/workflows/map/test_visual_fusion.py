"""Camera and LiDAR together by visual SLAM: as the motion of the scans, and grid by grid."""

import json

import numpy as np
import pytest

from fusion_core.model.errors import MissingStream
from fusion_core.recordings.ros_map import read_ros_map
from fusion_core.simulation.scenes import find_scene, write_scene
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.grid_fusion import read_evidence
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.result_folder import read_maps
from fusion_core.workflows.map.visual_result_folder import read_visual_map, read_visual_results
from tests.benchmarks.bench_office import trajectory_errors_m
from tests.workflows.map.test_visual_map import folder as images_alone

__all__ = ["images_alone"]


@pytest.fixture(scope="module")
def office(tmp_path_factory):
    path = tmp_path_factory.mktemp("office") / "office.mcap"
    settings = find_scene("office").settings
    settings = settings.model_copy(update={"seed": 2, "image_scale": 0.5, "duration_s": 6.0})
    write_scene("office", path, settings=settings)
    return path


def test_a_fusion_without_a_lidar_is_refused_at_once(images_alone, tmp_path):
    with pytest.raises(MissingStream, match="has no 2D LiDAR: --fusion table") as caught:
        build_map(images_alone, tmp_path / "map", MapOptions(slam="visual", fusion="table"))
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "map" / "report.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["table", "bayes"])
def test_both_grids_are_fused_along_one_path(rule, office, tmp_path):
    output = tmp_path / "map"
    summary = build_map(office, output, MapOptions(slam="visual", fusion=rule))
    assert set(read_maps(output)) == {"lidar", "camera", "fused"}
    evidence = read_evidence(output)
    assert list(evidence) == ["lidar", "camera"]
    report = summary.report["grid_fusion"]
    assert report["rule"] == rule
    placed = report["misalignment"]
    assert placed["observable"]
    # A cell, where nothing is moved.
    assert np.hypot(placed["dx_m"], placed["dy_m"]) < 0.05
    assert not placed["applied"]
    assert any("Misalignment of camera on lidar" in note for note in summary.report["notes"])
    shown = read_visual_map(output, read_visual_results(output)).grid
    fused = read_ros_map(output / "map_fused.yaml")
    assert shown is not None
    assert (shown.log_odds > 0.0).sum() == fused.occupied.sum()
    occupied = {name: (grid.log_odds > 0.0).sum() for name, grid in evidence.items()}
    if rule == "table":
        assert fused.occupied.sum() > 0.9 * max(occupied.values())


@pytest.mark.slow
def test_visual_slam_is_the_motion_of_the_scans(office, tmp_path):
    alone = build_map(office, tmp_path / "lidar", MapOptions(motion="none"))
    assert alone.report["surface_adjustment"] == {"adjusted": True, "odometry": {}}
    fused = build_map(office, tmp_path / "fused", MapOptions(motion="visual-slam"))
    found = json.loads(json.dumps(fused.report["surface_adjustment"]))["odometry"]["visual-slam"]
    assert found["scale"] == pytest.approx(1.0, abs=0.02)
    assert found["widened"] >= 1.0
    assert (tmp_path / "fused" / "odometry_visual-slam.tum").exists()
    assert any("Visual SLAM has placed" in note for note in fused.report["notes"])
    ours, theirs = (trajectory_errors_m(tmp_path / name, office) for name in ("fused", "lidar"))
    assert ours.mean() < theirs.mean()
    assert ours.mean() < 0.004
