"""PL-ICP against 3D libraries and the Cramér-Rao bound, on the same pairs of sweeps, in one run.

    OMP_NUM_THREADS=1 python -m tests.benchmarks.bench_scan_matching

200 pairs a row in the room of scan_matching_room.py, a full turn of beams, 1 cm of Gaussian noise
on each range of both sweeps. The second sweep is displaced by a distance uniform up to the row's
limit, in a uniform direction, and turned uniformly within ± its limit.

Every method starts at the identity; what it does to find a better start counts in its time, as
does all preparation (tables, normals, trees). ``after search`` gives a 3D library the start that
our correlative search finds, with that search's time. ``identity as guess`` is PL-ICP that refines
the identity, and searches only where that is refused. A failure is more than 5 cm or 1° off, or no
answer; medians are over all pairs. Times are the process's own, the median over the pairs, compiled
before.

The libraries match in space. Open3D gets normals of the flat points from their 10 nearest
neighbours; small_gicp estimates its own in space, so it gets the sweep at three heights.

NEES: mean over the pairs of eᵀ C⁻¹ e, e the error of (x, y, yaw) and C the stated covariance;
3 for an honest one, and within the interval in 95 % of the runs. ``bound``: what no matcher of two
noisy sweeps can beat (median over draws of an error with the bound's covariance).
"""

import os
import time
from collections.abc import Callable
from importlib.metadata import version

import numpy as np
import open3d as o3d
import small_gicp
from scipy.spatial import cKDTree
from scipy.stats import chi2

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import RegistrationFailed
from fusion_core.model.geometry import planar_from_transform, transform_from_planar
from fusion_core.registration.correlative import SearchWindow, find_best_pose
from fusion_core.registration.likelihood_grid import make_likelihood_pyramid
from fusion_core.registration.pl_icp import match_scans
from tests.benchmarks.scan_matching_room import Pair, bound, compose, draw_pair, inverse

PAIRS = 200
SIGMA_M = 0.01
SEED = 20240
# Beams, largest displacement in metres, largest turn in degrees.
ROWS = ((720, 0.5, 30.0), (720, 0.2, 45.0), (360, 0.1, 5.0))
FAILED_M, FAILED_DEG = 0.05, 1.0
PAIR_DISTANCE_M = 0.3
NEIGHBOURS = 10

Answer = tuple[FloatArray, FloatArray | None]


def points_of(pair: Pair, ranges_m: FloatArray) -> FloatArray:
    angles_rad = pair.angle_min_rad + pair.angle_increment_rad * np.arange(ranges_m.size)
    return ranges_m[:, None] * np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)


def pl_icp(guess: FloatArray | None = None):
    def solve(pair: Pair) -> Answer:
        match = match_scans(
            pair.first_m,
            pair.second_m,
            angle_min_rad=pair.angle_min_rad,
            angle_increment_rad=pair.angle_increment_rad,
            guess=guess,
        )
        return match.pose_first_second, match.covariance

    return solve


def search(pair: Pair) -> FloatArray:
    """The start that PL-ICP finds for itself."""
    pyramid = make_likelihood_pyramid(
        points_of(pair, pair.first_m), resolution_m=0.1, truncation_m=0.2, levels=5
    )
    points_m = points_of(pair, pair.second_m)
    return find_best_pose(
        pyramid,
        points_m[:: points_m.shape[0] // 90],
        SearchWindow(translation_m=1.0, rotation_rad=np.pi / 3.0),
        step_rad=0.0175,
    )


def at_height(points_m: FloatArray, height_m: float) -> FloatArray:
    return np.column_stack([points_m, np.full(points_m.shape[0], height_m)])


def open3d_plane(start: Callable[[Pair], FloatArray]):
    def solve(pair: Pair) -> Answer:
        first, second = points_of(pair, pair.first_m), points_of(pair, pair.second_m)
        near = first[cKDTree(first).query(first, k=NEIGHBOURS)[1]]
        near = near - near.mean(axis=1, keepdims=True)
        normals = np.linalg.eigh(near.swapaxes(1, 2) @ near)[1][:, :, 0]
        target, source = o3d.geometry.PointCloud(), o3d.geometry.PointCloud()
        target.points = o3d.utility.Vector3dVector(at_height(first, 0.0))
        target.normals = o3d.utility.Vector3dVector(at_height(normals, 0.0))
        source.points = o3d.utility.Vector3dVector(at_height(second, 0.0))
        result = o3d.pipelines.registration.registration_icp(
            source,
            target,
            PAIR_DISTANCE_M,
            transform_from_planar(start(pair)),
            o3d.pipelines.registration.TransformationEstimationPointToPlane(),
            o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=50),
        )
        return planar_from_transform(np.asarray(result.transformation)), None

    return solve


