"""Samples that a person has marked, to say what they are."""

import numpy as np

from fusion_core.model.conventions import BoolArray, IntArray
from fusion_core.model.labels import Capture, CaptureLabels


class Selection:
    """Marked samples of some captures."""

    def __init__(self) -> None:
        self._masks: dict[Capture, BoolArray] = {}

    def __bool__(self) -> bool:
        return any(mask.any() for mask in self._masks.values())

    def clear(self) -> None:
        """Mark nothing."""
        self._masks.clear()

    def add(self, capture: Capture, row: IntArray, column: IntArray) -> None:
        """Mark samples, (N,) rows and columns; negative ones are none."""
        inside = (row >= 0) & (column >= 0)
        shape = capture.rows, capture.columns
        mask = self._masks.setdefault(capture, np.zeros(shape, dtype=np.bool_))
        mask[row[inside], column[inside]] = True

    def counts(self) -> tuple[int, int]:
        """How many beams and how many pixels are marked."""
        counted = {"lidar": 0, "depth": 0}
        for capture, mask in self._masks.items():
            counted[capture.sensor] += int(mask.sum())
        return counted["lidar"], counted["depth"]

    def labels(self, label: int) -> list[CaptureLabels]:
        """One label for all that is marked."""
        marked = []
        for capture, mask in self._masks.items():
            row, column = np.nonzero(mask)
            if row.size:
                marked.append(CaptureLabels.of_samples(capture, row, column, label))
        return marked
