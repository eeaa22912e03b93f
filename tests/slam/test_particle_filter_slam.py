"""The particle filter in a simulated ring of corridors, and on a section of a real log."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from fusion_core.evaluation.relations import evaluate_relations
from fusion_core.model.errors import MappingFailed
from fusion_core.model.planar_poses import compose_poses, interpolate_pose, relative_pose
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.relation_file import read_relations
from fusion_core.recordings.topics import choose_streams
from fusion_core.slam import particle_filter
from fusion_core.slam.interpolate_poses import interpolate_poses
from fusion_core.slam.local_slam import LocalSlam, LocalSlamSettings
from fusion_core.slam.particle_filter import (
    PUBLISHED,
    ParticleFilter,
    ParticleSettings,
    effective_number,
)
from fusion_core.slam.particle_filter_slam import particle_filter_slam
from fusion_core.slam.particle_proposal import propose
from fusion_core.slam.submaps import SubmapSettings
from fusion_core.workflows.recorded_poses import recorded_poses
from tests.benchmarks.scan_matching_room import WALLS as ROOM
from tests.slam.ring import drive, error_m, revisit_error_m, scan_of, scan_with

FEW = ParticleSettings(particles=6)


@pytest.fixture(scope="module")
def ring():
    return drive()


@pytest.fixture(scope="module")
def views():
    return []


@pytest.fixture(scope="module")
def closed(ring, views):
    return particle_filter_slam(ring.scans, ring.prior, observer=views.append)


@pytest.fixture(scope="module")
def short(ring):
    return particle_filter_slam(ring.scans[:150], ring.prior, FEW)


def scan_matched(ring):
    slam = LocalSlam(LocalSlamSettings(), SubmapSettings())
    placed = [slam.add_scan(scan, ring.prior(scan.stamp_ns)) for scan in ring.scans]
    return np.array([tracked.pose_local_scan for tracked in placed])


def test_a_loop_closes(ring, closed):
    np.testing.assert_array_equal(closed.stamps_ns, ring.stamps_ns)
    assert error_m(ring.odometry, ring.truth) > 4.0
    assert error_m(closed.poses_map_scan, ring.truth) < 0.3
    found = revisit_error_m(closed.poses_map_scan, ring.truth)
    assert found < revisit_error_m(scan_matched(ring), ring.truth) / 1.5
    assert found < 0.15
    assert closed.resampled.any()
    assert closed.trusted.all()
    assert closed.unmatched.sum() == 0


def test_the_result_is_consistent(closed):
    count = ParticleSettings().particles
    assert closed.keyframes[0] == 0
    assert (np.diff(closed.keyframes) > 0).all()
    for array in (closed.effective, closed.resampled, closed.unmatched):
        assert array.shape == closed.keyframes.shape
    assert closed.effective[0] == pytest.approx(count)
    assert ((closed.effective >= 1.0) & (closed.effective <= count + 1e-9)).all()
    np.testing.assert_array_equal(closed.resampled, closed.effective < 0.5 * count)
    assert closed.particles.shape == (count, 3)
    assert closed.weights.sum() == pytest.approx(1.0)
    if not closed.resampled[-1]:
        assert effective_number(closed.weights) == pytest.approx(closed.effective[-1])
        best = closed.particles[closed.weights.argmax()]
        np.testing.assert_allclose(closed.poses_map_scan[closed.keyframes[-1]], best, atol=1e-12)


def test_filter_updates_are_a_step_from_each_other(closed):
    settings = ParticleSettings()
    steps = relative_pose(
        closed.poses_map_scan[closed.keyframes[:-1]], closed.poses_map_scan[closed.keyframes[1:]]
    )
    way_m, turn = np.hypot(*steps[:, :2].T), np.abs(steps[:, 2])
    # The particles' own steps differ a little from those of odometry.
    assert ((way_m > settings.step_m - 0.08) | (turn > settings.step_rad - 0.03)).all()
    assert way_m.max() < settings.step_m + 0.25


def test_an_observer_sees_the_trajectory_grow(closed, views):
    lengths = [view.stamps_ns.size for view in views]
    assert lengths == sorted(lengths)
    assert len(views) == closed.keyframes.size // 20 + 1
    for view in views:
        assert view.poses_map_scan.shape == (view.stamps_ns.size, 3)
        assert view.effective.shape == view.stamps_ns.shape
        assert view.particles.shape == (ParticleSettings().particles, 3)
        assert view.loops_m.shape == (0, 4)
    last = views[-1]
    assert last.poses_map_scan.tobytes() == closed.poses_map_scan.tobytes()
    np.testing.assert_array_equal(last.effective[closed.keyframes], closed.effective)
    assert np.isfinite(last.effective).sum() == closed.keyframes.size


def room_drive(scans, rounds=1):
    """A circle in the furnished room."""
    rng = np.random.default_rng(4)
    angle = 2.0 * np.pi * rounds * np.arange(scans) / scans
    truth = np.stack(
        [5.6 + 1.6 * np.cos(angle), 4.0 + 1.2 * np.sin(angle), angle + 0.5 * np.pi], axis=1
    )
    return [scan_of(pose, number, rng, ROOM, 12.0) for number, pose in enumerate(truth)], truth


def test_maps_follow_the_area_and_not_time():
    # Resampled often, so that tiles are shared and copied again and again.
    settings = FEW.model_copy(update={"resample_fraction": 0.99})
    once = particle_filter_slam(room_drive(100)[0], None, settings)
    twice = particle_filter_slam(room_drive(200, 2)[0], None, settings)
    assert twice.keyframes.size > 1.7 * once.keyframes.size
    assert twice.resampled.sum() > once.resampled.sum() > 5
    assert twice.tiles <= 1.1 * once.tiles


def test_the_same_seed_gives_the_same_bytes(ring, short):
    again = particle_filter_slam(iter(ring.scans[:150]), ring.prior, FEW)
    for name in ("poses_map_scan", "particles", "weights", "effective", "trusted"):
        assert getattr(again, name).tobytes() == getattr(short, name).tobytes()
    other = particle_filter_slam(ring.scans[:150], ring.prior, FEW.model_copy(update={"seed": 1}))
    assert other.poses_map_scan.tobytes() != short.poses_map_scan.tobytes()


def test_the_work_is_reported(ring):
    said = []
    result = particle_filter_slam(
        ring.scans[:40], ring.prior, FEW, progress=lambda *state: said.append(state)
    )
    assert said[-1] == (40, None, "weighing particles")
    assert set(result.seconds) == {"scan_matching", "particles"}
    assert all(value >= 0.0 for value in result.seconds.values())


def test_scans_between_updates_keep_the_local_trajectory():
    rng = np.random.default_rng(2)
    local = np.cumsum(rng.normal(0.0, 0.1, (12, 3)), axis=0)
    local[:, 2] += 3.0
    keyframes = np.array([2, 5, 10])
    moved = np.array([4.0, -2.0, 1.3])
    poses = compose_poses(moved, local)
    # A single rigid motion: there is no error to distribute.
    found = interpolate_poses(local, keyframes, poses[keyframes])
    np.testing.assert_allclose(relative_pose(found, poses), 0.0, atol=1e-9)
    # Otherwise each scan lies between the poses by its two neighbours.
    bent = poses[keyframes] + rng.normal(0.0, 0.1, (3, 3))
    found = interpolate_poses(local, keyframes, bent)
    np.testing.assert_allclose(relative_pose(found[keyframes], bent), 0.0, atol=1e-9)
    by_before = compose_poses(bent[1], relative_pose(local[5], local[7]))
    by_after = compose_poses(bent[2], relative_pose(local[10], local[7]))
    np.testing.assert_allclose(found[7], interpolate_pose(by_before, by_after, 0.4), atol=1e-9)
    np.testing.assert_allclose(
        found[0], compose_poses(bent[0], relative_pose(local[2], local[0])), atol=1e-9
    )
    np.testing.assert_allclose(
        found[11], compose_poses(bent[2], relative_pose(local[10], local[11])), atol=1e-9
    )


def test_a_room_needs_no_odometry():
    scans, truth = room_drive(150)
    result = particle_filter_slam(scans, None, FEW)
    assert (result.poses_map_scan[0] == 0.0).all()
    assert error_m(result.poses_map_scan, truth) < 0.15


def test_no_scan_is_no_map():
    with pytest.raises(MappingFailed, match="no scan to place"):
        particle_filter_slam([])


def test_scans_without_a_point_are_no_map():
    scans = [scan_with(np.full(180, np.nan), number) for number in range(5)]
    with pytest.raises(MappingFailed, match="none of 5 scans has a point within 30 m"):
        particle_filter_slam(scans)


def test_points_beyond_the_max_range_are_no_map(ring):
    with pytest.raises(MappingFailed, match="within 1 m"):
        particle_filter_slam(
            [scan_with(np.full(180, 3.0), 0)], None, ParticleSettings(max_range_m=1.0)
        )


def test_one_scan_is_a_map(ring):
    result = particle_filter_slam(ring.scans[:1], ring.prior, FEW)
    np.testing.assert_allclose(result.poses_map_scan, ring.truth[:1], atol=1e-9)
    assert result.trusted.all()
    assert result.keyframes.size == 1
    np.testing.assert_allclose(result.particles, np.repeat(ring.truth[:1], 6, axis=0), atol=1e-9)


def test_one_particle_is_enough_to_run(ring):
    result = particle_filter_slam(ring.scans[:60], ring.prior, ParticleSettings(particles=1))
    assert (result.effective == 1.0).all()
    assert error_m(result.poses_map_scan, ring.truth[:60]) < 0.25


@pytest.mark.parametrize("first", [0, 40])
def test_scans_without_points_are_untrusted_and_bridged_by_odometry(ring, first):
    blind = slice(first, first + 10)
    scans = [
        scan.with_ranges(np.full_like(scan.ranges_m, np.nan), None)
        if first <= number < first + 10
        else scan
        for number, scan in enumerate(ring.scans[:100])
    ]
    result = particle_filter_slam(scans, ring.prior, FEW)
    assert not result.trusted[blind].any()
    assert result.trusted[:first].all()
    # A corridor does not constrain the pose along it: for a while the pose is uncertain.
    assert result.trusted[-10:].all()
    assert not np.isin(result.keyframes, np.arange(first, first + 10)).any()
    assert error_m(result.poses_map_scan, ring.truth[:100]) < 0.3


def test_a_kidnapped_robot_is_untrusted(ring):
    rng = np.random.default_rng(4)
    scans = ring.scans[:100] + [
        scan_of(np.array([5.6, 4.0 + 0.05 * n, 1.0]), 100 + n, rng, ROOM, 12.0) for n in range(40)
    ]
    result = particle_filter_slam(scans, lambda stamp_ns: ring.prior(stamp_ns), FEW)
    assert result.trusted[:100].all()
    assert not result.trusted[100]
    # The first update there finds no match in any particle's map.
    first = np.flatnonzero(result.keyframes >= 100)[0]
    assert result.unmatched[first] == FEW.particles
    assert not result.trusted[result.keyframes[first]]


def test_a_match_that_fails_is_counted(ring):
    strict = FEW.model_copy(update={"occupancy_min": 1.0})
    result = particle_filter_slam(ring.scans[:40], ring.prior, strict)
    assert result.unmatched[0] == 0
    assert (result.unmatched[1:] == 6).all()
    assert not result.trusted[result.keyframes[1:]].any()
    # Odometry moves them on.
    assert error_m(result.poses_map_scan, ring.truth[:40]) < 0.3
    assert result.particles.std(axis=0)[:2].max() > 0.01


def test_stamps_must_increase(ring):
    with pytest.raises(ValueError, match="stamps must increase"):
        particle_filter_slam([ring.scans[1], ring.scans[0]], ring.prior, FEW)


def test_as_published_the_motion_is_odometrys_own(ring, monkeypatch):
    """And by default, it is odometry as scan matching has corrected it."""
    steps = []
    update = ParticleFilter.update
    monkeypatch.setattr(
        ParticleFilter,
        "update",
        lambda self, step, *rest: (steps.append(step), update(self, step, *rest))[1],
    )
    result = particle_filter_slam(
        ring.scans[:60], ring.prior, PUBLISHED.model_copy(update={"particles": 2})
    )
    by_odometry = ring.odometry[result.keyframes]
    expected = relative_pose(by_odometry[:-1], by_odometry[1:])
    np.testing.assert_allclose(steps, expected, atol=1e-9)
    steps.clear()
    corrected = particle_filter_slam(ring.scans[:60], ring.prior, FEW)
    true = ring.truth[corrected.keyframes]
    by_odometry = ring.odometry[corrected.keyframes]
    errors = [
        np.abs(relative_pose(of[:-1], of[1:]) - steps)[:, 2].mean() for of in (true, by_odometry)
    ]
    assert errors[0] < 0.7 * errors[1]


@pytest.mark.parametrize("settings", [PUBLISHED, ParticleSettings()])
def test_a_weight_is_the_product_of_its_evidence(ring, monkeypatch, settings):
    """Eq. 19 as printed multiplies by the whole of each η; the default by its root."""
    log_evidence = []

    def recorded(*args, **kwargs):
        proposal = propose(*args, **kwargs)
        log_evidence.append(proposal.log_evidence)
        return proposal

    monkeypatch.setattr(particle_filter, "propose", recorded)
    few = settings.model_copy(update={"particles": 3, "resample_fraction": 0.0})
    result = particle_filter_slam(ring.scans[:40], ring.prior, few)
    eta = np.exp(np.array(log_evidence).reshape(-1, 3).sum(axis=0) - np.mean(log_evidence))
    expected = eta ** (1.0 if settings is PUBLISHED else settings.likelihood_gain)
    np.testing.assert_allclose(result.weights, expected / expected.sum(), rtol=1e-6)


def test_as_published_a_loop_closes_and_particles_are_resampled(ring, closed):
    result = particle_filter_slam(ring.scans, ring.prior, PUBLISHED)
    assert result.resampled.sum() > 2 * closed.resampled.sum()
    assert result.effective.mean() < closed.effective.mean()
    assert error_m(result.poses_map_scan, ring.truth) < 0.15 * error_m(ring.odometry, ring.truth)


def test_as_published_where_odometry_is_missing_scan_matching_bridges(ring):
    gap = {scan.stamp_ns for scan in ring.scans[30:50]}
    settings = PUBLISHED.model_copy(update={"particles": 6})
    result = particle_filter_slam(
        ring.scans[:80],
        lambda stamp_ns: None if stamp_ns in gap else ring.prior(stamp_ns),
        settings,
    )
    assert error_m(result.poses_map_scan, ring.truth[:80]) < 0.3


@pytest.mark.data
@pytest.mark.slow
def test_a_section_of_the_intel_log_meets_its_relations(data_folder: Path):
    folder = data_folder / "real" / "carmen"
    with open_recording(folder / "intel.clf.bz2") as recording:
        streams = choose_streams(recording, odometry="/flaser/odom")
        odometry = recorded_poses(recording, streams, "flaser")
        assert odometry is not None
        messages = islice(recording.messages(["/flaser"]), 1000)
        result = particle_filter_slam((message.value for message in messages), odometry.at)
    trajectory = Trajectory.from_planar(result.stamps_ns, result.poses_map_scan)
    report = evaluate_relations(trajectory, read_relations(folder / "intel.relations"))
    assert report.covered > 80
    assert report.translation_m.mean() < 0.04
    assert np.degrees(report.rotation_rad).mean() < 0.6
    assert result.trusted.all()
