"""Gaps in time follow from the stamps alone, and are those by which frames are paired."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fusion_core.alignment.time import TimeSettings
from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.pairing_gaps import PairingStamps
from fusion_core.workflows.fuse.session import (
    FuseOptions,
    open_session,
)
from fusion_core.workflows.fuse.settings import PRESETS

START_NS = 1_700_000_000_000_000_000


def session_of(log, *, max_gap_ms=60.0, pair_by="nearest"):
    chosen = TimeSettings(max_gap_ms=max_gap_ms, pair_by=pair_by)
    chain = PRESETS["default"].model_copy(update={"time": chosen})
    return open_session(log.open(), FuseOptions(), chain)


def noted(entries):
    stamps = PairingStamps()
    passed = list(stamps.observe(entries))
    assert stamps.is_complete
    return stamps, passed


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    scan_period_ms=st.floats(25.0, 200.0),
    image_period_ms=st.floats(30.0, 150.0),
    phase_ms=st.floats(-300.0, 300.0),
    max_gap_ms=st.floats(1.0, 150.0),
    clock_offset_ms=st.floats(-200.0, 200.0),
)
def test_the_gaps_are_those_of_each_frame(
    new_log, scan_period_ms, image_period_ms, phase_ms, max_gap_ms, clock_offset_ms
):
    log = new_log()
    log.info()
    for index in range(12):
        log.scan(1000.0 + index * scan_period_ms)
    for index in range(12):
        log.image(1000.0 + phase_ms + index * image_period_ms, late_ms=30.0)
    session = session_of(log, max_gap_ms=max_gap_ms)
    with session.recording:
        stamps, _ = noted(session.pairs())
        # The pass took no offset out: what it noted serves any.
        gaps = stamps.gaps(clock_offset_ms, TimeSettings(max_gap_ms=max_gap_ms))
        frames = FrameReader(session)
        assert gaps.time_ns.tolist() == frames.times_ns.tolist()
        for number in range(len(frames)):
            paired = frames.pair(number, clock_offset_ms)
            assert gaps.is_paired[number] == (paired.window is not None)
            if paired.window is not None:
                assert gaps.gap_ms[number] * NS_PER_MS == pytest.approx(paired.gap_ns, abs=0.5)


def test_a_frame_without_a_scan_near_enough_still_has_its_gap(log):
    log.info()
    for index in range(3):
        log.scan(100.0 * index)
    log.image(250.0)
    log.image(900.0)
    stamps, _ = noted(session_of(log).pairs())
    gaps = stamps.gaps(0.0, TimeSettings())
    assert gaps.gap_ms.tolist() == [50.0, 700.0]
    assert gaps.is_paired.tolist() == [True, False]
    assert gaps.scan_period_ms == 100.0


@pytest.mark.parametrize("scans", [0, 1])
def test_no_scan_and_one_scan(scans):
    scan = LaserScan(
        stamp_ns=START_NS,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=0.0,
        angle_increment_rad=0.1,
        range_min_m=0.1,
        range_max_m=9.0,
        ranges_m=np.ones(3),
    )
    image = DepthImage(
        stamp_ns=START_NS + NS_PER_MS,
        received_ns=None,
        frame_id="camera",
        depth_m=np.ones((2, 2), dtype=np.float32),
    )
    entry = PairedImage(camera=0, image=image, window=None, gap_ns=0)
    stamps, passed = noted([*[scan] * scans, entry])
    assert passed[-1] is entry
    gaps = stamps.gaps(0.0, TimeSettings())
    assert gaps.time_ns.tolist() == [image.stamp_ns]
    assert gaps.is_paired.tolist() == [scans == 1]
    assert np.isnan(gaps.gap_ms[0]) == (scans == 0)
    assert np.isnan(gaps.scan_period_ms)


def test_a_pass_that_was_broken_off_is_not_complete(log):
    log.info()
    for index in range(4):
        log.scan(100.0 * index)
        log.image(100.0 * index)
    stamps = PairingStamps()
    next(stamps.observe(session_of(log).pairs()))
    assert not stamps.is_complete


def test_the_alignment_notes_what_it_passes(scenes):
    with open_recording(scenes("bedroom", duration_s=1.0)) as recording:
        session = open_session(recording, FuseOptions(), PRESETS["default"])
        stamps = PairingStamps()
        align_recording(session, stamps=stamps)
        assert stamps.is_complete
        assert stamps.gaps(0.0, TimeSettings()).gap_ms.size == session.image_count


def test_by_rates_the_gaps_are_to_the_scans_that_are_counted(log):
    log.info()
    for index in range(12):
        log.scan(100.0 * index)
    for index in range(14):
        log.image(700.0 + 100.0 * index)
    session = session_of(log, pair_by="rates")
    with session.recording:
        stamps, _ = noted(session.pairs())
        gaps = stamps.gaps(20.0, session.settings.time)
    assert gaps.is_paired.tolist() == [True] * 12 + [False] * 2
    np.testing.assert_allclose(gaps.gap_ms[:12], 680.0)
    assert np.isnan(gaps.gap_ms[12:]).all()
