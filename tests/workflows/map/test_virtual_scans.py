"""Virtual scans of whole recordings, against the rooms that they were made in."""

import json

import numpy as np
import pytest

from fusion_core.mapping.virtual_scan import VirtualScanSettings
from fusion_core.model.conventions import NS_PER_MS, wrap_angle
from fusion_core.model.errors import AlignmentFailed, MissingStream, SettingsError
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.fuse.settings import ChainSettings
from fusion_core.workflows.map.extrinsics import find_extrinsics
from fusion_core.workflows.map.floor_alignment import align_to_floor
from fusion_core.workflows.map.recorded_sensors import RecordedSensors
from fusion_core.workflows.map.scan_source import open_scans
from tests.mapping.box_room import LIDAR_HEIGHT_M, BoxRoom, camera_pose
from tests.workflows.box_recording import (
    ROOM,
    START_NS,
    START_POSE,
    TOPIC,
    T_camera_lidar,
    turning,
    write_boxes,
)

MOUNT_YAW_RAD = 0.1


def read(path, kind, settings=None, *, file=None, clock_offset_ms=0.0, **options):
    """All scans, and the notes after them. ``file``: of extrinsics."""
    with open_recording(path) as recording:
        streams = choose_streams(recording)
        if file is not None:
            extrinsics = find_extrinsics(recording, streams, ChainSettings(), file=file)
        else:
            extrinsics = None
        sensors = RecordedSensors(
            recording=recording,
            streams=streams,
            extrinsics=extrinsics,
            clock_offset_ms=clock_offset_ms,
        )
        scans = open_scans(sensors, kind, settings, **options)
        return list(scans), scans.notes


def true_ranges(scan, pose):
    return ROOM.nearest_in_band(pose, scan.angles_rad + pose[2], 0.06, 0.55)


def plain_in_view(scan, pose, half_deg=22.0):
    """Beams that the camera sees, away from edges."""
    true = true_ranges(scan, pose)
    step = np.maximum(np.abs(true - np.roll(true, 2)), np.abs(true - np.roll(true, -2)))
    ahead = np.abs(wrap_angle(scan.angles_rad - MOUNT_YAW_RAD)) < np.deg2rad(half_deg)
    return ahead & (step < 0.15)


def assert_true(scan, pose, *, atol_m=0.04, half_deg=22.0):
    shown = plain_in_view(scan, pose, half_deg)
    error = scan.ranges_m[shown] - true_ranges(scan, pose)[shown]
    assert shown.sum() > 40
    assert np.isfinite(error).mean() > 0.97
    assert np.nanmax(np.abs(error)) < atol_m


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    return write_boxes(tmp_path_factory.mktemp("still") / "still.mcap")


def low_box_share(scan):
    """Share of the beams towards the low box that meet it."""
    towards = np.abs(scan.angles_rad) < 0.09
    return (np.abs(scan.ranges_m[towards] - 1.6 / np.cos(scan.angles_rad[towards])) < 0.05).mean()


@pytest.mark.parametrize(("kind", "met"), [("lidar", 0.0), ("camera", 1.0), ("merged", 1.0)])
def test_the_low_box_is_where_a_camera_looks(still, kind, met):
    scans, _ = read(still, kind)
    assert len(scans) == 10
    assert [low_box_share(scan) for scan in scans] == [met] * 10


def test_the_scans_are_the_rooms_obstacles(still):
    scans, notes = read(still, "merged")
    for scan in scans:
        assert_true(scan, START_POSE)
    raw, _ = read(still, "lidar")
    beside = np.abs(wrap_angle(raw[0].angles_rad - MOUNT_YAW_RAD)) > np.deg2rad(40.0)
    for scan, before in zip(scans, raw, strict=True):
        assert (scan.stamp_ns, scan.frame_id) == (before.stamp_ns, "laser")
        np.testing.assert_array_equal(scan.ranges_m[beside], before.ranges_m[beside])
    for scan in read(still, "camera")[0]:
        assert scan.frame_id == "laser"
        assert_true(scan, START_POSE)
    assert any("/tf_static" in note for note in notes)
    (said,) = [note for note in notes if "above the floor" in note]
    assert float(said.split(" is ")[1].split(" m ")[0]) == pytest.approx(0.8, abs=0.005)


