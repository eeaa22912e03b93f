"""A layer of labels in memory."""

import hashlib

import numpy as np

from fusion_core.model.labels import Capture, CaptureLabels


class MemoryLayer:
    """Labels by capture, in the order in which they were put in."""

    def __init__(self, *labels: CaptureLabels, name: str = "anna") -> None:
        self.name = name
        self._labels = {own.capture: own for own in labels}

    @property
    def sha256(self) -> str:
        digest = hashlib.sha256()
        for capture, own in sorted(self._labels.items(), key=lambda entry: entry[0]):
            digest.update(repr((capture, own.row, own.column, own.label)).encode())
        return digest.hexdigest()

    def put(self, labels: CaptureLabels) -> None:
        self._labels[labels.capture] = labels

    def captures(self) -> list[Capture]:
        return list(self._labels)

    def labels_of(self, capture: Capture) -> CaptureLabels:
        nothing = np.empty(0, dtype=np.int64)
        empty = CaptureLabels(
            capture=capture, row=nothing, column=nothing.copy(), label=nothing.copy()
        )
        return self._labels.get(capture, empty)
