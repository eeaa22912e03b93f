"""The Calibrate panel on the sample, worked by a browser's messages: numbers, handles, files."""

import json
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser
from scipy.spatial.transform import Rotation

from fusion_core.model.errors import CalibrationFailed, SettingsError
from fusion_core.model.extrinsics import ExtrinsicsEstimate
from fusion_core.model.given_extrinsics import CameraPose, GivenExtrinsics
from fusion_core.model.progress import Progress
from fusion_core.recordings.calibration_files.estimate import read_estimate
from fusion_core.recordings.calibration_files.extrinsics import read_given_extrinsics
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView, given_extrinsics
from scanloom.jobs.calibration import CalibrationRequest, FinishedCalibration
from scanloom.page.bridge import PageBridge
from scanloom.panels import pose_controls
from scanloom.panels.calibrate import CalibratePanel
from scanloom.panels.camera_gizmo import _NAME, CameraGizmo
from scanloom.panels.mount_text import unknown_text
from scanloom.plots.theme import DARK, LIGHT
from scanloom.resources import sample_path
from scanloom.state.calibration_view import CalibrationView, pose_of
from scanloom.state.hand_pose import HandPose
from scanloom.state.library import Library
from scanloom.state.view import View
from tests.app.viser_client import ViserClient, connect
from tests.patience import ENOUGH_S, comes_true

FRAME, OTHER_FRAME = 58, 80
HOSTILE = '<b>"it & that".json'


@dataclass(frozen=True)
class Bench:
    """A browser at a session with nothing but this panel and the handles."""

    session: ClientSession
    panel: CalibratePanel
    gizmo: CameraGizmo
    browser: ViserClient
    output: Path

    @property
    def frame_view(self) -> FrameView:
        assert self.session.frame_view is not None
        return self.session.frame_view

    @property
    def shown(self) -> CalibrationView:
        assert self.frame_view.calibration is not None
        return self.frame_view.calibration

    def until(self, condition: Callable[[], bool]) -> None:
        """Wait for what a message of the browser brings about, and until that is shown."""
        assert comes_true(condition)
        assert self.session.wait(ENOUGH_S)

    def change(self, **values: object) -> None:
        self.session.change(**values)
        assert self.session.wait(ENOUGH_S)

    def drag(self, phase: str, **pose: Any) -> None:
        kind = {"start": "DragStart", "update": "Update", "end": "DragEnd"}[phase]
        # Nodes of a browser's own scene are named with it.
        owner = self.gizmo._handles._impl.api._owner_id
        self.browser.send(
            {"type": f"TransformControls{kind}Message", "name": _NAME, "owner": owner} | pose
        )

    def html(self, *words: str) -> str:
        """The HTML that holds these words, as the browser has it."""
        self.browser.wait_until(lambda: len(self._htmls(words)) == 1)
        return self._htmls(words)[0]

    def _htmls(self, words: tuple[str, ...]) -> list[str]:
        known = [str(w.props.get("content", "")) for w in self.browser.widgets.values()]
        return [content for content in known if all(word in content for word in words)]


def open_bench(library: Library, output: Path) -> Iterator[Bench]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    built: list[tuple[ClientSession, CalibratePanel, CameraGizmo]] = []

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        view = View(recording=next(iter(library.named())), panel="Calibrate", frame_index=FRAME)
        session = ClientSession(client, library, view)
        bridge = PageBridge(client.gui)
        panel = CalibratePanel(client, bridge, session, output)
        gizmo = CameraGizmo(client, session)
        session.panels = [panel, gizmo]
        session.refresh()
        built.append((session, panel, gizmo))

    with connect(f"http://127.0.0.1:{server.get_port()}") as browser:
        browser.find("Yaw (°)")
        assert comes_true(lambda: bool(built) and library.open(built[0][0].view).chain is not None)
        assert built[0][0].wait(ENOUGH_S)
        yield Bench(*built[0], browser, output)
        built[0][0].close()
    server.stop()
    library.close()


@pytest.fixture(scope="module")
def module_bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    output = tmp_path_factory.mktemp("poses")
    yield from open_bench(Library([sample_path()], []), output)


@pytest.fixture
def bench(module_bench: Bench) -> Bench:
    """The bench as at the start."""
    module_bench.change(
        panel="Calibrate",
        frame_index=FRAME,
        extrinsics=None,
        overlay_opacity=0.85,
        calibration_pictures="now",
        show_gizmo=True,
        color_scheme="light",
    )
    return module_bench


