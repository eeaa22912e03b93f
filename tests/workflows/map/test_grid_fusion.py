"""``map --fusion``: two independent grids of a recording fused cell by cell; what is refused."""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fusion_core.mapping.bayes import fuse_grids
from fusion_core.mapping.canvas import pad_to_common_canvas
from fusion_core.mapping.grid_misalignment import GridFusionSettings
from fusion_core.model.errors import ExportError, MissingStream, SettingsError
from fusion_core.model.grid_fusion import CellState, cell_states
from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.grid_fusion import (
    cell_evidence,
    fuse_named_grids,
    fusion_notes,
    fusion_report,
    read_evidence,
)
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.result_folder import read_map_results, read_maps
from fusion_core.workflows.map.settings import MAP_PRESETS
from scanloom.cli import main
from tests.mapping.test_grid_misalignment import ROOM, lidar_and_camera
from tests.slam.ring import drive
from tests.workflows.map.test_build_map import write_log

FILES = {
    "evidence.npz",
    "fusion.png",
    "misalignment.png",
    *(f"map_{name}.{kind}" for name in ("lidar", "camera", "fused") for kind in ("pgm", "yaml")),
}


@pytest.fixture(scope="module")
def recording(scenes) -> Path:
    return scenes("turtlebot_low", duration_s=3.0)


@pytest.fixture(scope="module")
def mapped(recording, tmp_path_factory) -> Callable[..., Path]:
    """The results of a run's options, each made once."""

    @cache
    def results(fusion: str, scan: str = "merged", motion: str = "visual") -> Path:
        folder = tmp_path_factory.mktemp("mapped") / "map"
        build_map(recording, folder, MapOptions(fusion=fusion, scan=scan, motion=motion))
        return folder

    return results


@pytest.fixture(scope="module")
def table(mapped) -> Path:
    return mapped("table")


def report_of(folder: Path) -> dict:
    return json.loads((folder / "report.json").read_text(encoding="utf-8"))


def test_merged_scans_by_visual_odometry_are_mapped_whole(table):
    written = {path.name for path in table.iterdir()}
    assert written >= FILES | {"odometry_visual.tum", "trajectory.tum", "graph.g2o"}
    # The layers that merged scans show without a fusion are the same two sensors again.
    assert "map_merged.yaml" not in written
    report = report_of(table)
    assert report["trusted_share"] > 0.8
    assert report["fusion"] == "table"
    assert report["grid_fusion"]["grids"] == ["lidar", "camera"]


def test_the_cells_where_the_rules_differ_are_counted(table):
    said = report_of(table)["grid_fusion"]
    grids = read_evidence(table)
    first, second = (cell_states(grid.log_odds) for grid in grids.values())
    differ = 0
    for a, b, x, y in zip(
        first.flat,
        second.flat,
        grids["lidar"].log_odds.flat,
        grids["camera"].log_odds.flat,
        strict=True,
    ):
        against = CellState.OCCUPIED in (a, b) and CellState.EMPTY in (a, b)
        differ += against and not x + y > 0.0
    assert 0 < differ == said["rules_differ"]
    assert said["cells"]["occupied empty"] + said["cells"]["empty occupied"] > differ
    assert sum(said["cells"].values()) == first.size


def require_maps_of_evidence(folder: Path, rule: str) -> None:
    fusion = fuse_grids(read_evidence(folder))
    drawn = read_maps(folder)["fused"]
    probability = fusion.fused(rule).probability
    np.testing.assert_array_equal(drawn.log_odds > 0.0, probability > 0.65)
    np.testing.assert_array_equal(drawn.log_odds < 0.0, probability < 0.25)
    shown = read_map_results(folder).grid
    assert shown is not None
    np.testing.assert_array_equal(shown.log_odds, drawn.log_odds)


def test_the_fused_map_is_that_of_the_evidence(table):
    require_maps_of_evidence(table, "table")


@pytest.mark.slow
def test_the_other_rule_fuses_the_same_grids_otherwise(mapped, table):
    bayes = mapped("bayes")
    require_maps_of_evidence(bayes, "bayes")
    for name in ("evidence.npz", "map_lidar.pgm", "map_camera.pgm", "trajectory.tum"):
        assert (table / name).read_bytes() == (bayes / name).read_bytes(), name
    drawn = [
        np.frombuffer((run / "map_fused.pgm").read_bytes(), np.uint8) for run in (table, bayes)
    ]
    differ = np.count_nonzero(drawn[0] != drawn[1])
    assert 0 < differ == report_of(table)["grid_fusion"]["drawn_cells_differ"]


@pytest.mark.slow
def test_the_two_grids_share_no_beam(recording, mapped, tmp_path):
    # The LiDAR's grid is that of a run without any camera, and the camera's is that of a run in
    # which no scan of the LiDAR is placed.
    fused = mapped("table", "lidar", "recorded")
    assert any("Extrinsics from" in note for note in report_of(fused)["notes"])
    lidar = mapped("none", "lidar", "recorded")
    assert (fused / "map_lidar.pgm").read_bytes() == (lidar / "map_lidar.pgm").read_bytes()
    by_poses = MapOptions(slam="none", fusion="table")
    camera = MapOptions(slam="none", scan="camera")
    maps = [
        read_maps(build_map(recording, tmp_path / name, options).output)["camera"]
        for name, options in (("fused", by_poses), ("camera", camera))
    ]
    # Poses between two scans are interpolated, which moves a beam's end by a cell here and there.
    laid = pad_to_common_canvas(dict(zip("ab", maps, strict=True)))
    same = laid["a"].known == laid["b"].known
    assert same.mean() > 0.98


