"""Recordings made by other people: counts as their README files state them."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.topics import choose_streams

pytestmark = pytest.mark.data

COUNTS = {
    "rooms/room_1": {"/scan": 80, "/camera/depth/image_raw": 120, "/tf_static": 1},
    "rooms/room_2.bag": {"/scan": 80, "/camera/depth/image_raw": 120, "/tf_static": 1},
    "rooms/room_3": {"/scan": 60, "/camera/depth/image_raw": 90},
    "real/rgbd/seven_scenes": {
        "/camera/depth/image_raw": 300,
        "/camera/color/image_raw": 300,
        "/camera/depth/camera_info": 300,
        "/camera/pose": 300,
    },
    "real/rgbd/redwood_and_odd_encodings": {
        "/camera/depth/image_raw": 5,
        "/camera/color/image_raw": 5,
        "/camera/depth/camera_info": 5,
        "/camera/pose": 5,
    },
    "real/rgbd/slambook_five_frames": {
        "/camera/depth/image_raw": 5,
        "/camera/color/image_raw": 5,
        "/camera/pose": 5,
    },
    "real/bags/scans_demo.bag": {"/front_scan": 331, "/rear_scan": 330},
}
# Two LaserScan topics and their rate, and how long the recording is.
RATES = {
    "real/bags/guardian_3.bag": ("/scan", 10.0, 104.0),
    "real/bags/jarvis_circular_path_fast.bag": ("/pose_ground_truth", 8.0, 25.5),
    "real/bags/scans_demo.bag": ("/front_scan", 10.0, 33.0),
    "real/bags/tilt_laser.bag": ("/scan", 10.0, 17.7),
    "real/bags/ship_interior_with_tilting_laser.bag": ("/tilt_scan", 10.0, 20.8),
    "real/bags/nav2_turtlebot.mcap": ("/odom", 27.0, 97.0),
}
ROS_FILES = ["rooms/room_1", "rooms/room_2.bag", "rooms/room_3", *RATES]
NO_RECORDINGS = [
    "real/carmen/intel.relations",
    "real/trajectories/fr2_desk_groundtruth.txt",
    "real/calibration/opencalib_street/calib.pcd",
    "real/calibration/opencalib_street/calib.jpg",
    "real/calibration/acfr_board/params.yaml",
    "real/calibration/acfr_board/pose1.png",
    "real/calibration/acfr_board",
    "real/calibration/kitti_000000/000000.bin",
    "real/odd/rosbag1/asci-file.txt",
    "real/odd/rosbag1/empty-file.bag",
    "real/bags",
    "rooms",
]


@pytest.mark.parametrize("name", COUNTS)
def test_counts(data_folder: Path, name: str) -> None:
    with open_recording(data_folder / name) as recording:
        counts = {topic.name: topic.count for topic in recording.topics}
        assert COUNTS[name].items() <= counts.items()
        assert recording.warnings == []
        if name.startswith("real/rgbd"):
            assert counts == COUNTS[name]


@pytest.mark.parametrize("name", RATES)
def test_rates_and_durations(data_folder: Path, name: str) -> None:
    topic, rate_hz, duration_s = RATES[name]
    with open_recording(data_folder / name) as recording:
        found = {t.name: t.rate_hz for t in recording.topics}[topic]
        assert recording.start_ns is not None
        assert recording.end_ns is not None
        assert found == pytest.approx(rate_hz, rel=0.05)
        assert (recording.end_ns - recording.start_ns) / 1e9 == pytest.approx(duration_s, abs=0.5)


@pytest.mark.parametrize("name", ROS_FILES)
def test_clocks_as_rosbags_reads_them(data_folder: Path, name: str) -> None:
    with open_recording(data_folder / name) as recording:
        readable = [t.name for t in recording.topics if t.role != "other"]
        ours = sorted((m.topic, m.received_ns) for m in recording.messages())
        skipped = [warning for warning in recording.warnings if "messages are left out" in warning]
    with AnyReader([data_folder / name]) as reader:
        connections = [c for c in reader.connections if c.topic in readable]
        theirs = sorted((c.topic, stamp) for c, stamp, _ in reader.messages(connections))
    assert ours == theirs
    assert skipped == []


def test_room_1_streams(data_folder: Path) -> None:
    with open_recording(data_folder / "rooms/room_1") as recording:
        streams = choose_streams(recording)
        info = recording.read(str(streams.camera_info[0]), 0).value
        scan = recording.read(str(streams.lidar), 0).value
    assert info.intrinsics is not None
    assert (info.intrinsics.width, info.intrinsics.height, info.intrinsics.fx) == (320, 240, 288)
    assert scan.ranges_m.shape == (682,)
    assert streams.odometry == "/odom"
    assert streams.pose is None


def test_seven_scenes_repeats_seventeen_depth_images(data_folder: Path) -> None:
    repeated, before = 0, None
    with open_recording(data_folder / "real/rgbd/seven_scenes") as recording:
        for message in recording.messages(["/camera/depth/image_raw"]):
            depth_m = message.value.depth_m
            if before is not None and np.array_equal(depth_m, before, equal_nan=True):
                repeated += 1
            before = depth_m
    assert repeated == 17


@pytest.mark.parametrize("name", NO_RECORDINGS)
def test_what_is_no_recording_is_refused(data_folder: Path, name: str) -> None:
    with pytest.raises(RecordingError) as caught:
        open_recording(data_folder / name)
    assert "\n" not in str(caught.value)
    assert caught.value.advice


def test_odd_files_open_or_are_refused(data_folder: Path) -> None:
    files = [f for f in (data_folder / "real/odd").rglob("*") if f.suffix in (".bag", ".db3")]
    files += (data_folder / "real/odd").rglob("*.mcap")
    refused = []
    for file in files:
        try:
            with open_recording(file) as recording:
                list(recording.messages())
        except RecordingError:
            refused.append(file.name)
    assert refused == ["empty-file.bag"]
