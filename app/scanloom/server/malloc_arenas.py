"""The memory that the C library keeps between uses."""

import ctypes
from contextlib import suppress

# M_ARENA_MAX of glibc's malloc.h.
_ARENA_MAX = -8
_ARENAS = 2


def limit_arenas() -> None:
    """Let all threads share two pools of free memory. Call it before the first thread begins.

    By default each thread gets its own, of which none gives back what another could use: a server
    that draws pictures in many threads would grow by a hundred megabytes for nothing. Other C
    libraries than glibc have no such pools and are left alone.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).mallopt(_ARENA_MAX, _ARENAS)
