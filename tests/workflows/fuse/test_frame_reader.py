"""Single frames of recordings in which not every message can be read or fits."""

import numpy as np
import pytest

from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.errors import RecordingError
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS


def reader_of(log):
    session = open_session(log.open(), FuseOptions(), PRESETS["default"])
    return session, FrameReader(session)


@pytest.fixture
def filled(log):
    """Ten scans and ten images, alternating; image 4 is of another size, scan 6 of other beams."""
    log.info()
    for index in range(10):
        log.scan(100.0 * index, beams=5 if index == 6 else 9)
        shape = (6, 8) if index == 4 else (log.lens.height, log.lens.width)
        log.image(100.0 * index + 20.0, shape=shape)
    return log


def unreadable(monkeypatch, session, topic, index):
    """Let one message fail to be read."""
    recording = session.recording
    read = recording.read

    def fail(name, number):
        if (name, number) == (topic, index):
            raise RecordingError(f"{topic}: message {index} is damaged.")
        return read(name, number)

    monkeypatch.setattr(recording, "read", fail)


def test_the_frames_are_those_of_a_pass(filled):
    session, frames = reader_of(filled)
    passed = [entry for entry in session.pairs() if isinstance(entry, PairedImage)]
    numbers = [number for number in range(10) if number != 4]
    assert len(frames) == 10
    for number, entry in zip(numbers, passed, strict=True):
        paired = frames.pair(number)
        assert paired.gap_ns == entry.gap_ns
        assert np.array_equal(paired.image.depth_m, entry.image.depth_m)
        assert (paired.window is None) == (entry.window is None)
        if entry.window is not None:
            assert paired.window.scan.stamp_ns == entry.window.scan.stamp_ns


def test_an_image_of_another_size_says_so_and_the_next_has_none_before_it(filled):
    _, frames = reader_of(filled)
    with pytest.raises(RecordingError, match="image 4 has 8 x 6 pixels, not 16 x 12") as refused:
        frames.pair(4)
    assert "another frame" in refused.value.advice
    assert frames.previous(5) is None
    assert frames.previous(4) is not None
    assert frames.pair(5).window is not None


def test_a_damaged_image_leaves_the_next_one_whole(filled, monkeypatch):
    session, frames = reader_of(filled)
    unreadable(monkeypatch, session, "/camera/depth/image_raw", 7)
    with pytest.raises(RecordingError, match="message 7 is damaged"):
        frames.pair(7)
    assert frames.previous(8) is None
    assert frames.pair(8).window is not None


def test_for_a_damaged_scan_the_next_nearest_is_taken(filled, monkeypatch):
    session, frames = reader_of(filled)
    assert frames.pair(2).gap_ns == 20 * NS_PER_MS
    session, frames = reader_of(filled)
    unreadable(monkeypatch, session, "/scan", 2)
    assert frames.pair(2).window is None
    # With another clock the scan after it is near enough.
    assert frames.pair(2, clock_offset_ms=-40.0).gap_ns == -40 * NS_PER_MS


@pytest.mark.parametrize("late_ms", [0.0, 400.0])
def test_a_raw_frame_has_the_image_and_scan_of_the_aligned_one(log, late_ms):
    log.info()
    for index in range(12):
        log.scan(100.0 * index, late_ms=late_ms)
        log.image(100.0 * index + 20.0)
    _, frames = reader_of(log)
    raw = [frames.raw_pair(number) for number in range(len(frames))]
    for number, own in enumerate(raw):
        paired = frames.pair(number)
        assert own.image.stamp_ns == paired.image.stamp_ns
        assert own.gap_ns == paired.gap_ns
        assert np.array_equal(own.image.depth_m, paired.image.depth_m)
        assert own.window is not None
        assert paired.window is not None
        assert own.window.scan.stamp_ns == paired.window.scan.stamp_ns


def test_a_raw_frame_takes_no_scan_whose_clock_has_jumped(log):
    log.info()
    for index in range(12):
        # Scan 4 has the stamp of the image after scan 6.
        log.scan(620.0 if index == 4 else 100.0 * index, late_ms=-220.0 if index == 4 else 0.0)
        log.image(100.0 * index + 20.0)
    _, frames = reader_of(log)
    for number in range(len(frames)):
        raw, paired = frames.raw_pair(number), frames.pair(number)
        assert raw.gap_ns == paired.gap_ns
        assert (raw.window is None) == (paired.window is None)


def test_a_raw_frame_is_read_without_a_pass_over_the_recording(log, monkeypatch):
    log.info()
    for index in range(40):
        log.scan(100.0 * index)
        log.image(100.0 * index + 20.0)
    session, frames = reader_of(log)
    recording = session.recording
    read, count = recording.read, []

    def refuse(*_):
        raise AssertionError("all messages would be read")

    monkeypatch.setattr(recording, "stamps_ns", refuse)
    monkeypatch.setattr(recording, "messages", refuse)
    monkeypatch.setattr(
        recording, "read", lambda topic, index: count.append(topic) or read(topic, index)
    )
    assert frames.raw_pair(20).window is not None
    assert len(count) <= 13


def test_an_image_is_read_once_for_its_own_frame_and_for_the_next(log, monkeypatch):
    log.info()
    for index in range(12):
        log.scan(100.0 * index)
        log.image(100.0 * index + 20.0)
    session, frames = reader_of(log)
    recording, read_images = session.recording, []
    read = recording.read

    def note(topic, index):
        if topic != "/scan":
            read_images.append(index)
        return read(topic, index)

    monkeypatch.setattr(recording, "read", note)
    for number in range(3, 8):
        assert frames.pair(number).image is frames.image(number)
        assert frames.previous(number).stamp_ns == frames.image(number - 1).stamp_ns
    assert sorted(read_images) == list(range(2, 8))
