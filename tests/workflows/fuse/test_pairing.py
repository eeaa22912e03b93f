"""Pairs of scan and image against a search over all scans, on logs out of step."""

from collections import deque

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fusion_core.alignment.curves import SamplingSettings
from fusion_core.alignment.time import TimeSettings
from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.sensors import LaserScan
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.fuse import pairing
from fusion_core.workflows.fuse.camera_rig import build_camera_rig
from fusion_core.workflows.fuse.pairing import PairedImage, paired_images
from fusion_core.workflows.fuse.session import make_geometry_filter


def entries(log, *, max_gap_ms=60.0, clock_offset_ms=0.0):
    with log.open() as recording:
        streams = choose_streams(recording)
        rig = build_camera_rig(recording, streams, SamplingSettings())
        wanted = TimeSettings(max_gap_ms=max_gap_ms)
        found = list(
            paired_images(
                recording,
                streams,
                rig,
                make_geometry_filter(recording, rig),
                wanted,
                clock_offset_ms=clock_offset_ms,
            )
        )
        return found, [camera.topic for camera in rig.cameras]


def images_of(found):
    return [entry for entry in found if isinstance(entry, PairedImage)]


def expected(scan_ns, image_ns, *, max_gap_ms, clock_offset_ms=0.0):
    """Stamps (before, nearest, after) of an image's window, None each where there is none."""
    scan_ns = sorted(scan_ns)
    gaps = [abs(image_ns - round(clock_offset_ms * NS_PER_MS) - stamp) for stamp in scan_ns]
    nearest = gaps.index(min(gaps))
    if gaps[nearest] > round(max_gap_ms * NS_PER_MS):
        return None
    around = [None, *scan_ns, None]
    return tuple(around[nearest : nearest + 3])


def stamps_of(window):
    if window is None:
        return None
    return tuple(
        None if scan is None else scan.stamp_ns
        for scan in (window.before, window.scan, window.after)
    )


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    scan_period_ms=st.floats(25.0, 200.0),
    image_period_ms=st.floats(30.0, 150.0),
    phase_ms=st.floats(-300.0, 300.0),
    scan_late_ms=st.floats(0.0, 400.0),
    image_late_ms=st.floats(0.0, 400.0),
    max_gap_ms=st.floats(1.0, 150.0),
    clock_offset_ms=st.floats(-200.0, 200.0),
)
def test_each_image_gets_the_nearest_of_all_scans(
    new_log,
    scan_period_ms,
    image_period_ms,
    phase_ms,
    scan_late_ms,
    image_late_ms,
    max_gap_ms,
    clock_offset_ms,
):
    log = new_log()
    log.info()
    for index in range(12):
        log.scan(1000.0 + index * scan_period_ms, late_ms=scan_late_ms)
    for index in range(16):
        log.image(1000.0 + phase_ms + index * image_period_ms, late_ms=image_late_ms)
    found, _ = entries(log, max_gap_ms=max_gap_ms, clock_offset_ms=clock_offset_ms)
    scan_ns = [entry.stamp_ns for entry in found if isinstance(entry, LaserScan)]
    images = images_of(found)
    assert len(scan_ns) == 12
    assert len(images) == 16
    for entry in images:
        window = expected(
            scan_ns,
            entry.image.stamp_ns,
            max_gap_ms=max_gap_ms,
            clock_offset_ms=clock_offset_ms,
        )
        assert stamps_of(entry.window) == window
        if window is not None:
            offset_ns = round(clock_offset_ms * NS_PER_MS)
            assert entry.gap_ns == entry.image.stamp_ns - offset_ns - window[1]


def test_scans_and_images_come_once_and_in_their_own_order(log):
    log.info()
    for index in range(30):
        log.scan(100.0 * index)
        log.image(100.0 * index + 30.0, late_ms=250.0)
    found, _ = entries(log)
    scans = [entry.stamp_ns for entry in found if isinstance(entry, LaserScan)]
    images = [entry.image.stamp_ns for entry in images_of(found)]
    assert scans == [log.start_ns + 100 * NS_PER_MS * index for index in range(30)]
    assert images == [stamp + 30 * NS_PER_MS for stamp in scans]


