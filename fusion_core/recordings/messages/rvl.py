"""RVL, the lossless depth codec of A. D. Wilson, "Fast Lossless Depth Image Compression" (2017).

The stream is a sequence of numbers, each in nibbles of a continuation bit and 3 bits, least
significant first, packed into 32-bit little-endian words from the most significant nibble. Runs of
zeros and of non-zero values alternate: each run has its length, and each non-zero value its zigzag
difference to the previous one.
"""

import numpy as np
import numpy.typing as npt

from fusion_core.compiled import compiled

_WORD_BYTES = 4
_NIBBLES_IN_WORD = 8
# Longer numbers exceed any run length and any difference of 16-bit values.
_MAX_BITS = 30


def decompress(stream: bytes, pixel_count: int) -> npt.NDArray[np.uint16]:
    """(pixel_count,) uint16. Raises ValueError if the stream has fewer pixels."""
    words = np.frombuffer(stream, "<u4", len(stream) // _WORD_BYTES).astype(np.uint32)
    pixels = np.zeros(pixel_count, np.uint16)
    found = _decompress(words, pixels)
    if found < pixel_count:
        raise ValueError(f"breaks off after {found} of {pixel_count} pixels")
    return pixels


@compiled()
def _decompress(words: npt.NDArray[np.uint32], pixels: npt.NDArray[np.uint16]) -> int:
    """Fill ``pixels``, which must be zero; returns the number of decoded pixels."""
    zeros: int
    others: int
    place = 0
    at = 0
    value = 0
    while at < pixels.size:
        zeros, place = _number(words, place)
        if zeros < 0 or zeros > pixels.size - at:
            return at
        at += zeros
        others, place = _number(words, place)
        if others < 0 or others > pixels.size - at:
            return at
        for _ in range(others):
            zigzag, place = _number(words, place)
            if zigzag < 0:
                return at
            value += (zigzag >> 1) ^ -(zigzag & 1)
            pixels[at] = value & 0xFFFF
            at += 1
    return at


@compiled()
def _number(words: npt.NDArray[np.uint32], place: int) -> tuple[int, int]:
    """The number at nibble ``place`` and the nibble after it; -1 if there is none."""
    number = 0
    bits = 0
    while place < words.size * _NIBBLES_IN_WORD and bits < _MAX_BITS:
        word = int(words[place // _NIBBLES_IN_WORD])
        nibble = (word >> (28 - 4 * (place % _NIBBLES_IN_WORD))) & 0xF
        place += 1
        number |= (nibble & 0x7) << bits
        bits += 3
        if nibble < 0x8:
            return number, place
    return -1, place
