"""Pose graph SLAM in a simulated ring of corridors, and on a section of a real log."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from fusion_core.evaluation.relations import evaluate_relations
from fusion_core.model.errors import MappingFailed
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.relation_file import read_relations
from fusion_core.recordings.topics import choose_streams
from fusion_core.slam.local_slam import LocalSlam, LocalSlamSettings
from fusion_core.slam.loop_search import LoopSettings
from fusion_core.slam.pose_graph_slam import SlamSettings, pose_graph_slam
from fusion_core.slam.submaps import SubmapSettings
from fusion_core.slam.surface_adjustment import SurfaceAdjustmentSettings
from fusion_core.workflows.recorded_poses import recorded_poses
from tests.benchmarks.scan_matching_room import WALLS as ROOM
from tests.slam.ring import drive, error_m, revisit_error_m, scan_of, scan_with

# A score of 1 is never exceeded; surfaces would join the ends as well.
NO_LOOPS = SlamSettings(
    loops=LoopSettings(score_min=1.0, score_min_wide=1.0),
    surface_adjustment=SurfaceAdjustmentSettings(rounds=0),
)


@pytest.fixture(scope="module")
def ring():
    return drive()


@pytest.fixture(scope="module")
def closed(ring):
    return pose_graph_slam(ring.scans, ring.prior)


def test_every_scan_is_placed_far_better_than_by_odometry(ring, closed):
    np.testing.assert_array_equal(closed.stamps_ns, ring.stamps_ns)
    assert error_m(ring.odometry, ring.truth) > 4.0
    assert error_m(closed.poses_map_scan, ring.truth) < 0.25
    assert closed.trusted.all()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_loop_closes(seed):
    ring = drive(seed=seed)
    closed = pose_graph_slam(ring.scans, ring.prior)
    open_end = pose_graph_slam(ring.scans, ring.prior, NO_LOOPS)
    assert open_end.loops == 0
    assert closed.loops >= 3
    error = revisit_error_m(closed.poses_map_scan, ring.truth)
    assert error < revisit_error_m(open_end.poses_map_scan, ring.truth) / 3.0
    assert error < 0.1


def test_loops_join_scans_of_one_place(ring, closed):
    graph = closed.graph
    places = ring.truth[closed.keyframes, :2]
    loops = np.flatnonzero(graph.is_loop)
    away_m = np.hypot(*(places[graph.first[loops]] - places[graph.second[loops]]).T)
    # An edge leads to a submap's first keyframe, not to its nearest.
    assert away_m.max() < 14.0
    assert np.hypot(*closed.residuals[loops, :2].T).max() < 0.5
    assert (
        closed.stamps_ns[closed.keyframes[graph.second]]
        > closed.stamps_ns[closed.keyframes[graph.first]]
    ).all()


def test_the_same_input_gives_the_same_bytes(ring, closed):
    again = pose_graph_slam(iter(ring.scans), ring.prior)
    assert again.poses_map_scan.tobytes() == closed.poses_map_scan.tobytes()
    assert again.graph.information.tobytes() == closed.graph.information.tobytes()
    assert again.residuals.tobytes() == closed.residuals.tobytes()


def test_the_work_is_reported(ring):
    said = []
    short = ring.scans[:40]
    result = pose_graph_slam(short, ring.prior, progress=lambda *state: said.append(state))
    stages = {"matching scans", "closing loops", "refining", "adjusting to surfaces"}
    assert {what for _, _, what in said} == stages
    assert (40, None, "matching scans") in said
    stages = {"local_slam", "loop_search", "optimisation", "refinement", "adjustment"}
    assert set(result.seconds) == stages
    assert all(value >= 0.0 for value in result.seconds.values())


def room_drive(count=150):
    """A circle in the furnished room, seen without odometry."""
    rng = np.random.default_rng(4)
    angle = 2.0 * np.pi * np.arange(count) / count
    truth = np.stack(
        [5.6 + 1.6 * np.cos(angle), 4.0 + 1.2 * np.sin(angle), angle + 0.5 * np.pi], axis=1
    )
    return [scan_of(pose, n, rng, ROOM, 12.0) for n, pose in enumerate(truth)], truth


def test_a_room_needs_no_odometry():
    scans, truth = room_drive()
    result = pose_graph_slam(scans)
    assert (result.poses_map_scan[0] == 0.0).all()
    assert error_m(result.poses_map_scan, truth) < 0.07


def test_odometry_that_jumps_is_rejected():
    scans, truth = room_drive()
    odometry = truth.copy()
    odometry[60:] += [0.6, -0.4, 0.5]
    numbers = {scan.stamp_ns: number for number, scan in enumerate(scans)}
    result = pose_graph_slam(scans, lambda stamp_ns: odometry[numbers[stamp_ns]])
    assert error_m(odometry, truth) > 0.5
    assert error_m(result.poses_map_scan, truth) < 0.07


def test_holes_in_odometry_are_bridged():
    scans, truth = room_drive()
    numbers = {scan.stamp_ns: number for number, scan in enumerate(scans)}

    def prior(stamp_ns):
        return None if 60 <= numbers[stamp_ns] < 70 else truth[numbers[stamp_ns]]

    result = pose_graph_slam(scans, prior)
    assert error_m(result.poses_map_scan, truth) < 0.06


def test_no_scan_is_no_map():
    with pytest.raises(MappingFailed, match="no scan to place"):
        pose_graph_slam([])


def test_scans_without_a_point_are_no_map():
    scans = [scan_with(np.full(180, np.nan), number) for number in range(5)]
    with pytest.raises(MappingFailed, match="none of 5 scans has a point within 30 m"):
        pose_graph_slam(scans)


def test_one_scan_is_a_map(ring):
    result = pose_graph_slam(ring.scans[:1], ring.prior)
    np.testing.assert_allclose(result.poses_map_scan, ring.truth[:1], atol=1e-9)
    assert result.trusted.all()
    assert result.graph.first.size == 0


def test_scans_without_points_are_untrusted_and_bridged_by_odometry(ring):
    blind = slice(40, 50)
    scans = [
        scan.with_ranges(np.full_like(scan.ranges_m, np.nan), None) if 40 <= n < 50 else scan
        for n, scan in enumerate(ring.scans[:120])
    ]
    result = pose_graph_slam(scans, ring.prior)
    assert not result.trusted[blind].any()
    assert result.trusted[:40].all()
    assert result.trusted[60:].all()
    assert error_m(result.poses_map_scan, ring.truth[:120]) < 0.3
    # Only the edge over it has less information.
    steps = ~result.graph.is_loop
    over = (result.keyframes[result.graph.second] >= 40) & (
        result.keyframes[result.graph.first] < 50
    )
    doubt = result.graph.information[:, 0, 0] ** -0.5
    assert (doubt[steps & over] > 0.29).all()
    assert (doubt[steps & ~over] < 0.031).all()


def test_a_kidnapped_robot_is_untrusted(ring):
    elsewhere, _ = room_drive(50)
    scans = [
        scan if number < 100 else scan_with(elsewhere[number - 100].ranges_m, number)
        for number, scan in enumerate(ring.scans[:150])
    ]
    result = pose_graph_slam(scans, ring.prior)
    assert result.trusted[:100].all()
    assert not result.trusted[100]


def test_stamps_must_increase(ring):
    slam = LocalSlam(LocalSlamSettings(), SubmapSettings())
    slam.add_scan(ring.scans[1], None)
    for scan in ring.scans[:2]:
        with pytest.raises(ValueError, match="stamps must increase"):
            slam.add_scan(scan, None)


def test_submaps_overlap_and_cover_the_trajectory(ring):
    slam = LocalSlam(LocalSlamSettings(), SubmapSettings(keyframes=20))
    for scan, pose in zip(ring.scans[:200], ring.odometry, strict=False):
        slam.add_scan(scan, pose)
    local = slam.finish()
    assert local.submaps[0].first == 0
    assert local.submaps[-1].end == local.keyframes.size
    for submap, following in zip(local.submaps[:-2], local.submaps[1:], strict=False):
        assert submap.end - submap.first == 20
        assert following.first - submap.first == 10


@pytest.mark.data
def test_a_section_of_the_intel_log_meets_its_relations(data_folder: Path):
    folder = data_folder / "real" / "carmen"
    with open_recording(folder / "intel.clf.bz2") as recording:
        streams = choose_streams(recording, odometry="/flaser/odom")
        odometry = recorded_poses(recording, streams, "flaser")
        assert odometry is not None
        messages = islice(recording.messages(["/flaser"]), 1500)
        result = pose_graph_slam((message.value for message in messages), odometry.at)
    trajectory = Trajectory.from_planar(result.stamps_ns, result.poses_map_scan)
    report = evaluate_relations(trajectory, read_relations(folder / "intel.relations"))
    assert report.covered > 100
    assert report.translation_m.mean() < 0.03
    assert np.degrees(report.rotation_rad).mean() < 0.5
    assert result.trusted.all()
