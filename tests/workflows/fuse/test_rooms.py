"""Robot@Home as its users have it: one room in both versions and as MCAP, and whole sessions."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.errors import ExportError, RecordingError
from fusion_core.model.geometry import make_transform
from fusion_core.model.sensors import CameraInfo, DepthImage, LaserScan, Transform, TransformBatch
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.rooms import fuse_rooms
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.info import info
from fusion_core.workflows.source import RoomChoice
from tests.recordings import robot_at_home_trees as trees

# Left to right, as the simulated rig numbers them.
LABELS = ("RGBD_3", "RGBD_4", "RGBD_1", "RGBD_2")
QUICK = FuseOptions(maps=False, figures=False)
# A session whose rooms are short.
SHORT = "alma-s2"
KITCHEN = RoomChoice(session="alma-s1", room="kitchen1")


def rows_of(table: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(table.read_text().splitlines()))


@pytest.fixture(scope="module")
def versions(scenes, tmp_path_factory) -> dict[str, Path]:
    """One simulated panorama as MCAP with all its mounts, as v1 and as Robot@Home2."""
    folder = tmp_path_factory.mktemp("robot_at_home")
    scene = scenes("robot_at_home", duration_s=1.5, image_scale=1.0)
    truth = np.load(scene.with_name(f"{scene.stem}.truth.npz"))
    x, y, z, *_ = trees.MOUNTS["HOKUYO1"]
    T_base_laser = make_transform(np.eye(3), np.array([x, y, z]))
    body = make_transform(R_BODY_OPTICAL, np.zeros(3))
    poses = {"HOKUYO1": trees.MOUNTS["HOKUYO1"]}
    mounts = {"laser": T_base_laser}
    cameras = {}
    for number, (label, T_lidar_camera) in enumerate(
        zip(LABELS, truth["T_lidar_camera"], strict=True), start=1
    ):
        T_base_camera = T_base_laser @ T_lidar_camera
        poses[label] = trees.pose_columns(T_base_camera @ np.linalg.inv(body))
        mounts[f"camera_{number}_depth_optical_frame"] = T_base_camera
        root = f"/camera_{number}"
        cameras[label] = (f"{root}/depth/image_raw", f"{root}/color/image_raw")
    with open_recording(scene) as recording:
        room = trees.room_of(recording, cameras, "/scan", poses, room="kitchen1")
        with Ros2McapWriter(folder / "kitchen1.mcap") as writer:
            for message in recording.messages():
                match message.value:
                    case LaserScan():
                        # The data set names no frame; its reader calls the scanner's so.
                        writer.write_laser_scan("/scan", replace(message.value, frame_id="laser"))
                    case DepthImage():
                        writer.write_depth(message.topic, message.value)
                    case CameraInfo():
                        writer.write_camera_info(message.topic, message.value)
            batch = TransformBatch(
                received_ns=recording.start_ns,
                transforms=tuple(
                    Transform(stamp_ns=0, parent="base_link", child=name, T_parent_child=T.copy())
                    for name, T in mounts.items()
                ),
            )
            writer.write_transforms("/tf_static", batch)
    short = room.sights[: len(room.sights) // 2]
    other = replace(room, room="bedroom1", sights=short)
    passages = [replace(each, session=SHORT, sights=short) for each in (room, other)]
    trees.write_plain_text(folder / "v1", [room, other, *passages])
    trees.write_robot_at_home2(folder / "v2", [room, other])
    return {"mcap": folder / "kitchen1.mcap", "v1": folder / "v1", "v2": folder / "v2"}


@pytest.fixture(scope="module")
def results(versions, tmp_path_factory) -> dict[str, tuple[Path, dict]]:
    found = {}
    for name, path in versions.items():
        folder = tmp_path_factory.mktemp("fused") / name
        options = QUICK if name == "mcap" else replace(QUICK, room=KITCHEN)
        fuse(path, folder, options)
        found[name] = (folder, json.loads((folder / "alignment.json").read_text()))
    return found


@pytest.mark.parametrize("version", ["v1", "v2"])
def test_both_versions_fuse_as_the_mcap_does(results, version):
    folder, ours = results[version]
    reference_folder, reference = results["mcap"]
    assert ours["u"] == pytest.approx(reference["u"], abs=0.2)
    assert ours["yaw_rad"] == pytest.approx(reference["yaw_rad"], abs=np.deg2rad(0.3))
    rows, expected = (rows_of(f / "frames.csv") for f in (folder, reference_folder))
    assert len(rows) == len(expected) > 60
    assert [row["u"] != "" for row in rows] == [row["u"] != "" for row in expected]
    paired = [(a, b) for a, b in zip(rows, expected, strict=True) if a["u"]]
    off = [abs(float(a["u"]) - float(b["u"])) for a, b in paired]
    assert np.percentile(off, 90) <= 1.0
    counts = {
        kind: [sum(int(row[kind]) for row in table) for table in (rows, expected)]
        for kind in ("lidar_good", "lidar_hole")
    }
    for mine, theirs in counts.values():
        assert mine == pytest.approx(theirs, rel=0.03)


def test_a_root_lists_its_rooms_and_a_room_is_a_recording(versions):
    for version, bits in (("v1", 16), ("v2", 8)):
        listed = info(versions[version])
        sessions = ("alma-s1", SHORT) if version == "v1" else ("alma-s1",)
        assert [(r["session"], r["room"], r["depth_bits"]) for r in listed["rooms"]] == [
            (session, room, bits) for session in sessions for room in ("bedroom1", "kitchen1")
        ]
        inside = info(versions[version], KITCHEN)
        roles = [topic["role"] for topic in inside["topics"]]
        assert (roles.count("depth"), roles.count("lidar")) == (4, 1)
        assert any("8 bits" in line for line in inside["warnings"]) is (bits == 8)


def test_coarse_depth_is_carried_into_epsilon(results):
    epsilon = {
        name: np.median(
            [float(row["epsilon_m"]) for row in rows_of(folder / "frames.csv") if row["epsilon_m"]]
        )
        for name, (folder, _) in results.items()
    }
    assert epsilon["v1"] == pytest.approx(epsilon["mcap"], rel=0.02)
    assert epsilon["v2"] > epsilon["mcap"]


def test_table_1_over_the_rooms_of_a_session(versions, tmp_path):
    summary = fuse_rooms(versions["v1"], SHORT, tmp_path / "all", QUICK)
    table = rows_of(tmp_path / "all" / "table1.csv")
    assert [row["room"] for row in table] == [f"{SHORT}_bedroom1", f"{SHORT}_kitchen1"]
    frames = rows_of(tmp_path / "all" / f"{SHORT}_kitchen1" / "frames.csv")
    scored = sum(
        int(table[1][name]) for name in ("low", "middle", "high", "not_positive", "missing")
    )
    # A panorama of the four cameras counts once.
    assert 4 * scored == sum(1 for row in frames if row["scan_stamp_ns"])
    assert summary.failed == {}
    assert any(f"{SHORT}_bedroom1" in line for line in summary.lines())


def test_nothing_is_written_into_the_data_set_or_over_a_foreign_table(versions, tmp_path):
    root = versions["v1"]
    for output in (root, root / "out", root.parent):
        with pytest.raises(ExportError, match="the input"):
            fuse_rooms(root, "alma-s1", output, QUICK)
    with pytest.raises(ExportError, match="lies inside the input"):
        fuse(root, root / "out", replace(QUICK, room=KITCHEN))
    (tmp_path / "table1.csv").write_text("mine")
    with pytest.raises(ExportError, match="not rooms of a session"):
        fuse_rooms(root, "alma-s1", tmp_path, QUICK)
    assert (tmp_path / "table1.csv").read_text() == "mine"


def test_unknown_names_are_answered_with_those_there_are(versions, tmp_path):
    with pytest.raises(RecordingError, match="alma-s1"):
        fuse_rooms(versions["v1"], "alma-s9", tmp_path / "none", QUICK)
    with pytest.raises(RecordingError, match="bedroom1, kitchen1"):
        info(versions["v2"], RoomChoice(session="alma-s1", room="attic"))
    with pytest.raises(RecordingError, match="no root of Robot@Home"):
        info(versions["mcap"], KITCHEN)
    with pytest.raises(RecordingError, match="--home SESSION --room ROOM"):
        fuse(versions["v1"], tmp_path / "none", QUICK)
