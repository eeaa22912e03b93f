"""Outliers of a recorded trajectory: poses that jump away and back at an impossible speed."""

from itertools import pairwise

import numpy as np

from fusion_core.model.conventions import NS_PER_S, BoolArray, FloatArray, IntArray

# 360 km/h, set by hand: faster than any vehicle with a 2D LiDAR.
_SPEED_MAX_M_S = 100.0
# Stamp jitter of drivers that read messages in bursts; set by hand.
_STAMP_JITTER_S = 0.01


def find_isolated_poses(stamps_ns: IntArray, positions_m: FloatArray) -> BoolArray:
    """(N,) which of (N,) stamps, strictly increasing, and (N, D) positions jump away and back.

    Steps above the speed limit split the trajectory into runs. A run is isolated if it is shorter
    than both of its neighbours and the step between these is possible; at either end only a single
    pose can be. A trajectory that jumps and stays there, as odometry that is reset to zero, has no
    isolated pose.
    """
    isolated = np.zeros(stamps_ns.size, dtype=np.bool_)
    splits = _find_too_fast_steps(stamps_ns, positions_m, np.arange(stamps_ns.size))
    if not splits.size:
        return isolated
    runs = list(pairwise([0, *(splits + 1).tolist(), stamps_ns.size]))
    before: tuple[int, int] | None = None
    for run, after in zip(runs, [*runs[1:], None], strict=True):
        size = run[1] - run[0]
        if before is None or after is None:
            beside = before or after
            jumps = size == 1 and beside is not None and beside[1] - beside[0] > 1
        else:
            ends = np.array([before[1] - 1, after[0]])
            shorter = size < min(before[1] - before[0], after[1] - after[0])
            jumps = shorter and not _find_too_fast_steps(stamps_ns, positions_m, ends).size
        isolated[slice(*run)] = jumps
        if not jumps:
            before = run
    return isolated


def _find_too_fast_steps(
    stamps_ns: IntArray, positions_m: FloatArray, chosen: IntArray
) -> IntArray:
    """Indices of the steps from each of ``chosen`` to the next that exceed the speed limit."""
    with np.errstate(over="ignore"):
        steps_m = np.linalg.norm(np.diff(positions_m[chosen], axis=0), axis=1)
    longest_m = _SPEED_MAX_M_S * (np.diff(stamps_ns[chosen]) / NS_PER_S + _STAMP_JITTER_S)
    return np.flatnonzero(steps_m > longest_m)
