"""Robot@Home as plain text: rooms, their own paths, poses, and what is lost by damage."""

import os
import random
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.alignment.curves import SamplingSettings
from fusion_core.model.errors import RecordingError
from fusion_core.model.sensors import LaserScan
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.robot_at_home.rig import RawScan, laser_scan, stamp_ns_of_ticks
from fusion_core.recordings.robot_at_home.rooms import list_rooms, open_room
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.fuse.camera_rig import build_camera_rig

MINUTE_NS = 60 * 10**9
RGBD = "Robot@Home-dataset_rgbd_data-plain_text"
LASER = "Robot@Home-dataset_laser_scans-plain_text"


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
    return lambda *rooms: trees.write_plain_text(tmp_path / "root", rooms)


def several(trees: Any) -> list[Any]:
    """Two homes; one room twice; one that only the LiDAR saw."""
    rooms = [
        trees.small_room(),
        trees.small_room(room="kitchen1", labels=["RGBD_2"]),
        trees.small_room(session="sarmis-s2"),
        trees.small_room(session="sarmis-s2", subsession=2, start_ns=trees.T0 + MINUTE_NS),
        trees.small_room(session="sarmis-s2", room="fullhouse1"),
    ]
    later = rooms[3].sweeps[2]
    rooms[3] = replace(rooms[3], sweeps={3: later})
    rooms[4] = replace(rooms[4], sights=[])
    return rooms


def test_rooms_are_listed(trees: Any, write: Callable[..., Path]) -> None:
    root = write(*several(trees))
    listed = [
        (x.home, x.session, x.room, x.subsession, x.scans, x.images, x.depth_bits)
        for x in list_rooms(root)
    ]
    assert listed == [
        ("alma", "alma-s1", "bedroom1", 1, 5, 6, 16),
        ("alma", "alma-s1", "kitchen1", 1, 5, 3, 16),
        ("sarmis", "sarmis-s2", "bedroom1", 1, 5, 6, 16),
        ("sarmis", "sarmis-s2", "bedroom1", 2, 5, 6, 16),
        ("sarmis", "sarmis-s2", "fullhouse1", 1, 5, 0, None),
    ]


def test_a_root_of_several_rooms_names_them(trees: Any, write: Callable[..., Path]) -> None:
    root = write(*several(trees))
    text = refused(lambda: open_recording(root))
    assert "alma-s1 kitchen1" in text
    assert "sarmis-s2 bedroom1 (subsession 2)" in text
    assert "--home SESSION --room ROOM" in text


def test_unknown_names_are_refused_with_the_known_ones(
    trees: Any, write: Callable[..., Path]
) -> None:
    root = write(*several(trees))
    assert "alma-s1, sarmis-s2" in refused(lambda: open_room(root, "pare-s1", "bedroom1"))
    assert "bedroom1, kitchen1" in refused(lambda: open_room(root, "alma-s1", "hall1"))
    assert "There is 1, 2" in refused(lambda: open_room(root, "sarmis-s2", "bedroom1", 3))
    assert "no room" in refused(lambda: list_rooms(root / f"{RGBD}-all" / "nothing"))


def test_rooms_and_subsessions_are_distinguished(trees: Any, write: Callable[..., Path]) -> None:
    root = write(*several(trees))
    with open_room(root, "sarmis-s2", "bedroom1", 2) as recording:
        assert recording.start_ns == trees.T0 + MINUTE_NS
        assert recording.read("/laser", 0).stamp_ns == trees.T0 + MINUTE_NS + 3 * trees.MS
    with open_room(root, "sarmis-s2", "fullhouse1") as recording:
        assert [t.name for t in recording.topics] == ["/laser", "/tf_static"]
        assert recording.warnings == []