def gicp(kind: str, start: Callable[[Pair], FloatArray]):
    def cloud(points_m: FloatArray):
        raised = np.vstack([at_height(points_m, height) for height in (-0.1, 0.0, 0.1)])
        return small_gicp.preprocess_points(
            raised, downsampling_resolution=1e-4, num_neighbors=3 * NEIGHBOURS, num_threads=1
        )

    def solve(pair: Pair) -> Answer:
        target, tree = cloud(points_of(pair, pair.first_m))
        source, _ = cloud(points_of(pair, pair.second_m))
        result = small_gicp.align(
            target,
            source,
            tree,
            init_T_target_source=transform_from_planar(start(pair)),
            registration_type=kind,
            max_correspondence_distance=PAIR_DISTANCE_M,
            num_threads=1,
            max_iterations=50,
        )
        return planar_from_transform(result.T_target_source), None

    return solve


def identity(pair: Pair) -> FloatArray:
    return np.zeros(3)


METHODS: dict[str, Callable[[Pair], Answer]] = {
    "PL-ICP": pl_icp(),
    "PL-ICP, identity as guess": pl_icp(np.zeros(3)),
    "Open3D point-to-plane": open3d_plane(identity),
    "Open3D, after search": open3d_plane(search),
    "small_gicp PLANE_ICP": gicp("PLANE_ICP", identity),
    "small_gicp, after search": gicp("PLANE_ICP", search),
    "small_gicp GICP": gicp("GICP", identity),
    "GICP, after search": gicp("GICP", search),
}


def error_of(pose: FloatArray, truth: FloatArray) -> FloatArray:
    """(3,) x and y in the first frame, yaw wrapped."""
    turn = compose(inverse(truth), pose)[2]
    return np.array([pose[0] - truth[0], pose[1] - truth[1], turn])


def measure(solve: Callable[[Pair], Answer], pairs: list[Pair]) -> tuple[str, ...]:
    """Median mm, median degrees, failures, median ms, mean NEES."""
    solve(pairs[0])
    shifts, turns, times, nees = [], [], [], []
    for pair in pairs:
        begin = time.process_time()
        try:
            pose, covariance = solve(pair)
        except RegistrationFailed:
            pose, covariance = np.full(3, np.inf), None
        times.append(time.process_time() - begin)
        error = error_of(pose, pair.pose_first_second) if np.isfinite(pose).all() else pose
        shifts.append(float(np.hypot(error[0], error[1])))
        turns.append(abs(float(np.degrees(error[2]))))
        if covariance is not None:
            nees.append(float(error @ np.linalg.solve(covariance, error)))
    failed = np.greater(shifts, FAILED_M) | np.greater(turns, FAILED_DEG)
    return (
        f"{np.median(shifts) * 1e3:.2f}",
        f"{np.median(turns):.4f}",
        f"{failed.sum()}",
        f"{np.median(times) * 1e3:.2f}",
        f"{np.mean(nees):.2f}" if nees else "-",
    )


def bound_of(pairs: list[Pair], rng: np.random.Generator) -> tuple[str, ...]:
    draws = np.concatenate(
        [rng.multivariate_normal(np.zeros(3), bound(pair, SIGMA_M), 100) for pair in pairs]
    )
    shift = np.median(np.hypot(draws[:, 0], draws[:, 1]))
    return f"{shift * 1e3:.2f}", f"{np.degrees(np.median(np.abs(draws[:, 2]))):.4f}", "-", "-", "-"


def main() -> None:
    low, high = chi2.ppf([0.025, 0.975], 3 * PAIRS) / PAIRS
    print(
        f"Open3D {o3d.__version__}, small_gicp {version('small_gicp')}, {PAIRS} pairs a row, "
        f"seed {SEED}, OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS')}"
    )
    print(f"mean NEES of an honest covariance, 95 % interval: {low:.2f} to {high:.2f}")
    titles = ("median mm", "median deg", "failures", "ms", "mean NEES")
    print(f"{'row':<22}{'method':<26}" + "".join(f"{title:>12}" for title in titles))
    for beams, shift_m, turn_deg in ROWS:
        rng = np.random.default_rng(SEED)
        pairs = [
            draw_pair(rng, beams, shift_m, np.radians(turn_deg), SIGMA_M) for _ in range(PAIRS)
        ]
        row = f"{beams}, {shift_m:g} m, {turn_deg:g}°"
        cells = bound_of(pairs, rng)
        print(f"{row:<22}{'bound':<26}" + "".join(f"{cell:>12}" for cell in cells))
        for name, solve in METHODS.items():
            cells = measure(solve, pairs)
            print(f"{row:<22}{name:<26}" + "".join(f"{cell:>12}" for cell in cells), flush=True)


if __name__ == "__main__":
    main()
