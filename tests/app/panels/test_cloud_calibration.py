"""The Calibrate panel on a recording of a turning LiDAR with a camera; the method is played."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import viser

from fusion_core.calibration.coloring import ColoringSettings
from fusion_core.calibration.features.camera_calibration import CameraCalibration
from fusion_core.calibration.features.intensity_image import IntensityImage, PixelSizeSearch
from fusion_core.calibration.features.matched_pairs import MatchedPairs
from fusion_core.calibration.features.reprojection import ReprojectionCurve
from fusion_core.calibration.features.virtual_camera import camera_towards
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.extrinsics import ExtrinsicsEstimate
from fusion_core.model.progress import Progress
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    ColorImage,
    JointSample,
    PointCloud,
)
from fusion_core.recordings.calibration_files.estimate import read_estimate
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from fusion_core.workflows.calibrate import recorded_camera
from fusion_core.workflows.calibrate.camera_input import CameraInput
from fusion_core.workflows.calibrate.recorded_camera import (
    RecordedCalibration,
    cloud_in_image,
    color_cloud,
)
from scanloom.client_session import ClientSession
from scanloom.page.bridge import PageBridge
from scanloom.panels.calibrate import CalibratePanel
from scanloom.scene.verdict import verdict_of
from scanloom.state.library import Library
from scanloom.state.possible_steps import why_not
from scanloom.state.view import View
from tests.app.viser_client import ViserClient, connect
from tests.patience import ENOUGH_S, comes_true

IMAGE = '/camera/<i>"image"'
INTRINSICS = CameraIntrinsics(width=64, height=48, fx=50.0, fy=50.0, cx=31.5, cy=23.5)
# Optical axes on those of the LiDAR, whose x is ahead.
T_CAMERA_LIDAR = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
RGB = np.random.default_rng(3).integers(0, 255, (48, 64, 3), dtype=np.uint8)
REASON = "a <b>hostile</b> reason"


def cloud() -> PointCloud:
    rng = np.random.default_rng(4)
    points_m = np.stack(
        [rng.uniform(2.0, 4.0, 500), rng.uniform(-1.0, 1.0, 500), rng.uniform(-0.8, 0.8, 500)],
        axis=1,
    )
    return PointCloud(
        stamp_ns=10**9,
        received_ns=10**9,
        frame_id="lidar",
        xyz_m=points_m.astype(np.float32),
        intensity=rng.uniform(0.0, 1.0, 500).astype(np.float32),
    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / "rig.mcap"
    with Ros2McapWriter(path) as writer:
        stamp = {"stamp_ns": 10**9, "received_ns": 10**9, "frame_id": "camera"}
        writer.write_camera_info("/camera/info", CameraInfo(**stamp, intrinsics=INTRINSICS))
        writer.write_color(IMAGE, ColorImage(**stamp, rgb=RGB))
        writer.write_joint_state(
            "/joints",
            JointSample(
                stamp_ns=10**9,
                received_ns=10**9,
                names=("axis",),
                positions=np.zeros(1),
                velocities=None,
            ),
        )
        writer.write_point_cloud("/points", cloud())
    return path


def found(*, improved: bool = True, T_guess: np.ndarray | None = None) -> RecordedCalibration:
    """A result of four matches, of which two are rejected."""
    view = camera_towards(np.array([1.0, 0.0, 0.0]), focal_px=50.0, width=80, height=60)
    empty = np.full((60, 80), np.nan, np.float32)
    image = IntensityImage(
        view=view,
        picture=np.full((60, 80), 120, np.uint8),
        smooth=empty,
        intensity=empty.copy(),
        points_m=np.full((60, 80, 3), np.nan, np.float32),
        pixel_size=1.0,
        filled_fraction=1.0,
        kept_fraction=1.0,
    )
    pixels = np.array([[5.0, 5.0], [50.0, 10.0], [20.0, 40.0], [40.0, 30.0]])
    pairs = MatchedPairs(
        image_px=pixels,
        intensity_px=pixels + 3.0,
        points_m=np.ones((4, 3)),
        reasons=("", "ratio", "", REASON),
    )
    estimate = ExtrinsicsEstimate(
        T_camera_lidar=T_CAMERA_LIDAR.copy(),
        covariance=np.diag([1e-8] * 3 + [1e-6] * 3),
        method="features",
        verdict="They agree.",
        improved=improved,
        T_guess=T_guess,
        reprojection_rms_px=0.7,
        reprojection_rms_used_px=0.6,
    )
    calibration = CameraCalibration(
        estimate=estimate,
        intrinsics=INTRINSICS,
        feature_image=image,
        features=pairs,
        image=image,
        pairs=pairs,
        curve=ReprojectionCurve(
            pairs=np.array([10, 20, 40]),
            unfiltered_px=np.array([3.0, 2.0, 1.5]),
            filtered_px=np.array([np.nan, 1.0, 0.8]),
        ),
        held_out_px=np.zeros((2, 2)),
        pixel_sizes=PixelSizeSearch(
            sizes=np.ones(1), filled_fraction=np.ones(1), kept_fraction=np.ones(1), chosen=1.0
        ),
    )
    given = CameraInput(
        cloud=cloud(),
        rgb=RGB,
        intrinsics=INTRINSICS,
        T_guess=T_guess,
        files=[],
        lidar_frame="rig",
        camera_frame="camera",
        turn=None,
        notes=[],
    )
    before = None if T_guess is None else cloud_in_image(given.cloud, INTRINSICS, T_guess)
    return RecordedCalibration(
        calibration=calibration,
        given=given,
        colored=color_cloud(given, T_CAMERA_LIDAR, ColoringSettings()),
        grey=RGB[..., 0].copy(),
        now=cloud_in_image(given.cloud, INTRINSICS, T_CAMERA_LIDAR),
        before=before,
    )


@dataclass(frozen=True)
class Bench:
    session: ClientSession
    panel: CalibratePanel
    browser: ViserClient
    output: Path

    def until(self, condition: Callable[[], bool]) -> None:
        assert comes_true(condition)
        assert self.session.wait(ENOUGH_S)

    def html(self, *words: str) -> str:
        self.browser.wait_until(lambda: bool(self._htmls(words)))
        return self._htmls(words)[0]

    def _htmls(self, words: tuple[str, ...]) -> list[str]:
        known = [str(w.props.get("content", "")) for w in self.browser.widgets.values()]
        return [content for content in known if all(word in content for word in words)]


@pytest.fixture
def bench(recording: Path, tmp_path: Path) -> Iterator[Bench]:
    library = Library([recording], [])
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    built: list[tuple[ClientSession, CalibratePanel]] = []

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        view = View(recording=recording.name, panel="Calibrate")
        session = ClientSession(client, library, view)
        panel = CalibratePanel(client, PageBridge(client.gui), session, tmp_path)
        session.panels = [panel]
        session.refresh()
        built.append((session, panel))

    with connect(f"http://127.0.0.1:{server.get_port()}") as browser:
        browser.find("Opacity of the cloud")
        assert comes_true(lambda: bool(built) and built[0][0].frame_view is not None)
        assert built[0][0].wait(ENOUGH_S)
        yield Bench(*built[0], browser, tmp_path)
        built[0][0].close()
    server.stop()
    library.close()


def play(monkeypatch: pytest.MonkeyPatch, result: RecordedCalibration) -> list[str]:
    """Have the method find this; the topics that it was asked for are appended."""
    asked: list[str] = []

    def calibrate(
        recording: Path, topic: str, guess: Path | None, progress: Progress
    ) -> RecordedCalibration:
        asked.append(topic)
        progress(0, None, "match features")
        return result

    monkeypatch.setattr(recorded_camera, "calibrate_recorded_camera", calibrate)
    return asked


def test_such_a_recording_has_this_step_and_another_panel(bench: Bench) -> None:
    frame_view = bench.session.frame_view
    assert frame_view is not None
    assert frame_view.open_recording.has_turning_lidar
    assert why_not("Calibrate", frame_view.open_recording) == ""
    assert why_not("Match", frame_view.open_recording)
    assert "turning LiDAR" in verdict_of(frame_view).sentence
    assert bench.panel._of_cloud.visible
    assert not bench.panel._planar.visible
    command = bench.html("scanloom calibrate camera")
    assert "&lt;i&gt;" in command
    assert IMAGE not in command


def test_the_result_comes_with_its_evidence(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    T_guess = T_CAMERA_LIDAR.copy()
    T_guess[0, 3] = 0.1
    asked = play(monkeypatch, found(T_guess=T_guess))
    cloud_panel = bench.panel._cloud
    bench.browser.update(cloud_panel._button._impl.uuid, {"value": True})
    bench.html("They agree.", "A better pose was found", "0.70 px on pairs that were held out")
    assert asked == [IMAGE]
    counts = bench.html("Matches of features")
    assert "a &lt;b&gt;hostile&lt;/b&gt; reason" in counts
    assert "another feature fits nearly as well" in counts
    assert [handle.visible for handle in cloud_panel._clouds] == [True, True]
    pairs, unfiltered, filtered = cloud_panel._curve.data
    np.testing.assert_array_equal(pairs, [10.0, 20.0, 40.0])
    np.testing.assert_array_equal(unfiltered, [3.0, 2.0, 1.5])
    np.testing.assert_array_equal(filtered, [np.nan, 1.0, 0.8])
    # The stage has the cloud in the camera's colours, in this step alone.
    node = cloud_panel._node._node
    assert node is not None
    assert node.visible
    assert 100 < len(node.points) <= 500
    bench.session.change(panel="Recording")
    bench.until(lambda: not node.visible)
    bench.session.change(panel="Calibrate")
    bench.until(lambda: node.visible)
    # What is under the pointer is said, and marked in both images.
    drawn = cloud_panel._matches
    assert drawn is not None
    for place, pair in enumerate(drawn.pairs):
        bench.browser.point("matches", "move", *map(float, drawn.lower_px[place]))
        reason = found().calibration.features.reasons[pair]
        words = {"": "accepted", "ratio": "fits nearly as well", REASON: "rejected: a &lt;b&gt;"}
        about = bench.html('data-picture="matches"', words[reason])
        assert about.count("cross") == 2
    # The opacity redraws the clouds alone.
    picture, shown = cloud_panel._picture._image._image, cloud_panel._clouds[0].image
    bench.browser.set_value("Opacity of the cloud", 0.3)
    bench.until(lambda: bench.session.view.overlay_opacity == 0.3)
    assert cloud_panel._picture._image._image is picture
    assert not np.array_equal(cloud_panel._clouds[0].image, shown)


def test_the_result_is_saved_as_by_the_command(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    play(monkeypatch, found())
    save = bench.browser.find("Save the result")
    assert save.props["disabled"]
    bench.browser.update(bench.panel._cloud._button._impl.uuid, {"value": True})
    bench.html("They agree.", "A pose was found")
    bench.browser.wait_until(lambda: not save.props["disabled"])
    bench.browser.click("Save the result")
    bench.until(lambda: len(list(bench.output.rglob("extrinsics.json"))) == 1)
    (path,) = bench.output.rglob("extrinsics.json")
    estimate = read_estimate(path)
    np.testing.assert_allclose(estimate.T_camera_lidar, T_CAMERA_LIDAR)
    assert estimate.reprojection_rms_px == 0.7


def test_the_verdict_is_of_the_result(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def sentence() -> str:
        frame_view = bench.session.frame_view
        assert frame_view is not None
        return verdict_of(frame_view).sentence

    asked = sentence()
    play(monkeypatch, found())
    press = bench.panel._cloud._button._impl.uuid
    bench.browser.update(press, {"value": True})
    bench.until(lambda: sentence() != asked)
    assert sentence().startswith("The camera's pose is found")
    assert "0.70 px" in sentence()
    T_guess = T_CAMERA_LIDAR.copy()
    T_guess[0, 3] = 0.1
    play(monkeypatch, found(improved=False, T_guess=T_guess))
    bench.browser.wait_until(lambda: not bench.panel._cloud._button.disabled)
    bench.browser.update(press, {"value": True})
    bench.until(lambda: sentence().startswith("The guess is kept"))


def test_the_verdict_names_what_is_not_observable(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = found()
    covariance = result.calibration.estimate.covariance.copy()
    covariance[1] = covariance[:, 1] = np.nan
    estimate = replace(
        result.calibration.estimate, covariance=covariance, unobservable=("rotation_y_rad",)
    )
    play(monkeypatch, replace(result, calibration=replace(result.calibration, estimate=estimate)))
    bench.browser.update(bench.panel._cloud._button._impl.uuid, {"value": True})

    def detail() -> str:
        frame_view = bench.session.frame_view
        return "" if frame_view is None else verdict_of(frame_view).detail

    bench.until(lambda: "Not observable: yaw" in detail())
    assert "pitch" not in detail()


def test_a_calibration_that_fails_says_why(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> RecordedCalibration:
        raise CalibrationFailed("the cloud has no <b>intensity</b>.", advice="Record it.")

    monkeypatch.setattr(recorded_camera, "calibrate_recorded_camera", fail)
    bench.browser.update(bench.panel._cloud._button._impl.uuid, {"value": True})
    bench.html("Failed: the cloud has no &lt;b&gt;intensity&lt;/b&gt;. Record it.")
    assert not bench.panel._cloud._evidence.visible
