"""Functions as machine code, kept on disk from run to run where a place for it can be written."""

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """``numba.njit`` with these options and, where there is a place for it, its cache.

    The places are the folder NUMBA_CACHE_DIR, beside the source, and the user's own cache. Without
    any, as for a service without a home in an installation of somebody else's, each process
    compiles anew what it calls.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        try:
            return njit(cache=True, **options)(function)
        except RuntimeError:
            # All that numba says of a cache that it has no place for.
            return njit(**options)(function)

    return decorate
