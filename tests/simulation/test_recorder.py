"""Whole recordings: what is in them, in which order, and always the same bytes."""

import zipfile
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from fusion_core.model.classes import SAME_SURFACE_M
from fusion_core.model.errors import ExportError, SettingsError
from fusion_core.model.geometry import transform_points
from fusion_core.recordings.world_file import world_path
from fusion_core.simulation.scenes import SceneSettings, find_scene, list_scenes, write_scene
from fusion_core.simulation.truth import TruthWriter, truth_path

SMALL = {"duration_s": 0.4, "image_scale": 0.25}
ROOM_KEYS = {
    "scan_stamp",
    "scan_true",
    "scan_kind",
    "depth_stamp",
    "depth_true",
    "depth_kind",
    "pose",
    "cam_yaw",
    "size",
    "blocks",
}


def small(name: str, **changes: float) -> SceneSettings:
    return SceneSettings(**{**find_scene(name).settings.model_dump(), **SMALL, **changes})


def read(path: Path):
    """(log time, topic, message) of each message, in the order of the file."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            assert schema is not None
            yield message.log_time, channel.topic, types.deserialize_cdr(message.data, schema.name)


def truth_of(path: Path) -> dict[str, np.ndarray]:
    return dict(np.load(truth_path(path)))


def header_of(path: Path) -> dict[str, tuple[np.dtype, int]]:
    """Type and number of dimensions of each array of an npz; the arrays stay packed."""
    found = {}
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            with archive.open(name) as array:
                assert np.lib.format.read_magic(array) == (1, 0)
                shape, _, dtype = np.lib.format.read_array_header_1_0(array)
            found[name.removesuffix(".npy")] = (dtype, len(shape))
    return found


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Each scene, short and small, written once."""
    folder = tmp_path_factory.mktemp("scenes")
    for scene in list_scenes():
        write_scene(scene.name, folder / f"{scene.name}.mcap", settings=small(scene.name))
    return folder


def nanoseconds(header) -> int:
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def test_the_same_settings_give_the_same_bytes(recorded, tmp_path):
    for name in ("moving_person", "robot_at_home"):
        again = tmp_path / f"{name}.mcap"
        write_scene(name, again, settings=small(name))
        assert again.read_bytes() == (recorded / f"{name}.mcap").read_bytes()
        for beside in (truth_path, world_path):
            first = beside(recorded / f"{name}.mcap")
            assert beside(again).read_bytes() == first.read_bytes()


def test_another_seed_gives_another_recording(recorded, tmp_path):
    path = tmp_path / "bedroom.mcap"
    write_scene("bedroom", path, settings=small("bedroom", seed=99))
    other = truth_of(recorded / "bedroom.mcap")
    assert not np.array_equal(truth_of(path)["scan_true"], other["scan_true"])


@pytest.mark.parametrize("scene", list_scenes(), ids=lambda scene: scene.name)
def test_messages_come_in_the_order_of_the_log(recorded, scene):
    times = [time for time, _, _ in read(recorded / f"{scene.name}.mcap")]
    assert times == sorted(times)


@pytest.mark.parametrize("scene", list_scenes(), ids=lambda scene: scene.name)
def test_topics_and_counts(recorded, scene):
    counts = Counter(topic for _, topic, _ in read(recorded / f"{scene.name}.mcap"))
    cameras = [f"/camera_{n}" for n in (1, 2, 3, 4)]
    images = round(0.4 * scene.settings.camera_rate_hz)
    scans = round(0.4 * scene.mounts().lidar.rate_hz)
    expected = {"/scan": scans, "/odom": 8, "/ground_truth": 8}
    for camera in cameras if scene.name == "robot_at_home" else ["/camera"]:
        for topic in ("depth/image_raw", "color/image_raw", "depth/camera_info"):
            expected[f"{camera}/{topic}"] = images
    if scene.published_mounts == "all":
        expected["/tf"] = 8
    if scene.published_mounts != "none":
        expected["/tf_static"] = 1
    assert counts == expected


@pytest.mark.parametrize("scene", list_scenes(), ids=lambda scene: scene.name)
def test_recorded_values_are_those_of_the_truth(recorded, scene):
    path = recorded / f"{scene.name}.mcap"
    truth = truth_of(path)
    messages = list(read(path))
    scans = [message for _, topic, message in messages if topic == "/scan"]
    assert [nanoseconds(scan.header) for scan in scans] == truth["scan_stamp"].tolist()
    ranges = np.array([scan.ranges for scan in scans])
    np.testing.assert_array_equal(np.isnan(ranges), truth["scan_kind"] == 1)
    good = truth["scan_kind"] == 0
    # Six standard deviations of the worse LiDAR, and half a step.
    bound_m = np.maximum(0.06 * truth["scan_true"], max(0.06, SAME_SURFACE_M)) + 0.001
    assert (np.abs(ranges - truth["scan_true"]) < bound_m)[good].all()
    topics = truth["camera_topics"].tolist()
    for number, name in enumerate(topics):
        suffix = f"_{number}" if len(topics) > 1 else ""
        images = [message for _, topic, message in messages if topic == name]
        stamps = [nanoseconds(image.header) for image in images]
        assert stamps == truth[f"depth_stamp{suffix}"].tolist()
        kinds, true_mm = truth[f"depth_kind{suffix}"], truth[f"depth_true{suffix}"]
        depth_mm = np.array([image.data.view("<u2") for image in images]).reshape(kinds.shape)
        np.testing.assert_array_equal(depth_mm == 0, kinds == 1)
        off = np.abs(depth_mm - true_mm.astype(float))[kinds == 0]
        ordinary = 1.0 + 6 * 1.43e-6 * true_mm[kinds == 0].astype(float) ** 2
        assert (off < np.maximum(ordinary, 1e3 * SAME_SURFACE_M + 1.0)).all()


