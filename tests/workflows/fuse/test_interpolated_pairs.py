"""With interpolated scans: offsets and mount are of the image's instant, values of a real scan."""

import numpy as np
import pytest

from fusion_core.alignment.time import TimeSettings
from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.sensors import LaserScan
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.fuse import align
from fusion_core.workflows.fuse.align import align_recording, observe_mount
from fusion_core.workflows.fuse.cached_chain import CachedChain, FrameChoice
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS
from tests.workflows.fuse.fused_frames import fuse_frames


def chain_of(preset, pair_by="interpolated"):
    own = PRESETS[preset]
    times = own.time.model_dump() | {"pair_by": pair_by}
    # Enough frames for a mount; more take longer.
    mount = own.mount.model_copy(update={"frames": 10})
    return own.model_copy(update={"time": TimeSettings(**times), "mount": mount})


@pytest.fixture(scope="module", params=["default", "published"])
def run(request, scenes):
    """The session, the scans searched in pass 1, the scans of pass 2, and its frames."""
    searched, scans, frames = [], [], []
    plain = align.search_rows

    def watched(scan, *rest):
        searched.append(scan)
        return plain(scan, *rest)

    with (
        open_recording(scenes("bedroom", duration_s=1.6)) as recording,
        pytest.MonkeyPatch.context() as patch,
    ):
        session = open_session(recording, FuseOptions(), chain_of(request.param))
        patch.setattr(align, "search_rows", watched)
        alignment = align_recording(session)
        for entry in fuse_frames(session, alignment):
            if isinstance(entry, LaserScan):
                scans.append(entry)
            elif isinstance(entry, FusedFrame):
                frames.append(entry)
        yield session, alignment, searched, scans, frames


def is_interpolated(frame):
    return frame.match.pair.aligned_scan is not frame.match.scan


def test_most_scans_are_made_for_their_images_instant(run) -> None:
    *_, frames = run
    made = [frame for frame in frames if is_interpolated(frame)]
    assert len(made) > 0.8 * len(frames) > 10
    for frame in made:
        assert frame.match.pair.aligned_scan.stamp_ns == frame.match.stamp_ns


def test_values_are_those_of_a_real_scan(run) -> None:
    *_, scans, frames = run
    for frame in frames:
        scan, pairs = frame.match.scan, frame.match.correspondence
        assert any(scan is own for own in scans)
        # The nearest of all, by a loop.
        off_ns = [abs(own.stamp_ns - frame.match.stamp_ns) for own in scans]
        assert abs(scan.stamp_ns - frame.match.stamp_ns) == min(off_ns)
        np.testing.assert_array_equal(pairs.lidar_range_m, scan.ranges_m[pairs.beam])


def test_offsets_are_searched_with_the_interpolated_scans(run) -> None:
    _, _, searched, _, frames = run
    images_ns = {frame.match.stamp_ns for frame in frames if is_interpolated(frame)}
    assert {scan.stamp_ns for scan in searched} >= images_ns
    for frame in frames:
        match = frame.match
        expected_m = match.pair.aligned_scan.ranges_m[match.curve.beams]
        np.testing.assert_array_equal(match.search.curve_m, expected_m)


def test_the_mount_is_observed_with_the_interpolated_scans(run) -> None:
    session, *_, frames = run
    for frame in frames:
        pair = frame.match.pair
        seen = observe_mount(pair, session.settings)
        ranges_m = pair.aligned_scan.ranges_m
        np.testing.assert_allclose(
            np.hypot(*seen.points_m.T), ranges_m[np.isfinite(ranges_m)], atol=1e-12
        )
        assert seen.scan is pair.scan
        assert seen.image_after_scan_s == pytest.approx(pair.gap_ns / NS_PER_S)
        late_s = 0.0 if is_interpolated(frame) else seen.image_after_scan_s
        assert seen.image_after_points_s == pytest.approx(late_s)


def test_the_workbench_sees_the_frames_of_a_run(run) -> None:
    session, alignment, *_, frames = run
    chain = CachedChain(session, FrameReader(session), alignment)
    for number in range(4, 8):
        seen = chain.fused(FrameChoice(number=number), session.settings)
        own = next(frame for frame in frames if frame.match.stamp_ns == seen.match.stamp_ns)
        assert seen.match.search.peaks == own.match.search.peaks
        np.testing.assert_array_equal(seen.repair.lidar_range_m, own.repair.lidar_range_m)


@pytest.mark.parametrize("run", ["published"], indirect=True)
def test_a_published_pair_is_turned_back_to_the_measured_scan(run) -> None:
    """Sample u + w of the interpolated scan is where the measured one has it before the turn."""
    *_, frames = run
    moved = 0
    for frame in frames:
        match = frame.match
        curve, pairs = match.curve, match.correspondence
        u = match.search.peaks["pearson"].u
        turned = 0.0
        if is_interpolated(frame) and match.motion is not None:
            turned = match.motion.turn_rate_rad_s * match.pair.gap_ns / NS_PER_S
        # A LiDAR that has turned left sees a thing farther to its right.
        first = round(u - turned / curve.step_rad)
        inside = (first + np.arange(match.row.columns.size) >= 0) & (
            first + np.arange(match.row.columns.size) < curve.beams.size
        )
        np.testing.assert_array_equal(pairs.beam, curve.beams[first + np.flatnonzero(inside)])
        moved += first != u
    assert moved > 2


@pytest.mark.parametrize("run", ["default"], indirect=True)
def test_what_moves_between_scan_and_image_leaves_the_offset(run, scenes) -> None:
    """A frame's own u, found without the recording's, is nearer to it than with nearest scans."""
    _, alignment, _, _, frames = run

    def spread(of_frames) -> float:
        found = [frame.match.search.peaks_without_prior["euclidean"].u for frame in of_frames]
        expected = [frame.match.search.peaks["euclidean"].u for frame in of_frames]
        return float(np.median(np.abs(np.array(found) - np.median(expected))))

    with open_recording(scenes("bedroom", duration_s=1.6)) as recording:
        nearest = open_session(recording, FuseOptions(), chain_of("default", "nearest"))
        found = fuse_frames(nearest, alignment)
        plain = [entry for entry in found if isinstance(entry, FusedFrame)]
    assert len(plain) == len(frames)
    assert spread(frames) < spread(plain)
