"""Pairs of scan and image against a search over all scans, on logs out of step."""

from collections import deque

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fusion_core.alignment.curves import SamplingSettings
from fusion_core.alignment.time import TimeSettings
from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.errors import MissingStream
from fusion_core.model.sensors import LaserScan
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.fuse import pairing
from fusion_core.workflows.fuse.camera_rig import build_camera_rig
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.pairing import PairedImage, paired_images
from fusion_core.workflows.fuse.session import FuseOptions, make_geometry_filter, open_session
from fusion_core.workflows.fuse.settings import PRESETS


def entries(log, *, max_gap_ms=60.0, clock_offset_ms=0.0, pair_by="nearest"):
    with log.open() as recording:
        streams = choose_streams(recording)
        rig = build_camera_rig(recording, streams, SamplingSettings())
        wanted = TimeSettings(max_gap_ms=max_gap_ms, pair_by=pair_by)
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


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    scan_period_ms=st.integers(20, 160),
    image_period_ms=st.integers(30, 150),
    phase_ms=st.integers(-400, 400),
    lost=st.sets(st.integers(1, 17), max_size=4),
)
def test_by_rates_the_paper_counts(new_log, scan_period_ms, image_period_ms, phase_ms, lost):
    """t = f(i) / g(j): scan j of image i by the ratio of the rates, whatever the stamps are."""
    log = new_log()
    log.info()
    scan_ms = [1000.0 + k * scan_period_ms for k in range(20) if k not in lost]
    image_ms = [1000.0 + phase_ms + k * image_period_ms for k in range(12)]
    for at_ms in scan_ms:
        log.scan(at_ms)
    for at_ms in image_ms:
        log.image(at_ms)
    # By the log: messages but one over the time from the first to the last.
    scans_per_ms = (len(scan_ms) - 1) / (scan_ms[-1] - scan_ms[0])
    found, _ = entries(log, pair_by="rates", max_gap_ms=1e-3)
    assert len(found) == len(scan_ms) + len(image_ms)
    for index, entry in enumerate(images_of(found)):
        counted = index * image_period_ms * scans_per_ms
        if abs(counted % 1.0 - 0.5) < 1e-6:
            continue
        number = round(counted)
        around = [None, *[log.start_ns + round(at * NS_PER_MS) for at in scan_ms], None]
        if number >= len(scan_ms):
            assert entry.window is None
        else:
            assert stamps_of(entry.window) == tuple(around[number : number + 3])
            assert entry.gap_ns == entry.image.stamp_ns - around[number + 1]


def test_rates_and_stamps_pair_alike_where_the_rates_are_constant(log):
    log.info()
    for index in range(40):
        log.scan(100.0 * index)
    for index in range(118):
        log.image(33.0 * index)
    nearest, counted = (
        images_of(entries(log, pair_by=pair_by)[0]) for pair_by in ("nearest", "rates")
    )
    for one, other in zip(nearest, counted, strict=True):
        assert stamps_of(one.window) == stamps_of(other.window)


def test_a_random_frame_is_paired_by_rates_as_a_pass_pairs_it(log):
    log.info()
    for index in range(30):
        log.scan(100.0 * index if index < 11 else 100.0 * index + 450.0)
    for index in range(50):
        log.image(60.0 * index + 130.0)
    chain = PRESETS["default"].model_copy(update={"time": TimeSettings(pair_by="rates")})
    with log.open() as recording:
        session = open_session(recording, FuseOptions(), chain)
        passed = [entry for entry in session.pairs() if isinstance(entry, PairedImage)]
        reader = FrameReader(session)
        assert len(reader) == len(passed) == 50
        for number, entry in enumerate(passed):
            own = reader.pair(number)
            assert stamps_of(own.window) == stamps_of(entry.window)
            assert own.gap_ns == entry.gap_ns


def test_a_single_scan_has_no_rate(log):
    log.info()
    log.scan(0.0)
    for index in range(4):
        log.image(30.0 * index)
    with pytest.raises(MissingStream, match="has no rate") as raised:
        entries(log, pair_by="rates")
    assert "time.pair_by" in raised.value.advice


def test_by_rates_scans_come_before_the_images_that_have_them(log):
    """Of a LiDAR that starts late, which is far behind in the log."""
    log.info()
    for index in range(60):
        log.scan(4000.0 + 100.0 * index)
        log.image(100.0 * index)
    seen = []
    for entry in entries(log, pair_by="rates")[0]:
        if isinstance(entry, LaserScan):
            seen.append(entry)
        else:
            assert entry.gap_ns == -4000 * NS_PER_MS
            assert any(entry.window.scan is scan for scan in seen[-pairing.SCANS_KEPT :])
    assert len(seen) == 60


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
