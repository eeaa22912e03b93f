"""What a frame is about: beams of a recorded scan and pixels of a stored image."""

import itertools

import numpy as np
import pytest

from fusion_core.model.labels import Capture
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.captures import frame_captures, image_capture, scan_capture
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS
from tests.workflows.fuse.fused_frames import fuse_frames


@pytest.fixture(scope="module", params=["default", "published"])
def rolled(request, scenes):
    """Fused frames of four rolled cameras, sampled by angle and by index; with their session."""
    settings = PRESETS[request.param].model_copy(update={"pairing": "frame"})
    with open_recording(scenes("robot_at_home", duration_s=2.0)) as recording:
        session = open_session(recording, FuseOptions(), settings)
        alignment = align_recording(session)
        frames = (own for own in fuse_frames(session, alignment) if isinstance(own, FusedFrame))
        yield session, list(itertools.islice(frames, 24))


def test_a_frame_names_the_samples_that_it_was_made_of(rolled) -> None:
    session, frames = rolled
    values = {
        (message.topic, message.stamp_ns): message.value
        for message in session.recording.messages(
            [session.streams.lidar, *(camera.topic for camera in session.rig.cameras)]
        )
    }
    assert len({frame.match.pair.camera_index for frame in frames}) == 4
    for frame in frames:
        found, pairs = frame_captures(frame.match, session), frame.match.correspondence
        scan = values[found.scan.topic, found.scan.stamp_ns]
        image = values[found.image.topic, found.image.stamp_ns]
        assert (found.scan.rows, found.scan.columns) == (1, scan.ranges_m.size)
        assert (found.image.rows, found.image.columns) == image.depth_m.shape
        assert found.scan.index == found.image.index == 0
        np.testing.assert_array_equal(scan.ranges_m[found.beam], pairs.lidar_range_m)
        has_pixel = found.row >= 0
        np.testing.assert_array_equal(has_pixel, pairs.row >= 0)
        np.testing.assert_array_equal(
            image.depth_m[found.row[has_pixel], found.column[has_pixel]], pairs.depth_m[has_pixel]
        )
        stored_row, stored_column = found.view.stored_pixel_maps()
        np.testing.assert_array_equal(image.depth_m[stored_row, stored_column], frame.match.depth_m)


def counted(recording, topic):
    """Each scan's number among those of its stamp, by its mark, by counting the messages."""
    seen, index_of = {}, {}
    for message in recording.messages([topic]):
        index_of[message.value.ranges_m[0]] = seen.get(message.stamp_ns, 0)
        seen[message.stamp_ns] = index_of[message.value.ranges_m[0]] + 1
    return index_of


def test_of_scans_with_one_stamp_the_number_is_that_of_the_one_in_use(log) -> None:
    log.info()
    # Stamps as logged: the first at 500 ms is out of order, of the two at 300 ms the second is.
    logged_ms = [0.0, 500.0, 100.0, 200.0, 300.0, 300.0, 400.0, 500.0, 600.0, 700.0]
    for place, at_ms in enumerate(logged_ms):
        log.scan(at_ms, late_ms=100.0 * place - at_ms, mark=2.0 + 0.1 * place)
        log.image(100.0 * place, late_ms=20.0)
    with log.open() as recording:
        session = open_session(recording, FuseOptions(), PRESETS["default"])
        index_of, frames = counted(recording, "/scan"), FrameReader(session)
        passed = {
            entry.image.stamp_ns: entry.window.scan
            for entry in session.pairs()
            if isinstance(entry, PairedImage) and entry.window is not None
        }
        used = set()
        for number in range(len(frames)):
            paired = frames.pair(number)
            if paired.window is None:
                continue
            scan = paired.window.scan
            capture = scan_capture(scan, session)
            assert capture == scan_capture(passed[paired.image.stamp_ns], session)
            expected = index_of[scan.ranges_m[0]]
            assert capture == Capture("lidar", "/scan", scan.stamp_ns, expected, 1, 9)
            used.add((round((scan.stamp_ns - log.start_ns) / 1e6), capture.index))
    assert {(300, 0), (500, 1)} <= used


def test_a_virtual_scan_is_nobody_s_measurement(log) -> None:
    log.info()
    for place in range(4):
        log.scan(100.0 * place)
        log.image(100.0 * place)
    with log.open() as recording:
        session = open_session(recording, FuseOptions(virtual_lidar_row=6), PRESETS["default"])
        paired = FrameReader(session).pair(1)
        assert scan_capture(paired.window.scan, session) is None
        topic, stamp_ns = "/camera/depth/image_raw", paired.image.stamp_ns
        assert image_capture(paired.image, 0, session) == Capture(
            "depth", topic, stamp_ns, 0, log.lens.height, log.lens.width
        )
