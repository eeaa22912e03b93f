"""Independent random streams from one seed: draws of one part do not shift those of another."""

from enum import IntEnum

import numpy as np


class RandomStream(IntEnum):
    """The parts of a simulation that draw random numbers."""

    WORLD = 0
    PATH = 1
    ODOMETRY = 2
    LIDAR = 3
    CAMERA = 4
    FAULTS = 5
    FEATURES = 6
    TURNING_RIG = 7
    TEXTURES = 8
    COLOR = 9


def make_generator(seed: int, stream: RandomStream, *indices: int) -> np.random.Generator:
    """The generator of a part, or of its item ``indices``."""
    return np.random.default_rng([seed, stream, *indices])
