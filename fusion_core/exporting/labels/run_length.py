"""COCO's run-length coding of masks: column by column, unset first."""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.conventions import BoolArray

_CHUNK_BITS = 5
_MORE = 1 << _CHUNK_BITS
_NEGATIVE = _MORE >> 1
_FIRST_CHARACTER = 48
# A count is an image's size at most.
_CHUNKS_MAX = 12


def encode_mask(mask: BoolArray) -> list[int]:
    """Lengths of the runs of unset and set pixels in turn, the first of unset ones, perhaps 0.

    ``mask``: (H, W), not empty.
    """
    flat = mask.ravel(order="F")
    bounds = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    counts: list[int] = np.diff(bounds, prepend=0, append=flat.size).tolist()
    return [0, *counts] if flat[0] else counts


def decode_mask(counts: Sequence[int], rows: int, columns: int) -> BoolArray:
    """(rows, columns). Raises ValueError where the counts are not those of such a mask."""
    # Python's sum, which no large number overflows.
    if any(count < 0 for count in counts) or sum(counts) != rows * columns:
        raise ValueError(f"its counts are not those of {rows} x {columns} pixels")
    flat = np.repeat(np.arange(len(counts)) % 2 == 1, np.array(counts, dtype=np.int64))
    return flat.reshape((rows, columns), order="F")


def unpack_counts(packed: str) -> list[int]:
    """The counts of pycocotools' text: groups of five bits, least first, from the fourth on
    each minus the one two before it. Raises ValueError."""
    counts: list[int] = []
    value = chunks = 0
    for character in packed:
        chunk = ord(character) - _FIRST_CHARACTER
        if not 0 <= chunk < 2 * _MORE or chunks > _CHUNKS_MAX:
            raise ValueError("its counts are no packed text")
        value |= (chunk & (_MORE - 1)) << (_CHUNK_BITS * chunks)
        chunks += 1
        if chunk & _MORE:
            continue
        if chunk & _NEGATIVE:
            value -= 1 << (_CHUNK_BITS * chunks)
        counts.append(value + counts[-2] if len(counts) > 2 else value)
        value = chunks = 0
    if chunks:
        raise ValueError("its counts are cut off")
    return counts
