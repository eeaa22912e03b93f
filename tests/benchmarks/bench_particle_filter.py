"""The particle filter on the Intel log and on parts of it, by the default and as published.

    SCANLOOM_TEST_DATA=... OMP_NUM_THREADS=1 python -m tests.benchmarks.bench_particle_filter
        [--case whole|half|starts] [--preset default|published] [--seed N]

The measure is Kümmerle's (2009), without alignment; GMapping's own is 0.070 m. ``whole``: every
scan. ``half``: every second scan. ``starts``: ten minutes of it, from ten instants evenly spread
over the log. A start is one line; the last line has the mean and the worst of the starts' means.
``p95``: the error below which 95 % of the relations lie.

The log's stamps come in bursts with gaps of up to 3 s between, so that a pose at the instant of a
scan that was left out cannot be interpolated in time: of the raw odometry, half of the scans
reproduce the relations of the whole to 0.056 m only. So ``half`` is two lines: by the relations
whose instants are both scans that are left, and by all, interpolated.
"""

import argparse
import os
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fusion_core.evaluation.relations import evaluate_relations
from fusion_core.model.conventions import NS_PER_S, IntArray
from fusion_core.model.planar_poses import PosePrior
from fusion_core.model.relations import Relations
from fusion_core.model.sensors import LaserScan
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.relation_file import read_relations
from fusion_core.recordings.topics import choose_streams
from fusion_core.slam.particle_filter import ParticleSettings
from fusion_core.slam.particle_filter_slam import particle_filter_slam
from fusion_core.workflows.map.settings import MAP_PRESETS
from fusion_core.workflows.recorded_poses import recorded_poses

STARTS, START_NS = 10, 600 * NS_PER_S


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", choices=["whole", "half", "starts"], action="append")
    parser.add_argument("--preset", choices=["default", "published"], action="append")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    folder = Path(os.environ["SCANLOOM_TEST_DATA"]) / "real" / "carmen"
    relations = read_relations(folder / "intel.relations")
    with open_recording(folder / "intel.clf.bz2") as recording:
        streams = choose_streams(recording, odometry="/flaser/odom")
        odometry = recorded_poses(recording, streams, "flaser")
        assert odometry is not None
        scans = [message.value for message in recording.messages(["/flaser"])]
    print(
        f"{'preset':<11}{'case':<10}{'mean m':>8}{'std':>8}{'p95':>8}{'worst':>8}{'deg':>7}"
        f"{'relations':>11}{'updates':>9}{'resampled':>11}{'N_eff':>7}{'unmatched':>11}"
        f"{'trusted':>9}{'CPU s':>7}"
    )
    for preset in asked.preset or ("default", "published"):
        settings = MAP_PRESETS[preset].particles.model_copy(update={"seed": asked.seed})
        for case in asked.case or ("whole", "half", "starts"):
            if case == "starts":
                means = [
                    _print_run(preset, f"start {number}", part, odometry.at, settings, relations)
                    for number, part in enumerate(parts_of(scans))
                ]
                print(f"{preset:<11}{'starts':<10}{np.mean(means):>8.4f}, worst {max(means):.4f}")
            else:
                part = scans if case == "whole" else scans[::2]
                _print_run(preset, case, part, odometry.at, settings, relations)


def parts_of(scans: Sequence[LaserScan]) -> list[Sequence[LaserScan]]:
    """Ten minutes of the log from each start."""
    stamps_ns = np.array([scan.stamp_ns for scan in scans])
    begins_ns = np.linspace(stamps_ns[0], stamps_ns[-1] - START_NS, STARTS).astype(np.int64)
    first = np.searchsorted(stamps_ns, begins_ns)
    last = np.searchsorted(stamps_ns, begins_ns + START_NS)
    return [scans[i:j] for i, j in zip(first, last, strict=True)]


def _print_run(
    preset: str,
    case: str,
    scans: Sequence[LaserScan],
    prior: PosePrior,
    settings: ParticleSettings,
    relations: Relations,
) -> float:
    """The mean error in metres."""
    begin_s = time.process_time()
    result = particle_filter_slam(scans, prior, settings)
    spent_s = time.process_time() - begin_s
    trajectory = Trajectory.from_planar(result.stamps_ns, result.poses_map_scan)
    report = evaluate_relations(trajectory, relations_between(result.stamps_ns, relations))
    errors_m = report.translation_m
    print(
        f"{preset:<11}{case:<10}{errors_m.mean():>8.4f}{errors_m.std():>8.4f}"
        f"{np.percentile(errors_m, 95):>8.4f}{errors_m.max():>8.4f}"
        f"{np.degrees(report.rotation_rad).mean():>7.3f}{report.covered:>11}"
        f"{result.keyframes.size:>9}{np.count_nonzero(result.resampled):>11}"
        f"{result.effective.mean():>7.1f}{result.unmatched.sum():>11}"
        f"{result.trusted.mean():>9.2%}{spent_s:>7.1f}",
        flush=True,
    )
    if case == "half":
        interpolated_m = evaluate_relations(trajectory, relations).translation_m
        print(
            f"{preset:<11}{'by all':<10}{interpolated_m.mean():>8.4f}{interpolated_m.std():>8.4f}"
            f"{np.percentile(interpolated_m, 95):>8.4f}{interpolated_m.max():>8.4f}"
            f"{np.nan:>7}{interpolated_m.size:>11}"
        )
    return float(errors_m.mean())


def relations_between(stamps_ns: IntArray, relations: Relations) -> Relations:
    """Those whose two instants are among the stamps (N,)."""
    first_ns, second_ns = relations.first_stamps_ns, relations.second_stamps_ns
    known = np.isin(first_ns, stamps_ns) & np.isin(second_ns, stamps_ns)
    return Relations(
        first_stamps_ns=first_ns[known],
        second_stamps_ns=second_ns[known],
        T_first_second=relations.T_first_second[known],
    )


if __name__ == "__main__":
    main()