@pytest.mark.parametrize(
    "T",
    [
        camera_pose(0.8, pitch=0.15, roll=0.05),
        camera_pose(0.8, roll=-np.pi / 2),
        camera_pose(0.8, roll=np.pi),
    ],
    ids=["tilted", "portrait", "upside_down"],
)
def test_however_the_camera_stands(tmp_path, T):
    path = write_boxes(tmp_path / "stands.mcap", T_base_camera=T, duration_s=0.3)
    for kind in ("camera", "merged"):
        for scan in read(path, kind)[0]:
            assert low_box_share(scan) == 1.0
            assert_true(scan, START_POSE, half_deg=15.0)


def test_a_lidar_that_hangs_upside_down(tmp_path):
    path = write_boxes(tmp_path / "hangs.mcap", upside_down=True, duration_s=0.3)
    for kind in ("camera", "merged"):
        for scan in read(path, kind)[0]:
            # Its azimuths run the other way.
            assert_true(
                scan.with_ranges(np.roll(scan.ranges_m[::-1], 1), None), START_POSE, half_deg=20.0
            )


def test_the_floor_corrects_a_tilt_that_tf_has_wrong(tmp_path):
    told = camera_pose(0.83, pitch=np.deg2rad(2.0))
    path = write_boxes(tmp_path / "told.mcap", T_told=told, duration_s=0.3)
    scans, notes = read(path, "merged")
    for scan in scans:
        assert_true(scan, START_POSE)
    assert any("tilts by 2.0 degrees" in note for note in notes)
    # The scans alone forgive 2 degrees.
    with open_recording(path) as recording:
        extrinsics = find_extrinsics(recording, choose_streams(recording), ChainSettings())
        (camera,) = align_to_floor(recording, extrinsics, VirtualScanSettings()).cameras
    R_told, R_true = told[:3, :3], camera_pose(0.8)[:3, :3]
    up_in_camera = camera.T_floor_camera[2, :3]
    assert np.rad2deg(np.arccos(up_in_camera @ R_told[2])) == pytest.approx(2.0, abs=0.1)
    assert np.rad2deg(np.arccos(min(up_in_camera @ R_true[2], 1.0))) < 0.1


def test_what_was_seen_before_is_carried_to_the_scan(tmp_path):
    """At 0.5 rad/s an image 50 ms later shows everything 1.4 degrees further on."""
    path = write_boxes(tmp_path / "turning.mcap", drive=turning, duration_s=1.0, first_image_ms=50)

    def pose_at(stamp_ns):
        return turning(1e-9 * (stamp_ns - START_NS))

    def worst(**options):
        errors = []
        for scan in read(path, "merged", **options)[0]:
            pose = pose_at(scan.stamp_ns)
            shown = plain_in_view(scan, pose, 20.0)
            errors.append(np.nanmax(np.abs(scan.ranges_m - true_ranges(scan, pose))[shown]))
        return max(errors)

    assert worst(prior=pose_at) < 0.05
    # From the scans themselves, whose turn is known to a share of a beam.
    assert worst() < 0.05
    assert worst(prior=lambda stamp_ns: np.zeros(3)) > 1.0


def test_a_late_camera_clock_is_taken_out(tmp_path):
    """The images are of 100 ms before their stamps."""
    path = write_boxes(
        tmp_path / "late.mcap", drive=lambda time_s: turning(max(0.0, time_s - 0.1)), lidar=False
    )
    (scans, notes) = read(path, "camera", clock_offset_ms=100.0)
    assert scans[0].stamp_ns == START_NS - 100 * NS_PER_MS
    assert "Camera stamps taken 100 ms earlier." in notes


def test_each_scan_takes_the_nearest_image(tmp_path):
    path = write_boxes(tmp_path / "slow.mcap", image_ms=400, duration_s=1.2)
    scans, notes = read(path, "merged")
    met = [low_box_share(scan) == 1.0 for scan in scans]
    # Images at 0, 400 and 800 ms serve the scans within 100 ms of them.
    assert met == [at in (0, 1, 3, 4, 5, 7, 8, 9) for at in range(12)]
    assert "4 scans have no image within 100 ms." in notes
    raw, _ = read(path, "lidar")
    np.testing.assert_array_equal(scans[2].ranges_m, raw[2].ranges_m)
    nearer, _ = read(path, "merged", VirtualScanSettings(max_gap_ms=50.0))
    assert sum(low_box_share(scan) == 1.0 for scan in nearer) == 3


