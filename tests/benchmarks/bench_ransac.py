"""The transform A by this project and by OpenCV: time and error on the same pairs, in one run.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python tests/benchmarks/bench_ransac.py

One thread: the two variables hold numpy's BLAS, cv2.setNumThreads(1) holds OpenCV. 180 pairs of a
room's walls, noise of 1 cm on each axis of D and 2.5 mm on L, outliers uniform within 1.5 m.

Every method meets the same pairs at the same thresholds. OpenCV gets centimetres, since its
MAGSAC has a noise scale of its own in pixels and fails in metres; its other methods do not care.
Error: mean distance over the 180 points, noise-free, between their image and the true one; the
median and the worst over the scenes. Failed: no map, or an error above 5 cm; they count as
infinite. ``oracle`` is least squares on the pairs that are good in truth: what no choice of
inliers is expected to beat, though chance may.
"""

import os
import time

import cv2
import numpy as np

from fusion_core.model.errors import RegistrationFailed
from fusion_core.registration.models import apply_transform, fit_transform
from fusion_core.registration.ransac import RegistrationSettings, register

SCENES = 40
THRESHOLDS_M = (0.03, 0.05, 0.10)
OUTLIERS = (0.3, 0.5, 0.7)
FAILED_M = 0.05
PER_METRE = 100.0

TURN = np.array(
    [[np.cos(0.12), np.sin(0.12), 0.0], [-np.sin(0.12), np.cos(0.12), 0.0], [0.05, -0.03, 1.0]]
)
MAPS = {
    "similarity": np.diag([1.06, 1.06, 1.0]) @ TURN,
    "affine": np.array([[1.1, 0.05, 0.0], [0.0, 0.98, 0.0], [0.0, 0.0, 1.0]]) @ TURN,
    "homography": TURN @ np.array([[1.05, 0.0, 0.03], [0.0, 1.0, 0.02], [0.0, 0.0, 1.0]]),
}


def room_curve(count=180):
    azimuth = np.linspace(-1.2, 1.2, count)
    distance = np.minimum(1.8 / np.abs(np.sin(azimuth) + 1e-12), 3.2 / np.cos(azimuth))
    distance = np.where((azimuth > 0.1) & (azimuth < 0.45), 2.0, distance)
    return distance[:, None] * np.stack([np.sin(azimuth), np.cos(azimuth)], axis=1)


def scene(model, outliers, seed):
    rng = np.random.default_rng(seed)
    curve = room_curve()
    depth = apply_transform(MAPS[model], curve) + rng.normal(0.0, 0.01, curve.shape)
    bad = rng.permutation(len(curve)) < round(outliers * len(curve))
    depth[bad] += rng.uniform(-1.5, 1.5, (bad.sum(), 2))
    return curve + rng.normal(0.0, 0.0025, curve.shape), depth, ~bad


def by_opencv(method):
    def solve(model, lidar, depth, good, threshold_m):
        lidar, depth, threshold = lidar * PER_METRE, depth * PER_METRE, threshold_m * PER_METRE
        if model == "homography":
            H = cv2.findHomography(lidar, depth, method, threshold, maxIters=2000, confidence=0.99)
            H = H[0]
        else:
            estimate = (
                cv2.estimateAffinePartial2D if model == "similarity" else cv2.estimateAffine2D
            )
            H = estimate(
                lidar,
                depth,
                method=method,
                ransacReprojThreshold=threshold,
                maxIters=2000,
                confidence=0.99,
            )[0]
            H = None if H is None else np.vstack([H, [0.0, 0.0, 1.0]])
        if H is None:
            return None
        to_unit = np.diag([PER_METRE, PER_METRE, 1.0])
        return (np.linalg.inv(to_unit) @ H @ to_unit).T

    return solve


def by_us(**chosen):
    def solve(model, lidar, depth, good, threshold_m):
        given = {"model": model, **chosen, "inlier_threshold_m": threshold_m}
        settings = RegistrationSettings(**given)
        try:
            return register(lidar, depth, settings).A
        except RegistrationFailed:
            return None

    return solve


def by_oracle(model, lidar, depth, good, threshold_m):
    return fit_transform(model, lidar[good], depth[good]).A


METHODS = {
    "default n=6": by_us(),
    "auto n=6": by_us(model="auto"),
    "84 draws n=6": by_us(stopping="fixed"),
    "adaptive n=4": by_us(sample_size=4),
    "cv2 RANSAC": by_opencv(cv2.RANSAC),
    "cv2 USAC_ACCURATE": by_opencv(cv2.USAC_ACCURATE),
    "cv2 USAC_MAGSAC": by_opencv(cv2.USAC_MAGSAC),
    "oracle": by_oracle,
}


def main():
    cv2.setNumThreads(1)
    variables = {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    print(f"numpy {np.__version__}, OpenCV {cv2.__version__}, {SCENES} scenes, {variables}")
    print("each cell: median error mm / worst error mm / failed / median ms")
    header = "".join(f"{f'threshold {threshold:.2f} m':>26}" for threshold in THRESHOLDS_M)
    print(f"{'model':<11}{'outliers':<9}{'method':<18}{header}")
    curve = room_curve()
    for model in MAPS:
        truth = apply_transform(MAPS[model], curve)
        for outliers in OUTLIERS:
            scenes = [scene(model, outliers, seed) for seed in range(SCENES)]
            for name, solve in METHODS.items():
                # estimateAffinePartial2D knows no USAC.
                if model == "similarity" and "USAC" in name:
                    continue
                cells = []
                for threshold_m in THRESHOLDS_M:
                    cv2.setRNGSeed(0)
                    solve(model, *scenes[0], threshold_m)
                    errors, times = [], []
                    for pairs in scenes:
                        begin = time.perf_counter()
                        A = solve(model, *pairs, threshold_m)
                        times.append(time.perf_counter() - begin)
                        error = np.inf
                        if A is not None:
                            distance = np.linalg.norm(apply_transform(A, curve) - truth, axis=1)
                            error = float(np.nan_to_num(distance, nan=np.inf).mean())
                        errors.append(error if error <= FAILED_M else np.inf)
                    failed = int(np.isinf(errors).sum())
                    cells.append(
                        f"{np.median(errors) * 1e3:.2f}/{np.max(errors) * 1e3:.1f}/{failed}/"
                        f"{np.median(times) * 1e3:.2f}"
                    )
                row = "".join(f"{cell:>26}" for cell in cells)
                print(f"{model:<11}{outliers:<9.0%}{name:<18}{row}", flush=True)


if __name__ == "__main__":
    main()
