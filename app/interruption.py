"""Ctrl-C as the wish to end a server, and no failure of whatever is at work when it comes."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

_LOOK_S = 0.1


class Interruption:
    """Whether Ctrl-C was pressed."""

    def __init__(self) -> None:
        self._pressed = False

    def note(self) -> None:
        """It was pressed. For a signal handler, which must wait for no lock."""
        self._pressed = True

    def wait(self) -> None:
        """Wait until it is pressed. Looks again and again: not every system wakes who waits."""
        while not self._pressed:
            time.sleep(_LOOK_S)

    def __bool__(self) -> bool:
        return self._pressed


@contextmanager
def interruption() -> Iterator[Interruption]:
    """Within, Ctrl-C raises nothing and is noted instead. Call it in the main thread.

    Once it was pressed, it stays without effect afterwards: the process is about to end, and people
    press it twice. Otherwise what it did before holds again.
    """
    noted = Interruption()
    before = signal.signal(signal.SIGINT, lambda *_: noted.note())
    try:
        yield noted
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN if noted else before or signal.SIG_DFL)
