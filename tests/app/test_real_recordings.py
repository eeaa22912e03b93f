"""Recordings of other people open on the page: what is shown of each, and what is grey."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from fusion_core.model.errors import RecordingError
from scanloom.server.workbench import ServeOptions, Workbench
from scanloom.state.library import Library
from scanloom.state.view import View
from tests.app.incomplete_recordings import Reader
from tests.app.viser_client import ViserClient, connect

pytestmark = pytest.mark.data

NO_CAMERA, NO_LIDAR = "no depth camera: nothing to match", "no LiDAR: nothing to match"
NEITHER = "neither LiDAR nor depth camera: nothing to match"
NOTHING = "Nothing that can be shown: no LiDAR, no depth camera, no odometry"
EMPTY = "The recording holds no messages: there is nothing to show"
MATCHING = ["Match", "Register", "Repair", "Review", "Calibrate"]
ALL_GREY = [*MATCHING[:-1], "Map", "Calibrate"]
# Path, what the verdict says, and the grey steps.
SHOWN = [
    ("carmen/intel.clf.bz2", f"13,631 scans of a LiDAR in 44 min 51 s; {NO_CAMERA}", MATCHING),
    ("carmen/mit-csail.clf.bz2", f"1,988 scans of a LiDAR in 7 min 4 s; {NO_CAMERA}", MATCHING),
    ("carmen/fr-clinic_robotlaser.clf.bz2", "6,917 scans of a LiDAR", MATCHING),
    ("bags/guardian_3.bag", f"1,038 scans of a LiDAR in 1 min 44 s; {NO_CAMERA}", MATCHING),
    ("bags/jarvis_circular_path_fast.bag", "213 scans of a LiDAR", MATCHING),
    ("bags/ship_interior_with_tilting_laser.bag", "207 scans of a LiDAR", MATCHING),
    ("bags/scans_demo.bag", f"331 scans of a LiDAR in 33 s; {NO_CAMERA}", MATCHING),
    ("bags/tilt_laser.bag", "178 scans of a LiDAR", MATCHING),
    ("bags/nav2_turtlebot.mcap", f"2,639 poses of the odometry in 1 min 37 s; {NEITHER}", ALL_GREY),
    ("rgbd/seven_scenes", f"300 depth images of a depth camera in 10 s; {NO_LIDAR}", MATCHING),
    ("rgbd/redwood_and_odd_encodings", "5 depth images of a depth camera", MATCHING),
    ("rgbd/slambook_five_frames", "5 depth images of a depth camera", MATCHING),
    ("odd/rosbag1/example.bag", NOTHING, ALL_GREY),
    ("odd/rosbag1/example-bz2.bag", NOTHING, ALL_GREY),
    ("odd/rosbag1/example-lz4.bag", NOTHING, ALL_GREY),
    ("odd/rosbag1/example-unsorted-chunks.bag", NOTHING, ALL_GREY),
    ("odd/rosbag1/no-messages.bag", EMPTY, ALL_GREY),
    ("odd/rosbag2/old_style_types.db3", NOTHING, ALL_GREY),
]
SEVERAL_LIDARS = {
    "bags/guardian_3.bag": "/hokuyo_back_scan",
    "bags/jarvis_circular_path_fast.bag": "/driver_laser_security/laser_scan",
    "bags/scans_demo.bag": "/front_scan",
    "bags/ship_interior_with_tilting_laser.bag": "/base_scan",
}
REFUSED = [
    ("carmen/intel.relations", "is no recording: a text file"),
    ("odd/rosbag1/empty-file.bag", "is empty"),
    ("odd/rosbag1/asci-file.txt", "is no recording: a text file"),
    ("trajectories/fr2_desk_groundtruth.txt", "is no recording: a text file"),
    ("calibration/kitti_000000", "is a folder without a recording"),
]


@pytest.fixture(scope="module")
def real(data_folder: Path) -> Path:
    if not (data_folder / "real").is_dir():
        pytest.skip(f"{data_folder} has no folder real/")
    return data_folder / "real"


@pytest.fixture(scope="module")
def workbench(real: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workbench]:
    recordings = [real / path for path, _, _ in SHOWN]
    output = tmp_path_factory.mktemp("out")
    with Workbench(ServeOptions(recordings=recordings, port=0, output_root=output)) as serving:
        yield serving


@pytest.fixture(scope="module")
def client(workbench: Workbench) -> Iterator[ViserClient]:
    with connect(workbench.address) as connected:
        yield connected


@pytest.mark.parametrize(("path", "verdict", "grey"), SHOWN, ids=[path for path, _, _ in SHOWN])
def test_it_opens_on_the_page(
    workbench: Workbench, client: ViserClient, path: str, verdict: str, grey: list[str]
) -> None:
    page = Reader(workbench, client)
    page.notes()
    page.open(Path(path).name)
    assert page.verdict.startswith(verdict)
    if path in SEVERAL_LIDARS:
        assert f"LiDARs {SEVERAL_LIDARS[path]} is used" in page.verdict
    assert list(page.grey_steps) == grey
    frame_view = page.session.frame_view
    assert frame_view is not None
    count = len(frame_view.open_recording.frames)
    for number in sorted({0, count // 2, max(count - 1, 0)}):
        page.show(frame_index=number)
        assert page.session.frame_view is not None
        assert page.session.frame_view.failure is None
    for step in ("Match", "Map"):
        page.show(panel=step)
        assert not page.verdict.startswith("Not")
    assert page.notes() == []


def test_another_lidar_can_be_chosen(workbench: Workbench, client: ViserClient) -> None:
    page = Reader(workbench, client)
    page.open("guardian_3.bag")
    chosen = client.find("LiDAR")
    assert chosen.props["options"] == ["found by type", "/hokuyo_back_scan", "/scan"]
    client.set_value("LiDAR", "/scan")
    client.wait_until(lambda: page.session.view.lidar_topic == "/scan")
    page.wait()
    assert page.verdict.startswith("1,036 scans of a LiDAR")
    assert "Of 2 LiDARs /scan is used" in page.verdict


@pytest.mark.parametrize(("path", "words"), REFUSED, ids=[path for path, _ in REFUSED])
def test_what_is_no_recording_is_refused_in_one_line(real: Path, path: str, words: str) -> None:
    library = Library([real / path], [])
    with pytest.raises(RecordingError, match=words) as raised:
        library.open(View(recording=Path(path).name))
    assert "\n" not in str(raised.value)
    library.close()