@pytest.mark.slow
def test_merged_maps_are_as_they_were_without_a_fusion(mapped):
    folder = mapped("none")
    assert {"map_lidar.yaml", "map_merged.yaml"} <= {path.name for path in folder.iterdir()}
    assert "grid_fusion" not in report_of(folder)


def test_the_misalignment_is_said_and_not_applied(table):
    said = report_of(table)["grid_fusion"]["misalignment"]
    assert said["applied"] is False
    for name in ("dx_m", "dy_m", "yaw_rad"):
        if said[name] is not None:
            assert abs(said[name]) < 5.0 * said[f"sigma_{name}"]
    notes = report_of(table)["notes"]
    assert any("Misalignment of camera on lidar" in note for note in notes)


def test_the_second_grid_is_moved_where_that_is_asked():
    error = np.array([0.2, -0.1, 0.03])
    lidar, camera = lidar_and_camera(ROOM, 0, turned_rad=0.3, error=error)
    grids = {"lidar": lidar, "camera": camera}
    shown = fuse_named_grids(grids, "table", GridFusionSettings())
    moved = fuse_named_grids(grids, "table", GridFusionSettings(alignment="apply"))
    assert (shown.is_moved, moved.is_moved) == (False, True)
    # What is reported is the same; what is fused lies on the same walls.
    said, applied = (fusion_report(fused) for fused in (shown, moved))
    assert said["misalignment"]["more_than_chance"]
    assert applied["misalignment"] == said["misalignment"] | {"applied": True}
    assert applied["cells"]["occupied occupied"] > 2 * said["cells"]["occupied occupied"]
    assert "more than chance; not applied" in " ".join(fusion_notes(shown))
    np.testing.assert_array_equal(moved.given["camera"].log_odds, camera.log_odds)


def test_what_is_not_observable_is_said_and_nothing_is_moved():
    lidar, _ = lidar_and_camera(ROOM, 0, turned_rad=0.0, error=np.zeros(3))
    nothing = OccupancyGrid(
        resolution_m=lidar.resolution_m,
        origin_m=lidar.origin_m,
        log_odds=np.full_like(lidar.log_odds, np.nan),
    )
    apply = GridFusionSettings(alignment="apply")
    fused = fuse_named_grids({"lidar": lidar, "projected": nothing}, "bayes", apply)
    assert fusion_report(fused)["misalignment"] == {
        "observable": False,
        "reason": fused.reason,
        "applied": False,
    }
    assert "not observable" in fusion_notes(fused)[-1]
    np.testing.assert_array_equal(fused.result.log_odds, lidar.log_odds)


def test_the_evidence_of_a_cell_can_be_read_from_the_folder(table):
    grids = read_evidence(table)
    lidar = grids["lidar"]
    row, column = np.argwhere(grids["camera"].known & lidar.known)[0]
    x_m, y_m = np.array(lidar.origin_m) + lidar.resolution_m * (np.array([column, row]) + 0.5)
    evidence = cell_evidence(grids, float(x_m), float(y_m))
    assert evidence.log_odds == {name: grid.log_odds[row, column] for name, grid in grids.items()}
    assert evidence.bayes_log_odds == pytest.approx(sum(evidence.log_odds.values()))


def test_evidence_that_is_not_there_or_was_changed_is_an_error(tmp_path):
    with pytest.raises(ExportError, match="holds no evidence"):
        read_evidence(tmp_path)
    (tmp_path / "evidence.npz").write_bytes(b"no archive")
    with pytest.raises(ExportError):
        read_evidence(tmp_path)


def test_repaired_scans_are_refused(recording, tmp_path, capsys):
    folder = tmp_path / "map"
    assert (
        main(["map", str(recording), "-o", str(folder), "--scan", "repaired", "--fusion", "table"])
        == 2
    )
    said = capsys.readouterr().err.strip()
    assert "count twice" in said
    with pytest.raises(SettingsError, match="count twice"):
        build_map(recording, folder, MapOptions(scan="repaired", fusion="bayes"))


def test_a_recording_with_one_sensor_is_refused(tmp_path):
    log = write_log(tmp_path / "ring.clf", drive(5))
    with pytest.raises(MissingStream, match="has no depth image: --fusion table takes"):
        build_map(log, tmp_path / "map", MapOptions(fusion="table"))


def test_the_published_preset_has_octomaps_increments_and_table_3():
    grid = MAP_PRESETS["published"].grid
    assert (grid.p_hit, grid.p_miss, grid.p_lowest, grid.p_highest) == (0.7, 0.4, 0.1192, 0.971)
    assert MAP_PRESETS["published"].grid_fusion.alignment == "off"
