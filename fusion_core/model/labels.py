"""What a person says of single beams and pixels.

A label belongs to a sample as it was recorded, not to a pair: it stays when the mount or a setting
changes. The samples of one message make a *capture*: a scan is one row of beams, a depth image H
rows of pixels as they are stored, before it is turned upright.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, Protocol

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, IntArray, read_only

SensorKind = Literal["lidar", "depth"]


class Label(IntEnum):
    """A person's word on a sample. The codes are stable: journals and files hold them.

    The first four are those of NoiseClass. ``UNSURE``: looked at and left open; it decides nothing.
    """

    GOOD = NoiseClass.GOOD
    HOLE = NoiseClass.HOLE
    BURR = NoiseClass.BURR
    CONFLICT = NoiseClass.CONFLICT
    UNSURE = 4


NO_LABEL = -1
"""In arrays of label codes: not labelled."""


@dataclass(frozen=True, slots=True, order=True)
class Capture:
    """One message of a sensor: a scan or a depth image.

    ``index`` counts the scans of one topic that have the same stamp, from 0 in the order of the
    recording; images have 0. ``rows`` x ``columns`` samples: 1 x beams, or the stored image's.
    """

    sensor: SensorKind
    topic: str
    stamp_ns: int
    index: int
    rows: int
    columns: int

    def __post_init__(self) -> None:
        if self.index < 0 or self.rows < 1 or self.columns < 1:
            raise ValueError("a capture has a row, a column and an index from 0")
        if self.sensor == "lidar" and self.rows != 1:
            raise ValueError("a scan has one row of beams")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CaptureLabels:
    """Labels of some samples of a capture, each sample once, by row, then column.

    ``row``, ``column``: (N,) places in the stored image; of a scan row 0 and the beam's number.
    ``label``: (N,) codes of Label; NO_LABEL takes a label away, where that is asked for.
    """

    capture: Capture
    row: IntArray
    column: IntArray
    label: IntArray

    def __post_init__(self) -> None:
        if not self.row.shape == self.column.shape == self.label.shape or self.row.ndim != 1:
            raise ValueError("row, column and label must be (N,) alike")
        inside = (self.row >= 0) & (self.row < self.capture.rows)
        inside &= (self.column >= 0) & (self.column < self.capture.columns)
        if not inside.all():
            raise ValueError("a sample lies outside its capture")
        if not np.isin(self.label, (NO_LABEL, *Label)).all():
            raise ValueError("a label has an unknown code")
        place = self.row * self.capture.columns + self.column
        if (np.diff(place) <= 0).any():
            raise ValueError("samples must be in the order of rows and columns, each once")
        for array in (self.row, self.column, self.label):
            read_only(array)

    @classmethod
    def of_samples(
        cls, capture: Capture, row: IntArray, column: IntArray, label: IntArray | int
    ) -> "CaptureLabels":
        """Of samples in any order, (N,) each; of one that is named twice the last counts."""
        codes = np.broadcast_to(np.asarray(label, dtype=np.int64), row.shape)
        place = row.astype(np.int64) * capture.columns + column
        # The first of the reversed ones is the last.
        unique, first = np.unique(place[::-1], return_index=True)
        return cls(
            capture=capture,
            row=unique // capture.columns,
            column=unique % capture.columns,
            label=codes[::-1][first].copy(),
        )

    @classmethod
    def of_image(cls, capture: Capture, image: IntArray) -> "CaptureLabels":
        """Of an image of codes, (rows, columns); samples with NO_LABEL are left out."""
        row, column = np.nonzero(image != NO_LABEL)
        return cls(
            capture=capture, row=row, column=column, label=image[row, column].astype(np.int64)
        )

    def as_image(self) -> IntArray:
        """(rows, columns) codes of Label, NO_LABEL where there is none."""
        image: IntArray = np.full((self.capture.rows, self.capture.columns), NO_LABEL)
        image[self.row, self.column] = self.label
        return image

    def subset(self, own: BoolArray) -> "CaptureLabels":
        """Some of the samples. ``own``: (N,)."""
        return CaptureLabels(
            capture=self.capture,
            row=self.row[own],
            column=self.column[own],
            label=self.label[own],
        )


class LabelLayer(Protocol):
    """The labels that are in force in one layer: one annotator's, or adjudicated ones."""

    @property
    def name(self) -> str:
        """The layer's name."""
        ...

    @property
    def sha256(self) -> str:
        """Digest of all its labels: layers of equal digests hold the same labels."""
        ...

    def labels_of(self, capture: Capture) -> CaptureLabels:
        """The labels of one capture; no samples where it has none."""
        ...
