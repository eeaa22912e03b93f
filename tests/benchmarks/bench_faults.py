"""What faults do to the pose graph, and whether its report names every interval that is off.

    python -m tests.benchmarks.bench_faults

Each fault is recorded in the two-room loop with odometry that drifts; the estimate is aligned to
the truth by its first pose alone. An interval is off where it is more than 0.3 m from the truth for
two scans or more; it is named where report.json calls any of its scans untrusted. Exits with 1
where one is not named.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from fusion_core.model.conventions import NS_PER_S, BoolArray, FloatArray, IntArray
from fusion_core.model.errors import MappingFailed
from fusion_core.model.planar_poses import compose_poses, relative_pose
from fusion_core.recordings.tum_trajectory import read_tum_trajectory
from fusion_core.simulation.faults import FaultSettings
from fusion_core.simulation.scenes import find_scene, write_scene
from fusion_core.simulation.truth import truth_path
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions

OFF_M = 0.3
FAULTS = {
    "none": FaultSettings(),
    "a tenth of the scans lost": FaultSettings(scan_loss_fraction=0.1),
    "a second of no data": FaultSettings(silence_at_s=40.0, silence_s=1.0),
    "wheels slip for 3 s": FaultSettings(slip_at_s=40.0, slip_s=3.0, slip_factor=3.0),
    "camera dark for 20 s": FaultSettings(dark_at_s=30.0, dark_s=20.0),
    "kidnapped by 6 m": FaultSettings(kidnap_at_s=60.0, kidnap_ahead_m=6.0),
}
RUNS = (
    ("lidar, recorded", MapOptions(scan="lidar", motion="recorded")),
    ("merged, fused", MapOptions(scan="merged", motion="fused")),
)


def main() -> None:
    missed = 0
    columns = ("median m", "greatest m", "off scans", "untrusted", "not named")
    print(f"{'fault':<28}{'run':<18}" + "".join(f"{name:>12}" for name in columns))
    for name, faults in FAULTS.items():
        with tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / "loop.mcap"
            settings = find_scene("two_room_loop").settings
            write_scene("two_room_loop", recording, settings=settings, faults=faults)
            for run, options in RUNS:
                figures = _judged(recording, Path(folder) / run.replace(", ", "_"), options)
                missed += int(figures[-1])
                print(
                    f"{name:<28}{run:<18}"
                    + f"{figures[0]:>12.3f}{figures[1]:>12.3f}"
                    + "".join(f"{int(figure):>12d}" for figure in figures[2:]),
                    flush=True,
                )
    if missed:
        sys.exit(f"{missed} intervals are off and not named")


def _judged(recording: Path, folder: Path, options: MapOptions) -> tuple[float, ...]:
    try:
        build_map(recording, folder, options)
    except MappingFailed as error:
        # Its results are there all the same.
        print(f"  {error.problem}")
    estimate = read_tum_trajectory(folder / "trajectory.tum").trajectory
    truth = np.load(truth_path(recording))
    stamps_ns, poses = truth["scan_stamp"], truth["pose"]
    _, own, theirs = np.intersect1d(estimate.stamps_ns, stamps_ns, return_indices=True)
    found, true = estimate.planar_poses[own], poses[theirs]
    aligned = compose_poses(true[0], relative_pose(found[0], found))
    away_m: FloatArray = np.hypot(*(aligned - true)[:, :2].T)
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    untrusted = _within(estimate.stamps_ns[own], report["untrusted"])
    intervals = _runs(away_m > OFF_M)
    unnamed = sum(not untrusted[a:b].any() for a, b in intervals if b - a > 1)
    return (
        float(np.median(away_m)),
        float(away_m.max()),
        int((away_m > OFF_M).sum()),
        int(untrusted.sum()),
        unnamed,
    )


def _within(stamps_ns: IntArray, intervals: list[dict[str, float]]) -> BoolArray:
    inside: BoolArray = np.zeros(stamps_ns.size, dtype=np.bool_)
    for interval in intervals:
        # Stamps in seconds are rounded.
        first, last = (round(interval[end] * NS_PER_S) for end in ("from_s", "to_s"))
        inside |= (stamps_ns >= first - 1000) & (stamps_ns <= last + 1000)
    return inside


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    turns = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return list(zip(turns[::2].tolist(), turns[1::2].tolist(), strict=True))


if __name__ == "__main__":
    main()
