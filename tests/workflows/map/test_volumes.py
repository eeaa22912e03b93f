"""The maps in space of keyframes as files: of a sphere seen from inside by a lens that distorts."""

import hashlib
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
import pytest

from fusion_core.model.errors import MappingFailed
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.workflows.map.keyframe_images import KeyframeImages, colors_of_depth
from fusion_core.workflows.map.volumes import VolumeSettings, write_volumes
from tests.mapping.octomap_reader import read_bt, read_ot
from tests.workflows.map.sphere_frames import INTRINSICS, RADIUS_M, SphereViews, color_of

FILES = {
    *("cloud.ply", "cloud.pcd", "cloud.png", "mesh.ply", "mesh.png", "octree.ot", "octree.bt"),
    *("map_camera.pgm", "map_camera.yaml", "map_camera.png"),
}


def settings_with(**groups):
    defaults = VolumeSettings()
    return defaults.model_copy(
        update={
            name: getattr(defaults, name).model_copy(update=values)
            for name, values in groups.items()
        }
    )


SETTINGS = settings_with(dense_cloud={"voxel_m": 0.03}, mesh={"voxel_m": 0.03, "weight_min": 1})


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("volumes")
    summary = write_volumes(folder, SphereViews(3), INTRINSICS, SETTINGS, floor_height_m=-RADIUS_M)
    return folder, summary


def test_the_files_hold_what_the_summary_says(written):
    folder, summary = written
    assert {path.name for path in folder.iterdir()} == FILES
    for name in ("cloud.ply", "cloud.pcd"):
        cloud = o3d.io.read_point_cloud(str(folder / name))
        points_m = np.asarray(cloud.points)
        assert len(points_m) == summary.points
        # The distortion is taken out: the sphere is round.
        assert np.abs(np.linalg.norm(points_m, axis=1) - RADIUS_M).max() < 0.006
        colors = np.rint(255.0 * np.asarray(cloud.colors))
        assert np.abs(colors - color_of(points_m)).max() <= 3
        assert np.allclose(points_m.min(axis=0), summary.lowest_in_map_m, atol=1e-6)
        assert np.allclose(points_m.max(axis=0), summary.highest_in_map_m, atol=1e-6)
    mesh = o3d.io.read_triangle_mesh(str(folder / "mesh.ply"))
    assert len(mesh.vertices) == summary.mesh_vertices
    assert len(mesh.triangles) == summary.mesh_triangles
    radii_m = np.linalg.norm(np.asarray(mesh.vertices), axis=1)
    # Depth of the nearest pixel, half a pixel off, of a surface at up to 60 degrees.
    assert np.abs(radii_m - RADIUS_M).mean() < 0.01
    assert np.abs(255.0 * np.asarray(mesh.vertex_colors) - color_of(mesh.vertices)).mean() < 6.0
    _, leaves = read_ot((folder / "octree.ot").read_bytes())
    assert len(leaves) == summary.octree_leaves
    assert sum(value >= 0.0 for value in leaves.values()) == summary.octree_occupied_leaves
    assert len(read_bt((folder / "octree.bt").read_bytes())[1]) > 100
    pixels = cv2.imread(str(folder / "map_camera.pgm"), cv2.IMREAD_UNCHANGED)
    assert (pixels == 0).sum() == summary.grid_occupied_cells > 0
    assert (pixels == 254).sum() == summary.grid_free_cells > 0
    report = json.loads(json.dumps(summary.to_report()))
    assert report["keyframes"] == 3
    assert "notes" not in report
    assert summary.notes == ()


def test_an_unknown_floor_is_said(tmp_path, written):
    summary = write_volumes(tmp_path, SphereViews(3), INTRINSICS, SETTINGS, floor_height_m=None)
    assert summary.floor_height_m == pytest.approx(written[1].lowest_in_map_m[2], abs=0.1)
    assert any("No floor is known" in note for note in summary.notes)


def test_maps_that_are_too_large_become_coarser(tmp_path):
    settings = settings_with(
        dense_cloud={"voxel_m": 0.01, "voxels_max": 1000},
        mesh={"voxel_m": 0.01, "blocks_max": 100, "weight_min": 1},
        octree={"resolution_m": 0.05, "nodes_max": 4000},
    )
    views = SphereViews(2)
    summary = write_volumes(tmp_path, views, INTRINSICS, settings)
    assert summary.points <= 1000
    assert summary.cloud_voxel_m > 0.01
    assert summary.mesh_voxel_m > 0.01
    assert summary.octree_resolution_m > 0.05
    assert views.passes > 1
    assert len([note for note in summary.notes if "exceeds" in note or "more than" in note]) == 3
    assert summary.keyframes == 2


