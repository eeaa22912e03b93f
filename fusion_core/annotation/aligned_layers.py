"""Layers side by side: what each of them says of the same samples."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from heapq import merge
from itertools import groupby, pairwise
from operator import itemgetter

import numpy as np
import numpy.typing as npt

from fusion_core.model.conventions import IntArray, read_only
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels

CodeArray = npt.NDArray[np.int8]

# Set by hand: enough for numpy to work on, little for memory.
_SAMPLES_PER_BLOCK = 1 << 17


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AlignedLabels:
    """The samples of some captures that any layer has a label of.

    ``capture``: (N,) indices into ``captures``. ``row``, ``column``: (N,). Samples are ordered by
    capture, row and column. ``codes``: (layers, N) codes of Label, NO_LABEL in layers without one.
    """

    layers: tuple[str, ...]
    captures: tuple[Capture, ...]
    capture: IntArray
    row: IntArray
    column: IntArray
    codes: CodeArray

    def __post_init__(self) -> None:
        size = self.capture.size
        if not self.capture.shape == self.row.shape == self.column.shape == (size,):
            raise ValueError("capture, row and column must be (N,) alike")
        if self.codes.shape != (len(self.layers), size):
            raise ValueError("codes must be (layers, N)")
        for array in (self.capture, self.row, self.column, self.codes):
            read_only(array)

    def __iter__(self) -> Iterator[tuple[Capture, slice]]:
        """Each capture, and where its samples stand."""
        bounds = np.searchsorted(self.capture, np.arange(len(self.captures) + 1)).tolist()
        for capture, (start, stop) in zip(self.captures, pairwise(bounds), strict=True):
            yield capture, slice(start, stop)


def align_layers(
    layers: Mapping[str, Iterable[CaptureLabels]], *, samples_per_block: int = _SAMPLES_PER_BLOCK
) -> Iterator[AlignedLabels]:
    """Join layers capture by capture, as blocks of whole captures.

    Each layer is read once, in the order of Capture; no more than a block and a capture of each
    layer is held. Raises ScanLoomError where layers give one message different sizes, ValueError
    where a layer is out of order.
    """
    streams = [_numbered(number, stream) for number, stream in enumerate(layers.values())]
    names = tuple(layers)
    block: list[tuple[Capture, IntArray, CodeArray]] = []
    size = 0
    before: Capture | None = None
    for capture, group in groupby(merge(*streams, key=itemgetter(0, 1)), key=itemgetter(0)):
        if before is not None:
            _require_one_size(before, capture)
        before = capture
        place, codes = _join(len(names), [(number, labels) for _, number, labels in group])
        if size and size + place.size > samples_per_block:
            yield _block_of(names, block)
            block, size = [], 0
        block.append((capture, place, codes))
        size += place.size
    if block:
        yield _block_of(names, block)


def _numbered(
    number: int, stream: Iterable[CaptureLabels]
) -> Iterator[tuple[Capture, int, CaptureLabels]]:
    """A layer's captures with its number. Raises ValueError where they are out of order."""
    before: Capture | None = None
    for labels in stream:
        if before is not None and labels.capture <= before:
            raise ValueError(f"captures out of order: {labels.capture} after {before}")
        before = labels.capture
        yield before, number, labels


def _require_one_size(before: Capture, capture: Capture) -> None:
    def message(one: Capture) -> tuple[str, str, int, int]:
        return one.sensor, one.topic, one.stamp_ns, one.index

    if message(before) == message(capture):
        raise ScanLoomError(
            f"{capture.topic} at {capture.stamp_ns} ns has labels for {before.rows} x "
            f"{before.columns} and for {capture.rows} x {capture.columns} samples.",
            advice="Compare layers of one recording.",
        )


def _join(layers: int, labels: Sequence[tuple[int, CaptureLabels]]) -> tuple[IntArray, CodeArray]:
    """(N,) places in the capture, in order, and (layers, N) codes."""
    places = [of.row * of.capture.columns + of.column for _, of in labels]
    place = places[0] if len(places) == 1 else np.unique(np.concatenate(places))
    codes = np.full((layers, place.size), NO_LABEL, dtype=np.int8)
    for (number, of), own in zip(labels, places, strict=True):
        codes[number, np.searchsorted(place, own)] = of.label
    return place, codes


def _block_of(
    layers: tuple[str, ...], block: Sequence[tuple[Capture, IntArray, CodeArray]]
) -> AlignedLabels:
    captures = tuple(capture for capture, _, _ in block)
    sizes = [place.size for _, place, _ in block]
    columns = np.repeat([capture.columns for capture in captures], sizes)
    place = np.concatenate([place for _, place, _ in block])
    return AlignedLabels(
        layers=layers,
        captures=captures,
        capture=np.repeat(np.arange(len(captures)), sizes),
        row=place // columns,
        column=place % columns,
        codes=np.concatenate([codes for _, _, codes in block], axis=1),
    )
