"""Runs of consecutive samples that are not good: how wide the gap is in which a sample lies."""

import numpy as np

from fusion_core.model.conventions import BoolArray, IntArray


def run_bounds(in_gap: BoolArray) -> tuple[IntArray, IntArray]:
    """(..., N) first and last position of the run, along the last axis, around each sample.

    Where ``in_gap`` is false there is no run: last = first - 2.
    """
    size = in_gap.shape[-1]
    position = np.arange(size)
    before = np.maximum.accumulate(np.where(in_gap, -1, position), axis=-1)
    after = np.where(in_gap, size, position)
    after = np.minimum.accumulate(after[..., ::-1], axis=-1)[..., ::-1]
    return before + 1, after - 1
