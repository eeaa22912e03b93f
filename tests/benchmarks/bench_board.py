"""Joint calibration with a board over simulated recordings: errors, and whether the covariance is
honest.

    python -m tests.benchmarks.bench_board --seeds 20 [--range-offset 0.0]

Each recording has its own mounting, places of the board and noise, none of which the calibration is
told. The mean of the normalised error squared has a 95 % interval that it should lie in.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from fusion_core.calibration.pose_error import pose_error
from fusion_core.simulation.board_recording import BoardSceneSettings, write_board_recording
from fusion_core.simulation.truth import truth_path
from fusion_core.workflows.calibrate.planar import PlanarOptions, calibrate_planar

# What is to be shown.
ROTATION_DEG, TRANSLATION_M = 0.2, 0.01


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--range-offset", type=float, help="doubt of the ranges (m), by one offset")
    asked = parser.parse_args()
    print("seed  places  rotation [deg]     sd  translation [mm]     sd    NEES  basin  time [s]")
    squares, rotations, translations = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        recording, result = Path(folder) / "board.mcap", Path(folder) / "result.json"
        settings = None
        if asked.range_offset is not None:
            settings = Path(folder) / "settings.toml"
            settings.write_text(f"[laser_board]\nrange_offset_sd_m = {asked.range_offset}\n")
        for seed in range(asked.first, asked.first + asked.seeds):
            write_board_recording(recording, BoardSceneSettings(seed=seed))
            with np.load(truth_path(recording)) as truth:
                T_true = truth["T_camera_lidar"]
            started = time.perf_counter()
            options = PlanarOptions(board="7x5", square_m=0.1, settings_file=settings)
            found = calibrate_planar(recording, result, options)
            took_s = time.perf_counter() - started
            error = pose_error(T_true, np.array(found["T_camera_lidar"]))
            covariance = np.array(found["covariance"], dtype=float)
            squares.append(float(error @ np.linalg.solve(covariance, error)))
            rotations.append(np.degrees(np.linalg.norm(error[:3])))
            translations.append(np.linalg.norm(error[3:]))
            variances = np.diag(covariance)
            sd_deg = np.degrees(np.sqrt(variances[:3].sum()))
            sd_mm = 1000.0 * np.sqrt(variances[3:].sum())
            print(
                f"{seed:4d}  {found['views_used']:6d}  {rotations[-1]:14.3f}  {sd_deg:5.3f}"
                f"  {1000.0 * translations[-1]:16.2f}  {sd_mm:5.2f}  {squares[-1]:6.2f}"
                f"  {found['basin']:5.2f}  {took_s:8.1f}",
                flush=True,
            )
    count = len(squares)
    good = (np.array(rotations) <= ROTATION_DEG) & (np.array(translations) <= TRANSLATION_M)
    low, high = chi2.ppf([0.025, 0.975], 6 * count) / count
    mean = float(np.mean(squares))
    print(
        f"\nwithin {ROTATION_DEG} deg and {100 * TRANSLATION_M:g} cm: {good.sum()} of {count};"
        f" worst {max(rotations):.3f} deg, {1000.0 * max(translations):.2f} mm"
    )
    inside = "inside" if low <= mean <= high else "OUTSIDE"
    print(f"mean NEES {mean:.2f}, 95 % interval {low:.2f} .. {high:.2f}: {inside}")


if __name__ == "__main__":
    main()
