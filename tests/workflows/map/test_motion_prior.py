"""Motion of a recording by each source, and its files, on the built-in recording."""

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fusion_core.alignment.upright import upright_view
from fusion_core.evaluation.odometry import evaluate_odometry
from fusion_core.model.errors import MissingStream, ScanLoomError
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import CameraInfo
from fusion_core.model.trajectory import Trajectory
from fusion_core.motion.fusion import FusionSettings
from fusion_core.motion.steps import steps_between, subtract_poses
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.topics import choose_streams
from fusion_core.recordings.tum_trajectory import read_tum_trajectory
from fusion_core.workflows.evaluate.odometry import odometry, odometry_lines
from fusion_core.workflows.map.extrinsics import CameraExtrinsics, MountedCamera
from fusion_core.workflows.map.motion_prior import (
    MotionKind,
    MotionPrior,
    MotionSettings,
    choose_map_streams,
    open_motion_prior,
    require_recorded_poses,
)
from fusion_core.workflows.map.recorded_sensors import RecordedSensors
from fusion_core.workflows.map.rgbd_frames import RgbdFrames, first_camera_extrinsics
from fusion_core.workflows.map.scan_source import LidarScans
from fusion_core.workflows.map.write_odometry import write_odometry

SAMPLE = Path(__file__).parents[3] / "samples" / "furnished_room.mcap"
TRUTH = SAMPLE.with_suffix(".truth.npz")


@pytest.fixture(scope="module")
def recording() -> Iterator[Recording]:
    with open_recording(SAMPLE) as opened:
        yield opened


def motion_of(
    recording: Recording, kind: MotionKind, settings: MotionSettings | None = None, **sensor_values
) -> MotionPrior | None:
    streams = choose_map_streams(recording, None, None)
    sensors = RecordedSensors(recording=recording, streams=streams, **sensor_values)
    return open_motion_prior(sensors, LidarScans(recording, streams), kind, settings)


def placed(recording: Recording) -> CameraExtrinsics:
    """The camera where the truth has it; the recording itself does not tell."""
    streams = choose_streams(recording)
    assert streams.camera_info[0] is not None
    info = recording.read(streams.camera_info[0], 0).value
    assert isinstance(info, CameraInfo)
    assert info.intrinsics is not None
    T_lidar_camera = np.load(TRUTH)["T_lidar_camera"].reshape(4, 4)
    camera = MountedCamera(
        topic=streams.depth[0],
        view=upright_view(info.intrinsics, T_lidar_camera[2, :3]),
        T_lidar_camera=T_lidar_camera.copy(),
    )
    return CameraExtrinsics(
        source="file",
        frame_id="laser",
        cameras=(camera,),
        is_height_known=True,
        lidar_height_m=None,
        notes=(),
    )


@pytest.fixture(scope="module")
def fused(recording: Recording) -> MotionPrior:
    motion = motion_of(recording, "fused", extrinsics=placed(recording))
    assert motion is not None
    return motion


def errors(track_poses: tuple[np.ndarray, np.ndarray]) -> dict:
    truth = np.load(TRUTH)
    reference = Trajectory.from_planar(truth["scan_stamp"].astype(np.int64), truth["pose"])
    estimate = Trajectory.from_planar(*(array.copy() for array in track_poses))
    return evaluate_odometry(estimate, reference).to_json()


def test_fused_motion_errs_less_than_half_of_the_wheels(fused: MotionPrior) -> None:
    assert [track.name for track in fused.tracks] == ["wheel", "laser", "visual", "fused"]
    by_name = {t.name: errors((t.stamps_ns, t.poses_odom_lidar)) for t in fused.tracks}
    wheel, result = by_name["wheel"]["over_stretches"], by_name["fused"]["over_stretches"]
    assert result["translation_error"] < 0.5 * wheel["translation_error"]
    assert result["rotation_deg_per_m"] < 0.5 * wheel["rotation_deg_per_m"]


def test_the_camera_says_how_well_it_tells_each_step(fused: MotionPrior) -> None:
    """Before a plain wall a way aside looks like a turn: it errs by centimetres there, and by
    millimetres elsewhere, and its covariance knows which."""
    visual = fused.tracks[2]
    truth = np.load(TRUTH)
    true = steps_between(truth["pose"])
    away = subtract_poses(visual.steps, true)[visual.measured]
    said = visual.step_covariance[visual.measured]
    squares = np.einsum("ka,kab,kb->k", away, np.linalg.inv(said), away)
    assert 0.3 < np.median(squares) < 5.0
    sigma = np.sqrt(said[:, 2, 2])
    surest = sigma < np.quantile(sigma, 0.25)
    doubtful = sigma > np.quantile(sigma, 0.75)
    assert np.abs(away[surest, 2]).mean() < 0.3 * np.abs(away[doubtful, 2]).mean()


