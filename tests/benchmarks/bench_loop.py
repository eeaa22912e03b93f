"""The two-room loop: what closing loops is worth, by pose graph and by particles.

    python -m tests.benchmarks.bench_loop [--seeds 3]

The absolute error is that of the trajectory without alignment but for its first pose, RMSE over
the scans. "without" is the same pose graph with loops that no match can pass (score_min 1).
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from fusion_core.model.planar_poses import compose_poses, relative_pose
from fusion_core.recordings.tum_trajectory import read_tum_trajectory
from fusion_core.simulation.scenes import find_scene, write_scene
from fusion_core.simulation.truth import truth_path
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions

NO_LOOPS = "[loops]\nscore_min = 1.0\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    asked = parser.parse_args()
    columns = ("wheel", "without", "pose graph", "particles", "ratio")
    print(f"{'seed':<6}" + "".join(f"{name:>12}" for name in columns))
    for seed in range(asked.seeds):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            recording = folder / "loop.mcap"
            settings = find_scene("two_room_loop").settings.model_copy(update={"seed": seed})
            write_scene("two_room_loop", recording, settings=settings)
            no_loops = folder / "no_loops.toml"
            no_loops.write_text(NO_LOOPS, encoding="utf-8")
            runs = {
                "wheel": MapOptions(motion="wheel", slam="none"),
                "without": MapOptions(motion="wheel", settings_file=no_loops),
                "pose graph": MapOptions(motion="wheel"),
                "particles": MapOptions(motion="wheel", slam="particle-filter"),
            }
            errors_m = {}
            for run, options in runs.items():
                build_map(recording, folder / run.replace(" ", "_"), options)
                errors_m[run] = error_m(folder / run.replace(" ", "_"), recording)
            ratio = errors_m["pose graph"] / errors_m["without"]
            figures = [*errors_m.values(), ratio]
            print(f"{seed:<6}" + "".join(f"{figure:>12.3f}" for figure in figures), flush=True)


def error_m(folder: Path, recording: Path) -> float:
    """RMSE of the trajectory against the truth, aligned at the first scan."""
    estimate = read_tum_trajectory(folder / "trajectory.tum").trajectory
    truth = np.load(truth_path(recording))
    _, own, theirs = np.intersect1d(estimate.stamps_ns, truth["scan_stamp"], return_indices=True)
    found, true = estimate.planar_poses[own], truth["pose"][theirs]
    aligned = compose_poses(true[0], relative_pose(found[0], found))
    return float(np.sqrt(((aligned - true)[:, :2] ** 2).sum(axis=1).mean()))


if __name__ == "__main__":
    main()
