"""Functions as machine code, kept on disk from run to run where a place for it can be written."""

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """``numba.njit`` with these options and, where there is a place for it, its cache.

    The places are the folder NUMBA_CACHE_DIR, beside the source, and the user's own cache. Without
    any, as for a service without a home in an installation of somebody else's, each process
    compiles anew what it calls. So it does where the cache was written by another version of the
    source and names classes that are no more.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        try:
            dispatcher = njit(cache=True, **options)(function)
        except RuntimeError:
            # All that numba says of a cache that it has no place for.
            return njit(**options)(function)
        _discard_unreadable_index(dispatcher._cache)
        return dispatcher

    return decorate


def _discard_unreadable_index(cache: Any) -> None:
    """Have numba empty a cache whose index cannot be unpickled, instead of failing.

    It unpickles the types of the arguments before it compares the index with the source.
    """
    load = cache.load_overload

    def load_overload(*signature_and_target: Any) -> Any:
        try:
            return load(*signature_and_target)
        except (AttributeError, ImportError):
            cache.flush()
            return None

    cache.load_overload = load_overload
