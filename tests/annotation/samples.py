"""Captures, labels and authors that the tests of the journal share."""

from collections.abc import Mapping

import numpy as np

from fusion_core.annotation.identity import Author, RecordingIdentity
from fusion_core.annotation.store import LabelStore
from fusion_core.model.labels import Capture, CaptureLabels

RECORDING = RecordingIdentity("room.mcap", "ab" * 32)
SCAN = Capture("lidar", "/scan", 1_000, 0, 1, 12)
SECOND_SCAN = Capture("lidar", "/scan", 1_000, 1, 1, 12)
IMAGE = Capture("depth", "/depth", 900, 0, 4, 5)
CAPTURES = (IMAGE, SCAN, SECOND_SCAN)
"""In order."""

ANNA, BEN = Author("anna"), Author("ben")


def labels(capture: Capture, codes: Mapping[tuple[int, int], int]) -> CaptureLabels:
    """Codes by (row, column)."""
    places = np.array(list(codes), dtype=np.int64).reshape(-1, 2)
    return CaptureLabels.of_samples(
        capture, places[:, 0], places[:, 1], np.array(list(codes.values()), dtype=np.int64)
    )


def codes_of(given: CaptureLabels) -> dict[tuple[int, int], int]:
    """By (row, column)."""
    places = zip(given.row.tolist(), given.column.tolist(), strict=True)
    return dict(zip(places, given.label.tolist(), strict=True))


def state_of(store: LabelStore, layer: str) -> dict[Capture, dict[tuple[int, int], int]]:
    """All labels of a layer."""
    return {given.capture: codes_of(given) for given in store.labelled(layer)}