def test_every_pass_gives_the_same(still):
    for kind in ("camera", "merged"):
        with open_recording(still) as recording:
            scans = open_scans(
                RecordedSensors(recording=recording, streams=choose_streams(recording)), kind
            )
            first, notes = [scan.ranges_m.tobytes() for scan in scans], scans.notes
            # A pass that is given up half way leaves nothing behind.
            next(iter(scans))
            assert [scan.ranges_m.tobytes() for scan in scans] == first
            assert scans.notes == notes


def test_without_a_lidar_the_scans_are_level_under_the_camera(tmp_path):
    T = camera_pose(0.8, x=0.0, y=0.0, yaw=0.3, pitch=0.35)
    path = write_boxes(tmp_path / "alone.mcap", lidar=False, tf=(), T_base_camera=T, duration_s=0.4)
    scans, notes = read(path, "camera")
    assert any("camera_level" in note for note in notes)
    for scan in scans:
        assert scan.frame_id == "camera_level"
        pose = START_POSE + np.array([0.0, 0.0, 0.3])
        ahead = np.abs(scan.angles_rad) < 0.3
        true = true_ranges(scan, pose)
        step = np.maximum(np.abs(true - np.roll(true, 2)), np.abs(true - np.roll(true, -2)))
        shown = ahead & (step < 0.15)
        assert shown.sum() > 20
        assert np.abs(scan.ranges_m - true)[shown].max() < 0.06
    with pytest.raises(MissingStream, match="LiDAR"):
        read(path, "merged")


def extrinsics_file(folder, text):
    path = folder / "extrinsics.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("form", ["T", "R and t", "table", "json"])
def test_extrinsics_from_a_file(tmp_path, form):
    path = write_boxes(tmp_path / "plain.mcap", tf=(), duration_s=0.3)
    T = T_camera_lidar(camera_pose(0.8))
    text = {
        "T": f"T_camera_lidar = {T.tolist()}",
        "R and t": f"R = {T[:3, :3].tolist()}\nt = {T[:3, 3].tolist()}\nreprojection_px = 0.4",
        "table": f'[cameras."{TOPIC}"]\nT_camera_lidar = {T.tolist()}',
        "json": json.dumps({"T_camera_lidar": T.tolist(), "note": "by hand"}),
    }[form]
    scans, notes = read(path, "merged", file=extrinsics_file(tmp_path, text))
    assert "Extrinsics from extrinsics.toml." in notes
    for scan in scans:
        assert low_box_share(scan) == 1.0
        assert_true(scan, START_POSE)


def test_a_file_places_a_camera_on_its_side(tmp_path):
    T = camera_pose(0.8, roll=-np.pi / 2)
    path = write_boxes(tmp_path / "side.mcap", T_base_camera=T, tf=(), duration_s=0.2)
    file = extrinsics_file(tmp_path, f"T_camera_lidar = {T_camera_lidar(T).tolist()}")
    for scan in read(path, "merged", file=file)[0]:
        assert low_box_share(scan) == 1.0
        assert_true(scan, START_POSE, half_deg=15.0)


def test_a_file_goes_over_tf(tmp_path):
    path = write_boxes(tmp_path / "told.mcap", T_told=camera_pose(0.8, yaw=1.0), duration_s=0.3)
    with pytest.raises(AlignmentFailed, match="The recorded mount is not used"):
        read(path, "merged")
    file = extrinsics_file(
        tmp_path, f"T_camera_lidar = {T_camera_lidar(camera_pose(0.8)).tolist()}"
    )
    assert low_box_share(read(path, "merged", file=file)[0][0]) == 1.0


