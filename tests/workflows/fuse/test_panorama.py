"""Four rolled cameras as one panorama, from the search to the rows that name stored pixels."""

import csv
import itertools
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.evaluate import evaluate
from fusion_core.workflows.fuse import align as align_module
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.session import (
    FuseOptions,
    open_session,
)
from fusion_core.workflows.fuse.settings import PRESETS
from tests.workflows.fuse.fused_frames import fuse_frames

TOPICS = [f"/camera_{number}/depth/image_raw" for number in (1, 2, 3, 4)]


@pytest.fixture(scope="module")
def images(panorama):
    with open_recording(panorama.recording) as recording:
        values = [(message.topic, message.value) for message in recording.messages(TOPICS)]
    return {(topic, value.stamp_ns): value for topic, value in values}


def test_every_image_of_every_camera_has_a_row(panorama, images):
    with (panorama.folder / "frames.csv").open(newline="", encoding="utf-8") as file:
        rows = [(row["camera"], int(row["stamp_ns"])) for row in csv.DictReader(file)]
    assert sorted(rows) == sorted(images)
    assert {camera for camera, _ in rows} == set(TOPICS)


def test_samples_name_pixels_of_the_stored_images(panorama, images):
    table = pq.read_table(panorama.folder / "samples.parquet")
    column = {name: table[name].to_numpy() for name in table.column_names}
    stored_shape = next(iter(images.values())).depth_m.shape
    assert stored_shape == (120, 160)
    for topic in TOPICS:
        own = (column["camera"] == topic) & np.isfinite(column["depth_row"])
        assert own.sum() > 100, topic
        rows, columns = column["depth_row"][own], column["depth_column"][own]
        assert rows.min() >= 0
        assert rows.max() < stored_shape[0]
        assert columns.min() >= 0
        assert columns.max() < stored_shape[1]
        # Rolled by a quarter turn: neighbouring beams lie in neighbouring stored rows.
        assert np.ptp(rows) > 0.8 * stored_shape[0]
        raw = [
            images[topic, stamp].depth_m[int(row), int(col)]
            for stamp, row, col in zip(column["stamp_ns"][own], rows, columns, strict=True)
        ]
        np.testing.assert_array_equal(column["depth_raw_m"][own], raw)


def test_the_yaw_of_the_rig_is_found(panorama):
    alignment = evaluate.alignment(panorama.folder, panorama.truth)
    assert abs(alignment["yaw_error_deg"]) < 1.0


@pytest.fixture
def session(scenes):
    """Paired frame by frame, which leaves the long refinement out."""
    settings = PRESETS["default"].model_copy(update={"pairing": "frame"})
    with open_recording(scenes("robot_at_home", duration_s=2.0)) as recording:
        yield open_session(recording, FuseOptions(), settings)


@pytest.mark.parametrize("fields", [21, 10, 5, 4])
def test_a_long_recording_still_gives_whole_panoramas(session, monkeypatch, fields):
    """However thinned out, a field is of all four cameras at one instant."""
    monkeypatch.setattr(align_module, "_FIELD_FRAMES", fields)
    every = max(1, session.image_count // 4 // fields)
    assert session.image_count == 84
    assert align_recording(session, lambda *_: None).frames == 21 // every


class StopHere(Exception):
    """What follows is not looked at."""


@pytest.mark.parametrize("kept", [42, 21, 10])
def test_no_camera_is_left_out_of_the_refinement(session, monkeypatch, kept):
    taken: list[str] = []

    def take_and_stop(frames, settings, **_):
        taken.extend(frame.camera.topic for frame in frames)
        raise StopHere

    monkeypatch.setattr(align_module, "estimate_mount", take_and_stop)
    default = PRESETS["default"]
    mount = default.mount.model_copy(update={"frames": kept})
    session = replace(session, settings=default.model_copy(update={"mount": mount}))
    with pytest.raises(StopHere):
        align_recording(session, lambda *_: None)
    counts = {topic: taken.count(topic) for topic in TOPICS}
    assert len(set(counts.values())) == 1
    assert counts[TOPICS[0]] >= 1


def test_a_session_gives_scans_and_every_image_once(session, images):
    alignment = align_recording(session, lambda *_: None)
    found = list(itertools.islice(fuse_frames(session, alignment), 40))
    scans = [entry for entry in found if isinstance(entry, LaserScan)]
    frames = [entry for entry in found if not isinstance(entry, LaserScan | PairedImage)]
    assert scans
    assert frames
    for frame in frames:
        assert isinstance(frame.match.pair.image, DepthImage)
        stored = images[TOPICS[frame.match.pair.camera_index], frame.match.stamp_ns]
        np.testing.assert_array_equal(frame.match.pair.image.depth_m, stored.depth_m)
        # The upright view of a rolled landscape image is in portrait.
        assert frame.match.depth_m.shape == stored.depth_m.shape[::-1]
