"""``fuse --extrinsics``: the given transform is used whole, and takes part in what a run is."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fusion_core.exporting.manifest import Manifest
from fusion_core.model.errors import SettingsError
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_yaw_pitch_roll,
)
from fusion_core.model.given_extrinsics import CameraPose, GivenExtrinsics
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.topics import choose_streams
from fusion_core.simulation.faults import FaultSettings
from fusion_core.simulation.recorder import record_run
from fusion_core.simulation.scenes import SceneSettings, find_scene, plan_run
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.camera_rig import build_camera_rig
from fusion_core.workflows.fuse.export_clouds import export_clouds
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions
from tests.workflows.fuse.test_export_clouds import points_of

ROLL_RAD = np.deg2rad(5.0)
TOPIC = "/camera/depth/image_raw"


@pytest.fixture(scope="module")
def rolled(tmp_path_factory) -> tuple[Path, np.ndarray]:
    """A scene whose camera is rolled by 5 degrees, without transforms, and its T_camera_lidar."""
    path = tmp_path_factory.mktemp("rolled") / "rolled.mcap"
    scene = find_scene("furnished_room")
    own = scene.settings.model_dump() | {"duration_s": 3.0, "image_scale": 0.5}
    run = plan_run(scene, SceneSettings(**own), FaultSettings())
    mounts = run.simulation.mounts
    (camera,) = mounts.cameras
    # About the camera's own axis, ahead.
    roll = make_transform(rotation_from_yaw_pitch_roll(ROLL_RAD, 0.0, 0.0), np.zeros(3))
    camera = replace(camera, T_base_optical=camera.T_base_optical @ roll)
    mounts = replace(mounts, cameras=(camera,))
    simulation = replace(run.simulation, mounts=mounts)
    record_run(replace(run, simulation=simulation, published_mounts="none"), path)
    return path, invert_transform(mounts.T_lidar_camera()[0])


def extrinsics_file(folder: Path, T_camera_lidar: np.ndarray, **more) -> Path:
    path = folder / "extrinsics.json"
    path.write_text(json.dumps({"T_camera_lidar": T_camera_lidar.tolist(), **more}))
    return path


def test_a_rolled_camera_keeps_its_roll(rolled, tmp_path) -> None:
    path, T_camera_lidar = rolled
    file = extrinsics_file(tmp_path, T_camera_lidar)
    options = FuseOptions(figures=False, maps=False, extrinsics_file=file)
    summary = fuse(path, tmp_path / "given", options)
    document = json.loads((tmp_path / "given" / "alignment.json").read_text())
    (camera,) = document["cameras"]
    np.testing.assert_allclose(
        camera["T_lidar_camera"], invert_transform(T_camera_lidar), atol=1e-12
    )
    assert document["given_extrinsics"] == "extrinsics.json"
    assert document["row_model"] == "curve"
    assert not document["recorded_mount_used"]
    assert document["agreement"] > 0.9
    assert not any("contradict" in note for note in summary.notes)
    assert "Extrinsics from extrinsics.json." in summary.notes
    # Clouds of the results are placed by the same transform: the floor is level.
    export_clouds(path, tmp_path / "given", tmp_path / "clouds", FuseOptions(), voxel_m=0.05)
    heights_m = points_of(tmp_path / "clouds" / "depth.ply")[:, 2]
    assert np.quantile(heights_m, 0.01) == pytest.approx(-0.31, abs=0.03)
    # Without them the floor shows the roll, which would else seem to be a place farther left.
    found = fuse(path, tmp_path / "found", FuseOptions(figures=False, maps=False)).document
    assert found["roll_used_rad"] == pytest.approx(ROLL_RAD, abs=np.deg2rad(0.2))
    assert found["left_m"] == pytest.approx(document["left_m"], abs=0.02)
    assert "given_extrinsics" not in found
    assert "roll_used_rad" not in document


def test_the_file_is_part_of_what_a_run_is(rolled, tmp_path) -> None:
    path, T_camera_lidar = rolled
    file = extrinsics_file(tmp_path, T_camera_lidar)
    options = FuseOptions(figures=False, maps=False, extrinsics_file=file)
    folder = tmp_path / "out"
    assert not fuse(path, folder, options).skipped
    assert fuse(path, folder, options).skipped
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    names = [entry["name"] for entry in json.loads(before["manifest.json"])["inputs"]]
    assert file.name in names
    turned = T_camera_lidar.copy()
    turned[:3, :3] = rotation_from_yaw_pitch_roll(0.0, np.deg2rad(4.0), 0.0) @ turned[:3, :3]
    extrinsics_file(tmp_path, turned)
    changed = fuse(path, folder, options)
    assert not changed.skipped
    assert any("contradict them" in note for note in changed.notes)
    extrinsics_file(tmp_path, T_camera_lidar)
    fuse(path, folder, options)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
    assert Manifest.read(folder).content is not None


def test_values_set_by_hand_need_no_file(rolled) -> None:
    path, T_camera_lidar = rolled
    by_hand = GivenExtrinsics(
        source="hand", cameras={TOPIC: CameraPose(T_camera_lidar=T_camera_lidar.copy())}
    )
    with open_recording(path) as recording:
        session = open_session(recording, FuseOptions(), PRESETS["default"], by_hand)
        rig = session.rig
        assert rig.recorded_mount is None
        assert rig.known_mount is rig.given.mount
        np.testing.assert_allclose(
            rig.known_mount.T_lidar_rig @ rig.cameras[0].T_rig_camera,
            invert_transform(T_camera_lidar),
            atol=1e-12,
        )
        published = open_session(recording, FuseOptions(), PRESETS["published"], by_hand)
        (note,) = align_recording(published).notes
        assert "not by the given extrinsics" in note


def test_they_go_over_the_recordings_transforms(log, pose_of) -> None:
    log.scan(0.0)
    log.image(0.0)
    log.info()
    log.transform("laser", "camera_optical", pose_of(0.1, 0.0, 0.6, optical=True))
    T_lidar_camera = pose_of(0.2, -0.1, 0.5, yaw=-0.3, pitch=0.2, roll=0.4, optical=True)
    pose = CameraPose(T_camera_lidar=invert_transform(T_lidar_camera))
    rig = rig_with(log, {None: pose})
    mount = rig.given.mount
    assert (mount.yaw_rad, mount.pitch_rad) == pytest.approx((-0.3, 0.2))
    assert (mount.forward_m, mount.left_m, mount.delta_z_m) == pytest.approx((0.2, -0.1, 0.5))
    np.testing.assert_allclose(
        mount.T_lidar_rig @ rig.cameras[0].T_rig_camera, T_lidar_camera, atol=1e-12
    )


def rig_with(log, cameras):
    with log.open() as recording:
        streams, settings = choose_streams(recording), PRESETS["default"].sampling
        given = GivenExtrinsics(source="hand", cameras=cameras)
        return build_camera_rig(recording, streams, settings, given=given)


def test_several_cameras_are_placed_by_topic(log, pose_of) -> None:
    log.scan(0.0)
    poses = {}
    for index, name in enumerate(("a", "b", "c")):
        log.image(0.0, name=name)
        log.info(name)
        T = pose_of(0.1 * index, 0.0, 0.6, yaw=0.5 * index, roll=0.1 * index, optical=True)
        poses[f"/{name}/depth/image_raw"] = CameraPose(T_camera_lidar=invert_transform(T))
    with pytest.raises(SettingsError, match="one transform for 3 depth cameras"):
        rig_with(log, {None: next(iter(poses.values()))})
    rig = rig_with(log, poses)
    for camera in rig.cameras:
        np.testing.assert_allclose(
            rig.given.mount.T_lidar_rig @ camera.T_rig_camera,
            invert_transform(poses[camera.topic].T_camera_lidar),
            atol=1e-12,
        )
    del poses["/b/depth/image_raw"]
    rig = rig_with(log, poses)
    assert [camera.topic for camera in rig.cameras] == list(poses)
    assert any("/b/depth/image_raw left out" in note for note in rig.notes)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda T: {"T_camera_lidar": [*(1000.0 * T[:3]).tolist(), [0, 0, 0, 1]]}, "no rigid"),
        (lambda T: {"R": T[:3, :3].tolist(), "t": (1000.0 * T[:3, 3]).tolist()}, "m apart"),
        (lambda T: {"cameras": {"/other": {"T_camera_lidar": T.tolist()}}}, "none of the depth"),
        (lambda T: {"T_camera_lidar": np.eye(4).tolist()}, "looks straight up"),
        (lambda T: {"T_camera_lidar": T.tolist(), "covariance": [[1.0]]}, "covariance must be"),
        (lambda T: {"T_camera_lidar": T.tolist(), "covariance": (-np.eye(6)).tolist()}, "not neg"),
    ],
    ids=["scaled", "millimetres", "topic", "identity", "covariance", "negative"],
)
def test_a_wrong_file_is_one_clear_line(rolled, tmp_path, change, problem) -> None:
    path, T_camera_lidar = rolled
    file = tmp_path / "wrong.json"
    file.write_text(json.dumps(change(T_camera_lidar)))
    with pytest.raises(SettingsError, match=problem) as caught:
        fuse(path, tmp_path / "out", FuseOptions(extrinsics_file=file))
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_map_of_repaired_scans_uses_them(rolled, tmp_path) -> None:
    path, T_camera_lidar = rolled
    turned = T_camera_lidar.copy()
    turned[:3, :3] = rotation_from_yaw_pitch_roll(0.0, np.deg2rad(4.0), 0.0) @ turned[:3, :3]
    for name, T in (("right", T_camera_lidar), ("wrong", turned)):
        options = MapOptions(
            scan="repaired",
            slam="none",
            extrinsics_file=extrinsics_file(tmp_path, T, made_by="hand"),
        )
        notes = build_map(path, tmp_path / name, options).report["notes"]
        assert "Extrinsics from extrinsics.json." in notes
        assert any("contradict them" in note for note in notes) == (name == "wrong")
