"""Any recording opens: what is there is shown, and what is missing is grey with its reason."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fusion_core.model.errors import MissingStream
from fusion_core.model.sensors import LaserScan, PoseSample
from fusion_core.workflows.fuse import camera_rig, recorded_streams
from scanloom.frame_view import FrameView, compute_frame_view
from scanloom.panels.scene import ScenePanel
from scanloom.scene.camera_views import SceneWindow, stage_extent, step_view
from scanloom.scene.frame_stage import pose_stamps_ns, staged_frame
from scanloom.scene.layers import absent_layers
from scanloom.scene.verdict import verdict_of
from scanloom.server.pages import LINK_KEY
from scanloom.server.workbench import ServeOptions, Workbench
from scanloom.state.library import Library
from scanloom.state.possible_steps import why_not
from scanloom.state.view import View
from tests.app.incomplete_recordings import TOPICS, Reader, plain, write_parts
from tests.app.viser_client import ViserClient, connect

# The steps that compare both sensors, with their keys.
MATCHING = {"Match": 2, "Register": 3, "Repair": 4, "Review": 5, "Calibrate": 7}
NO_CAMERA = "The recording has no depth camera: there is nothing to match the LiDAR with"
NO_LIDAR = "The recording has no 2D LiDAR: there is nothing to match the depth images with"
NEITHER = "The recording has neither a 2D LiDAR nor a depth camera: there is nothing to match"


@pytest.fixture(scope="module")
def recordings(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return [small_scene, *write_parts(small_scene, tmp_path_factory.mktemp("parts"))]


@pytest.fixture(scope="module")
def workbench(
    recordings: list[Path], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Workbench]:
    options = ServeOptions(
        recordings=recordings, port=0, output_root=tmp_path_factory.mktemp("out")
    )
    with Workbench(options) as serving:
        yield serving


@pytest.fixture(scope="module")
def client(workbench: Workbench) -> Iterator[ViserClient]:
    with connect(workbench.address) as connected:
        yield connected


@pytest.fixture
def page(workbench: Workbench, client: ViserClient) -> Reader:
    reader = Reader(workbench, client)
    reader.notes()
    return reader


@pytest.fixture(scope="module")
def library(recordings: list[Path]) -> Iterator[Library]:
    shared = Library(recordings, [])
    yield shared
    shared.close()


def shown(library: Library, name: str, **values: object) -> FrameView:
    view = View(recording=name).changed(**values)
    return compute_frame_view(view, library.open(view))


# What is computed


def test_a_lidar_alone_gives_its_scans(library: Library) -> None:
    frame_view = shown(library, "lidar.mcap", frame_index=3)
    opened = frame_view.open_recording
    assert len(opened.frames) == opened.recording.received_ns("/scan").size
    assert frame_view.lone is not None
    scan = frame_view.lone.scan
    assert isinstance(scan, LaserScan)
    assert scan.stamp_ns == opened.recording.stamps_ns("/scan")[3]
    assert (frame_view.paired, frame_view.raw, frame_view.color) == (None, None, None)
    assert (frame_view.failure, frame_view.is_being_aligned) == (None, False)
    assert opened.poses is not None
    assert opened.poses.at(scan.stamp_ns) is not None


def test_depth_alone_gives_its_images(library: Library) -> None:
    frame_view = shown(library, "depth.mcap", frame_index=3)
    assert frame_view.raw is not None
    assert frame_view.raw.scan is None
    assert not frame_view.raw.is_mount_recorded
    # The whole image: none is cut for a LiDAR of its own.
    full = frame_view.open_recording.fuse_session.rig.full_views[0].stored_shape
    assert frame_view.raw.paired.image.depth_m.shape == full
    assert frame_view.raw.depth_m.shape == full
    assert frame_view.color is not None
    assert (frame_view.failure, frame_view.is_being_aligned) == (None, False)


def test_the_settings_of_pairing_do_not_matter_to_depth_alone(library: Library) -> None:
    view = View(recording="depth.mcap")
    rates = view.with_setting("time", "pair_by", "rates")
    rates = rates.changed(alignment_settings=rates.settings)
    assert compute_frame_view(rates, library.open(rates)).failure is None


def test_odometry_alone_gives_its_poses(library: Library) -> None:
    frame_view = shown(library, "odometry.mcap", frame_index=3)
    opened = frame_view.open_recording
    assert len(opened.frames) == opened.recording.received_ns("/odom").size
    assert frame_view.lone is not None
    assert isinstance(frame_view.lone.value, PoseSample)
    assert frame_view.lone.scan is None
    assert opened.poses is not None
    path = [opened.poses.at(int(stamp)) for stamp in opened.recording.stamps_ns("/odom")]
    assert np.isfinite(np.array(path, dtype=float)).all()


@pytest.mark.parametrize("name", ["color.mcap", "lidar.mcap"])
def test_a_frame_beyond_the_end_is_the_last(library: Library, name: str) -> None:
    frame_view = shown(library, name, frame_index=1000)
    count = len(frame_view.open_recording.frames)
    assert frame_view.view.frame_index == max(count - 1, 0)
    assert frame_view.failure is None


def test_it_is_never_aligned(library: Library) -> None:
    opened = library.open(View(recording="lidar.mcap"))
    opened.align(lambda: pytest.fail("nothing is aligned"))
    assert not opened.is_aligning
    assert opened.wait(0.0)


def test_a_recording_with_both_sensors_is_opened_as_before(
    library: Library, small_scene: Path
) -> None:
    opened = library.open(View(recording=small_scene.name))
    assert opened.can_be_fused
    assert opened.opened.session is opened.fuse_session
    assert opened.lone(0) is None


def test_a_sensor_that_cannot_be_read_is_told(
    small_scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = "/scan holds no scan that can be read."

    def fail(*_: object) -> None:
        raise MissingStream(problem)

    monkeypatch.setattr(camera_rig, "first_scan", fail)
    monkeypatch.setattr(recorded_streams, "first_scan", fail)
    library = Library([small_scene], [])
    frame_view = shown(library, small_scene.name)
    assert frame_view.raw is not None
    assert not frame_view.is_being_aligned
    said = verdict_of(frame_view)
    assert said.sentence.endswith("in 2 s; nothing else can be read: nothing to match")
    assert said.detail == problem
    assert why_not("Match", frame_view.open_recording) == problem
    library.close()


def test_a_virtual_lidar_needs_depth_images(library: Library) -> None:
    with pytest.raises(MissingStream, match="no depth images"):
        library.open(View(recording="lidar.mcap", virtual_row=60))


# What the scene draws


def test_a_lidar_alone_is_drawn_without_a_camera(library: Library) -> None:
    frame_view = shown(library, "lidar.mcap", frame_index=3)
    staged = staged_frame(frame_view, with_rows=True)
    assert staged is not None
    drawn, lone = staged.geometry, frame_view.lone
    assert lone is not None
    assert lone.scan is not None
    valid = np.isfinite(lone.scan.ranges_m)
    assert np.array_equal(np.isfinite(drawn.beams_m[:, 0]), valid)
    assert np.allclose(np.hypot(*drawn.beams_m[valid, :2].T), lone.scan.ranges_m[valid])
    assert len(drawn.curve_m)
    assert (drawn.body, drawn.frustum, len(drawn.surface.points_m)) == ("LiDAR", None, 0)
    assert {"surface", "rows", "classes"} < absent_layers(drawn)
    assert "curve" not in absent_layers(drawn)
    window = SceneWindow(width_px=1600.0, height_px=1000.0)
    assert step_view("Recording", stage_extent(drawn), window).position_m[2] > 0.0


def test_depth_alone_is_drawn_without_a_lidar(library: Library) -> None:
    staged = staged_frame(shown(library, "depth.mcap", frame_index=3), with_rows=True)
    assert staged is not None
    drawn = staged.geometry
    assert len(drawn.surface.points_m)
    assert staged.color is not None
    assert drawn.body is None
    assert drawn.frustum is not None
    assert np.array_equal(drawn.frustum.position_m, np.zeros(3))
    assert {"curve", "rays"} < absent_layers(drawn)
    assert "surface" not in absent_layers(drawn)


def test_of_odometry_alone_the_robot_is_a_dot_on_its_path(library: Library) -> None:
    frame_view = shown(library, "odometry.mcap", frame_index=3)
    poses, lone = frame_view.open_recording.poses, frame_view.lone
    assert poses is not None
    assert lone is not None
    pose = poses.at(lone.stamp_ns)
    assert pose is not None
    staged = staged_frame(frame_view, with_rows=False)
    assert staged is not None
    assert staged.geometry.body == "robot"
    assert staged.geometry.body_m == (pose[0], pose[1], 0.0)
    assert len(pose_stamps_ns(frame_view)) == len(frame_view.open_recording.frames)


def test_the_scene_shows_what_there_is(page: Reader) -> None:
    (scene,) = [panel for panel in page.session.panels if isinstance(panel, ScenePanel)]
    nodes = scene._nodes
    page.open("lidar.mcap", panel="Repair")
    assert (nodes._lidar.visible, nodes._body_label.text) == (True, "LiDAR")
    assert not nodes._cameras
    page.open("odometry.mcap")
    assert (nodes._lidar.visible, nodes._body_label.text) == (True, "robot")
    # The path is shown in any step: it is all there is.
    assert nodes.map._frame.visible
    page.open("depth.mcap")
    assert not nodes._lidar.visible
    assert nodes._cameras
    assert not nodes.map._frame.visible
    page.open("color.mcap")
    assert not nodes._lidar.visible


# What the page says


@pytest.mark.parametrize(
    ("name", "verdict", "reason"),
    [
        ("lidar.mcap", "20 scans of a LiDAR in 2 s; no depth camera: nothing to match", NO_CAMERA),
        ("scans.mcap", "20 scans of a LiDAR in 2 s; no depth camera: nothing to match", NO_CAMERA),
        ("depth.mcap", "30 depth images of a depth camera in 2 s; no LiDAR: nothing", NO_LIDAR),
        ("odometry.mcap", "40 poses of the odometry in 2 s; neither LiDAR nor depth", NEITHER),
        ("color.mcap", "Nothing that can be shown: no LiDAR, no depth camera, no", NEITHER),
    ],
)
def test_steps_without_their_sensor_are_grey_and_say_why(
    page: Reader, name: str, verdict: str, reason: str
) -> None:
    page.open(name)
    assert page.verdict.startswith(verdict)
    assert page.html_with("data-alignment") == "<div data-alignment='none'></div>"
    grey = page.grey_steps
    assert [step for step in grey if step != "Map"] == list(MATCHING)
    # Scans and depth images can be mapped.
    assert ("Map" in grey) == (reason == NEITHER)
    for step, number in MATCHING.items():
        assert grey[step] == f"{reason}. (Alt + {number})"
        page.show(panel=step)
        assert page.verdict == reason
    assert page.notes() == []


def test_a_recording_with_both_sensors_has_no_grey_step(page: Reader, small_scene: Path) -> None:
    page.open("color.mcap")
    assert page.grey_steps
    page.open(small_scene.name)
    assert page.grey_steps == {}


def test_pictures_that_there_are_none_of_say_why(page: Reader, client: ViserClient) -> None:
    page.open("lidar.mcap")
    texts = [plain(str(w.props.get("content"))) for w in client.widgets.values() if is_seen(w)]
    assert texts.count(f"{NO_CAMERA}.") >= 2
    assert not client.shows_picture("depth")
    page.open("depth.mcap")
    assert client.shows_picture("depth")
    assert not client.shows_picture("similarity")


def is_seen(widget: object) -> bool:
    return bool(widget.props.get("visible"))  # type: ignore[attr-defined]  # a widget's


def test_a_depth_camera_without_intrinsics_is_told(page: Reader) -> None:
    sentence = "The depth camera comes without intrinsics: a field of view of 57° is assumed."
    for name in ("uncalibrated.mcap", "depth uncalibrated.mcap"):
        page.open(name)
        assert page.verdict.endswith(sentence)
    assert page.notes() == []


def test_a_row_of_depth_alone_is_a_lidar_at_one_click(page: Reader, client: ViserClient) -> None:
    page.open("depth uncalibrated.mcap")
    assert not client.find("Cut a LiDAR from the depth image").props["visible"]
    page.open("depth.mcap")
    button = client.find("Cut a LiDAR from the depth image")
    assert button.props["visible"]
    rows = page.session.frame_view.raw.depth_m.shape[0]  # type: ignore[union-attr]  # it is shown
    client.click("Cut a LiDAR from the depth image")
    client.wait_until(lambda: page.session.view.virtual_row == rows // 2)
    page.wait()
    client.wait_until(lambda: page.session.frame_view.fused is not None)  # type: ignore[union-attr]  # it is shown
    # Where it is in the image is known.
    assert list(page.grey_steps) == ["Calibrate"]
    client.click("Show the depth images alone")
    client.wait_until(lambda: page.session.view.virtual_row is None)
    page.wait()
    assert list(page.grey_steps) == list(MATCHING)


def test_the_map_step_runs_slam_alone(page: Reader, client: ViserClient) -> None:
    page.open("scans.mcap", panel="Map")
    assert not client.find("Mode").props["visible"]
    assert client.find("Motion and SLAM").props["visible"]
    assert not client.find("Fuse").props["visible"]
    assert plain(page.html_with("Maps of both sensors are off")).endswith(f"{NO_CAMERA}.")
    # Without odometry the recorded motion is not there: it begins with what is.
    run, motion = client.find("Run"), client.find("Motion")
    assert not run.props["disabled"]
    assert motion.value == "laser"
    assert not client.find("Choose what this recording allows").props["visible"]
    # What a person chooses stays, and says what it needs; one click takes what is there.
    client.set_value("Motion", "wheel")
    client.wait_until(lambda: run.props["disabled"])
    page.html_with("“wheel” needs odometry, which this recording lacks")
    client.click("Choose what this recording allows")
    client.wait_until(lambda: not run.props["disabled"])
    assert page.session.view.slam.motion == "laser"
    assert not client.find("Choose what this recording allows").props["visible"]
    page.open("lidar.mcap", panel="Map")
    assert not run.props["disabled"]


def test_a_map_of_a_lidar_alone_lies_around_it(page: Reader, client: ViserClient) -> None:
    (scene,) = [panel for panel in page.session.panels if isinstance(panel, ScenePanel)]
    page.open("lidar.mcap", panel="Map")
    run = client.find("Run")
    client.wait_until(lambda: not run.props["disabled"])
    assert not scene._nodes.map._frame.visible
    client.click("Run")
    client.wait_until(lambda: scene._nodes.map._frame.visible)
    assert scene._grid is not None
    assert len(scene._path_m)
    before = tuple(scene._nodes.map._frame.position)
    page.show(frame_index=15)
    assert scene._nodes.map._frame.visible
    assert tuple(scene._nodes.map._frame.position) != before
    # It is this recording's.
    page.open("scans.mcap", panel="Map")
    assert not scene._nodes.map._frame.visible


def test_a_link_that_names_a_topic_that_is_not_there(workbench: Workbench) -> None:
    link = View(recording="lidar.mcap", lidar_topic="/no<b>").to_link()
    with connect(workbench.address, storage={LINK_KEY: link}) as client:
        note = client.wait_for(lambda one: one.type == "NotificationShowMessage")
        assert note.message["props"]["title"] == "lidar.mcap: has no topic '/no<b>'."
        assert note.message["props"]["body"].startswith("It holds /odom, /scan")


def test_every_kind_of_recording_is_tried() -> None:
    assert len(TOPICS) == 7