def test_a_file_needs_its_camera_and_a_lidar(tmp_path):
    T = T_camera_lidar(camera_pose(0.8)).tolist()
    path = write_boxes(tmp_path / "plain.mcap", duration_s=0.2)
    other = extrinsics_file(tmp_path, f'[cameras."/other"]\nT_camera_lidar = {T}')
    with pytest.raises(SettingsError, match=TOPIC):
        read(path, "merged", file=other)
    file = extrinsics_file(tmp_path, f"T_camera_lidar = {T}")
    alone = write_boxes(tmp_path / "alone.mcap", lidar=False, duration_s=0.2)
    with pytest.raises(SettingsError, match="no LiDAR"):
        read(alone, "camera", file=file)


# A camera at 0.8 m that looks upwards sees walls only, and from afar.
UP = camera_pose(0.8, pitch=-0.45)


def test_without_a_floor_the_height_must_be_given(tmp_path):
    path = write_boxes(tmp_path / "up.mcap", T_base_camera=UP, duration_s=0.4)
    with pytest.raises(AlignmentFailed, match="no floor plane") as caught:
        read(path, "camera")
    assert "lidar_height_m" in caught.value.advice
    settings = VirtualScanSettings(lidar_height_m=LIDAR_HEIGHT_M)
    _, notes = read(path, "camera", settings)
    assert "The LiDAR is 0.3 m above the floor, as given." in notes
    path = write_boxes(tmp_path / "footprint.mcap", T_base_camera=UP, base="base_footprint")
    _, notes = read(path, "camera")
    assert any("0.300 m is TF's" in note for note in notes)


def test_a_height_by_hand_is_the_cut(still):
    """Told that the LiDAR is 17 cm lower than it is, the low box ends 3 cm above the floor."""
    scans, _ = read(still, "merged", VirtualScanSettings(lidar_height_m=LIDAR_HEIGHT_M - 0.17))
    assert low_box_share(scans[0]) == 0.0
    scans, _ = read(still, "merged", VirtualScanSettings(lidar_height_m=LIDAR_HEIGHT_M))
    assert low_box_share(scans[0]) == 1.0


def test_a_height_by_hand_does_not_replace_a_mount(tmp_path):
    path = write_boxes(tmp_path / "alone.mcap", lidar=False, tf=(), duration_s=0.2)
    with pytest.raises(AlignmentFailed, match="height is given"):
        read(path, "camera", VirtualScanSettings(lidar_height_m=0.3))


def test_a_mount_that_scans_and_images_do_not_show_is_refused(tmp_path):
    # One plain wall fits at any place.
    path = write_boxes(
        tmp_path / "plain.mcap", room=BoxRoom(size_m=(3.0, 30.0, 2.5)), tf=(), duration_s=1.0
    )
    with pytest.raises(AlignmentFailed) as caught:
        read(path, "merged")
    assert caught.value.file == str(path)


def test_a_mount_from_the_alignment_and_a_height_from_the_floor(scenes):
    path = scenes("furnished_room", duration_s=4.0)
    truth = dict(np.load(path.with_name(f"{path.stem}.truth.npz")))
    T_true = truth["T_lidar_camera"][0]
    with open_recording(path) as recording:
        found = find_extrinsics(recording, choose_streams(recording), ChainSettings())
        level = align_to_floor(recording, found, VirtualScanSettings())
    assert found.source == "alignment"
    P = level.cameras[0].T_floor_camera
    turned = P[:, :3] @ T_true[:3, :3].T
    assert np.rad2deg(np.arccos((np.trace(turned) - 1.0) / 2.0)) < 0.9
    # The floor shows the tilt that the alignment does not.
    assert np.rad2deg(np.arccos(P[2, :3] @ T_true[2, :3])) < 0.2
    np.testing.assert_allclose(P[:2, 3], T_true[:2, 3], atol=0.05)
    # The rig's LiDAR is 0.31 m above the floor.
    assert P[2, 3] == pytest.approx(T_true[2, 3] + 0.31, abs=0.01)
    if not found.is_height_known:
        assert level.lidar_height_m is None
        assert any("the floor in the depth must" in note for note in found.notes)


def test_a_recording_without_depth_is_refused(log):
    for at in (0.0, 100.0):
        log.scan(at)
    with log.open() as recording:
        for kind in ("camera", "merged", "repaired"):
            with pytest.raises(MissingStream, match="no depth"):
                open_scans(
                    RecordedSensors(recording=recording, streams=choose_streams(recording)), kind
                )