def test_the_numbers_are_the_alignments_pose(bench: Bench) -> None:
    chain = bench.frame_view.chain
    assert chain is not None
    pose = pose_of(chain)
    for label, value in (("Yaw (°)", pose.yaw_deg), ("Up (m)", pose.up_m)):
        bench.browser.wait_until(
            lambda label=label, value=value: abs(bench.browser.find(label).value - value) < 0.006
        )
    assert bench.shown.before is None
    assert bench.shown.now.agreement.fraction > 0.5


def test_numbers_that_the_recording_does_not_tell_are_said_to_be_assumed(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain = bench.frame_view.chain
    assert chain is not None
    mount = chain.alignment.mount
    known = replace(mount, sd=(0.1, 0.1, 0.1, 0.1, 0.1, 0.1))
    assert not unknown_text(known)
    # The sample does not show the height.
    assert [index for index, sd in enumerate(mount.sd) if sd is None] == [1]
    bench.html("does not tell how far above the LiDAR it sits (Δz): assumed here, not found")
    flat = replace(mount, sd=(0.1, None, 0.1, 0.1, None, None))
    said = unknown_text(flat)
    assert said == (
        "This recording does not tell how far above the LiDAR it sits (Δz), how far it looks down: "
        "assumed here, not found."
    )
    monkeypatch.setattr(pose_controls, "unknown_text", lambda _: said)
    bench.change(frame_index=FRAME + 1)
    bench.html("how far it looks down: assumed here, not found")
    # A pose by hand is nobody's guess.
    bench.change(extrinsics=pose_of(chain))
    bench.browser.wait_until(lambda: not bench._htmls(("assumed here, not found",)))


def test_a_number_moves_the_camera_for_every_step_and_undo_moves_it_back(bench: Bench) -> None:
    before = bench.shown.now
    picture = bench.panel._pictures[0].image
    match = bench.frame_view.match
    assert match is not None
    yaw_deg = round(before.pose.yaw_deg + 5.0, 2)
    bench.browser.set_value("Yaw (°)", yaw_deg)
    bench.until(lambda: bench.session.view.hand_pose is not None)
    pose = bench.session.view.hand_pose
    assert pose == before.pose.model_copy(update={"yaw_deg": yaw_deg})
    now = bench.shown
    assert now.now.pose.yaw_deg == pytest.approx(yaw_deg, abs=1e-3)
    # The same points, turned: nearly as many are in the image, and fewer agree.
    assert now.now.agreement.fraction < before.agreement.fraction - 0.1
    assert now.before is not None
    assert now.before.agreement == before.agreement
    assert bench.panel._pictures[0].image is not picture
    # The chain that all steps show.
    chain, moved = bench.frame_view.chain, bench.frame_view.match
    assert chain is not None
    assert moved is not None
    assert chain.alignment.mount.yaw_rad == pytest.approx(np.deg2rad(yaw_deg), abs=1e-3)
    assert not np.array_equal(
        moved.correspondence.residual_m, match.correspondence.residual_m, equal_nan=True
    )
    bench.session.undo()
    bench.until(lambda: bench.session.view.extrinsics is None)
    assert bench.shown.now.agreement == before.agreement
    bench.session.redo()
    bench.until(lambda: bench.session.view.hand_pose == pose)


def test_a_point_moves_in_the_picture_as_the_camera_turns(bench: Bench) -> None:
    before = bench.shown.now
    turned = before.pose.model_copy(update={"yaw_deg": before.pose.yaw_deg + 1.0})
    bench.change(extrinsics=turned)
    assert before.curve is not None
    curve = bench.shown.now.curve
    assert curve is not None
    fx = bench.frame_view.session.rig.cameras[0].intrinsics.fx
    # A camera that turns to the left sees everything farther right, by about f times the angle.
    common = np.intersect1d(curve.range_m, before.curve.range_m)
    assert common.size > 50
    moved = [
        one.pixels[np.flatnonzero(one.range_m == common[40])[0], 0] for one in (before.curve, curve)
    ]
    assert moved[1] - moved[0] == pytest.approx(np.deg2rad(1.0) * fx, rel=0.4)


def test_a_gesture_with_the_handles_is_one_step_of_undo(bench: Bench) -> None:
    before = bench.shown.now.pose
    body = Rotation.from_euler("ZYX", [10.0, 3.0, 0.0], degrees=True).as_quat(scalar_first=True)
    bench.drag("start")
    for forward_m in (0.1, 0.2, 0.3):
        bench.drag("update", wxyz=body.tolist(), position=[forward_m, 0.01, 0.62])
    bench.drag("end")
    expected = HandPose(yaw_deg=10.0, pitch_deg=3.0, forward_m=0.3, left_m=0.01, up_m=0.62)
    bench.until(lambda: bench.session.view.hand_pose == expected)
    bench.session.undo()
    bench.until(lambda: bench.session.view.extrinsics is None)
    assert bench.shown.now.pose == before
    # The handles are where the camera is.
    position_m = [before.forward_m, before.left_m, before.up_m]
    bench.until(lambda: bool(np.allclose(bench.gizmo._handles.position, position_m)))


@pytest.mark.parametrize(
    "pose",
    [
        {"wxyz": [0.0, 0.0, 0.0, 0.0], "position": [0.0, 0.0, 0.0]},
        {"wxyz": [1.0, 0.0, 0.0, 0.0], "position": [1e9, 0.0, 0.0]},
    ],
)
def test_what_is_no_pose_of_a_rig_changes_nothing(bench: Bench, pose: dict[str, Any]) -> None:
    bench.drag("start")
    bench.drag("update", **pose)
    bench.drag("update", wxyz=[1.0, 0.0, 0.0, 0.0], position=[0.5, 0.0, 0.0])
    bench.drag("end")
    bench.until(lambda: bench.session.view.hand_pose == HandPose(forward_m=0.5))


def test_the_handles_are_seen_in_this_step_alone(bench: Bench) -> None:
    handles = bench.gizmo._handles
    assert handles.visible
    bench.browser.set_value("3D handles", False)
    bench.until(lambda: not bench.session.view.show_gizmo)
    assert not handles.visible
    bench.browser.set_value("3D handles", True)
    bench.until(lambda: bench.session.view.show_gizmo)
    assert handles.visible
    bench.change(panel="Match")
    assert not handles.visible


def test_before_and_now_are_drawn_where_they_are_wanted(bench: Bench) -> None:
    first, second = bench.panel._pictures
    assert (first.visible, second.visible) == (True, False)
    assert not bench.panel._which.visible
    pose = bench.shown.now.pose
    estimated = first.image
    bench.change(extrinsics=pose.model_copy(update={"yaw_deg": pose.yaw_deg + 4.0}))
    assert bench.panel._which.visible
    now = first.image
    bench.browser.set_value("Show", "before and now")
    bench.until(lambda: second.visible)
    np.testing.assert_array_equal(second.image, now)
    # But for the title and the scale, the picture before is that of the estimate.
    differing = (first.image[60:-60] != estimated[60:-60]).any(axis=2)
    assert differing.mean() < 0.02
    bench.browser.set_value("Show", "before the adjustment")
    bench.until(lambda: not second.visible)
    assert first.visible


def test_without_opacity_the_image_is_seen_alone(bench: Bench) -> None:
    bench.browser.set_value("Opacity", 0.0)
    bench.until(lambda: bench.session.view.overlay_opacity == 0.0)
    bare = bench.panel._pictures[0].image[60:-60]
    bench.browser.set_value("Opacity", 1.0)
    bench.until(lambda: bench.session.view.overlay_opacity == 1.0)
    covered = bench.panel._pictures[0].image[60:-60]
    differing = (bare != covered).any(axis=2).mean()
    assert 0.001 < differing < 0.2


def test_pictures_are_dark_on_a_dark_page(bench: Bench) -> None:
    bench.change(color_scheme="dark")
    assert tuple(bench.panel._pictures[0].image[3, 3]) == DARK.background
    bench.change(color_scheme="light")
    assert tuple(bench.panel._pictures[0].image[3, 3]) == LIGHT.background


def test_while_another_panel_is_open_nothing_is_drawn_or_counted(bench: Bench) -> None:
    drawn = bench.panel._pictures[0].image
    bench.change(panel="Map")
    bench.change(frame_index=OTHER_FRAME)
    assert bench.frame_view.calibration is None
    assert bench.panel._pictures[0].image is drawn
    bench.change(panel="Calibrate")
    assert bench.panel._pictures[0].image is not drawn


def test_the_saved_file_gives_the_same_pose_to_every_command(bench: Bench) -> None:
    pose = HandPose(yaw_deg=12.0, pitch_deg=2.0, roll_deg=-3.0, forward_m=0.1, up_m=0.5)
    bench.change(extrinsics=pose)
    bench.browser.click("Save as file")
    bench.html("<textarea", "extrinsics.json</textarea>", "scanloom view")
    (path,) = bench.output.rglob("extrinsics.json")
    assert str(path) in bench.html("extrinsics.json</textarea>", f">{path}<")
    estimate = read_estimate(path)
    assert estimate.method == "by hand"
    assert "Set by hand" in estimate.verdict
    T_lidar_camera = np.linalg.inv(estimate.T_camera_lidar)
    np.testing.assert_allclose(T_lidar_camera, pose.T_lidar_camera, atol=1e-12)
    assert {each.name for each in path.parent.iterdir()} == {
        f"extrinsics.{suffix}" for suffix in ("json", "yaml", "urdf", "tf.mcap")
    }
    # What a build gets is the same.
    given = given_extrinsics(bench.frame_view, None)
    assert given is not None
    (own,) = given.cameras.values()
    np.testing.assert_allclose(own.T_camera_lidar, estimate.T_camera_lidar, atol=1e-9)
    # Once more is not another file.
    bench.browser.click("Save as file")
    bench.browser.click("Download")
    time.sleep(0.3)
    assert list(bench.output.rglob("extrinsics.json")) == [path]


def test_a_pose_can_be_reset_to_what_the_recording_says(bench: Bench) -> None:
    estimated = bench.shown.now
    bench.change(extrinsics=HandPose(yaw_deg=20.0))
    bench.browser.wait_until(
        lambda: 'aria-pressed="true"' not in bench.html("Reset the pose", "estimated")
    )
    names = re.findall(r'data-value="(\w+)"', bench.html("Reset the pose"))
    if "recorded" in names:
        bench.browser.press("pose source", "recorded")
        bench.until(lambda: bench.session.view.hand_pose != HandPose(yaw_deg=20.0))
        rig = bench.frame_view.open_recording.fuse_session.rig
        assert rig.recorded_mount is not None
        turned = bench.session.view.hand_pose
        assert turned is not None
        assert np.deg2rad(turned.yaw_deg) == pytest.approx(rig.recorded_mount.yaw_rad, abs=1e-5)
    bench.browser.press("pose source", "estimated")
    bench.until(lambda: bench.session.view.extrinsics is None)
    assert bench.shown.now.agreement == estimated.agreement
    bench.browser.press("pose source", "nonsense")
    assert bench.session.wait(ENOUGH_S)


def test_a_file_given_at_the_start_is_used_by_all_steps_until_it_is_reset(tmp_path: Path) -> None:
    pose = HandPose(yaw_deg=9.0, forward_m=0.05, up_m=0.55)
    file = tmp_path / HOSTILE
    T_camera_lidar = np.linalg.inv(pose.T_lidar_camera)
    file.write_text(json.dumps({"T_camera_lidar": T_camera_lidar.tolist()}))
    library = Library([sample_path()], [], given=read_given_extrinsics(file))
    for bench in open_bench(library, tmp_path):
        bench.until(lambda bench=bench: bench.frame_view.chain is not None)
        chain = bench.frame_view.chain
        assert chain is not None
        assert chain.session.rig.given is not None
        assert pose_of(chain) == pose
        row = bench.html("Reset the pose")
        assert HOSTILE not in row
        assert "From &lt;b&gt;" in row
        assert re.search(r'data-value="file"[^>]*aria-pressed="true"', row)
        given = given_extrinsics(bench.frame_view, library.given_of(bench.session.view))
        assert given is not None
        assert given.file == file
        bench.browser.press("pose source", "estimated")
        bench.until(lambda bench=bench: bench.session.view.extrinsics == "recording")
        bench.until(lambda bench=bench: bench.frame_view.chain is not None)
        estimated = bench.frame_view.chain
        assert estimated is not None
        assert estimated.session.rig.given is None
        assert given_extrinsics(bench.frame_view, library.given_of(bench.session.view)) is None
        bench.session.undo()
        bench.until(lambda bench=bench: bench.session.view.extrinsics is None)


def test_extrinsics_of_other_cameras_are_one_line(tmp_path: Path) -> None:
    cameras: dict[str | None, CameraPose] = {
        "/other": CameraPose(T_camera_lidar=np.linalg.inv(HandPose().T_lidar_camera))
    }
    library = Library([sample_path()], [], given=GivenExtrinsics(source="x.json", cameras=cameras))
    with pytest.raises(SettingsError, match="names none of the depth topics"):
        library.open(View(recording=next(iter(library.named()))))
    library.close()


def estimate_at(pose: HandPose, *, improved: bool, **values: Any) -> ExtrinsicsEstimate:
    """A result in which the height is not observable."""
    covariance = np.diag([1e-6, 1e-6, 1e-6, 1e-4, np.nan, 1e-4])
    unseen = np.isnan(np.diag(covariance))
    covariance[unseen, :] = np.nan
    covariance[:, unseen] = np.nan
    return ExtrinsicsEstimate(
        T_camera_lidar=np.linalg.inv(pose.T_lidar_camera),
        covariance=covariance,
        method="walls",
        verdict="It <b>fits</b>.",
        improved=improved,
        unobservable=("y_m",),
        **values,
    )


def calibrate_as(
    monkeypatch: pytest.MonkeyPatch, estimate: ExtrinsicsEstimate
) -> list[CalibrationRequest]:
    """Have the job find this estimate; what it was asked for is appended."""
    asked: list[CalibrationRequest] = []

    def calibrate(request: CalibrationRequest, progress: Progress) -> FinishedCalibration:
        asked.append(request)
        progress(1, 2, "searching")
        pose = HandPose.of_transform(np.linalg.inv(estimate.T_camera_lidar))
        return FinishedCalibration(request=request, estimate=estimate, pose=pose)

    monkeypatch.setattr("scanloom.panels.natural_calibration.calibrate", calibrate)
    return asked


def test_a_better_pose_is_used_at_once_and_says_how_sure_it_is(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    pose = HandPose(yaw_deg=7.5, forward_m=0.05, left_m=0.03, up_m=0.55)
    asked = calibrate_as(monkeypatch, estimate_at(pose, improved=True, basin=0.9))
    bench.browser.click("Calibrate")
    bench.until(lambda: bench.session.view.hand_pose == pose)
    result = bench.html('class="scanloom-result"')
    assert "It &lt;b&gt;fits&lt;/b&gt;." in result
    assert result.index("fits") < result.index("of the LiDAR&#x27;s points agree")
    assert "± 0.057°" in result
    assert "± 10.0 mm" in result
    assert result.count("not observable") == 1
    assert "90% come back" in result
    # Nothing was given: the method finds the recording's own pose.
    assert asked[0].guess is None
    assert asked[0].depth_topic == bench.frame_view.session.rig.cameras[0].topic
    # What is saved is the result itself, with its deviations, until a person changes the pose.
    bench.browser.click("Save as file")
    text = bench.html("scanloom view", "extrinsics.json</textarea>")
    path = Path(re.findall(r"--extrinsics=([^<]*extrinsics.json)</textarea>", text)[0])
    assert read_estimate(path).method == "walls"
    bench.change(extrinsics=pose.model_copy(update={"roll_deg": 1.0}))
    again = bench.browser.find("Use this pose")
    bench.browser.wait_until(lambda: bool(again.props["visible"]))
    bench.browser.click("Calibrate")
    bench.until(lambda: len(asked) == 2)
    bench.until(lambda: bench.session.view.hand_pose == pose)
    guess = asked[1].guess
    assert guess is not None
    np.testing.assert_allclose(
        np.linalg.inv(guess),
        HandPose(**pose.model_dump() | {"roll_deg": 1.0}).T_lidar_camera,
        atol=1e-3,
    )
    bench.session.undo()
    bench.until(lambda: bench.session.view.hand_pose != pose)


def test_a_kept_guess_changes_nothing(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    guess = HandPose(yaw_deg=3.0)
    T_guess = np.linalg.inv(guess.T_lidar_camera)
    calibrate_as(monkeypatch, estimate_at(guess, improved=False, T_guess=T_guess))
    bench.change(extrinsics=guess)
    bench.browser.click("Calibrate")
    bench.html("The guess is kept")
    assert bench.session.view.hand_pose == guess


def test_a_calibration_that_fails_says_why(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(request: CalibrationRequest, progress: Progress) -> FinishedCalibration:
        raise CalibrationFailed("all walls are <i>parallel</i>.", advice="Turn.")

    monkeypatch.setattr("scanloom.panels.natural_calibration.calibrate", fail)
    bench.browser.click("Calibrate")
    bench.html("Failed: all walls are &lt;i&gt;parallel&lt;/i&gt;. Turn.")
    assert bench.session.view.extrinsics is None
    assert bench.browser.find("Calibrate").props["disabled"] is False


def test_the_command_has_the_recording_and_the_guess(bench: Bench) -> None:
    command = bench.html("scanloom calibrate planar")
    assert str(sample_path()) in command
    assert "--guess" not in command
    bench.change(extrinsics=HandPose(yaw_deg=3.0))
    bench.html("scanloom calibrate planar", "--guess=")
