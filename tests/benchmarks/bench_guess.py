"""Extrinsics refined from a disturbed guess, on real street scenes.

    python -m tests.benchmarks.bench_guess [--starts N] [--seed N] [--pictures FOLDER] [SCENE ...]

Each scene's given extrinsics are disturbed by up to 2 degrees and 10 cm (uniform in a ball each),
and refined. Printed are the share that comes back within 0.3 degrees and 5 cm of the given ones,
and the share that ends worse than it began: farther from the given extrinsics by the mean distance,
in pixels, between where the visible points appear under the two (``image``), and by the rotation
and the translation alone. The given extrinsics are no truth: they are as good as their authors'
calibration. All starts of a scene share its one cloud and image: what their errors have in common
is one draw, so that the error squared in the covariance says something of several scenes together
alone. ``--pictures`` writes the cloud over the image at the first guess, at its result and
at the given extrinsics.
"""

import argparse
import os
import time
from collections import Counter
from pathlib import Path

import numpy as np

from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.calibration.refinement.guess_refinement import GuessRefinement, refine_from_guess
from fusion_core.exporting.figures_calibration import CloudOverImage, write_cloud_over_image
from fusion_core.lens.projection import inside_image, project_points
from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import transform_points
from tests.benchmarks.street_scenes import SCENES, StreetScene, read_scene

ROTATION_MAX_RAD, TRANSLATION_MAX_M = np.radians(2.0), 0.10
_RETURNED_RAD, _RETURNED_M = np.radians(0.3), 0.05


