"""``map --slam visual`` of folders of images, and what it refuses."""

import json

import cv2
import numpy as np
import pytest

from fusion_core.mapping.floor_in_map import find_floor_in_map
from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.errors import AlignmentFailed, MissingStream, SettingsError
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.recordings.tum_trajectory import read_tum_trajectory
from fusion_core.workflows.info import info
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions
from tests.slam.visual.textured_corner import INTRINSICS, frame, poses

COUNT = 12
POSES = poses(COUNT)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Images in the layout of 7-Scenes."""
    path = tmp_path_factory.mktemp("frames")
    for k, T in enumerate(POSES):
        view = frame(T, k)
        cv2.imwrite(str(path / f"frame-{k:06d}.color.png"), view.gray)
        depth_mm = np.nan_to_num(1000.0 * view.depth_m).astype(np.uint16)
        cv2.imwrite(str(path / f"frame-{k:06d}.depth.png"), depth_mm)
        np.savetxt(path / f"frame-{k:06d}.pose.txt", T)
    np.savetxt(path / "camera-intrinsics.txt", INTRINSICS.matrix)
    return path


@pytest.fixture(scope="module")
def mapped(folder, tmp_path_factory):
    output = tmp_path_factory.mktemp("out") / "map"
    return output, build_map(folder, output, MapOptions(slam="visual", workers=2))


def test_each_image_has_a_line(mapped):
    output, summary = mapped
    assert summary.report["images_tracked"] == summary.report["images"] == COUNT
    trajectory = read_tum_trajectory(output / "trajectory.tum").trajectory
    assert trajectory.stamps_ns.size == COUNT
    assert not (output / "trajectory_camera.tum").exists()
    true = np.linalg.inv(POSES[0]) @ POSES
    ours = np.linalg.inv(trajectory.T_map_body[0]) @ trajectory.T_map_body
    assert np.linalg.norm(ours[:, :3, 3] - true[:, :3, 3], axis=1).max() < 0.02
    # Two walls and no floor: the first camera's own axes, z up.
    np.testing.assert_allclose(trajectory.T_map_body[0][:3, :3], R_BODY_OPTICAL, atol=1e-6)
    assert any("first camera's own axes" in note for note in summary.report["notes"])


def test_the_files_of_the_contract(mapped):
    output, summary = mapped
    there = {path.name for path in output.iterdir()}
    assert there >= {
        "trajectory.tum", "keyframes.tum", "visual_map.npz", "cloud.ply", "cloud.pcd",
        "mesh.ply", "octree.bt", "octree.ot", "map_camera.yaml", "map_camera.pgm",
        "report.json", "settings.toml", "manifest.json",
    }  # fmt: skip
    with np.load(output / "visual_map.npz") as visual_map:
        keyframes = len(visual_map["stamps_ns"])
        assert visual_map["T_map_camera"].shape == (keyframes, 4, 4)
        offsets, landmarks = visual_map["offsets"], visual_map["landmarks"]
        assert offsets[0] == 0
        assert offsets[-1] == len(landmarks) == len(visual_map["pixels"])
        assert visual_map["pixels"].dtype == np.float32
        assert -1 <= landmarks.min() < landmarks.max() < len(visual_map["landmarks_in_map_m"])
        # A landmark lies where its keyframe's pixel says.
        row = int(np.flatnonzero(landmarks >= 0)[0])
        T = np.linalg.inv(visual_map["T_map_camera"][0])
        p = T[:3, :3] @ visual_map["landmarks_in_map_m"][landmarks[row]] + T[:3, 3]
        pixel = p[:2] / p[2] * INTRINSICS.fx + [INTRINSICS.cx, INTRINSICS.cy]
        np.testing.assert_allclose(pixel, visual_map["pixels"][row], atol=4.0)
        assert visual_map["loops"].shape == (0, 2)
    stamps_ns = read_tum_trajectory(output / "keyframes.tum").trajectory.stamps_ns
    assert len(stamps_ns) == keyframes == summary.report["keyframes"]


@pytest.mark.slow
def test_one_thread_writes_the_same_bytes(mapped, folder, tmp_path):
    output, _ = mapped
    build_map(folder, tmp_path / "map", MapOptions(slam="visual", workers=1))
    for name in ("trajectory.tum", "keyframes.tum", "visual_map.npz", "cloud.ply", "report.json"):
        assert (tmp_path / "map" / name).read_bytes() == (output / name).read_bytes(), name


def test_it_is_skipped_the_second_time(mapped, folder):
    output, summary = mapped
    again = build_map(folder, output, MapOptions(slam="visual", workers=2))
    assert again.is_skipped
    assert json.loads(json.dumps(again.report)) == json.loads(json.dumps(summary.report))
    assert any("12 of 12 have a pose" in line for line in again.lines())


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (MapOptions(slam="visual", scan="merged"), "--scan merged"),
        (MapOptions(slam="visual", motion="laser"), "--motion laser"),
        (MapOptions(slam="visual", preset="published"), "--preset published"),
        (MapOptions(slam="visual", seed=1), "--seed"),
        (MapOptions(slam="visual", pose_topic="/odom"), "--pose"),
        (MapOptions(slam="visual", clock_offset_ms=3.0), "--clock-offset-ms"),
    ],
)
def test_options_without_a_use_are_refused(options, named, folder, tmp_path):
    with pytest.raises(SettingsError, match=named):
        build_map(folder, tmp_path / "map", options)
    assert not (tmp_path / "map").exists()


@pytest.mark.parametrize(("lacking", "named"), [("color", "colour"), ("intrinsics", "intrinsics")])
def test_what_lacks_is_named(lacking, named, folder, tmp_path):
    bare = tmp_path / "frames"
    bare.mkdir()
    for path in folder.iterdir():
        if lacking not in path.name:
            (bare / path.name).write_bytes(path.read_bytes())
    with pytest.raises(MissingStream, match=named) as caught:
        build_map(bare, tmp_path / "map", MapOptions(slam="visual"))
    assert "Visual SLAM" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not any("visual SLAM" in line for line in info(bare)["can"] if "cannot" not in line)


def test_info_says_that_it_can(folder):
    assert any("visual SLAM" in line for line in info(folder)["can"])


def test_the_floor_below_a_camera_in_a_hand():
    """A floor 1.4 m below, a table at 0.7 m, seen from poses that pitch and rise."""
    v, u = np.mgrid[:240, :320].astype(float)
    rays = np.stack(
        [
            (u - INTRINSICS.cx) / INTRINSICS.fx,
            (v - INTRINSICS.cy) / INTRINSICS.fy,
            np.ones(u.shape),
        ],
        axis=-1,
    )
    rng = np.random.default_rng(0)
    views, first = [], None
    for k in range(8):
        R = rotation_from_yaw_pitch_roll(0.1 * k, 0.5 + 0.03 * k, 0.02 * k) @ R_BODY_OPTICAL
        T = make_transform(R, np.array([0.05 * k, 0.0, 1.4 + 0.03 * k]))
        d = rays @ R.T
        with np.errstate(divide="ignore"):
            floor = np.where(d[..., 2] < 0.0, -T[2, 3] / d[..., 2], np.inf)
            table = np.where(d[..., 2] < 0.0, (0.7 - T[2, 3]) / d[..., 2], np.inf)
        x, y = (T[axis, 3] + table * d[..., axis] for axis in (0, 1))
        depth = np.where((np.abs(x - 1.5) < 0.5) & (np.abs(y) < 0.6), table, floor)
        depth += rng.normal(0.0, 0.003, depth.shape)
        depth[~(depth < 6.0)] = np.nan
        first = T if first is None else first
        views.append((depth.astype(np.float32), np.linalg.inv(first) @ T))
    found = find_floor_in_map(
        views, INTRINSICS, np.array([0.0, -1.0, 0.0]), tilt_max_rad=np.deg2rad(45.0)
    )
    np.testing.assert_allclose(found.up, first[2, :3], atol=0.005)
    assert found.offset_m == pytest.approx(1.4, abs=0.01)
    with pytest.raises(AlignmentFailed, match="no floor"):
        find_floor_in_map(views, INTRINSICS, np.array([0.0, 1.0, 0.0]), tilt_max_rad=0.7)
