"""Progress of long work, reported to a callable: no stage depends on a terminal or a browser."""

from typing import Protocol


class Progress(Protocol):
    """Called as ``progress(done, total, what)``; ``total`` is None where it is not known."""

    def __call__(self, done: int, total: int | None, what: str) -> None: ...


def silent(done: int, total: int | None, what: str) -> None:
    """Report nothing."""
