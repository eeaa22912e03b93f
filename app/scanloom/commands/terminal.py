"""Terminal output: progress on stderr."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from fusion_core.model.names import printable
from fusion_core.model.progress import Progress


@contextmanager
def progress_on_stderr() -> Iterator[Progress]:
    """Progress bars on a terminal; elsewhere one line at the start of each stage."""
    if sys.stderr.isatty():
        yield from _bars()
    else:
        yield _StageLines()


def silence_disconnect_warnings() -> None:
    """Silence viser's warnings about messages queued for disconnected browsers."""
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")


class _StageLines:
    def __init__(self) -> None:
        self._printed: set[str] = set()

    def __call__(self, done: int, total: int | None, what: str) -> None:
        if what not in self._printed:
            self._printed.add(what)
            sys.stderr.write(f"{printable(what)}\n")
            sys.stderr.flush()


def _bars() -> Iterator[Progress]:
    # Imported here to keep --help fast.
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        TaskID,
        TextColumn,
        TimeElapsedColumn,
    )
    from rich.progress import Progress as RichProgress

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    tasks: dict[str, TaskID] = {}
    with RichProgress(
        *columns, console=Console(stderr=True), transient=True, redirect_stdout=False
    ) as bars:

        def report(done: int, total: int | None, what: str) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(printable(what), total=total)
            bars.update(tasks[what], completed=done, total=total)

        yield report
