"""``calibrate lidar`` from recordings of a turn, whole and with something wrong."""

import json
import tomllib

import numpy as np
import open3d as o3d
import pytest

from fusion_core.calibration.turning.turn import SELF_CALIBRATION_PARAMETERS
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.progress import silent
from fusion_core.workflows.calibrate.lidar import LidarOptions, calibrate_lidar, lidar_lines
from tests.workflows.calibrate.turns import TurnFile, small_turn

# Must-show bounds for 1 cm of noise: degrees and metres, here with a twentieth of the points.
BOUNDS = np.array([np.deg2rad(0.02)] * 2 + [1e-3] * 2)


def calibrate(tmp_path, file, *, points_max=100_000, **options):
    recording = file.write(tmp_path / "turn.mcap")
    given = LidarOptions(settings_file=few_points(tmp_path, points_max), **options)
    return calibrate_lidar(recording, tmp_path / "out.json", given, silent)


def few_points(tmp_path, points_max):
    path = tmp_path / "few.toml"
    path.write_text(f"[self_calibration]\npoints_max = {points_max}\n[frames]\nframes = 12\n")
    return path


def error_of(document):
    data = small_turn()
    truth = np.array([data.theta_rad, data.beta_rad, *data.delta_m])
    return np.array([document[name] for name in SELF_CALIBRATION_PARAMETERS]) - truth


def broken(points):
    points = points.copy()
    points[::5] = np.nan
    points[1::7, 1] = np.inf
    return points


@pytest.mark.parametrize(
    ("file", "note"),
    [
        pytest.param(TurnFile(), "", id="joint"),
        pytest.param(TurnFile(axis="tf"), "", id="tf"),
        pytest.param(
            TurnFile(mounting=None), "the LiDAR's -y", id="no mounting", marks=pytest.mark.slow
        ),
        pytest.param(
            TurnFile(mounting=np.eye(4)),
            "blurs the cloud",
            id="wrong mounting",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            TurnFile(instants=False), "one after another", id="no instants", marks=pytest.mark.slow
        ),
        pytest.param(
            TurnFile(change_points=broken),
            "no finite position",
            id="nan and inf",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_mounting_is_found(tmp_path, file, note):
    document = calibrate(tmp_path, file)
    assert (np.abs(error_of(document)) < BOUNDS).all()
    assert note in " ".join(document["notes"])
    assert json.loads((tmp_path / "out.json").read_text()) == document
    for line in lidar_lines(document):
        assert "\n" not in line


@pytest.mark.slow
def test_an_axis_that_stands_still_in_each_scan(tmp_path):
    # A view is one scan here, of so few beams that it needs all of them.
    file = TurnFile(steps=True, instants=False)
    document = calibrate(tmp_path, file, points_max=300_000)
    assert (np.abs(error_of(document)) < BOUNDS).all()
    assert "at the stamp" in " ".join(document["notes"])


@pytest.mark.parametrize(
    ("file", "problem"),
    [
        pytest.param(TurnFile(axis="none"), "no angles of the axis", id="no angles"),
        pytest.param(TurnFile(angle_scale=0.0), "stands still", id="still joint"),
        pytest.param(TurnFile(angle_scale=0.0, axis="tf"), "stands still", id="still tf"),
        pytest.param(TurnFile(turn_deg=180.0), "180 deg", id="half a turn"),
        pytest.param(TurnFile(angle_scale=57.3), "radians", id="degrees"),
        pytest.param(TurnFile(change_points=lambda p: 1e3 * p), "metres", id="millimetres"),
        pytest.param(TurnFile(change_points=lambda p: np.nan * p), "finite", id="no points"),
    ],
)
def test_bad_input_is_one_clear_line(tmp_path, file, problem):
    with pytest.raises(ScanLoomError) as caught:
        calibrate(tmp_path, file)
    line = str(caught.value)
    assert problem in line
    assert "turn.mcap" in line
    assert "\n" not in line
    assert caught.value.advice
    assert not (tmp_path / "out.json").exists()


def test_names_that_are_not_there(tmp_path):
    with pytest.raises(ScanLoomError, match=r"joint 'arm'.*still, turn"):
        calibrate(tmp_path, TurnFile(), joint="arm")
    with pytest.raises(ScanLoomError, match="no topic '/other'"):
        calibrate(tmp_path, TurnFile(), points="/other")
    with pytest.raises(ScanLoomError, match="stands still"):
        calibrate(tmp_path, TurnFile(), joint="still")


def test_the_dense_cloud_is_that_of_the_room(tmp_path):
    """Read by Open3D, in the room's frame: no point lies far outside its walls."""
    calibrate(tmp_path, TurnFile(), cloud=tmp_path / "turn.ply")
    cloud = o3d.t.io.read_point_cloud(str(tmp_path / "turn.ply"))
    in_rig = cloud.point.positions.numpy()
    assert "intensity" in cloud.point
    data = small_turn()
    in_room = in_rig @ data.T_room_rig[:3, :3].T + data.T_room_rig[:3, 3]
    beyond = np.maximum(-in_room, in_room - np.array(data.room_size_m)).max(axis=1)
    assert np.percentile(beyond, 99.9) < 0.05
    assert len(in_rig) > 0.99 * sum(len(scan.points_m) for scan in data.scans)


@pytest.mark.slow
def test_toml_and_the_same_bytes_again(tmp_path):
    recording = TurnFile().write(tmp_path / "turn.mcap")
    for name in ("a.toml", "b.toml"):
        calibrate_lidar(recording, tmp_path / name, LidarOptions(preset="published"), silent)
    text = (tmp_path / "a.toml").read_bytes()
    assert text == (tmp_path / "b.toml").read_bytes()
    document = tomllib.loads(text.decode())
    assert document["preset"] == "published"
    assert np.rad2deg(np.abs(error_of(document)[:2])).max() < 0.15


def test_the_recording_is_not_written_over(tmp_path):
    recording = TurnFile().write(tmp_path / "turn.mcap")
    before = recording.read_bytes()
    for output, cloud in ((tmp_path / "o.txt", None), (tmp_path / "o.json", recording)):
        with pytest.raises(ScanLoomError):
            calibrate_lidar(recording, output, LidarOptions(cloud=cloud), silent)
    assert recording.read_bytes() == before
