"""What is added up over the images of a recording, and how much the shares vary along it."""

from dataclasses import dataclass, field

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray

# A recording is parted into this many stretches to twice as many: so few that what neighbouring
# images share stays mostly within one, and enough to tell the deviation within a quarter.
_STRETCHES = 8
# Fewer say nothing of a deviation.
_STRETCHES_MIN = 4


@dataclass(slots=True)
class FrameTotals:
    """Sums of columns over images that come in blocks, kept apart for stretches of equal length.

    ``by_stretch``: (2 _STRETCHES, C), the number of its rows in use follows from ``images``. A
    stretch becomes twice as long whenever there are too many: memory does not grow.
    """

    columns: tuple[str, ...]
    images: int = 0
    by_stretch: IntArray = field(init=False)
    _length: int = 1

    def __post_init__(self) -> None:
        self.by_stretch = np.zeros((2 * _STRETCHES, len(self.columns)), dtype=np.int64)

    def add(self, block: IntArray) -> None:
        """Add the (B, C) numbers of the next images."""
        while self.images + len(block) > 2 * _STRETCHES * self._length:
            merged = self.by_stretch[0::2] + self.by_stretch[1::2]
            self.by_stretch = np.concatenate([merged, np.zeros_like(merged)])
            self._length *= 2
        stretch = (self.images + np.arange(len(block))) // self._length
        np.add.at(self.by_stretch, stretch, block)
        self.images += len(block)

    def total(self, column: str) -> int:
        """The sum of a column."""
        return int(self._of((column,)).sum())

    def share(self, part: str, whole: tuple[str, ...]) -> tuple[float | None, float | None]:
        """The sum of a column over that of several, and its standard deviation.

        That of a ratio of sums over stretches (Cochran, Sampling Techniques, 1977, eq. 6.13):
        sd^2 = K / (K - 1) sum_k (part_k - share whole_k)^2 / (sum_k whole_k)^2. None where
        unknown.
        """
        parts, wholes = self._of((part,)), self._of(whole)
        if wholes.sum() == 0.0:
            return None, None
        share = float(parts.sum() / wholes.sum())
        stretches = np.count_nonzero(wholes)
        if stretches < _STRETCHES_MIN:
            return share, None
        rest = parts - share * wholes
        variance = stretches / (stretches - 1) * (rest @ rest) / wholes.sum() ** 2
        return share, float(np.sqrt(variance))

    def _of(self, columns: tuple[str, ...]) -> FloatArray:
        places = [self.columns.index(column) for column in columns]
        sums: FloatArray = self.by_stretch[:, places].sum(axis=1).astype(np.float64)
        return sums
