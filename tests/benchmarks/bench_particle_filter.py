"""The particle filter on the whole Intel log, against its relations, and its time by length.

    SCANLOOM_TEST_DATA=... OMP_NUM_THREADS=1 python -m tests.benchmarks.bench_particle_filter

The measure is Kümmerle's (2009), without alignment; the row to beat is that of GMapping there:
0.070 m. Real time is by CPU seconds, of one process; reading the log is not in them. The exponent
is the slope of log CPU seconds over log scans: 1 is linear.
"""

import os
import time
from pathlib import Path

import numpy as np

from fusion_core.evaluation.relations import evaluate_relations
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.relation_file import read_relations
from fusion_core.recordings.topics import choose_streams
from fusion_core.slam.particle_filter import particle_filter_slam
from fusion_core.workflows.poses import recorded_poses

SHARES = (1 / 8, 1 / 4, 1 / 2, 1)
COMPILED_BY = 300


def main() -> None:
    folder = Path(os.environ["SCANLOOM_TEST_DATA"]) / "real" / "carmen"
    with open_recording(folder / "intel.clf.bz2") as recording:
        streams = choose_streams(recording, odometry="/flaser/odom")
        odometry = recorded_poses(recording, streams, "flaser")
        assert odometry is not None
        scans = [message.value for message in recording.messages(["/flaser"])]
    particle_filter_slam(scans[:COMPILED_BY], odometry.at)
    counts, spent = [], []
    print(f"{'scans':>7}{'weighed':>9}{'wall s':>9}{'CPU s':>9}{'x real time':>13}{'tiles':>7}")
    for share in SHARES:
        part = scans[: round(share * len(scans))]
        begin, begin_cpu = time.perf_counter(), time.process_time()
        result = particle_filter_slam(part, odometry.at)
        wall, cpu = time.perf_counter() - begin, time.process_time() - begin_cpu
        duration_s = (part[-1].stamp_ns - part[0].stamp_ns) / 1e9
        counts.append(len(part))
        spent.append(cpu)
        print(
            f"{len(part):>7}{result.key.size:>9}{wall:>9.1f}{cpu:>9.1f}"
            f"{duration_s / cpu:>13.1f}{result.tiles:>7}",
            flush=True,
        )
    exponent = np.polyfit(np.log(counts), np.log(spent), 1)[0]
    last = np.log(spent[-1] / spent[-2]) / np.log(counts[-1] / counts[-2])
    print(f"exponent {exponent:.2f}, of the last doubling {last:.2f}")
    print(", ".join(f"{stage} {value:.1f} s" for stage, value in result.seconds.items()))
    trajectory = Trajectory.from_planar(result.stamps_ns, result.poses_map_scan)
    report = evaluate_relations(trajectory, read_relations(folder / "intel.relations"))
    for name, errors, unit in (
        ("translation", report.translation_m, "m"),
        ("rotation", np.degrees(report.rotation_rad), "deg"),
    ):
        print(
            f"{name:<12}{errors.mean():.4f} +- {errors.std():.4f} {unit}, "
            f"median {np.median(errors):.4f}, greatest {errors.max():.4f}"
        )
    print(f"coverage    {report.coverage:.1%} of {report.relations} relations")
    print(
        f"N_eff       {result.effective.mean():.1f} on average, {result.resampled.sum()} times "
        f"drawn anew, {result.unmatched.sum()} matches failed, "
        f"{result.trusted.mean():.2%} of the scans trusted"
    )


if __name__ == "__main__":
    main()