def test_fused_motion_is_that_of_its_track(fused: MotionPrior) -> None:
    track = fused.tracks[-1]
    middle = int(track.stamps_ns[10])
    np.testing.assert_array_equal(fused.at(middle), track.poses_odom_lidar[10])
    assert fused.at(middle + 1_000_000) is not None
    assert fused.at(int(track.stamps_ns[-1]) + 1) is None
    assert fused.weights is not None
    np.testing.assert_allclose(fused.weights.translation.sum(axis=1), 1.0)
    assert fused.source == "fused (wheel, laser, visual)"


def test_without_extrinsics_it_is_fused_without_the_camera(recording: Recording) -> None:
    motion = motion_of(recording, "fused")
    assert motion is not None
    assert [track.name for track in motion.tracks] == ["wheel", "laser", "fused"]
    assert any("without the camera" in note for note in motion.notes)


def test_a_single_source_is_noted(recording: Recording) -> None:
    """No odometry, no extrinsics: the laser is all there is, and the notes say why."""
    streams = choose_streams(recording)
    bare = type(streams)(
        **{
            **{name: getattr(streams, name) for name in type(streams).__dataclass_fields__},
            "odometry": None,
        }
    )
    motion = open_motion_prior(
        RecordedSensors(recording=recording, streams=bare), LidarScans(recording, bare), "fused"
    )
    assert motion is not None
    assert motion.source == "laser"
    assert motion.weights is None
    assert any("Nothing to fuse" in note for note in motion.notes)
    assert any("without wheels" in note for note in motion.notes)
    with pytest.raises(MissingStream, match="holds no odometry"):
        open_motion_prior(
            RecordedSensors(recording=recording, streams=bare), LidarScans(recording, bare), "wheel"
        )


@pytest.mark.parametrize("kind", ["wheel", "laser"])
def test_single_sources(recording: Recording, kind: MotionKind) -> None:
    motion = motion_of(recording, kind)
    assert motion is not None
    (track,) = motion.tracks
    assert track.name == motion.source == kind
    assert track.measured_fraction > 0.95
    error = errors((track.stamps_ns, track.poses_odom_lidar))["over_stretches"]
    assert error["translation_error"] < 0.04


def test_none_is_none_and_recorded_is_as_recorded(recording: Recording) -> None:
    assert motion_of(recording, "none") is None
    motion = motion_of(recording, "recorded")
    assert motion is not None
    assert motion.tracks == ()
    assert "/odom" in motion.source


def test_a_camera_that_nobody_has_placed_says_so() -> None:
    with open_recording(SAMPLE) as recording:
        streams = choose_streams(recording)
        assert first_camera_extrinsics(recording, streams, None) == (None, ())
        motion = motion_of(recording, "visual")
    assert motion is not None
    assert any("taken to be level" in note for note in motion.notes)
    assert motion.tracks[0].measured_fraction > 0.9


def test_extrinsics_of_stored_images_are_those_of_the_file(recording: Recording) -> None:
    T, _ = first_camera_extrinsics(recording, choose_streams(recording), placed(recording))
    assert T is not None
    np.testing.assert_allclose(T, np.load(TRUTH)["T_lidar_camera"].reshape(4, 4), atol=1e-6)


def test_images_are_paired_in_order_and_shifted_by_the_clock(recording: Recording) -> None:
    streams = choose_streams(recording)
    frames = RgbdFrames(recording, streams)
    plain = [frame.stamp_ns for frame in frames]
    topic = next(topic for topic in recording.topics if topic.name == streams.depth[0])
    assert len(plain) == topic.count
    assert (np.diff(plain) > 0).all()
    shifted = [f.stamp_ns for f in RgbdFrames(recording, streams, clock_offset_ns=40_000_000)]
    np.testing.assert_array_equal(np.array(plain) - shifted, 40_000_000)
    # Any number of times.
    assert [frame.stamp_ns for frame in frames] == plain


