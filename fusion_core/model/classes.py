"""The noise classes of a LiDAR beam or a depth pixel (Xu 2024 §2.3.2, and one that it lacks)."""

from enum import IntEnum

import numpy as np

from fusion_core.model.conventions import BoolArray, IntArray


class NoiseClass(IntEnum):
    """One class for each sample. The codes are stable: files and labels hold them."""

    GOOD = 0
    HOLE = 1
    BURR = 2
    CONFLICT = 3


SAME_SURFACE_M = 0.10
"""Ranges that differ by less lie on one surface, in ground truth and in metrics."""


class RepairSource(IntEnum):
    """Where a repaired value came from. The codes are stable: files hold their names."""

    RAW = 0
    OTHER_SENSOR = 1
    NEIGHBOURS = 2
    NONE = 3


def is_repaired(source: IntArray) -> BoolArray:
    """Of codes of RepairSource, which stand for a value that the repair made."""
    return is_one_of(source, RepairSource.OTHER_SENSOR, RepairSource.NEIGHBOURS)


def is_one_of(codes: IntArray, *wanted: IntEnum) -> BoolArray:
    """Whether each of the codes is one of a few: np.isin takes twenty times as long for a frame."""
    found = np.zeros(codes.shape, dtype=np.bool_)
    for code in wanted:
        found |= codes == int(code)
    return found
