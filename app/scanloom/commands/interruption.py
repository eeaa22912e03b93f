"""Being asked to end: by Ctrl-C, by ``kill`` (SIGTERM), or as the terminal goes (SIGHUP).

Work ends by an exception, and so leaves nothing half done. For a server it is the wish to end, and
no failure of whatever is at work when it comes.
"""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_LOOK_S = 0.1
_ENDING = (signal.SIGTERM, signal.SIGHUP)


class Terminated(KeyboardInterrupt):
    """The process was asked to end by a signal other than Ctrl-C's."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


@contextmanager
def termination() -> Iterator[None]:
    """Within, the first SIGTERM or SIGHUP raises Terminated; later ones must not break off the
    cleaning up. A signal that is ignored, as under nohup, stays so. Call it in the main thread.
    """

    def end(number: int, _: FrameType | None) -> None:
        for each in handled:
            signal.signal(each, signal.SIG_IGN)
        raise Terminated(number)

    handled = [each for each in _ENDING if signal.getsignal(each) is not signal.SIG_IGN]
    before = {each: signal.signal(each, end) for each in handled}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


class Interruption:
    """Whether the wish to end has come."""

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
    """Within, Ctrl-C and the signals like it raise nothing and are noted instead. Call it in the
    main thread.

    Once one came, they stay without effect afterwards: the process is about to end, and people
    press it twice. Otherwise what they did before holds again.
    """
    noted = Interruption()
    before = {
        each: signal.signal(each, lambda *_: noted.note()) for each in (signal.SIGINT, *_ENDING)
    }
    try:
        yield noted
    finally:
        for each, handler in before.items():
            signal.signal(each, signal.SIG_IGN if noted else handler or signal.SIG_DFL)
