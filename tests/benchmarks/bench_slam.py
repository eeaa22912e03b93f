"""SLAM on the whole Intel log, against its relations, and its time by the number of scans.

    SCANLOOM_TEST_DATA=... OMP_NUM_THREADS=1 python -m tests.benchmarks.bench_slam
        [--slam pose-graph|particle-filter] [--repeats 5] [--plot OUT.png]

The measure is Kümmerle's (2009), without alignment; anchors: Cartographer 0.0229 m, 0.453 deg;
Graph FLIRT 0.02 m, 0.3 deg; GMapping 0.070 m. Seconds are of one process, on the wall clock and on
its own; reading the log is not in them. The exponent is the slope of log CPU seconds over log
scans: 1 is linear. Each fraction of the log is placed ``--repeats`` times, in turn, after a first
quarter that compiles everything, and the least seconds of each count: other load on the machine
only adds. The log's first eighth sees no place twice; the last doubling shows how the work grows
once loops are there.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np

from fusion_core.evaluation.relations import evaluate_relations
from fusion_core.exporting.figures import png_figure
from fusion_core.exporting.palette import DEPTH
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.relation_file import read_relations
from fusion_core.recordings.topics import choose_streams
from fusion_core.slam.particle_filter_slam import ParticleResult, particle_filter_slam
from fusion_core.slam.pose_graph_slam import SlamResult, pose_graph_slam
from fusion_core.workflows.recorded_poses import recorded_poses

ESTIMATORS = {"pose-graph": pose_graph_slam, "particle-filter": particle_filter_slam}
FRACTIONS = (1 / 8, 1 / 4, 1 / 2, 1)
COMPILED_BY = 1 / 4


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--slam", choices=list(ESTIMATORS), default="pose-graph")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--plot", type=Path, default=None)
    asked = parser.parse_args()
    estimate = ESTIMATORS[asked.slam]
    folder = Path(os.environ["SCANLOOM_TEST_DATA"]) / "real" / "carmen"
    with open_recording(folder / "intel.clf.bz2") as recording:
        streams = choose_streams(recording, odometry="/flaser/odom")
        odometry = recorded_poses(recording, streams, "flaser")
        assert odometry is not None
        scans = [message.value for message in recording.messages(["/flaser"])]
    parts = [scans[: round(fraction * len(scans))] for fraction in FRACTIONS]
    estimate(scans[: round(COMPILED_BY * len(scans))], odometry.at)
    wall = np.full((asked.repeats, len(parts)), np.inf)
    cpu = np.full((asked.repeats, len(parts)), np.inf)
    for repeat in range(asked.repeats):
        for index, part in enumerate(parts):
            begin, begin_cpu = time.perf_counter(), time.process_time()
            result = estimate(part, odometry.at)
            wall[repeat, index] = time.perf_counter() - begin
            cpu[repeat, index] = time.process_time() - begin_cpu
    counts, spent = [len(part) for part in parts], cpu.min(axis=0)
    print(f"{'scans':>7}{'wall s':>9}{'CPU s':>9}{'x real time':>13}")
    for part, wall_s, cpu_s in zip(parts, wall.min(axis=0), spent, strict=True):
        duration_s = (part[-1].stamp_ns - part[0].stamp_ns) / 1e9
        print(f"{len(part):>7}{wall_s:>9.1f}{cpu_s:>9.1f}{duration_s / wall_s:>13.1f}")
    exponent, _ = np.polyfit(np.log(counts), np.log(spent), 1)
    last = np.log(spent[-1] / spent[-2]) / np.log(counts[-1] / counts[-2])
    print(f"exponent {exponent:.2f}, of the last doubling {last:.2f}")
    print(", ".join(f"{stage} {value:.1f} s" for stage, value in result.seconds.items()))
    _print_errors(result, folder / "intel.relations")
    if asked.plot is not None:
        _plot(asked.plot, asked.slam, counts, spent, exponent)


def _print_errors(result: SlamResult | ParticleResult, relations: Path) -> None:
    trajectory = Trajectory.from_planar(result.stamps_ns, result.poses_map_scan)
    report = evaluate_relations(trajectory, read_relations(relations))
    for name, errors, unit in (
        ("translation", report.translation_m, "m"),
        ("rotation", np.degrees(report.rotation_rad), "deg"),
    ):
        print(
            f"{name:<12}{errors.mean():.4f} +- {errors.std():.4f} {unit}, "
            f"median {np.median(errors):.4f}, greatest {errors.max():.4f}"
        )
    print(f"coverage    {report.coverage:.1%} of {report.relations} relations")
    print(f"trusted     {result.trusted.mean():.2%} of the scans")
    if isinstance(result, SlamResult):
        print(f"loops       {result.loops}, {result.loops_dropped} dropped")
    else:
        print(
            f"N_eff       {result.effective.mean():.1f} on average, {result.resampled.sum()} times "
            f"drawn anew, {result.unmatched.sum()} matches failed, at most {result.tiles} tiles"
        )


def _plot(path: Path, slam: str, counts: list[int], spent: list[float], exponent: float) -> None:
    with png_figure(path, f"{slam} on the Intel log", height_in=2.6) as figure:
        axes = figure.subplots()
        axes.loglog(counts, spent, "o", color=DEPTH, ms=3.0, label="CPU seconds, one process")
        # The fitted line goes through the mean of the logarithms.
        middle = np.exp(np.mean(np.log(counts))), np.exp(np.mean(np.log(spent)))
        fitted = middle[1] * (np.array(counts) / middle[0]) ** exponent
        axes.loglog(counts, fitted, "-", color=DEPTH, lw=0.9, label=f"exponent {exponent:.2f}")
        axes.set_xlabel("scans")
        axes.set_ylabel("CPU seconds")
        figure.legend(loc="outside lower center", ncols=2, frameon=False)


if __name__ == "__main__":
    main()
