"""The published preset on four cameras: frames are panoramas, compared with a plain loop."""

import csv
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from fusion_core.evaluation.fuse_folder import open_fuse_folder, read_frames
from fusion_core.model.classes import NoiseClass, RepairSource
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.cached_chain import CachedChain, FrameChoice
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS
from tests.benchmarks.bench_published_panorama import (
    FROM_LEFT,
    PSI,
    W,
    compare,
    panorama_rows,
)
from tests.workflows.fuse.fused_frames import fuse_frames

PUBLISHED = PRESETS["published"]


@pytest.fixture(scope="module")
def recording(scenes):
    return scenes("robot_at_home", duration_s=2.0)


@pytest.fixture(scope="module")
def folder(recording, tmp_path_factory):
    return tmp_path_factory.mktemp("published") / "results"


@pytest.fixture(scope="module")
def compared(recording, folder):
    return compare(recording, folder)


@pytest.fixture(scope="module")
def fused(recording):
    """Fused frames by camera and stamp, with the alignment and the session."""
    with open_recording(recording) as opened:
        session = open_session(opened, FuseOptions(preset="published"), PUBLISHED)
        alignment = align_recording(session)
        frames = [
            entry for entry in fuse_frames(session, alignment) if isinstance(entry, FusedFrame)
        ]
        yield session, alignment, frames


def test_the_preset_finds_what_a_plain_loop_finds(compared) -> None:
    assert compared.loop.size >= 20
    np.testing.assert_array_equal(compared.preset, compared.loop)
    assert np.isfinite(compared.truth).all()
    # 2.5 degrees of yaw and the lever arm; the pasted row's left end lies 67 degrees to the left.
    assert compared.truth == pytest.approx(49.6, abs=0.5)


def test_the_images_of_a_panorama_share_its_search_and_count_once(compared, folder) -> None:
    with (folder / "frames.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    panoramas = panorama_rows(read_frames(open_fuse_folder(folder)))
    assert len(panoramas) * len(FROM_LEFT) == len(rows)
    for panorama in panoramas:
        own = [rows[row] for row in panorama]
        for name in ("u", "v", "score", "scan_stamp_ns", "inliers", "mean_error_m"):
            assert len({row[name] for row in own}) == 1, name
    table = pq.read_table(folder / "samples.parquet").to_pydict()
    # One row for each of the W samples: the cameras' parts make the whole.
    assert len(table["camera"]) == len(panoramas) * W


def test_frames_of_a_panorama_are_parts_of_one_whole(fused) -> None:
    _, alignment, frames = fused
    assert alignment.panorama is not None
    for first in range(0, len(frames), 4):
        parts = frames[first : first + 4]
        matches = [part.match for part in parts]
        assert [match.pair.camera_index for match in matches] == [0, 1, 2, 3]
        assert len({id(match.search) for match in matches}) == 1
        assert len({id(match.registration) for match in matches}) == 1
        # The cameras are stored leftmost first, so the parts follow each other.
        beams = np.concatenate([match.correspondence.beam for match in matches])
        assert beams.size == W
        u = round(matches[0].search.peaks["pearson"].u)
        positions = np.rint(np.linspace(0, 681, PSI)).astype(int)[u : u + W]
        np.testing.assert_array_equal(beams, 681 - positions)
        for match in matches:
            pairs = match.correspondence
            assert set(pairs.row) == {round(match.search.peaks["pearson"].v)}
            np.testing.assert_array_equal(
                pairs.depth_m, match.depth_m[pairs.row, pairs.column].astype(np.float64)
            )


def test_a_side_without_any_value_is_filled_across_the_gap(fused) -> None:
    """Neighbours close gaps wider than the default's limit, as the paper sets none."""
    limit_rad = np.deg2rad(PRESETS["default"].repair.max_gap_deg)
    widest = 0.0
    for frame in fused[2]:
        source = frame.repair.lidar_source == RepairSource.NEIGHBOURS
        hole = frame.classes.lidar_class == NoiseClass.HOLE
        azimuth = frame.match.correspondence.azimuth_rad[source & hole]
        if azimuth.size:
            widest = max(widest, float(np.ptp(azimuth)))
    assert widest > limit_rad


def test_the_workbench_sees_the_frames_of_a_run(fused) -> None:
    session, alignment, frames = fused
    reader = FrameReader(session)
    chain = CachedChain(session, reader, alignment)
    by_image = {(own.match.pair.camera_index, own.match.stamp_ns): own for own in frames}
    for number in range(8, 16):
        seen = chain.fused(FrameChoice(number=number), PUBLISHED)
        own = by_image[reader.camera_of(number), seen.match.stamp_ns]
        assert seen.match.search.peaks == own.match.search.peaks
        np.testing.assert_array_equal(seen.repair.lidar_range_m, own.repair.lidar_range_m)
        np.testing.assert_array_equal(seen.classes.depth_class, own.classes.depth_class)


def test_by_angle_a_panorama_is_paired_by_its_own_peak_too(fused, recording) -> None:
    session, _, _ = fused
    by_angle = PUBLISHED.sampling.model_copy(update={"by": "angle"})
    settings = PUBLISHED.model_copy(update={"sampling": by_angle})
    session = replace(session, settings=settings)
    alignment = align_recording(session)
    frame = next(
        entry for entry in fuse_frames(session, alignment) if isinstance(entry, FusedFrame)
    )
    assert frame.match.pasted is not None
    assert frame.match.search.rows_m.shape[1] == W


def test_an_image_whose_partners_are_missing_is_a_frame_of_its_own(fused, monkeypatch) -> None:
    session, alignment, _ = fused
    passes = session.pairs

    def without_third(clock_offset_ms: float = 0.0):
        return (entry for entry in passes(clock_offset_ms) if getattr(entry, "camera", 0) != 2)

    monkeypatch.setattr(type(session), "pairs", lambda _, offset=0.0: without_third(offset))
    frames = [e for e in fuse_frames(session, alignment) if isinstance(e, FusedFrame)]
    assert {frame.match.pair.camera_index for frame in frames} == {0, 1, 3}
    assert all(frame.match.pasted is None for frame in frames)
    keys = [(frame.match.pair.camera_index, frame.match.stamp_ns) for frame in frames]
    assert len(keys) == len(set(keys)) == 63
