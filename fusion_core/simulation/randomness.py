"""One seed, many random streams: what one part draws does not shift what another draws."""

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """The parts of a recording that draw at random."""

    WORLD = 0
    PATH = 1
    ODOMETRY = 2
    LIDAR = 3
    CAMERA = 4
    FAULTS = 5


def generator(seed: int, stream: Stream, *indices: int) -> np.random.Generator:
    """The generator of a part, or of the ``indices``-th piece of it."""
    return np.random.default_rng([seed, stream, *indices])
