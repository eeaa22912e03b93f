"""Clouds of a simulated room: where its surfaces are, and nothing else."""

from pathlib import Path

import numpy as np
import pytest

from fusion_core.model.classes import NoiseClass
from fusion_core.model.errors import MissingStream, RecordingError
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse import export_clouds as exporting
from fusion_core.workflows.fuse.export_clouds import export_clouds
from fusion_core.workflows.fuse.session import FuseOptions

VOXEL_M = 0.05


def points_of(path: Path) -> np.ndarray:
    import open3d as o3d

    return np.asarray(o3d.io.read_point_cloud(path).points)


def occupied_cells(folder: Path) -> np.ndarray:
    """(N, 2) centres of the fused map's occupied cells."""
    header, pixels = (folder / "map_fused.pgm").read_bytes().split(b"255\n", 1)
    columns, rows = map(int, header.split(b"\n")[1].split())
    grey = np.flipud(np.frombuffer(pixels, np.uint8).reshape(rows, columns))
    yaml = dict(
        line.split(": ", 1) for line in (folder / "map_fused.yaml").read_text().splitlines()
    )
    x_m, y_m = map(float, yaml["origin"].strip("[]").split(",")[:2])
    row, column = np.nonzero(grey == 0)
    return float(yaml["resolution"]) * (np.stack([column, row], axis=1) + 0.5) + [x_m, y_m]


def share_near(points: np.ndarray, others: np.ndarray, within_m: float) -> float:
    """Share of ``points`` with one of ``others`` near."""
    from scipy.spatial import KDTree

    return float(np.mean(KDTree(others).query(points)[0] < within_m))


@pytest.fixture(scope="module")
def exported(bedroom, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("clouds") / "clouds"
    export_clouds(bedroom.recording, bedroom.folder, folder, FuseOptions(), voxel_m=VOXEL_M)
    return folder


@pytest.mark.slow
def test_the_clouds_lie_on_the_surfaces_of_the_map(bedroom, exported):
    assert {path.name for path in exported.iterdir()} == {
        "lidar.ply",
        "lidar.pcd",
        "depth.ply",
        "depth.pcd",
        "manifest.json",
    }
    lidar, depth = (points_of(exported / f"{name}.ply") for name in ("lidar", "depth"))
    cells = occupied_cells(bedroom.folder)
    assert np.all(lidar[:, 2] == 0.0)
    assert share_near(cells, lidar[:, :2], 0.1) > 0.95
    # What the camera sees at the LiDAR's height is what the LiDAR sees there.
    at_lidar = depth[np.abs(depth[:, 2]) < 0.05]
    assert len(at_lidar) > 100
    assert share_near(at_lidar[:, :2], lidar[:, :2], 0.1) > 0.85
    # It looks far above and below that plane, to the floor and to nothing under it.
    assert depth[:, 2].max() > 0.5
    for name in ("lidar", "depth"):
        assert np.allclose(points_of(exported / f"{name}.pcd"), points_of(exported / f"{name}.ply"))


def test_one_point_a_voxel_and_the_same_bytes_again(bedroom, exported, tmp_path):
    points = points_of(exported / "depth.ply")
    # A mean of points that lie on a border may fall beside it by rounding.
    assert len(np.unique(np.floor(points / VOXEL_M), axis=0)) >= len(points) - 5
    export_clouds(bedroom.recording, bedroom.folder, tmp_path, FuseOptions(), voxel_m=VOXEL_M)
    for path in exported.iterdir():
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()


def test_beams_are_placed_and_burrs_that_nothing_repaired_are_left_out():
    raw = LaserScan(
        stamp_ns=0,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=0.0,
        angle_increment_rad=np.pi / 4,
        range_min_m=0.1,
        range_max_m=10.0,
        ranges_m=np.array([1.1, 2.0, np.nan, 4.0, 5.0, 12.0, np.nan]),
    )
    codes = [NoiseClass.BURR, NoiseClass.BURR, NoiseClass.HOLE, NoiseClass.CONFLICT]
    codes += [NoiseClass.GOOD, NoiseClass.GOOD, NoiseClass.HOLE]
    repaired_m = np.array([1.1, 2.5, 3.0, 4.0, 5.0, 12.0, np.nan]).astype(np.float32)
    repaired = raw.with_ranges(repaired_m.astype(np.float64), np.array(codes, dtype=np.float64))
    points_m = exporting._beams_m(raw, repaired)
    half = np.sqrt(0.5)
    directions = np.array([[half, half, 0], [0, 1, 0], [-half, half, 0], [-1, 0, 0]])
    assert np.allclose(points_m, directions * [[2.5], [3.0], [4.0], [5.0]])


def test_without_poses_there_is_no_frame_for_clouds(fused, tmp_path):
    virtual = fused("bedroom", duration_s=2.0, virtual_lidar_row=60)
    options = FuseOptions(virtual_lidar_row=60)
    with pytest.raises(MissingStream, match="no recorded poses"):
        export_clouds(virtual.recording, virtual.folder, tmp_path / "clouds", options)
    assert not (tmp_path / "clouds").exists()


def test_results_of_another_recording_are_refused(bedroom, scenes, tmp_path):
    other = scenes("bedroom", duration_s=2.0)
    with pytest.raises(RecordingError, match="not those of the results"):
        export_clouds(other, bedroom.folder, tmp_path / "clouds", FuseOptions())
    assert not (tmp_path / "clouds").exists()


def test_a_cancelled_export_leaves_nothing(bedroom, tmp_path):
    def cancel(done: int, total: int | None, what: str) -> None:
        if what.startswith("writing depth"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_clouds(
            bedroom.recording, bedroom.folder, tmp_path / "c", FuseOptions(), progress=cancel
        )
    assert not (tmp_path / "c").exists()