def test_late_cameras_show_an_earlier_instant(recorded):
    truth = truth_of(recorded / "clock_offset.mcap")
    assert truth["clock_offset_ms"] == 40.0
    assert truth["depth_stamp"][0] - truth["scan_stamp"][0] == 53_000_000


def test_extrinsics_of_a_single_camera_are_those_of_the_truth(recorded):
    path = recorded / "bedroom.mcap"
    (static,) = [message for _, topic, message in read(path) if topic == "/tf_static"]
    mounts = {mount.child_frame_id: mount for mount in static.transforms}
    assert {mount.header.frame_id for mount in static.transforms} == {"base_link"}
    lidar, camera = mounts["laser"].transform, mounts["camera_depth_optical_frame"].transform
    apart = [getattr(camera.translation, a) - getattr(lidar.translation, a) for a in "xyz"]
    np.testing.assert_allclose(apart, truth_of(path)["T_lidar_camera"][0, :3, 3], atol=1e-12)


def test_four_cameras_are_calibrated_among_themselves_alone(recorded):
    path = recorded / "robot_at_home.mcap"
    (static,) = [message for _, topic, message in read(path) if topic == "/tf_static"]
    parents = {mount.header.frame_id for mount in static.transforms}
    children = [mount.child_frame_id for mount in static.transforms]
    assert parents == {"camera_rig"}
    assert children == [f"camera_{n}_depth_optical_frame" for n in (1, 2, 3, 4)]
    truth = truth_of(path)
    assert truth["cam_yaw"] == pytest.approx(np.radians(2.5))
    assert truth["intrinsics"].shape == (4, 4)
    assert "depth_true_3" in truth
    assert "depth_true" not in truth


def test_scan_and_depth_truth_meet_where_a_beam_meets_a_pixel(recorded):
    """The truth of both sensors, laid over each other with the recorded mount, is one world."""
    truth = truth_of(recorded / "turtlebot_low.mcap")
    fx, fy, cx, cy = truth["intrinsics"][0]
    azimuth = truth["lidar_angle_min"] + np.arange(682) * truth["lidar_angle_increment"]
    scan = truth["scan_true"][0].astype(float)
    points = np.stack([scan * np.cos(azimuth), scan * np.sin(azimuth), 0 * scan], axis=1)
    x, y, z = transform_points(np.linalg.inv(truth["T_lidar_camera"][0]), points).T
    ahead = z > 0.1
    u = np.rint(cx + fx * x[ahead] / z[ahead]).astype(int)
    v = np.rint(cy + fy * y[ahead] / z[ahead]).astype(int)
    height, width = truth["depth_true"].shape[1:]
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    assert inside.sum() > 100
    depth = truth["depth_true"][0][v[inside], u[inside]] / 1000.0
    # 13 ms and half a pixel apart: all but the edges agree.
    assert np.median(np.abs(depth - z[ahead][inside])) < 0.02


@pytest.mark.data
def test_the_truth_has_the_form_of_the_rooms(recorded, room_truth_path):
    room = header_of(room_truth_path)
    ours = header_of(truth_path(recorded / "furnished_room.mcap"))
    assert room.keys() == ROOM_KEYS
    assert ours.keys() >= ROOM_KEYS
    for key, theirs in room.items():
        assert ours[key] == theirs, key


def test_truth_needs_no_pickle_and_has_no_dates(recorded):
    path = truth_path(recorded / "bedroom.mcap")
    with zipfile.ZipFile(path) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    with np.load(path, allow_pickle=False) as archive:
        assert archive["camera_topics"].tolist() == ["/camera/depth/image_raw"]


def test_a_failure_leaves_nothing_behind(tmp_path):
    path = tmp_path / "room.truth.npz"

    def fail() -> None:
        with TruthWriter(path) as truth:
            truth.append("scan", np.zeros(3))
            raise RuntimeError("the disk is full")

    with pytest.raises(RuntimeError, match="full"):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ExportError, match="nowhere"):
        write_scene("bedroom", tmp_path / "nowhere" / "a.mcap", settings=small("bedroom"))


def test_an_unknown_scene_is_refused_with_the_known_names():
    with pytest.raises(SettingsError, match=r"'kitchen'.*furnished_room"):
        find_scene("kitchen")


def test_progress_ends_at_the_total(tmp_path):
    seen: list[tuple[int, int | None]] = []
    write_scene(
        "corridor",
        tmp_path / "a.mcap",
        settings=small("corridor"),
        progress=lambda done, total, what: seen.append((done, total)),
    )
    assert seen[-1] == (400, 400)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
