"""Scans of every kind, as motion and SLAM read them."""

from typing import get_args

import numpy as np
import pytest

from fusion_core.model.classes import NoiseClass
from fusion_core.model.errors import MissingStream
from fusion_core.model.sensors import LaserScan
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.map.recorded_sensors import RecordedSensors
from fusion_core.workflows.map.scan_source import LidarScans, ScanKind, open_scans
from tests.workflows.box_recording import write_boxes


def scans_of(path, topic):
    with open_recording(path) as recording:
        return [m.value for m in recording.messages([topic]) if isinstance(m.value, LaserScan)]


@pytest.mark.parametrize("kind", sorted({*get_args(ScanKind)} - {"repaired"}))
def test_stamps_increase_and_every_pass_is_the_same(bedroom, kind):
    with open_recording(bedroom.recording) as recording:
        scans = open_scans(
            RecordedSensors(recording=recording, streams=choose_streams(recording)), kind
        )
        first = [(scan.stamp_ns, scan.ranges_m.tobytes()) for scan in scans]
        stamps = [stamp for stamp, _ in first]
        assert (np.diff(stamps) > 0).all()
        images = kind == "camera"
        assert len(stamps) == (45 if images else 30)
        assert {scan.frame_id for scan in scans} == {scans.frame_id} == {"laser"}
        assert [(scan.stamp_ns, scan.ranges_m.tobytes()) for scan in scans] == first


def test_repaired_scans_are_those_that_fuse_writes(bedroom):
    fused = scans_of(bedroom.folder / "fused.mcap", "/scan")
    raw = scans_of(bedroom.recording, "/scan")
    with open_recording(bedroom.recording) as recording:
        scans = open_scans(
            RecordedSensors(recording=recording, streams=choose_streams(recording)), "repaired"
        )
        assert scans.frame_id == "laser"
        repaired = list(scans)
        again = [scan.ranges_m.tobytes() for scan in scans]
    assert [scan.ranges_m.tobytes() for scan in repaired] == again
    changed = 0
    for scan, written, before in zip(repaired, fused, raw, strict=True):
        assert scan.stamp_ns == written.stamp_ns
        assert scan.intensities is None
        same = written.ranges_m.astype(np.float32) == before.ranges_m.astype(np.float32)
        left = (written.intensities == NoiseClass.BURR) & same
        expected = np.where(left, np.nan, written.ranges_m)
        np.testing.assert_allclose(scan.ranges_m, expected, rtol=1e-6)
        changed += int((~same & np.isfinite(written.ranges_m)).sum())
    assert changed > 100


def test_scans_without_an_image_are_repaired_by_nothing(tmp_path):
    path = write_boxes(tmp_path / "late.mcap", first_image_ms=500)
    with open_recording(path) as recording:
        scans = open_scans(
            RecordedSensors(recording=recording, streams=choose_streams(recording)), "repaired"
        )
        found = list(scans)
        assert "5 of 10 scans have no image and stay as they were." in scans.notes
    for scan, before in zip(found[:4], scans_of(path, "/scan"), strict=False):
        np.testing.assert_array_equal(scan.ranges_m, before.ranges_m)


def test_scans_out_of_order_are_left_out_and_counted(log):
    for at in (0.0, 100.0, 300.0, 200.0):
        log.scan(at, late_ms=250.0 if at == 200.0 else 0.0, mark=1.0 + at / 100.0)
    with log.open() as recording:
        scans = LidarScans(recording, choose_streams(recording))
        assert [scan.ranges_m[0] for scan in scans] == [1.0, 2.0, 4.0]
        assert list(scans)[2].ranges_m[0] == 4.0
        assert scans.recorded_count == 4
        left_out = [line for line in recording.warnings if "out of order" in line]
        assert left_out == [
            "/scan: 1 of 4 messages are left out, as they are stamped out of order; "
            "the first: 3, at 1700000000.200 s"
        ]


@pytest.mark.parametrize("kind", ["lidar", "merged", "repaired"])
def test_what_needs_a_lidar_says_so(tmp_path, kind):
    path = write_boxes(tmp_path / "alone.mcap", lidar=False, duration_s=0.2)
    with (
        open_recording(path) as recording,
        pytest.raises(MissingStream, match=r"LiDAR|LaserScan"),
    ):
        open_scans(RecordedSensors(recording=recording, streams=choose_streams(recording)), kind)
