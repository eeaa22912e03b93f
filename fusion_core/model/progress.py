"""How long work reports itself: a callable, so that no stage knows a terminal or a browser."""

from typing import Protocol


class Progress(Protocol):
    """Called as ``progress(done, total, what)``; ``total`` is None where it is not known."""

    def __call__(self, done: int, total: int | None, what: str) -> None: ...


def silent(done: int, total: int | None, what: str) -> None:
    """Report nothing."""
