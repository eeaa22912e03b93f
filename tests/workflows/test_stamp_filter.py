"""A clock that jumps costs the messages that it stamps, in every stage that reads them."""

import json

import numpy as np
import pytest

from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.errors import RecordingError
from fusion_core.model.stamps import NO_STAMP
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.rgbd_frames import RgbdFrames
from fusion_core.workflows.recorded_poses import recorded_poses
from fusion_core.workflows.stamp_filter import StampFilter
from scanloom.cli import main
from tests.hostile.drive import (
    COLOR,
    DEPTH,
    ODOMETRY,
    SCAN,
    SCANS,
    START_NS,
    STEP_MS,
    TF,
    pose_of,
    write_drive,
)
from tests.hostile.stamps import backwards, one_ahead

FAST = FuseOptions(figures=False)


def left_out(notes, topic):
    return [note for note in notes if note.startswith(f"{topic}: 1 of {SCANS} ")]


@pytest.mark.parametrize(("number", "years"), [(2, 1), (19, 1), (0, -1)])
def test_one_scan_a_year_off_costs_itself(tmp_path, number, years):
    ahead_ns = years * 365 * 24 * 3600 * 1000 * NS_PER_MS
    path = one_ahead(tmp_path / "drive.mcap", number=number, ahead_ns=ahead_ns, camera=False)
    report = build_map(path, tmp_path / "map", MapOptions(slam="none")).report
    assert report["scans"] == 19
    assert report["scans_recorded"] == 20
    assert report["trusted_share"] == pytest.approx(0.95)
    assert report["duration_s"] < 2.0
    assert left_out(report["notes"], SCAN)


def test_scans_backwards_fail_and_leave_their_results(tmp_path, capsys):
    path = backwards(tmp_path / "drive.mcap", camera=False)
    out = tmp_path / "map"
    assert main(["map", str(path), "-o", str(out), "--json"]) == 1
    assert "19 of 20 scans are left out of the map" in json.loads(capsys.readouterr().out)["error"]
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["trusted_share"] == pytest.approx(0.05)
    assert any("19 of 20 messages are left out" in note for note in report["notes"])


@pytest.mark.parametrize(("topic", "paired"), [(SCAN, 19), (DEPTH, 19), (ODOMETRY, 20)])
def test_fuse_loses_what_is_stamped_wrong_and_says_so(tmp_path, topic, paired):
    summary = fuse(one_ahead(tmp_path / "drive.mcap", topic=topic), tmp_path / "out", FAST)
    assert summary.paired == paired
    assert len(left_out(summary.notes, topic)) == 1


@pytest.mark.parametrize("topic", [SCAN, DEPTH])
def test_fuse_refuses_a_clock_that_runs_backwards(tmp_path, topic):
    path = backwards(tmp_path / "drive.mcap", topic=topic)
    with pytest.raises(RecordingError, match=f"19 of 20 messages of {topic} are stamped out of"):
        fuse(path, tmp_path / "out", FAST)


@pytest.mark.parametrize("tf", [False, True])
def test_a_pose_a_year_ahead_is_none(tmp_path, tf):
    """Without it the recording says of its time what its neighbours do, and of later times
    nothing."""
    topic = TF if tf else ODOMETRY
    path = one_ahead(tmp_path / "drive.mcap", topic=topic, number=7, tf=tf, camera=False)
    with open_recording(path) as recording:
        poses = recorded_poses(recording, choose_streams(recording), "laser")
        assert len(left_out(recording.warnings, topic)) == 1
    at_ns = START_NS + 7 * STEP_MS * NS_PER_MS
    np.testing.assert_allclose(poses.at(at_ns), pose_of(7), atol=1e-6)
    assert poses.at(START_NS + SCANS * STEP_MS * NS_PER_MS) is None


def test_stamps_are_read_from_the_headers_alone_and_good_ones_cost_no_warning(tmp_path):
    path = write_drive(tmp_path / "drive.mcap", camera=False)
    with open_recording(path) as recording:
        stamps_ns = recording.stamps_ns(ODOMETRY)
        assert stamps_ns.tolist() == recording.received_ns(ODOMETRY).tolist()
        # A batch of transforms has as many stamps as transforms.
        assert recording.stamps_ns("/tf_static").tolist() == [NO_STAMP]
        StampFilter(recording, strictly=False).require_most_in_order(ODOMETRY)
        assert recording.warnings == []


@pytest.mark.parametrize("topic", [DEPTH, COLOR])
def test_visual_odometry_goes_on_behind_an_image_of_another_year(tmp_path, topic):
    path = one_ahead(tmp_path / "drive.mcap", topic=topic, color=True)
    with open_recording(path) as recording:
        frames = RgbdFrames(recording, choose_streams(recording))
        steps = [(frame.stamp_ns - START_NS) // (STEP_MS * NS_PER_MS) for frame in frames]
    assert steps == [0, 1, *range(3, SCANS)]