def test_an_image_comes_after_the_scans_around_it(log):
    """Whoever consumes the stream has seen every scan of a window before the window."""
    log.info()
    for index in range(10):
        log.scan(100.0 * index, late_ms=350.0)
        log.image(100.0 * index + 60.0)
    seen = []
    for entry in entries(log)[0]:
        if isinstance(entry, LaserScan):
            seen.append(entry)
        elif entry.window is not None:
            parts = (entry.window.before, entry.window.scan, entry.window.after)
            assert all(any(part is scan for scan in seen) for part in parts if part is not None)


@pytest.mark.parametrize("image_ms", [-200.0, 930.0, 5000.0])
def test_an_image_far_from_every_scan_has_no_window(log, image_ms):
    log.info()
    for index in range(10):
        log.scan(1000.0 + 100.0 * index)
    log.image(image_ms)
    (entry,) = images_of(entries(log)[0])
    assert entry.window is None


@pytest.mark.parametrize(("image_ms", "scan_ms"), [(945.0, 1000.0), (1955.0, 1900.0)])
def test_an_image_a_little_outside_of_the_scans_gets_the_end_one(log, image_ms, scan_ms):
    log.info()
    for index in range(10):
        log.scan(1000.0 + 100.0 * index)
    log.image(image_ms)
    (entry,) = images_of(entries(log)[0])
    assert entry.window.scan.stamp_ns == log.start_ns + round(scan_ms * NS_PER_MS)
    assert entry.gap_ns == round((image_ms - scan_ms) * NS_PER_MS)
    assert (entry.window.before is None) == (image_ms < scan_ms)
    assert (entry.window.after is None) == (image_ms > scan_ms)


def test_a_lidar_that_pauses_leaves_images_unpaired_and_is_found_again(log):
    log.info()
    scan_ms = [*np.arange(0.0, 1000.0, 100.0), *np.arange(6000.0, 7000.0, 100.0)]
    for at_ms in scan_ms:
        log.scan(at_ms)
    for at_ms in np.arange(0.0, 7000.0, 33.0):
        log.image(at_ms)
    for entry in images_of(entries(log)[0]):
        at_ms = (entry.image.stamp_ns - log.start_ns) / NS_PER_MS
        nearest = min(scan_ms, key=lambda scan: abs(scan - at_ms))
        if abs(nearest - at_ms) > 60.0:
            assert entry.window is None
        else:
            assert entry.window.scan.stamp_ns == log.start_ns + round(nearest * NS_PER_MS)


def test_two_cameras_are_distinguished(log, pose_of):
    for name, y in (("left", 0.1), ("right", -0.1)):
        log.info(name)
        log.transform("base", f"{name}_optical", pose_of(y=y, optical=True))
    for index in range(10):
        log.scan(100.0 * index)
        log.image(100.0 * index + 10.0, name="left")
        log.image(100.0 * index - 10.0, name="right", late_ms=40.0)
    found, topics = entries(log)
    gaps = {topic: set() for topic in topics}
    for entry in images_of(found):
        gaps[topics[entry.camera]].add(entry.gap_ns)
    assert gaps == {
        "/left/depth/image_raw": {10 * NS_PER_MS},
        "/right/depth/image_raw": {-10 * NS_PER_MS},
    }


def test_what_waits_is_bounded_whatever_the_log_does(log, monkeypatch):
    longest = {}

    class Watched(deque):
        def append(self, entry):
            super().append(entry)
            kind = type(entry).__name__
            longest[kind] = max(longest.get(kind, 0), len(self))

    monkeypatch.setattr(pairing, "deque", Watched)
    log.info()
    for index in range(300):
        log.scan(20.0 * index)
    for index in range(200):
        log.image(7000.0 + 10.0 * index)
    assert len(images_of(entries(log)[0])) == 200
    assert longest == {"LaserScan": 64, "tuple": 33}