@pytest.mark.parametrize(
    "own",
    [
        f"{RGBD}-all",
        f"{RGBD}-all/{RGBD}-alma-s1",
        f"{RGBD}-all/{RGBD}-alma-s1/alma-s1",
        f"{RGBD}-all/{RGBD}-alma-s1/alma-s1/bedroom1_rgbd.txt",
        f"{RGBD}-all/{RGBD}-alma-s1/alma-s1/bedroom1_rgbd",
        f"{LASER}-all/{LASER}-alma-s1/alma-s1/bedroom1",
        f"{LASER}-all/{LASER}-alma-s1/alma-s1/bedroom1/2_hokuyo_processed.txt",
        f"{LASER}-all/{LASER}-alma-s1/alma-s1/bedroom1/2_hokuyo_processed",
    ],
)
def test_a_room_opens_by_its_own_paths(
    trees: Any, write: Callable[..., Path], room: Any, own: str
) -> None:
    others = [] if own.endswith("all") else [trees.small_room(session="pare-s1")]
    if "bedroom1" in own:
        others.append(trees.small_room(room="hall1"))
    root = write(room, *others)
    with open_recording(root / own) as recording, open_room(root, "alma-s1", "bedroom1") as same:
        assert recording.path == same.path
        assert recording.topics == same.topics
        assert [t.count for t in recording.topics if t.name == "/laser"] == [5]


def test_a_session_folder_can_be_opened_alone(write: Callable[..., Path], room: Any) -> None:
    root = write(room)
    alone = root.parent / "copied" / "alma-s1"
    shutil.copytree(root / f"{RGBD}-all/{RGBD}-alma-s1/alma-s1", alone)
    shutil.copytree(root / f"{LASER}-all/{LASER}-alma-s1/alma-s1", alone, dirs_exist_ok=True)
    for own in (alone, alone / "bedroom1_rgbd.txt", alone / "bedroom1_rgbd", alone / "bedroom1"):
        with open_recording(own) as recording:
            assert {"/laser", "/rgbd_1/depth"} <= {t.name for t in recording.topics}


def test_streams_are_chosen_for_each_camera(write: Callable[..., Path], room: Any) -> None:
    with open_recording(write(room)) as recording:
        streams = choose_streams(recording)
        assert streams.lidar == "/laser"
        assert streams.depth == ("/rgbd_1/depth", "/rgbd_4/depth")
        assert streams.color == ("/rgbd_1/color", "/rgbd_4/color")
        assert streams.camera_info == ("/rgbd_1/camera_info", "/rgbd_4/camera_info")
        assert streams.notes == ()


def test_the_rig_stands_upright_as_published(trees: Any, write: Callable[..., Path]) -> None:
    labels = ["RGBD_1", "RGBD_2", "RGBD_3", "RGBD_4"]
    with open_recording(write(trees.small_room(labels=labels))) as recording:
        rig = build_camera_rig(recording, choose_streams(recording), SamplingSettings())
    yaws = [round(np.rad2deg(camera.yaw_rad), 2) for camera in rig.cameras]
    assert yaws == [-45.0, -90.0, 45.0, 0.0]
    for camera in rig.cameras:
        intrinsics = camera.intrinsics
        assert (intrinsics.width, intrinsics.height, intrinsics.fx, intrinsics.fy) == (
            240,
            320,
            271.36999,
            286.441384,
        )
        # Down in the upright view is down in the rig.
        assert camera.T_rig_camera[2, 1] < -0.99
    assert rig.recorded_mount is not None
    heights = [trees.MOUNTS[label][2] - 0.31 for label in labels]
    assert rig.recorded_mount.delta_z_m == pytest.approx(np.mean(heights))
    assert rig.recorded_mount.yaw_rad == pytest.approx(0.0)


def sequences(room: Any, **offsets_ns: int) -> Any:
    """The room's scans shifted in time, as the laser sequences k1, k2, ..."""
    base = room.sweeps[2]
    return replace(
        room,
        sweeps={
            int(name[1:]): [replace(s, stamp_ns=s.stamp_ns + offset) for s in base]
            for name, offset in offsets_ns.items()
        },
    )


def test_laser_sequences_that_ran_with_the_cameras(write: Callable[..., Path], room: Any) -> None:
    root = write(sequences(room, k1=-MINUTE_NS, k2=0, k10=10**8, k3=MINUTE_NS))
    with open_recording(root) as recording:
        stamps = recording.received_ns("/laser")
        assert len(stamps) == 10
        assert (np.diff(stamps) >= 0).all()
        assert recording.warnings == [
            "Laser sequences read: 2, 10; not read, since they ran at other times than the "
            "cameras: 1, 3."
        ]
        found = [message.value.ranges_m for message in recording.messages(["/laser"])]
    expected = sorted(
        [(s.stamp_ns, i) for i, s in enumerate(room.sweeps[2])]
        + [(s.stamp_ns + 10**8, i) for i, s in enumerate(room.sweeps[2])]
    )
    for ranges, (_, i) in zip(found, expected, strict=True):
        np.testing.assert_array_equal(ranges, room.sweeps[2][i].ranges_m)


