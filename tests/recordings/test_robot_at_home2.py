"""Robot@Home2: the tables and files of rh.db against the same room in the first version."""

import random
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.robot_at_home.rooms import list_rooms, open_room
from fusion_core.recordings.topics import choose_streams

QUANTUM_M = 256 / 6553.5
MINUTE_NS = 60 * 10**9


def refused(call: Callable[[], Any]) -> str:
    with pytest.raises(RecordingError) as caught:
        call()
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture
def trees(robot_at_home_trees: Any) -> Any:
    return robot_at_home_trees


@pytest.fixture
def room(trees: Any) -> Any:
    return trees.small_room()


@pytest.fixture
def write(trees: Any, tmp_path: Path) -> Callable[..., Path]:
    return lambda *rooms, **options: trees.write_robot_at_home2(tmp_path / "R@H2", rooms, **options)


def change(root: Path, *statements: str) -> None:
    with closing(sqlite3.connect(root / "rh.db")) as connection:
        for statement in statements:
            connection.execute(statement)
        connection.commit()


def test_the_same_room_in_both_versions(
    trees: Any, write: Callable[..., Path], room: Any, tmp_path: Path
) -> None:
    first = trees.write_plain_text(tmp_path / "first", [room])
    with open_recording(first) as one, open_recording(write(room)) as two:
        assert [(t.name, t.count) for t in one.topics] == [(t.name, t.count) for t in two.topics]
        for a, b in zip(one.messages(), two.messages(), strict=True):
            assert (a.topic, a.stamp_ns) == (b.topic, b.stamp_ns)
            if a.topic.endswith("depth"):
                fine, coarse = a.value.depth_m, b.value.depth_m
                assert (a.value.quantum_m, b.value.quantum_m) == (None, QUANTUM_M)
                # Less than a step is lost to 0, as what the camera did not see.
                np.testing.assert_array_equal(np.isnan(coarse), ~(fine > QUANTUM_M * 0.999))
                assert np.nanmax(np.abs(fine - coarse)) <= 0.5 * QUANTUM_M
            elif a.topic.endswith("color"):
                np.testing.assert_array_equal(a.value.rgb, b.value.rgb)
            elif a.topic == "/laser":
                np.testing.assert_array_equal(a.value.ranges_m, b.value.ranges_m)
                np.testing.assert_array_equal(a.value.angles_rad, b.value.angles_rad)
            elif a.topic == "/tf_static":
                for s, t in zip(a.value.transforms, b.value.transforms, strict=True):
                    assert (s.parent, s.child) == (t.parent, t.child)
                    np.testing.assert_array_equal(s.T_parent_child, t.T_parent_child)


def test_the_stored_images_are_those_of_the_cruncher(
    trees: Any, write: Callable[..., Path], room: Any, tmp_path: Path
) -> None:
    """Its three calls of OpenCV, on a file of the first version."""
    first = trees.write_plain_text(tmp_path / "first", [room])
    for kind in ("depth", "intensity"):
        source = next(first.rglob(f"0_{kind}.png"))
        turned = cv2.rotate(
            cv2.imread(str(source), cv2.IMREAD_COLOR), cv2.ROTATE_90_COUNTERCLOCKWISE
        )
        assert turned.shape == (320, 240, 3)
        root = tmp_path / "R@H2"
        stored = (root if root.exists() else write(room)) / "files/rgbd/session_1/alma/bedroom1"
        ours = stored / f"subsession_1/100000_{kind}.png"
        np.testing.assert_array_equal(cv2.imread(str(ours), cv2.IMREAD_UNCHANGED), turned)


def test_upright_files_are_turned_back(write: Callable[..., Path], room: Any) -> None:
    """Upright pixel (c, r) is stored pixel (u, v) = (319 - r, c)."""
    root = write(room)
    file = next(root.rglob("100000_depth.png"))
    upright = np.zeros((320, 240), dtype=np.uint8)
    upright[5, 7] = 100
    cv2.imwrite(str(file), upright)
    with open_recording(root) as recording:
        depth_m = recording.read("/rgbd_1/depth", 0).value.depth_m
    assert np.argwhere(np.isfinite(depth_m)).tolist() == [[7, 319 - 5]]
    assert depth_m[7, 314] == pytest.approx((100 * 256 + 127.5) / 6553.5)


def test_sixteen_bits_are_fine(write: Callable[..., Path], room: Any) -> None:
    with open_recording(write(room, bits=16)) as recording:
        assert recording.warnings == []
        depth = recording.read("/rgbd_1/depth", 0).value
    assert depth.quantum_m is None
    error_m = room.sights[0].depth_m - depth.depth_m
    assert np.nanmin(error_m) >= -1e-6
    assert np.nanmax(error_m) <= 1.0 / 6553.5 + 1e-6


def several(trees: Any) -> list[Any]:
    return [
        trees.small_room(),
        trees.small_room(room="kitchen1", labels=["RGBD_2"]),
        replace(trees.small_room(room="fullhouse1"), sights=[]),
        trees.small_room(session="sarmis-s2"),
        replace(
            trees.small_room(session="sarmis-s2", subsession=2, start_ns=trees.T0 + MINUTE_NS),
            sweeps={
                3: trees.small_room(start_ns=trees.T0 + MINUTE_NS).sweeps[2],
            },
        ),
    ]


