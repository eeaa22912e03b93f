"""Requests to stop: Ctrl-C (SIGINT), ``kill`` (SIGTERM), or the closed terminal (SIGHUP).

In a batch command they raise an exception, so that work is cleaned up. For the server they are the
usual end: they are recorded, and interrupt nothing.
"""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Ctrl-C takes effect within this time.
_POLL_S = 0.1
_STOP_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


class Terminated(KeyboardInterrupt):
    """The process was asked to stop by SIGTERM or SIGHUP."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


@contextmanager
def termination() -> Iterator[None]:
    """Within the block the first SIGTERM or SIGHUP raises Terminated. Later ones are ignored, so
    that they do not interrupt the clean-up. A signal that is already ignored, as under nohup, stays
    ignored. Call it in the main thread.
    """

    def end(number: int, _: FrameType | None) -> None:
        for each in handled:
            signal.signal(each, signal.SIG_IGN)
        raise Terminated(number)

    handled = [each for each in _STOP_SIGNALS if signal.getsignal(each) is not signal.SIG_IGN]
    before = {each: signal.signal(each, end) for each in handled}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


class StopRequest:
    """Whether the process was asked to stop."""

    def __init__(self) -> None:
        self._is_set = False

    def set(self) -> None:
        """Record the request. Takes no lock: it is called in a signal handler."""
        self._is_set = True

    def wait(self) -> None:
        """Wait for the request. Polls: a signal does not wake a waiting thread on every system."""
        while not self._is_set:
            time.sleep(_POLL_S)

    def __bool__(self) -> bool:
        return self._is_set


@contextmanager
def interruption() -> Iterator[StopRequest]:
    """Within the block the stop signals are recorded and raise nothing. Call it in the main thread.

    After a request they stay ignored: the process is about to end, and people press Ctrl-C twice.
    Otherwise their handlers are restored.
    """
    request = StopRequest()
    before = {
        each: signal.signal(each, lambda *_: request.set())
        for each in (signal.SIGINT, *_STOP_SIGNALS)
    }
    try:
        yield request
    finally:
        for each, handler in before.items():
            signal.signal(each, signal.SIG_IGN if request else handler or signal.SIG_DFL)
