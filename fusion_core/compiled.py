"""Functions as machine code, kept on disk from run to run where a place for it can be written."""

import threading
from collections.abc import Callable, Iterator
from functools import update_wrapper
from types import CodeType, FunctionType
from typing import Any

# Functions that call each other are prepared by one thread.
_preparing = threading.RLock()
_declared: list["_Compiled"] = []


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """``numba.njit`` with these options and, where there is a place for it, its cache.

    numba is imported when such a function is called first, not when it is defined: what only reads
    and displays does not wait for it.

    The places are the folder NUMBA_CACHE_DIR, beside the source, and the user's own cache. Without
    any, as for a service without a home in an installation of somebody else's, each process
    compiles anew what it calls. So it does where the cache was written by another version of the
    source and names classes that are no more.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        assert isinstance(function, FunctionType), "numba compiles plain functions"
        _declared.append(_Compiled(function, options))
        return _declared[-1]

    return decorate


def load_cached() -> None:
    """Load what the caches hold of all functions declared so far: a process that waits for its work
    need not do it then. What no cache holds is compiled at its first call, as ever."""
    for function in _declared:
        function.load_cached()


class _Compiled:
    """A function that is handed to numba when it is called first, or asked for an attribute."""

    def __init__(self, function: FunctionType, options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self._function = function
        self._options = options
        self._dispatcher: Any = None

    def __call__(self, *values: Any) -> Any:
        return (self._dispatcher or self._prepare())(*values)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._prepare(), name)

    def _prepare(self) -> Any:
        """numba's function, which compiles at its first call. Those that it calls are put in their
        places first: numba knows nothing of this class."""
        with _preparing:
            if self._dispatcher is None:
                self._dispatcher = _dispatcher_of(self._function, self._options)
                names = self._function.__globals__
                for name in _names_in(self._function.__code__):
                    if isinstance(called := names.get(name), _Compiled):
                        names[name] = called._prepare()
            return self._dispatcher

    def load_cached(self) -> None:
        """Load what the cache holds of it for this machine."""
        dispatcher = self._prepare()
        cache = dispatcher._cache
        file = getattr(cache, "_cache_file", None)  # None without a place.
        try:
            keys = list(file._load_index()) if file is not None else []
        except (AttributeError, ImportError):
            return  # Of another version, as _discard_unreadable_index says.
        codegen = dispatcher.targetctx.codegen()
        for key in keys:
            signature = key[0]
            if key == cache._index_key(signature, codegen):
                dispatcher.compile(signature)


def _names_in(code: CodeType) -> Iterator[str]:
    """The global names that a function and those within it may look up."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names_in(constant)


def _dispatcher_of(function: FunctionType, options: dict[str, Any]) -> Any:
    from numba import njit

    try:
        dispatcher = njit(cache=True, **options)(function)
    except RuntimeError:
        # All that numba says of a cache that it has no place for.
        return njit(**options)(function)
    _discard_unreadable_index(dispatcher._cache)
    return dispatcher


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