def test_rooms_are_listed(trees: Any, write: Callable[..., Path]) -> None:
    root = write(*several(trees))
    listed = [
        (x.home, x.session, x.room, x.subsession, x.scans, x.images, x.depth_bits)
        for x in list_rooms(root)
    ]
    assert listed == [
        ("alma", "alma-s1", "bedroom1", 1, 5, 6, 8),
        ("alma", "alma-s1", "fullhouse1", 1, 5, 0, None),
        ("alma", "alma-s1", "kitchen1", 1, 5, 3, 8),
        ("sarmis", "sarmis-s2", "bedroom1", 1, 5, 6, 8),
        ("sarmis", "sarmis-s2", "bedroom1", 2, 5, 6, 8),
    ]


def test_rooms_are_named_and_distinguished(trees: Any, write: Callable[..., Path]) -> None:
    root = write(*several(trees))
    text = refused(lambda: open_recording(root))
    assert "sarmis-s2 bedroom1 (subsession 2)" in text
    assert "--home SESSION --room ROOM" in text
    assert "alma-s1, sarmis-s2" in refused(lambda: open_room(root, "pare-s1", "bedroom1"))
    assert "bedroom1, fullhouse1" in refused(lambda: open_room(root, "alma-s1", "alma_bedroom1"))
    assert "There is 1." in refused(lambda: open_room(root, "alma-s1", "kitchen1", 2))
    with open_room(root, "sarmis-s2", "bedroom1", 2) as recording:
        assert "Laser sequences read: 3; " in recording.warnings[0]
        scan = recording.read("/laser", 0)
        assert scan.stamp_ns == trees.T0 + MINUTE_NS + 3 * trees.MS


def test_the_database_alone_names_its_room(write: Callable[..., Path], room: Any) -> None:
    root = write(room)
    for path in (root, root / "rh.db"):
        with open_recording(path) as recording:
            assert recording.format == "Robot@Home2 room"
            assert choose_streams(recording).depth == ("/rgbd_1/depth", "/rgbd_4/depth")


def test_poses_in_a_map_take_their_mounts_from_the_raw_data(
    trees: Any, write: Callable[..., Path], room: Any
) -> None:
    sights = [
        replace(s, pose=(0.1 * i, 0.5, 1.045, 0.01 * i, 0.0, -1.5708))
        for i, s in enumerate(room.sights)
    ]
    root = write(replace(room, sights=sights, mounts=trees.MOUNTS))
    with open_recording(root) as recording:
        assert "mounts are those of the raw data" in recording.warnings[1]
        (static,) = recording.messages(["/tf_static"])
        heights = {t.child: t.T_parent_child[2, 3] for t in static.value.transforms}
        assert heights == {"laser": 0.31, "rgbd_1_optical": 1.045, "rgbd_4_optical": 1.045}
        places = [m.value.T_parent_child[0, 3] for m in recording.messages(["/rgbd_4/pose"])]
    assert places == pytest.approx([0.1, 0.3, 0.5])


def test_a_room_that_only_the_raw_data_has(write: Callable[..., Path], room: Any) -> None:
    root = write(room)
    change(
        root,
        "INSERT INTO rh_raw SELECT * FROM rh_lblrgbd",
        "UPDATE rh_raw SET id = id - 100000",
        "UPDATE rh2_old2new_rgbd_files SET id = id - 100000",
        "DELETE FROM rh_lblrgbd",
        # The toolbox stores no angles with raw scans.
        "UPDATE rh_lsrscan SET id = id - 190000, home_subsession_id = 0, laser_aperture = 0,"
        " laser_max_range = 0, laser_num_of_scans = 0",
        "INSERT INTO rh_raw SELECT * FROM rh_lsrscan",
        "DELETE FROM rh_lsrscan",
        "INSERT INTO rh_raw_scans SELECT id, shot_id, scan, valid_scan,"
        " sensor_observation_id - 190000 FROM rh_lsrscan_scans",
    )
    with open_recording(root) as recording:
        assert "taken as 4.1847 rad" in recording.warnings[0]
        assert len(list(recording.messages(["/rgbd_1/depth", "/laser"]))) == 3 + 5
        scan = recording.read("/laser", 0).value
    np.testing.assert_array_equal(scan.ranges_m, room.sweeps[2][0].ranges_m)
    assert scan.angle_increment_rad == 4.1847 / 682