def test_no_laser_sequence_ran_with_the_cameras(write: Callable[..., Path], room: Any) -> None:
    with open_recording(write(sequences(room, k1=MINUTE_NS))) as recording:
        assert "/laser" not in {t.name for t in recording.topics}
        assert "read: none" in recording.warnings[0]
        assert "no laser scans" in recording.warnings[1]


def test_a_room_without_laser(write: Callable[..., Path], room: Any) -> None:
    with open_recording(write(replace(room, sweeps={}))) as recording:
        assert recording.warnings == ["There are no laser scans of this room."]
        assert choose_streams(recording).lidar is None


@given(
    count=st.integers(2, 1081),
    aperture=st.floats(0.1, 2.0 * np.pi),
    beam=st.integers(0, 1080),
)
def test_beam_angles_in_closed_form(count: int, aperture: float, beam: int) -> None:
    raw = RawScan(
        aperture_rad=aperture,
        max_range_m=5.6,
        ranges_m=np.ones(count),
        valid=np.ones(count, dtype=bool),
    )
    i = min(beam, count - 1)
    urg = laser_scan(raw, 0, "aperture/N").angles_rad
    assert urg[i] == pytest.approx((i - (count - 1) / 2) * aperture / count, abs=1e-12)
    mrpt = laser_scan(raw, 0, "aperture/(N-1)").angles_rad
    assert mrpt[i] == pytest.approx(-aperture / 2 + i * aperture / (count - 1), abs=1e-12)


def test_beam_spacing_is_an_option(write: Callable[..., Path], room: Any) -> None:
    root = write(room)
    with open_room(root, "alma-s1", "bedroom1", beam_spacing="aperture/(N-1)") as recording:
        scan = recording.read("/laser", 0).value
        assert isinstance(scan, LaserScan)
        assert scan.angle_min_rad == pytest.approx(-4.1847 / 2)
    with open_room(root, "alma-s1", "bedroom1") as recording:
        scan = recording.read("/laser", 0).value
        # The URG's 119.707 degrees to either side, in its own steps of 360/1024.
        assert np.rad2deg(scan.angles_rad[[0, -1]]) == pytest.approx([-119.707, 119.707], abs=1e-3)


