"""Which poses of a track jump away and back faster than anything moves."""

from itertools import pairwise

import numpy as np

from fusion_core.model.conventions import NS_PER_S, BoolArray, FloatArray, IntArray

# No vehicle that carries a 2D LiDAR is as fast: 360 km/h.
_SPEED_MAX_M_S = 100.0
# A driver that stamps what it reads in bursts is so much too early or too late.
_UNEVEN_S = 0.01


def find_isolated_poses(stamps_ns: IntArray, positions_m: FloatArray) -> BoolArray:
    """(N,) which of (N,) stamps, strictly increasing, and (N, D) positions jump away and back.

    Steps that are too fast part the track into runs. A run jumps where it is shorter than both of
    its neighbours, and from the one to the other is a step that can be; at either end of the track
    a single pose does. A track that jumps and stays there, as odometry that is set to zero, has no
    such pose.
    """
    lone = np.zeros(stamps_ns.size, dtype=np.bool_)
    parted = _find_too_fast_steps(stamps_ns, positions_m, np.arange(stamps_ns.size))
    if not parted.size:
        return lone
    runs = list(pairwise([0, *(parted + 1).tolist(), stamps_ns.size]))
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
        lone[slice(*run)] = jumps
        if not jumps:
            before = run
    return lone


def _find_too_fast_steps(
    stamps_ns: IntArray, positions_m: FloatArray, chosen: IntArray
) -> IntArray:
    """Indices of the steps from each of ``chosen`` to the next that nothing can make."""
    with np.errstate(over="ignore"):
        steps_m = np.linalg.norm(np.diff(positions_m[chosen], axis=0), axis=1)
    longest_m = _SPEED_MAX_M_S * (np.diff(stamps_ns[chosen]) / NS_PER_S + _UNEVEN_S)
    return np.flatnonzero(steps_m > longest_m)