def disturbances(count: int, seed: int) -> FloatArray:
    """(count, 6) errors, uniform in a ball of rotations and in one of translations."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 2, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    lengths = np.cbrt(rng.random((count, 2))) * (ROTATION_MAX_RAD, TRANSLATION_MAX_M)
    return (directions * lengths[:, :, np.newaxis]).reshape(count, 6)


def mean_displacement_px(scene: StreetScene, T_camera_lidar: FloatArray) -> float:
    """Mean distance between pixels of the points in the image by the given extrinsics and by
    others."""
    given_px = project_points(transform_points(scene.T_given, scene.points_m), scene.intrinsics)
    inside = inside_image(given_px, scene.intrinsics)
    moved = transform_points(T_camera_lidar, scene.points_m[inside])
    moved_px = project_points(moved, scene.intrinsics)
    return float(np.nanmean(np.linalg.norm(moved_px - given_px[inside], axis=1)))


def distances(scene: StreetScene, T_camera_lidar: FloatArray) -> FloatArray:
    """(3,) from the given extrinsics: pixels, degrees, centimetres."""
    error = pose_error(scene.T_given, T_camera_lidar)
    return np.array(
        [
            mean_displacement_px(scene, T_camera_lidar),
            np.degrees(np.linalg.norm(error[:3])),
            100.0 * np.linalg.norm(error[3:]),
        ]
    )


def report(name: str, scene: StreetScene, starts: int, seed: int) -> GuessRefinement:
    """Refine from each disturbed guess, and print what became of it; the first result."""
    rows, seconds, verdicts, normalised = [], [], Counter[str](), []
    results: list[GuessRefinement] = []
    print(f"\n{name}")
    print("start px   deg    cm |   end px   deg    cm | basin | verdict", flush=True)
    for disturbance in disturbances(starts, seed):
        T_guess = apply_pose_error(scene.T_given, disturbance)
        began = time.perf_counter()
        refined = refine_from_guess(
            scene.points_m, scene.intensity, scene.grey, scene.intrinsics, T_guess
        )
        seconds.append(time.perf_counter() - began)
        estimate = refined.estimate
        before, after = distances(scene, T_guess), distances(scene, estimate.T_camera_lidar)
        rows.append((before, after))
        results.append(refined)
        error = pose_error(scene.T_given, estimate.T_camera_lidar)
        normalised.append(float(error @ np.linalg.solve(estimate.covariance, error)))
        verdicts[estimate.verdict.split(":")[0] if not estimate.improved else "improved"] += 1
        shown = " | ".join(f"{d[0]:8.1f} {d[1]:5.2f} {d[2]:5.1f}" for d in (before, after))
        print(f"{shown} |  {estimate.basin:4.2f} | {estimate.verdict}", flush=True)
    before, after = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    # Rounding: a guess that is kept is as good as itself.
    worse = (after > before + 1e-9).mean(axis=0)
    returned = (after[:, 1] <= np.degrees(_RETURNED_RAD)) & (after[:, 2] <= 100.0 * _RETURNED_M)
    improved = np.array([result.estimate.improved for result in results])
    print(f"within 0.3 deg and 5 cm of the given extrinsics: {returned.mean():.2f}")
    print(f"within 0.3 deg: {(after[:, 1] <= np.degrees(_RETURNED_RAD)).mean():.2f}")
    print(
        f"worse than it began: image {worse[0]:.2f}, rotation {worse[1]:.2f}, "
        f"translation {worse[2]:.2f}"
    )
    for what, median in (("start", np.median(before, axis=0)), ("end", np.median(after, axis=0))):
        print(f"median {what}: {median[0]:.1f} px, {median[1]:.2f} deg, {median[2]:.1f} cm")
    print(f"guess replaced: {improved.mean():.2f}; kept: {dict(verdicts)}")
    print(f"error squared in its covariance, median (6 expected): {np.median(normalised):.1f}")
    print(f"seconds a scene: median {np.median(seconds):.1f}, longest {max(seconds):.1f}")
    nats = np.array(
        [
            (
                result.information_before,
                result.information_after,
                result.evidence.information(result.T_best).sum(),
                result.evidence.information(scene.T_given).sum(),
            )
            for result in results
        ]
    )
    at = np.median(nats, axis=0)
    print(
        f"evidence (nats, median): guess {at[0]:.0f}, result {at[1]:.0f}, best pose {at[2]:.0f}, "
        f"given extrinsics {at[3]:.0f}; best above given in {(nats[:, 2] > nats[:, 3]).mean():.2f}"
    )
    _report_spread(scene, results)
    return results[0]


def _report_spread(scene: StreetScene, results: list[GuessRefinement]) -> None:
    """Where the results that were accepted agree, as an error of the given extrinsics."""
    accepted = [result for result in results if result.estimate.improved]
    if not accepted:
        return
    errors = np.array([pose_error(scene.T_given, result.T_best) for result in accepted])
    units = np.array([np.degrees(1.0)] * 3 + [100.0] * 3)
    print("given minus found (deg, cm), median:", (np.median(errors, axis=0) * units).round(2))
    print("their spread (1.4826 MAD):          ", (_spread(errors) * units).round(2))


def _spread(errors: FloatArray) -> FloatArray:
    spread: FloatArray = 1.4826 * np.median(np.abs(errors - np.median(errors, axis=0)), axis=0)
    return spread


def _write_picture(path: Path, name: str, scene: StreetScene, refined: GuessRefinement) -> None:
    poses = (
        ("guess", refined.estimate.T_guess),
        ("result", refined.estimate.T_camera_lidar),
        ("given extrinsics", scene.T_given),
    )
    clouds = []
    for title, T_camera_lidar in poses:
        assert T_camera_lidar is not None
        in_camera = transform_points(T_camera_lidar, scene.points_m)
        pixels = project_points(in_camera, scene.intrinsics)
        inside = inside_image(pixels, scene.intrinsics)
        range_m = np.linalg.norm(in_camera[inside], axis=1)
        nats = refined.evidence.information(T_camera_lidar).sum()
        clouds.append(
            CloudOverImage(
                pixels=pixels[inside], range_m=range_m, title=f"{title}: {nats:.0f} nats shared"
            )
        )
    write_cloud_over_image(path, name, scene.grey, clouds)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1, help="of the disturbances")
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("scenes", nargs="*", default=list(SCENES))
    given = parser.parse_args()
    data = os.environ.get("SCANLOOM_TEST_DATA")
    if not data:
        parser.error("SCANLOOM_TEST_DATA is not set.")
    for name in given.scenes:
        scene = read_scene(Path(data), name)
        first = report(name, scene, given.starts, given.seed)
        if given.pictures is not None:
            _write_picture(given.pictures / f"{name}.png", name, scene, first)


if __name__ == "__main__":
    main()