@given(st.integers(0, 2**63 // 100 - 1))
def test_ticks_since_1601(hundred_ns: int) -> None:
    assert stamp_ns_of_ticks(hundred_ns + 116_444_736_000_000_000) == 100 * hundred_ns


@pytest.mark.parametrize("ticks", [-1, 0, 116_444_735_999_999_999, 2**63, 10**40])
def test_times_before_1970_are_refused(ticks: int) -> None:
    with pytest.raises(ValueError, match="1601"):
        stamp_ns_of_ticks(ticks)


def mapped(room: Any, mounts: dict[str, tuple[float, ...]]) -> Any:
    """The images placed in a map: every observation has its own pose."""
    sights = [
        replace(s, pose=(0.1 * i, 0.5, 1.045, 0.01 * i, 0.0, -1.5708))
        for i, s in enumerate(room.sights)
    ]
    return replace(room, sights=sights, mounts=mounts)


def test_poses_in_a_map_are_no_mounts(trees: Any, write: Callable[..., Path], room: Any) -> None:
    with open_recording(write(mapped(room, {}))) as recording:
        (warning,) = recording.warnings
        assert "/rgbd_1/pose, /rgbd_4/pose" in warning
        assert "mounts of RGBD_1, RGBD_4 are not known" in warning
        (static,) = recording.messages(["/tf_static"])
        assert [t.child for t in static.value.transforms] == ["laser"]
        place = recording.read("/rgbd_4/pose", 2).value
        assert (place.parent, place.child) == ("map", "rgbd_4_optical")
        assert place.T_parent_child[:3, 3] == pytest.approx([0.5, 0.5, 1.045])


def test_mounts_of_the_raw_data_beside_poses_in_a_map(
    trees: Any, write: Callable[..., Path], room: Any
) -> None:
    with open_recording(write(mapped(room, trees.MOUNTS))) as recording:
        assert "mounts are those of the raw data" in recording.warnings[0]
        (static,) = recording.messages(["/tf_static"])
        found = {t.child: t.T_parent_child[:3, 3].tolist() for t in static.value.transforms}
    assert found == {
        "laser": [0.205, 0.0, 0.31],
        "rgbd_1_optical": [0.271, -0.031, 1.045],
        "rgbd_4_optical": [0.285, 0.0, 1.045],
    }


def test_a_changing_mount_is_reported(write: Callable[..., Path], room: Any) -> None:
    moved = replace(room.sights[2], pose=(0.271, -0.031, 1.065, -0.785398, 0.0, -1.55334))
    sights = [*room.sights[:2], moved, *room.sights[3:]]
    with open_recording(write(replace(room, sights=sights))) as recording:
        assert recording.warnings == [
            "The mount of RGBD_1 changes: 1 of 3 observations differ by up to 0.02 m and 1 degrees "
            "from the pose that is taken."
        ]
        (static,) = recording.messages(["/tf_static"])
        assert static.value.transforms[1].T_parent_child[2, 3] == 1.045


def test_images_of_another_size_have_no_intrinsics(trees: Any, write: Callable[..., Path]) -> None:
    with open_recording(write(trees.small_room(shape=(48, 64)))) as recording:
        assert "known for 320 x 240" in recording.warnings[0]
        assert choose_streams(recording).camera_info == (None, None)
        assert recording.read("/rgbd_1/depth", 0).value.depth_m.shape == (48, 64)


def rgbd_folder(root: Path) -> Path:
    return root / f"{RGBD}-all/{RGBD}-alma-s1/alma-s1/bedroom1_rgbd"


def scan_file(root: Path, number: int) -> Path:
    folder = f"{LASER}-all/{LASER}-alma-s1/alma-s1/bedroom1/2_hokuyo_processed"
    return root / folder / f"{number}_scan.txt"


def test_missing_files_lose_only_their_messages(write: Callable[..., Path], room: Any) -> None:
    root = write(room)
    (rgbd_folder(root) / "0_depth.png").unlink()
    (rgbd_folder(root) / "3_intensity.png").unlink()
    scan_file(root, 4).unlink()
    with open_recording(root) as recording:
        counts = {t.name: 0 for t in recording.topics}
        for message in recording.messages():
            counts[message.topic] += 1
        assert counts["/rgbd_1/depth"] == 2
        assert counts["/rgbd_4/color"] == 2
        assert counts["/laser"] == 4
        assert len(recording.warnings) == 3
        assert all("1 of " in warning for warning in recording.warnings)
        assert "0_depth.png" in " ".join(recording.warnings)


@pytest.mark.parametrize(
    ("line", "text", "said"),
    [
        (2, "1000000000", "beams"),
        (2, "1e400", "beams"),
        (2, "681", "682 ranges and 682 flags for 681 beams"),
        (2, "nan", "beams"),
        (0, "0", "aperture"),
        (0, "nan", "aperture"),
        (0, "9.5", "aperture"),
        (1, "inf", "maximum range"),
        (3, "1.0 2.0 x", "3 ranges"),
        (4, "", "4 lines"),
    ],
)
def test_scans_that_contradict_themselves(
    write: Callable[..., Path], room: Any, line: int, text: str, said: str
) -> None:
    root = write(room)
    lines = scan_file(root, 0).read_text().splitlines()
    lines[7 + line] = text
    scan_file(root, 0).write_text("\n".join(lines))
    with open_recording(root) as recording:
        assert said in refused(lambda: recording.read("/laser", 0))
        assert len(list(recording.messages(["/laser"]))) == 4


def test_comments_may_be_anywhere_in_a_scan(write: Callable[..., Path], room: Any) -> None:
    root = write(room)
    lines = scan_file(root, 0).read_text().splitlines()
    lines = ["# one more", *lines[:8], "", "# and here", *lines[8:]]
    scan_file(root, 0).write_text("\n".join(lines))
    with open_recording(root) as recording:
        ranges = recording.read("/laser", 0).value.ranges_m
    np.testing.assert_array_equal(ranges, room.sweeps[2][0].ranges_m)


def test_a_pipe_in_place_of_a_scan(write: Callable[..., Path], room: Any) -> None:
    root = write(room)
    scan_file(root, 0).unlink()
    os.mkfifo(scan_file(root, 0))
    with open_recording(root) as recording:
        assert "no file" in refused(lambda: recording.read("/laser", 0))


def test_a_depth_image_of_another_kind(write: Callable[..., Path], room: Any) -> None:
    root = write(room)
    colored = np.dstack([np.full((240, 320), value, dtype=np.uint8) for value in (1, 2, 3)])
    cv2.imwrite(str(rgbd_folder(root) / "0_depth.png"), colored)
    small = np.full((24, 32), 700, dtype=np.uint16)
    cv2.imwrite(str(rgbd_folder(root) / "2_depth.png"), small)
    with open_recording(root) as recording:
        assert "no depth image" in refused(lambda: recording.read("/rgbd_1/depth", 0))
        assert "other images" in refused(lambda: recording.read("/rgbd_1/depth", 1))


def test_a_truncated_sequence_keeps_its_whole_lines(write: Callable[..., Path], room: Any) -> None:
    root = write(room)
    file = rgbd_folder(root).with_suffix(".txt")
    content = file.read_text()
    # The last time loses a digit, and would be centuries ago.
    file.write_text(content[: len(content) - 2])
    with open_recording(root) as recording:
        assert recording.warnings[0].startswith("bedroom1_rgbd.txt: 1 of 6 lines")
        assert {t.name: t.count for t in recording.topics}["/rgbd_4/depth"] == 2


@pytest.mark.parametrize(
    "line",
    [
        "x RGBD_1 0 0 0 0 0 0 130765535977706490",
        "1 SICK_1 0 0 0 0 0 0 130765535977706490",
        "1 RGBD_1 0 0 nan 0 0 0 130765535977706490",
        "1 RGBD_1 0 0 0 0 0 0 -130765535977706490",
        "99999999999999999999 RGBD_1 0 0 0 0 0 0 130765535977706490",
        "1 RGBD_1 0 0 0 0 0 130765535977706490",
        "1 RGBD_1 " + "0 " * 5000,
    ],
)
def test_lines_that_are_no_observations(write: Callable[..., Path], room: Any, line: str) -> None:
    root = write(room)
    with rgbd_folder(root).with_suffix(".txt").open("a") as stream:
        stream.write(line + "\n")
    with open_recording(root) as recording:
        assert {t.name: t.count for t in recording.topics}["/rgbd_1/depth"] == 3
        assert "no observations" in recording.warnings[0]
        assert len(recording.warnings[0]) < 400


def test_observations_in_any_order(write: Callable[..., Path], room: Any) -> None:
    with open_recording(write(replace(room, sights=room.sights[::-1]))) as recording:
        for topic in recording.topics:
            assert (np.diff(recording.received_ns(topic.name)) >= 0).all()
        first = recording.read("/rgbd_1/color", 0).value
    np.testing.assert_array_equal(first.rgb, room.sights[0].rgb)


def test_mutated_text_is_read_or_refused(write: Callable[..., Path], room: Any) -> None:
    root = write(room)
    rng = random.Random(3)
    files = [
        rgbd_folder(root).with_suffix(".txt"),
        scan_file(root, 0),
        scan_file(root, 0).parent.with_suffix(".txt"),
    ]
    errors, opened = [], 0
    for _ in range(60):
        file = rng.choice(files)
        intact = file.read_bytes()
        content = bytearray(intact)
        for _ in range(rng.choice([1, 3, 30])):
            content[rng.randrange(len(content))] = rng.randrange(256)
        file.write_bytes(content[: rng.choice([len(content), rng.randrange(len(content))])])
        try:
            with open_recording(root) as recording:
                there = {topic.name for topic in recording.topics}
                list(recording.messages({"/laser"} & there))
                opened += 1
        except RecordingError as error:
            errors.append(str(error))
        file.write_bytes(intact)
    assert opened > 30
    assert not any("\n" in text for text in errors)