def test_colour_or_depth_that_is_not_there_is_named(recording: Recording) -> None:
    streams = choose_streams(recording)
    fields = {name: getattr(streams, name) for name in type(streams).__dataclass_fields__}
    with pytest.raises(MissingStream, match="no colour images beside"):
        RgbdFrames(recording, type(streams)(**{**fields, "color": (None,)}))
    with pytest.raises(MissingStream, match="no depth images"):
        RgbdFrames(recording, type(streams)(**{**fields, "depth": ()}))
    with pytest.raises(MissingStream, match="no usable intrinsics"):
        RgbdFrames(recording, type(streams)(**{**fields, "camera_info": (None,)}))


def test_files_and_their_evaluation(fused: MotionPrior, tmp_path: Path) -> None:
    names = write_odometry(tmp_path, fused)
    assert set(names) == {path.name for path in tmp_path.iterdir()}
    track = fused.tracks[-1]
    written = read_tum_trajectory(tmp_path / "odometry_fused.tum").trajectory
    np.testing.assert_array_equal(written.stamps_ns, track.stamps_ns)
    np.testing.assert_allclose(written.planar_poses, track.poses_odom_lidar, atol=1e-8)
    with (tmp_path / "odometry_weights.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == track.stamps_ns.size - 1
    shares = [float(rows[5][f"{name}_translation"]) for name in ("wheel", "laser", "visual")]
    assert sum(shares) == pytest.approx(1.0)
    assert (tmp_path / "odometry_weights.png").read_bytes()[1:4] == b"PNG"

    result = odometry(tmp_path, TRUTH)
    assert list(result["tracks"]) == ["fused", "laser", "visual", "wheel"]
    own = errors((track.stamps_ns, track.poses_odom_lidar))
    measured = result["tracks"]["fused"]
    assert measured["end"]["translation_error"] == pytest.approx(
        own["end"]["translation_error"], abs=1e-6
    )
    lines = odometry_lines(result)
    # Before them stands what the simulation put in.
    assert [line.split()[0] for line in lines[4:8]] == list(result["tracks"])


def test_the_same_motion_gives_the_same_bytes(fused: MotionPrior, tmp_path: Path) -> None:
    contents = []
    for folder in (tmp_path / "one", tmp_path / "two"):
        folder.mkdir()
        contents.append([(folder / name).read_bytes() for name in write_odometry(folder, fused)])
    assert contents[0] == contents[1]


def test_as_published_the_table_has_the_gain(recording: Recording, tmp_path: Path) -> None:
    settings = MotionSettings(fusion=FusionSettings(method="published"))
    motion = motion_of(recording, "fused", settings=settings)
    assert motion is not None
    write_odometry(tmp_path, motion)
    header = (tmp_path / "odometry_weights.csv").read_text().splitlines()[0]
    assert header.endswith("gain_x,gain_y,gain_yaw")


def test_a_folder_or_a_reference_that_is_none_is_refused(
    fused: MotionPrior, tmp_path: Path
) -> None:
    with pytest.raises(ScanLoomError, match="holds no odometry"):
        odometry(tmp_path, TRUTH)
    write_odometry(tmp_path, fused)
    with pytest.raises(ScanLoomError, match="cannot be read"):
        odometry(tmp_path, tmp_path / "missing.npz")
    with pytest.raises(ScanLoomError, match="cannot be read"):
        odometry(tmp_path, tmp_path / "missing.tum")
    np.savez(tmp_path / "other.npz", scan_stamp=np.arange(3))
    with pytest.raises(ScanLoomError, match="must hold scan_stamp and pose"):
        odometry(tmp_path, tmp_path / "other.npz")


def test_localisation_alone_is_refused_and_the_remedy_named(log, pose_of) -> None:
    log.scan(0.0)
    log.transform("base", "laser", pose_of())
    for at_ms in (0.0, 100.0):
        log.transform("map", "base", pose_of(1.0), at_ms=at_ms)
    recording = log.open()
    streams = choose_streams(recording)
    with pytest.raises(MissingStream, match="holds no recorded odometry") as refused:
        require_recorded_poses(recording, streams, "laser", wheel_only=False)
    assert "--pose" in str(refused.value)
    named = choose_streams(recording, pose="map")
    poses = require_recorded_poses(recording, named, "laser", wheel_only=False)
    assert poses.source == "/tf (map to laser)"
    with pytest.raises(MissingStream, match="holds no odometry"):
        require_recorded_poses(recording, named, "laser", wheel_only=True)
