"""LZF, the compression of PCD files (Marc Lehmann, liblzf).

A control byte below 32 is followed by one more literal bytes than it says. Any other copies bytes
from before: its upper three bits give the length less 2 (7: the next byte is added), its lower five
and the next byte how far back the copy begins, less 1.
"""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import ByteArray

MAX_RATIO = 88
"""Three bytes give at most 264."""

_COMPLETE, _ENDED, _DAMAGED = 0, 1, 2


def decompress(packed: bytes, count: int) -> tuple[ByteArray, int]:
    """(count,) bytes, and how many of them were found; the rest are 0.

    Fewer are found where the stream ends early. Raises ValueError for a copy from before the start.
    """
    content = np.zeros(count, np.uint8)
    found, outcome = _decompress(np.frombuffer(packed, np.uint8), content)
    if outcome == _DAMAGED:
        raise ValueError(f"the compressed data are damaged at byte {found} of {count}")
    return content, found


@compiled()
def _decompress(packed: ByteArray, content: ByteArray) -> tuple[int, int]:
    """Fills ``content`` and returns how many bytes were found, and why it stopped."""
    read = 0
    found = 0
    while found < content.size:
        if read >= packed.size:
            return found, _ENDED
        control = int(packed[read])
        read += 1
        if control < 32:
            for _ in range(control + 1):
                if found == content.size:
                    return found, _COMPLETE
                if read >= packed.size:
                    return found, _ENDED
                content[found] = packed[read]
                read += 1
                found += 1
            continue
        length = control >> 5
        if read + (length == 7) >= packed.size:
            return found, _ENDED
        if length == 7:
            length += int(packed[read])
            read += 1
        source = found - ((control & 31) << 8) - int(packed[read]) - 1
        read += 1
        if source < 0:
            return found, _DAMAGED
        for _ in range(length + 2):
            if found == content.size:
                return found, _COMPLETE
            content[found] = content[source]
            source += 1
            found += 1
    return found, _COMPLETE
