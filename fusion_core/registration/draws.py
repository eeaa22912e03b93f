"""The random draws of RANSAC (Xu 2024 §2.3.1): made in blocks, and replayed one by one."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.registration.models import TransformModel, residuals, solve_least_squares


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Draw:
    """One draw: ``pairs`` (n,) of the m given pairs, the transform ``A`` (3, 3) fitted to them.

    ``is_inlier``: (m,) pairs that agree with A, ``inliers`` their number. A is NaN where the n
    pairs do not determine it.
    """

    index: int
    pairs: IntArray
    A: FloatArray
    inliers: int
    is_inlier: BoolArray

    def __post_init__(self) -> None:
        read_only(self.pairs)
        read_only(self.A)
        read_only(self.is_inlier)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Draws:
    """The draws of one model, recomputed from the seed on demand: ``draws[i]``, iteration.

    A whole block is recomputed as it was at first, so a replay equals the original to the bit.
    ``lidar_points_m`` and ``depth_points_m``: (m, 2) as given, NaN where missing.
    """

    model: TransformModel
    count: int
    block_size: int
    sample_size: int
    inlier_threshold_m: float
    seed: int
    lidar_points_m: FloatArray
    depth_points_m: FloatArray

    def __post_init__(self) -> None:
        read_only(self.lidar_points_m)
        read_only(self.depth_points_m)

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> Draw:
        if not -self.count <= index < self.count:
            raise IndexError(f"draw {index} of {self.count}")
        block, within = divmod(index % self.count, self.block_size)
        return self._block(block)[within]

    def __iter__(self) -> Iterator[Draw]:
        for block in range(-(-self.count // self.block_size)):
            yield from self._block(block)

    def _block(self, block: int) -> list[Draw]:
        valid = np.flatnonzero(find_valid_pairs(self.lidar_points_m, self.depth_points_m))
        lidar, depth = self.lidar_points_m[valid], self.depth_points_m[valid]
        first = block * self.block_size
        size = min(self.block_size, self.count - first)
        samples = draw_samples(valid.size, self.sample_size, size, (self.seed, block))
        A, agree = evaluate_samples(self.model, lidar, depth, samples, self.inlier_threshold_m)
        masks = np.zeros((size, self.lidar_points_m.shape[0]), dtype=np.bool_)
        masks[:, valid] = agree
        return [
            Draw(
                index=first + i,
                pairs=valid[samples[i]],
                A=A[i].copy(),
                inliers=int(agree[i].sum()),
                is_inlier=masks[i].copy(),
            )
            for i in range(size)
        ]


def find_valid_pairs(lidar_points_m: FloatArray, depth_points_m: FloatArray) -> BoolArray:
    """(m,) pairs whose two points are both finite."""
    given = np.isfinite(np.hstack([lidar_points_m, depth_points_m]))
    valid: BoolArray = np.logical_and.reduce(given, axis=1)
    return valid


def draw_samples(pairs: int, sample_size: int, draws: int, seed: tuple[int, int]) -> IntArray:
    """(draws, sample_size) distinct indices below ``pairs``, each subset equally likely."""
    generator = np.random.default_rng(seed)
    ranks = [generator.integers(0, pairs - k, size=draws) for k in range(sample_size)]
    samples: IntArray = _samples_of_ranks(np.stack(ranks, axis=1))
    return samples


@compiled()
def _samples_of_ranks(ranks: IntArray) -> IntArray:
    """(draws, sample_size) indices: each rank is among the pairs not drawn yet, and is moved past
    the drawn ones in rising order."""
    draws, size = ranks.shape
    samples = np.empty((draws, size), dtype=np.int64)
    taken = np.empty(size, dtype=np.int64)
    for draw in range(draws):
        for k in range(size):
            index = ranks[draw, k]
            place = 0
            while place < k and index >= taken[place]:
                index += 1
                place += 1
            for moved in range(k, place, -1):
                taken[moved] = taken[moved - 1]
            taken[place] = index
            samples[draw, k] = index
    return samples


def evaluate_samples(
    model: TransformModel,
    lidar_m: FloatArray,
    depth_m: FloatArray,
    samples: IntArray,
    threshold_m: float,
) -> tuple[FloatArray, BoolArray]:
    """A (draws, 3, 3) of each sample, and (draws, m) which pairs are its inliers."""
    A = solve_least_squares(model, lidar_m[samples], depth_m[samples])
    agree: BoolArray = np.less_equal(residuals(A, lidar_m, depth_m), threshold_m)
    return A, agree


def count_draws_needed(inlier_ratio: float, sample_size: int, confidence: float) -> float:
    """N = ln(1 - p) / ln(1 - cⁿ) (Fischler and Bolles 1981): draws for confidence p in a clean one.

    ``inlier_ratio`` is c; infinite where it is 0.
    """
    clean = inlier_ratio**sample_size
    if clean >= 1.0:
        return 1.0
    return float(np.log1p(-confidence) / np.log1p(-clean)) if clean > 0.0 else np.inf
