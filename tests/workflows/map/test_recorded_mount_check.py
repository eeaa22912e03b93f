"""A mount in /tf_static that explains nothing is not used, and every command says so."""

import numpy as np
import pytest

from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.camera_rig import build_camera_rig
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import (
    FuseOptions,
    session_of,
)
from fusion_core.workflows.fuse.settings import ChainSettings
from fusion_core.workflows.map.extrinsics import find_extrinsics
from fusion_core.workflows.map.recorded_mount_check import recorded_mount_problem
from fusion_core.workflows.map.rgbd_frames import first_camera_extrinsics
from scanloom.panels.mount_text import mount_text
from tests.hostile.drive import write_drive
from tests.hostile.mounts import moved_mount
from tests.mapping.box_room import camera_pose
from tests.workflows.box_recording import write_boxes

NOT_USED = "The recorded mount is not used: "
FAR = "it puts the camera 1e+06 m from the LiDAR, which sees no farther than "


def test_fuse_does_not_claim_a_mount_that_explains_nothing(tmp_path):
    path = moved_mount(tmp_path / "far.mcap", forward_m=1e6)
    summary = fuse(path, tmp_path / "out", FuseOptions(figures=False, maps=False))
    document = summary.document
    assert not document["recorded_mount_used"]
    assert abs(document["mount_used"]["forward_m"]) < 0.2
    assert document["agreement"] > 0.9
    for notes in (summary.notes, document["notes"]):
        assert len([note for note in notes if note.startswith(NOT_USED + FAR)]) == 1


def test_a_mount_that_is_dropped_for_its_yaw_is_named(tmp_path):
    path = moved_mount(tmp_path / "turned.mcap", yaw_error_rad=0.7)
    summary = fuse(path, tmp_path / "out", FuseOptions(figures=False, maps=False))
    assert any(
        note.startswith(NOT_USED) and "past where scans and images fit best" in note
        for note in summary.notes
    )


def test_a_camera_that_looks_over_the_lidar_keeps_its_mount_but_no_uncertainty(tmp_path):
    """Walls are the same at any height: that another mount agrees better proves nothing."""
    path = write_boxes(tmp_path / "up.mcap", T_base_camera=camera_pose(0.8, pitch=-0.45))
    with open_recording(path) as recording:
        streams, settings = choose_streams(recording), ChainSettings()
        rig = build_camera_rig(recording, streams, settings.sampling)
        alignment = align_recording(session_of(recording, streams, rig, settings))
    assert alignment.estimate.is_from_recorded
    np.testing.assert_allclose(alignment.mount.vector(), rig.recorded_mount.vector(), atol=0.01)
    assert alignment.mount.sd == (None,) * 6
    (note,) = alignment.notes
    assert note.startswith("The recorded mount is used, but scans and images do not confirm it: 0%")


def test_a_camera_recorded_as_looking_up_is_named(tmp_path):
    with open_recording(
        moved_mount(tmp_path / "up.mcap", pitch_error_rad=0.5 * np.pi)
    ) as recording:
        rig = build_camera_rig(recording, choose_streams(recording), ChainSettings().sampling)
    assert rig.recorded_mount is None
    assert any(note.startswith(NOT_USED) for note in rig.notes)


@pytest.mark.parametrize("moved", [{"forward_m": 1e6}, {"up_m": 1e6}, {"left_m": 2.0}])
def test_map_and_visual_odometry_check_it_too(tmp_path, moved):
    with open_recording(moved_mount(tmp_path / "far.mcap", **moved)) as recording:
        streams = choose_streams(recording)
        found = find_extrinsics(recording, streams, ChainSettings())
        assert found.source == "alignment"
        assert any(note.startswith(NOT_USED) for note in found.notes)
        T, notes = first_camera_extrinsics(recording, streams, None)
        assert T is None
        assert notes[0].startswith(NOT_USED)


def test_a_mount_that_is_right_is_used_without_a_word(tmp_path):
    with open_recording(write_drive(tmp_path / "right.mcap")) as recording:
        streams, settings = choose_streams(recording), ChainSettings()
        found = find_extrinsics(recording, streams, settings)
        assert found.source == "tf"
        assert not any(NOT_USED in note for note in found.notes)
        rig = build_camera_rig(recording, streams, settings.sampling)
        assert recorded_mount_problem(session_of(recording, streams, rig, settings)) == ""
        assert mount_text(rig.recorded_mount, ["said"]).endswith("- said")
