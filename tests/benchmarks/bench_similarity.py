"""Time of the masked Pearson field against its peers, on one thread.

    python -m tests.benchmarks.bench_similarity

Ours has 10 % holes in runs on both sides. The peers that know no mask get complete data, their
best case; the masked peer gets the holes. The times are of the processor, not of the clock: other
work on the machine counts little, and a hidden thread would show.
"""

import os

# Read once, when the libraries below are imported.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")
os.environ.update(NUMBA_NUM_THREADS="1")

import time
from collections.abc import Callable
from importlib.metadata import version
from timeit import Timer

import cv2
import numpy as np
import stumpy
from skimage.feature import match_template
from skimage.registration._masked_phase_cross_correlation import cross_correlate_masked

from fusion_core.alignment.similarity import similarity_field, similarity_fields
from fusion_core.freed_memory import keep_freed_memory

CASES = ((240, 180, 240), (320, 960, 1280))
ROUNDS = 7
MASKED = {"ours", "ours, all four metrics", "skimage cross_correlate_masked"}


def with_holes(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A copy with 10 % of each line missing, in runs of up to a twentieth of the line."""
    result = values.copy()
    longest = result.shape[-1] // 20
    for line in result.reshape(-1, result.shape[-1]):
        while np.isnan(line).mean() < 0.1:
            start = rng.integers(0, line.size)
            line[start : start + rng.integers(1, longest + 1)] = np.nan
    return result


def contenders(height: int, width: int, length: int) -> dict[str, Callable[[], object]]:
    """Each contender's whole field, ready to be called."""
    rng = np.random.default_rng(0)
    curve = 3.0 + 0.1 * rng.normal(size=length).cumsum()
    rows = curve[(length - width) // 2 :][:width] + rng.normal(0.0, 0.02, (height, width))
    curve_holes, rows_holes = with_holes(curve, rng), with_holes(rows, rng)
    image, rows_32 = curve[np.newaxis].astype(np.float32), rows.astype(np.float32)
    curve_mask, rows_mask = np.isfinite(curve_holes), np.isfinite(rows_holes)
    curve_0, rows_0 = np.nan_to_num(curve_holes), np.nan_to_num(rows_holes)

    def masked_peer() -> list[np.ndarray]:
        return [
            cross_correlate_masked(curve_0, row, curve_mask, mask, axes=(0,), overlap_ratio=0.5)
            for row, mask in zip(rows_0, rows_mask, strict=True)
        ]

    return {
        "ours": lambda: similarity_field(curve_holes, rows_holes, metric="pearson"),
        "ours, all four metrics": lambda: similarity_fields(
            curve_holes, rows_holes, metrics=("pearson", "cosine", "inverse_cosine", "euclidean")
        ),
        "cv2.matchTemplate": lambda: [
            cv2.matchTemplate(image, row[np.newaxis], cv2.TM_CCOEFF_NORMED) for row in rows_32
        ],
        "skimage match_template": lambda: [
            match_template(image, row[np.newaxis]) for row in rows_32
        ],
        "stumpy.mass": lambda: [stumpy.mass(row, curve) for row in rows],
        "skimage cross_correlate_masked": masked_peer,
    }


def measure(calls: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Median milliseconds a call, over rounds in which each contender runs for at least 50 ms."""
    timers = {name: Timer(call, timer=time.process_time) for name, call in calls.items()}
    times: dict[str, list[float]] = {name: [] for name in calls}
    for timer in timers.values():
        timer.timeit(1)
    for _ in range(ROUNDS):
        for name, timer in timers.items():
            number = 1 + int(0.05 / timer.timeit(1))
            times[name].append(1e3 * timer.timeit(number) / number)
    return {name: float(np.median(values)) for name, values in times.items()}


def main() -> None:
    cv2.setNumThreads(1)
    # As the program begins, for all contenders.
    keep_freed_memory()
    packages = ("numpy", "numba", "opencv-python-headless", "scikit-image", "stumpy")
    print("1 thread;", ", ".join(f"{package} {version(package)}" for package in packages))
    for case in CASES:
        height, width, length = case
        medians = measure(contenders(*case))
        print(f"\n{height} rows x {width} against {length}: median of {ROUNDS} rounds")
        print(f"{'':32}{'masks':>6}{'ms':>10}{'x ours':>9}")
        for name, median in sorted(medians.items(), key=lambda item: item[1]):
            masks = "yes" if name in MASKED else "no"
            print(f"{name:32}{masks:>6}{median:10.2f}{median / medians['ours']:9.1f}")


if __name__ == "__main__":
    main()
