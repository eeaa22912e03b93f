"""Messages of another rig than the rest are left out, and named."""

import numpy as np
import pytest

from fusion_core.alignment.curves import SamplingSettings
from fusion_core.alignment.time import TimeSettings
from fusion_core.model.errors import MissingStream
from fusion_core.model.sensors import LaserScan
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.fuse.camera_rig import build_camera_rig
from fusion_core.workflows.fuse.pairing import PairedImage, paired_images
from fusion_core.workflows.fuse.session import make_geometry_filter
from fusion_core.workflows.sensor_geometry import ScanGeometry, most_common_geometry


def run(log):
    with log.open() as recording:
        streams = choose_streams(recording)
        rig = build_camera_rig(recording, streams, SamplingSettings())
        fitting = make_geometry_filter(recording, rig)
        passes = [
            list(paired_images(recording, streams, rig, fitting, TimeSettings())) for _ in range(2)
        ]
        return passes, recording.warnings


def test_what_fits_passes_and_what_does_not_is_named_once(log):
    log.info()
    for number in range(20):
        log.scan(100.0 * number, beams=7 if number in (0, 5, 6) else 9)
        log.image(100.0 * number, shape=(6, 8) if number == 11 else (12, 16))
    passes, warnings = run(log)
    for found in passes:
        scans = [entry for entry in found if isinstance(entry, LaserScan)]
        images = [entry for entry in found if isinstance(entry, PairedImage)]
        assert [scan.ranges_m.size for scan in scans] == [9] * 17
        assert [image.image.depth_m.shape for image in images] == [(12, 16)] * 19
    about_scans, about_images = sorted(warnings, key=lambda line: "depth" in line)
    assert "3 of 20 messages are left out" in about_scans
    assert "7 beams" in about_scans
    assert "not 9 beams" in about_scans
    assert "1 of 20 messages are left out" in about_images
    assert "8 x 6 pixels, not 16 x 12" in about_images


def test_the_usual_geometry_is_that_of_most_scans(log):
    for number, beams in enumerate([7, 9, 9, 7, 9]):
        log.scan(100.0 * number, beams=beams)
    with log.open() as recording:
        assert most_common_geometry(recording, "/scan") == ScanGeometry(
            beams=9, angle_min_rad=-1.0, angle_increment_rad=0.25
        )


@pytest.mark.parametrize(
    ("first_rad", "step_rad", "same"),
    [
        (0.0, 0.0, True),
        (0.02, 0.0, True),
        (0.03, 0.0, False),
        (0.0, 0.002, True),
        (0.0, 0.003, False),
    ],
)
def test_rounded_angles_are_the_same_geometry(first_rad, step_rad, same):
    geometry = ScanGeometry(beams=9, angle_min_rad=-1.0, angle_increment_rad=0.25)
    scan = LaserScan(
        stamp_ns=0,
        received_ns=0,
        frame_id="laser",
        angle_min_rad=-1.0 + first_rad,
        angle_increment_rad=0.25 + step_rad,
        range_min_m=0.1,
        range_max_m=10.0,
        ranges_m=np.full(9, 2.0),
    )
    assert geometry.matches(scan) is same


def test_a_recording_whose_scans_cannot_be_read_has_no_lidar_to_fuse(log, monkeypatch):
    log.scan(0.0)
    log.image(0.0)
    recording = log.open()
    streams = choose_streams(recording)
    readable = recording.messages
    monkeypatch.setattr(
        recording, "messages", lambda topics: iter(()) if "/scan" in topics else readable(topics)
    )
    with pytest.raises(MissingStream, match="/scan holds no scan that can be read"):
        build_camera_rig(recording, streams, SamplingSettings())