class Frames:
    """Keyframes that a test has made itself."""

    def __init__(self, *frames, T_map_camera=None):
        self.frames = frames
        self.T_map_camera = np.eye(4) if T_map_camera is None else T_map_camera

    def __len__(self):
        return len(self.frames)

    def __iter__(self):
        for frame in self.frames:
            yield frame, self.T_map_camera


def frame_of(depth_m, rgb=None):
    return RgbdFrame(
        stamp_ns=0, gray=np.full((60, 80), 90, dtype=np.uint8), depth_m=depth_m, rgb=rgb
    )


@pytest.mark.parametrize("depth", [np.nan, np.inf, 0.0, -1.0, 0.1, 50.0, 1e30])
def test_keyframes_without_usable_depth(tmp_path, depth):
    frames = Frames(frame_of(np.full((60, 80), depth, dtype=np.float32)))
    with pytest.raises(MappingFailed, match="no points") as raised:
        write_volumes(tmp_path, frames, INTRINSICS, SETTINGS)
    assert "\n" not in str(raised.value)
    assert not list(tmp_path.iterdir())


def test_no_keyframes(tmp_path):
    with pytest.raises(MappingFailed, match="no points"):
        write_volumes(tmp_path, Frames(), INTRINSICS, SETTINGS)


@pytest.mark.parametrize(("at_m", "message"), [(np.nan, "not finite"), (1e9, "map's origin")])
def test_poses_that_make_no_map(tmp_path, at_m, message):
    pose = np.eye(4)
    pose[0, 3] = at_m
    frames = Frames(frame_of(np.ones((60, 80), dtype=np.float32)), T_map_camera=pose)
    with pytest.raises(MappingFailed, match=message) as raised:
        write_volumes(tmp_path, frames, INTRINSICS, SETTINGS)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (0, 80)])
def test_depth_that_is_no_image(tmp_path, shape):
    frames = Frames(frame_of(np.ones(shape, dtype=np.float32)))
    with pytest.raises(MappingFailed) as raised:
        write_volumes(tmp_path, frames, INTRINSICS, SETTINGS)
    assert "\n" not in str(raised.value)


def test_one_keyframe_with_smaller_depth_and_without_colour(tmp_path):
    """Grey images take the place of colours, and depth of half the size has its own rays."""
    depth_m = np.full((30, 40), 1.5, dtype=np.float32)
    depth_m[:5] = np.nan
    intrinsics = replace(INTRINSICS, distortion=())
    summary = write_volumes(tmp_path, Frames(frame_of(depth_m)), intrinsics, SETTINGS)
    cloud = o3d.io.read_point_cloud(str(tmp_path / "cloud.ply"))
    assert np.allclose(np.asarray(cloud.points)[:, 2], 1.5)
    assert (np.rint(255.0 * np.asarray(cloud.colors)) == 90).all()
    # The outermost pixel centres of 80 x 60 pixels, in the middle of pairs of them; the image's
    # corners have too few neighbours.
    assert summary.lowest_in_map_m[0] == pytest.approx(1.5 * (0.5 - 38.7) / 60.0, abs=0.015)
    assert summary.highest_in_map_m[0] == pytest.approx(1.5 * (78.5 - 38.7) / 60.0, abs=0.015)
    assert summary.highest_in_map_m[1] == pytest.approx(1.5 * (58.5 - 30.9) / 62.0, abs=0.015)


def test_pixels_without_distortion():
    """An image of the rays themselves: after the remap each pixel shows its own straight ray."""
    depth_m = np.ones((60, 80), dtype=np.float32)
    geometry = KeyframeImages(INTRINSICS).geometry(depth_m)
    across = geometry.rays[:, :, 0]
    value = np.rint(255.0 * (across - across.min()) / np.ptp(across)).astype(np.uint8)
    straight = geometry.straight.color(value[:, :, np.newaxis].repeat(3, axis=2))
    u = np.arange(80)
    expected = 255.0 * ((u - 38.7) / 60.0 - across.min()) / np.ptp(across)
    inside = slice(15, 65)
    found = straight[15:45, inside, 0].astype(float)
    assert np.abs(found - expected[inside]).max() < 2.0
    assert colors_of_depth(frame_of(depth_m)).shape == (60, 80, 3)


def digests(folder):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


@pytest.mark.slow
def test_the_same_bytes_with_one_thread_and_with_two(tmp_path, written):
    script = (
        "import sys; from pathlib import Path; from tests.workflows.map.test_volumes import *\n"
        "write_volumes(Path(sys.argv[1]), SphereViews(3), INTRINSICS, SETTINGS, "
        "floor_height_m=-RADIUS_M)"
    )
    for threads in ("1", "2"):
        folder = tmp_path / threads
        folder.mkdir()
        environment = {**os.environ, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
        subprocess.run(
            [sys.executable, "-c", script, str(folder)],
            check=True,
            env=environment,
            cwd=Path(__file__).parents[3],
        )
        assert digests(folder) == digests(written[0])
