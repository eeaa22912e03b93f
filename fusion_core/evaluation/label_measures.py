"""The automatic classes measured against a person's labels, sample by sample, on each side."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import IntArray, read_only
from fusion_core.model.labels import SensorKind

SIDES: tuple[SensorKind, SensorKind] = ("lidar", "depth")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelMeasures:
    """Counts, from which every measure follows; the counts of recordings add up.

    ``confusion``: (2, 4, 4) labelled samples by side (SIDES), class that the person gave, automatic
    class. Samples that are labelled unsure, and pixels that no beam is paired with, are in none. A
    sample that is judged in several frames counts in each.
    """

    confusion: IntArray

    def __post_init__(self) -> None:
        if self.confusion.shape != (2, 4, 4):
            raise ValueError(f"confusion must be (2, 4, 4), got {self.confusion.shape}")
        read_only(self.confusion)

    def recall(self, side: SensorKind, noise: NoiseClass) -> float | None:
        """Of the samples that the person gave a class, the fraction that has it."""
        counts = self.confusion[SIDES.index(side)]
        return _fraction(counts[noise, noise], counts[noise].sum())

    def precision(self, side: SensorKind, noise: NoiseClass) -> float | None:
        """Of the labelled samples that have a class, the fraction to which the person gave it."""
        counts = self.confusion[SIDES.index(side)]
        return _fraction(counts[noise, noise], counts[:, noise].sum())

    def to_json(self) -> dict[str, Any]:
        """By side and class; None where there is nothing to count."""
        return {
            side: {
                "samples": int(self.confusion[number].sum()),
                "confusion": self.confusion[number].tolist(),
                "classes": {
                    noise.name.lower(): {
                        "precision": self.precision(side, noise),
                        "recall": self.recall(side, noise),
                        "labelled": int(self.confusion[number, noise].sum()),
                        "automatic": int(self.confusion[number, :, noise].sum()),
                    }
                    for noise in NoiseClass
                },
            }
            for number, side in enumerate(SIDES)
        }


def count_confusion(labels: IntArray, classes: IntArray) -> IntArray:
    """(4, 4) samples by label and automatic class. ``labels``: (n,) codes of Label or NO_LABEL;
    ``classes``: (n,) codes of NoiseClass, -1 for none."""
    counted = np.isin(labels, list(NoiseClass)) & (classes >= 0)
    counts = np.zeros((4, 4), dtype=np.int64)
    np.add.at(counts, (labels[counted], classes[counted]), 1)
    return counts


def _fraction(part: np.integer[Any], whole: np.integer[Any]) -> float | None:
    return float(part) / float(whole) if whole else None
