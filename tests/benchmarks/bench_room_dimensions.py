"""Dimensions of a furnished room from a cloud of it, beside Song 2022, Table 3 (under 2 cm).

    python -m tests.benchmarks.bench_room_dimensions

20 seeds a row: 60,000 rays in every direction from a scanner in the furnished box of
tests/evaluation/scanned_box.py, at any yaw and up to 5° of tilt, with Gaussian noise on each range
and a fraction of them anywhere. Errors are those of length, width and height, in millimetres.
"""

import time

import numpy as np

from fusion_core.evaluation.room_dimensions import measure_room
from fusion_core.model.errors import EvaluationFailed
from tests.evaluation.scanned_box import SIZE_M, scan_box

SEEDS = 20
TILT_MAX_RAD = np.deg2rad(5.0)
# Noise in metres, fraction of outliers.
ROWS = ((0.01, 0.02), (0.03, 0.02), (0.01, 0.2), (0.05, 0.02))


def main() -> None:
    print("noise  outliers  mean error (mm)         largest  refused  s each")
    for noise_m, outliers in ROWS:
        errors_mm, refused = [], 0
        start_s = time.process_time()
        for seed in range(SEEDS):
            rng = np.random.default_rng(seed)
            yaw_rad, tilt_rad = rng.uniform(-np.pi, np.pi), TILT_MAX_RAD * rng.uniform(-1.0, 1.0)
            points_m = scan_box(
                rng, noise_m=noise_m, outliers=outliers, yaw_rad=yaw_rad, tilt_rad=tilt_rad
            )
            try:
                room = measure_room(points_m)
            except EvaluationFailed:
                refused += 1
                continue
            found_m = [room.length.value_m, room.width.value_m, room.height.value_m]
            errors_mm.append(1000.0 * (np.array(found_m) - SIZE_M))
        each_s = (time.process_time() - start_s) / SEEDS
        means = " ".join(f"{value:+6.2f}" for value in np.mean(errors_mm, axis=0))
        largest = np.abs(errors_mm).max()
        print(
            f"{noise_m:<6g} {outliers:<9g} {means}   {largest:7.2f}  {refused:7d}  {each_s:6.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
