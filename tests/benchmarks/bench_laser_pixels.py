"""Laser points with their pixels: a published result's reprojection error against ours.

    python -m tests.benchmarks.bench_laser_pixels FOLDER

FOLDER holds data.txt (x y u v), config.yaml (the camera) and calibration_result.txt (quaternion
x y z w, then t), which maps laser points to the camera.
"""

import argparse
import os
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fusion_core.calibration.board.laser_pixel_noise import Pairs
from fusion_core.calibration.board.laser_pixels import (
    LaserPixelSettings,
    calibrate_laser_pixels,
)
from fusion_core.calibration.pose_error import pose_error
from fusion_core.calibration.reprojection_rms import reprojection_rms
from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import invert_transform, make_transform
from fusion_core.recordings.calibration_files.intrinsics import read_intrinsics
from fusion_core.recordings.laser_pixel_file import read_laser_pixels


def describe(errors_px: FloatArray) -> str:
    sizes = np.linalg.norm(errors_px, axis=1)
    return f"{reprojection_rms(errors_px):8.2f}  {np.median(sizes):8.2f}  {sizes.max():8.2f}"


def main() -> None:
    data = Path(os.environ.get("SCANLOOM_TEST_DATA", "."))
    default = data / "real" / "calibration" / "laser_pixel_pairs"
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=default)
    folder = parser.parse_args().folder
    points_m, pixels = read_laser_pixels(folder / "data.txt")
    camera = read_intrinsics(folder / "config.yaml", (640, 480))
    values = np.array((folder / "calibration_result.txt").read_text().split(), dtype=np.float64)
    given = make_transform(Rotation.from_quat(values[:4]).as_matrix(), values[4:])
    pairs = Pairs(np.column_stack([points_m, np.zeros(len(points_m))]), pixels, camera)
    print(f"{len(pixels)} pairs, all used by the published result as far as is known\n")
    print("direction of the published quaternion and t   rms [px]")
    for name, T in (
        ("LiDAR to camera", given),
        ("camera to LiDAR", invert_transform(given)),
    ):
        print(f"  {name:42}{reprojection_rms(pairs.residuals_px(T)):10.2f}")
    guessed = calibrate_laser_pixels(points_m, pixels, camera, T_guess=given)
    plain = LaserPixelSettings(huber=100.0, starts=0)
    least_squares = calibrate_laser_pixels(points_m, pixels, camera, plain)
    print(f"\n{'':44}{'rms':>8}  {'median':>8}  {'largest':>8}  [px]")
    published_px = pairs.residuals_px(given)
    for name, errors in (
        ("published, all pairs", published_px),
        ("ours, the pairs it was fitted to", guessed.residuals_px),
        ("ours, each pair by a fit without its tenth", guessed.held_out_px),
        ("(1)-(4) with equal weights, fitted", least_squares.residuals_px),
        ("(1)-(4) with equal weights, left out", least_squares.held_out_px),
    ):
        print(f"{name:44}{describe(errors)}")
    print("\nby tenths that were left out (rms, px)")
    order = np.random.default_rng(0).permutation(len(pixels))
    rows = [(f"{number}", order[number::10]) for number in range(10)]
    print("  tenth     " + "".join(f"{name:>8}" for name, _ in rows))
    for name, errors in (("published", published_px), ("ours", guessed.held_out_px)):
        print(
            f"  {name:10}" + "".join(f"{reprojection_rms(errors[part]):8.2f}" for _, part in rows)
        )
    estimate = guessed.estimate
    difference = pose_error(given, estimate.T_camera_lidar)
    sd = np.array(estimate.sd, dtype=np.float64)
    print(
        "\npublished - ours   "
        f"rotation {np.degrees(difference[:3]).round(2)} deg (sd {np.degrees(sd[:3]).round(2)}),"
        f" translation {(1000 * difference[3:]).round(0)} mm (sd {(1000 * sd[3:]).round(0)})"
    )
    print(f"{estimate.verdict} improved: {estimate.improved}")
    for note in estimate.notes:
        print(f"note: {note}")


if __name__ == "__main__":
    main()
