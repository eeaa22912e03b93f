"""Faults are in the recording as set, and nowhere else; they do not change the ground truth."""

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from fusion_core.simulation.faults import FaultSettings, KidnappedPath
from fusion_core.simulation.paths import WeavingPath
from fusion_core.simulation.recorder import START_NS
from fusion_core.simulation.scenes import SceneSettings, find_scene, write_scene
from fusion_core.simulation.truth import truth_path
from fusion_core.workflows.sample import write

SMALL = {"duration_s": 6.0, "image_scale": 0.1, "camera_rate_hz": 4.0}
SETTINGS = SceneSettings(**{**find_scene("arena").settings.model_dump(), **SMALL})


def record(folder: Path, name: str, faults: FaultSettings) -> Path:
    path = folder / f"{name}.mcap"
    write_scene("arena", path, settings=SETTINGS, faults=faults)
    return path


def messages(path: Path) -> list[tuple[str, float, object]]:
    """Topic, seconds since the start, message."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    with path.open("rb") as file:
        return [
            (
                channel.topic,
                (message.log_time - START_NS) / 1e9,
                types.deserialize_cdr(message.data, schema.name),
            )
            for schema, channel, message in make_reader(file).iter_messages()
        ]


def raw(path: Path) -> list[tuple[str, int, bytes]]:
    with path.open("rb") as file:
        return [(c.topic, m.log_time, m.data) for _, c, m in make_reader(file).iter_messages()]


def truth_of(path: Path) -> dict[str, np.ndarray]:
    return dict(np.load(truth_path(path)))


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    return record(tmp_path_factory.mktemp("sound"), "sound", FaultSettings())


def test_without_faults_the_truth_has_no_fault_entries(sound):
    assert not any(name.startswith("fault") or name == "scan_lost" for name in truth_of(sound))


def test_scans_are_lost_at_random_and_alone(sound, tmp_path):
    lossy = record(tmp_path, "lossy", FaultSettings(scan_loss_fraction=0.3))
    whole, left = raw(sound), raw(lossy)
    missing = [message for message in whole if message not in left]
    assert {topic for topic, _, _ in missing} == {"/scan"}
    assert [message for message in whole if message not in missing] == left
    lost = truth_of(lossy)["scan_lost"]
    stamps = truth_of(lossy)["scan_stamp"]
    assert [time for _, time, _ in missing] == stamps[lost].tolist()
    np.testing.assert_array_equal(truth_of(sound)["scan_true"], truth_of(lossy)["scan_true"])


@pytest.mark.parametrize("fraction", [0.1, 0.5])
def test_the_fraction_of_lost_scans_is_as_set(fraction):
    faults = FaultSettings(scan_loss_fraction=fraction)
    lost = [faults.is_scan_lost(7, index) for index in range(4000)]
    assert np.mean(lost) == pytest.approx(
        fraction, abs=4 * np.sqrt(fraction * (1 - fraction) / 4000)
    )
    assert lost == [faults.is_scan_lost(7, index) for index in range(4000)]
    assert lost != [faults.is_scan_lost(8, index) for index in range(4000)]


def test_no_sensor_reports_during_a_dropout(sound, tmp_path):
    path = record(tmp_path, "silent", FaultSettings(silence_at_s=2.0, silence_s=1.5))
    whole, left = raw(sound), raw(path)
    start, end = truth_of(path)["fault_silence_ns"] - START_NS
    assert (start, end) == (2_000_000_000, 3_500_000_000)

    def quiet(message):
        topic, time, _ = message
        return topic != "/ground_truth" and start <= time - START_NS < end

    assert sum(map(quiet, whole)) > 60
    assert [message for message in whole if not quiet(message)] == left


def test_slipping_wheels_report_another_distance(sound, tmp_path):
    faults = FaultSettings(slip_at_s=2.0, slip_s=1.0, slip_factor=3.0)
    path = record(tmp_path, "slip", faults)

    def steps(file):
        odom = [(t, m) for topic, t, m in messages(file) if topic == "/odom"]
        at = np.array([(m.pose.pose.position.x, m.pose.pose.position.y) for _, m in odom])
        return np.array([t for t, _ in odom])[1:], np.linalg.norm(np.diff(at, axis=0), axis=1)

    time_s, plain = steps(sound)
    _, slipped = steps(path)
    slips = (time_s > 2.0) & (time_s < 3.01)
    assert slips.sum() == 20
    np.testing.assert_allclose(slipped[slips], 3.0 * plain[slips], rtol=1e-9)
    np.testing.assert_allclose(slipped[~slips], plain[~slips], rtol=1e-9)
    np.testing.assert_array_equal(truth_of(sound)["pose"], truth_of(path)["pose"])
    assert (truth_of(path)["fault_slip_ns"] - START_NS).tolist() == [2_000_000_000, 3_000_000_000]


def test_a_dark_camera_reports_black_and_holes(sound, tmp_path):
    path = record(tmp_path, "dark", FaultSettings(dark_at_s=1.0, dark_s=2.0))
    dark = total = 0
    for topic, time_s, message in messages(path):
        if not topic.endswith("image_raw"):
            continue
        total += 1
        if 1.0 <= time_s < 3.0:
            dark += 1
            assert not np.asarray(message.data).any()
        elif "color" in topic:
            assert np.asarray(message.data).any()
    assert (dark, total) == (16, 48)
    first, second = truth_of(sound), truth_of(path)
    np.testing.assert_array_equal(first["depth_true"], second["depth_true"])
    stamps_s = (second["depth_stamp"] - START_NS) / 1e9
    blind = (stamps_s >= 1.0) & (stamps_s < 3.0)
    assert (second["depth_kind"][blind] == 1).all()
    np.testing.assert_array_equal(first["depth_kind"][~blind], second["depth_kind"][~blind])


def test_the_odometry_does_not_notice_a_kidnapping(sound, tmp_path):
    faults = FaultSettings(kidnap_at_s=3.02, kidnap_ahead_m=2.5)
    path = record(tmp_path, "kidnapped", faults)
    truth = truth_of(path)
    before, after = truth["fault_kidnap_poses"]
    assert truth["fault_kidnap_ns"] == START_NS + 3_020_000_000
    assert np.linalg.norm(after[:2] - before[:2]) > 1.0
    places = {"/odom": [], "/ground_truth": []}
    for topic, time_s, message in messages(path):
        if topic in places:
            pose = message.pose.pose if topic == "/odom" else message.pose
            places[topic].append((time_s, pose.position.x, pose.position.y))
    longest = {}
    for topic, rows in places.items():
        time_s, *xy = np.array(rows).T
        steps = np.hypot(*np.diff(xy, axis=1))
        longest[topic] = (steps.max(), time_s[1:][steps.argmax()])
        assert np.sort(steps)[-2] < 0.03
    assert longest["/ground_truth"][0] > 1.0
    assert longest["/ground_truth"][1] == pytest.approx(3.05)
    assert longest["/odom"][0] < 0.03
    np.testing.assert_array_equal(truth["pose"][:16], truth_of(sound)["pose"][:16])


def test_a_kidnapped_robot_continues_along_its_route():
    route = np.array([[1.0, 1.0], [4.0, 1.2], [4.2, 3.0], [1.1, 2.8]])
    path = WeavingPath(route, speed_m_s=0.5, start=0.0)
    carried = KidnappedPath(path, at_s=2.0, ahead_m=1.5)
    np.testing.assert_array_equal(carried.pose(1.99), path.pose(1.99))
    np.testing.assert_allclose(carried.pose(2.0), path.pose(5.0))
    np.testing.assert_array_equal(carried.poses_around_kidnap()[0], path.pose(2.0))


def test_the_same_faults_give_the_same_bytes(tmp_path):
    faults = FaultSettings(scan_loss_fraction=0.2, dark_at_s=1.0, dark_s=0.5, kidnap_at_s=2.0)
    short = SETTINGS.model_copy(update={"duration_s": 2.5})
    for name in ("a", "b"):
        write_scene("arena", tmp_path / f"{name}.mcap", settings=short, faults=faults)
    for end in ("mcap", "truth.npz", "world.json"):
        assert (tmp_path / f"a.{end}").read_bytes() == (tmp_path / f"b.{end}").read_bytes()


def test_lost_sensor_data_makes_nothing_visible(sound, tmp_path):
    """In the dark the camera sees no outline, and the world file says so."""
    path = record(tmp_path, "night", FaultSettings(dark_s=100.0))
    worlds = [json.loads(p.with_name(f"{p.stem}.world.json").read_text()) for p in (sound, path)]
    runs = [[o["seen_by"] for o in world["obstacles"]] for world in worlds]
    assert [own["lidar"] for own in runs[0]] == [own["lidar"] for own in runs[1]]
    assert any(own["camera"] for own in runs[0])
    assert not any(own["camera"] for own in runs[1])


def test_faults_are_read_from_a_settings_file(tmp_path):
    settings = tmp_path / "s.toml"
    settings.write_text(
        "[scene]\nduration_s = 1.0\nimage_scale = 0.1\n[faults]\nsilence_at_s = 0.5\n"
        "silence_s = 10.0\n"
    )
    output = tmp_path / "a.mcap"
    summary = write(
        "arena",
        output,
        settings_file=settings,
        seed=None,
        overwrite=False,
        progress=lambda *_: None,
    )
    assert summary["faults"]["silence_s"] == 10.0
    assert summary["world"] == str(tmp_path / "a.world.json")
    assert max(t for topic, t, _ in messages(output) if topic != "/ground_truth") < 0.5
