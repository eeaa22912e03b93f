"""The trajectories of all particles as a tree, in which common ancestors are stored once.

After resampling, the particles descend from a few earlier ones: backwards in time, their
trajectories soon merge, and the common beginning is stored once instead of for each particle.
"""

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray

# Steps between two searches for common ancestors, set by hand: a small part of the work.
_MERGE_EVERY = 64


class TrajectoryTree:
    """Values (V,) of each of P particles at each step, along the lines of descent."""

    def __init__(self, particles: int, values: int) -> None:
        self._particles = particles
        self._common: list[FloatArray] = []
        self._values: list[FloatArray] = []
        self._parents: list[IntArray] = []
        self._last_parents = np.arange(particles)
        self._width = values

    @property
    def branching(self) -> int:
        """Steps that are stored for each particle."""
        return len(self._values)

    def add(self, values: FloatArray) -> None:
        """The next step: (P, V)."""
        self._values.append(values.copy())
        self._parents.append(self._last_parents)
        self._last_parents = np.arange(self._particles)
        if len(self._values) % _MERGE_EVERY == 0:
            self._merge()

    def resample(self, parents: IntArray) -> None:
        """Particle i goes on from where particle ``parents[i]`` is."""
        self._last_parents = self._last_parents[parents]

    def path(self, particle: int) -> FloatArray:
        """(steps, V) the values along a particle's trajectory."""
        number = int(self._last_parents[particle])
        path = []
        for values, parents in zip(reversed(self._values), reversed(self._parents), strict=True):
            path.append(values[number])
            number = int(parents[number])
        steps = [*self._common, *reversed(path)]
        return np.array(steps).reshape(-1, self._width)

    def _merge(self) -> None:
        """Move the steps with a single ancestor to the common beginning."""
        numbers = np.unique(self._last_parents)
        step = len(self._values)
        while step > 0 and numbers.size > 1:
            step -= 1
            numbers = np.unique(self._parents[step][numbers])
        # All come from this one of step - 1.
        if step == 0:
            return
        number = int(numbers[0])
        common = []
        for before in range(step - 1, -1, -1):
            common.append(self._values[before][number].copy())
            number = int(self._parents[before][number])
        self._common.extend(reversed(common))
        del self._values[:step]
        del self._parents[:step]