@pytest.mark.parametrize(
    "path",
    ["'../../../secret'", "'/etc'", "'a/../../b'", "'C:/x'", "'a\\b'", "''", "NULL", "x'ff'"],
)
@pytest.mark.parametrize("column", ["new_path", "new_file_1"])
def test_paths_that_leave_the_root_are_refused(
    write: Callable[..., Path], room: Any, path: str, column: str
) -> None:
    root = write(room)
    change(root, f"UPDATE rh2_old2new_rgbd_files SET {column} = {path} WHERE id = 100000")
    with open_recording(root) as recording:
        assert "no path below" in refused(lambda: recording.read("/rgbd_1/depth", 0))
        assert len(list(recording.messages(["/rgbd_1/depth"]))) == 2


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("DELETE FROM rh_lsrscan_scans WHERE shot_id = 3 AND sensor_observation_id = 200000", "3"),
        ("UPDATE rh_lsrscan_scans SET shot_id = 7 WHERE shot_id = 3", "beam 4 follows"),
        ("UPDATE rh_lsrscan SET laser_num_of_scans = 1000000000 WHERE id = 200000", "1e+09 beams"),
        ("UPDATE rh_lsrscan SET laser_num_of_scans = NULL WHERE id = 200000", "no scan"),
        ("UPDATE rh_lsrscan SET laser_aperture = 'wide' WHERE id = 200000", "no scan"),
        ("UPDATE rh_lsrscan SET laser_num_of_scans = 683 WHERE id = 200000", "682 of its 683"),
        ("UPDATE rh_lsrscan_scans SET scan = 'far' WHERE id = 5", "no scan"),
    ],
)
def test_scans_that_contradict_themselves(
    write: Callable[..., Path], room: Any, statement: str, said: str
) -> None:
    root = write(room)
    change(root, statement)
    with open_recording(root) as recording:
        assert said in refused(lambda: recording.read("/laser", 0))


def test_rows_that_are_no_observations(write: Callable[..., Path], room: Any) -> None:
    root = write(room)
    change(
        root,
        "UPDATE rh_lblrgbd SET time_stamp = 7 WHERE id = 100000",
        "UPDATE rh_lblrgbd SET sensor_pose_x = NULL WHERE id = 100001",
        "DELETE FROM rh2_old2new_rgbd_files WHERE id = 100002",
    )
    with open_recording(root) as recording:
        counts = {t.name: t.count for t in recording.topics}
        assert (counts["/rgbd_1/depth"], counts["/rgbd_4/depth"]) == (1, 2)
        assert recording.warnings[0].startswith("rh_lblrgbd: 2 of 6 rows are no observations")
        assert recording.warnings[1].startswith("rh_lblrgbd: 1 of 6 rows have no files")


def test_missing_files_lose_only_their_messages(write: Callable[..., Path], room: Any) -> None:
    root = write(room)
    next(root.rglob("100000_depth.png")).unlink()
    with open_recording(root) as recording:
        assert len(list(recording.messages(["/rgbd_1/depth"]))) == 2
        assert "100000_depth.png" in recording.warnings[-1]


@pytest.mark.parametrize("table", ["rh_lblrgbd", "rh_lsrscan", "rh2_old2new_rgbd_files"])
def test_a_table_that_is_not_there(write: Callable[..., Path], room: Any, table: str) -> None:
    root = write(room)
    change(root, f"DROP TABLE {table}")
    with open_recording(root) as recording:
        kinds = {topic.role for topic in recording.topics}
        assert ("depth" in kinds) is (table == "rh_lsrscan")
        assert ("lidar" in kinds) is (table != "rh_lsrscan")


def test_a_view_in_place_of_a_table_is_not_queried(write: Callable[..., Path], room: Any) -> None:
    root = write(room)
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
    change(
        root, "DROP TABLE rh_rooms", f"CREATE VIEW rh_rooms AS {endless} SELECT i id, i name FROM n"
    )
    assert "SQLite database" in refused(lambda: open_recording(root / "rh.db"))


def test_a_truncated_database_gives_what_is_left(write: Callable[..., Path], room: Any) -> None:
    """The beams are the last rows and nearly all bytes."""
    root = write(room)
    database = root / "rh.db"
    intact = database.read_bytes()
    counts = []
    for fraction in (0.01, 0.5, 0.99):
        database.write_bytes(intact[: int(fraction * len(intact))])
        try:
            with open_recording(root) as recording:
                counts.append(len(list(recording.messages(["/laser", "/rgbd_1/depth"]))))
                assert any("laser" in warning for warning in recording.warnings)
        except RecordingError as error:
            counts.append(0)
            said = str(error)
    assert "rh.db" in said
    assert counts[0] == 0
    # All images, and the scans before the cut.
    assert 3 <= counts[1] <= counts[2] < 8


def test_cut_and_mutated_databases_are_read_or_refused(
    write: Callable[..., Path], room: Any
) -> None:
    root = write(room)
    database = root / "rh.db"
    intact = database.read_bytes()
    rng = random.Random(5)
    errors, opened = [], 0
    for turn in range(80):
        content = bytearray(intact)
        for _ in range(rng.choice([1, 5, 50])):
            content[rng.randrange(len(content))] = rng.randrange(256)
        size = rng.randrange(len(content)) if turn % 4 == 0 else len(content)
        database.write_bytes(content[:size])
        try:
            with open_recording(root) as recording:
                there = {topic.name for topic in recording.topics}
                list(recording.messages({"/laser", "/rgbd_1/depth"} & there))
                opened += 1
        except RecordingError as error:
            errors.append(str(error))
    assert opened > 30
    assert not any("\n" in text for text in errors)
