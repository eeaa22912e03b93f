"""What goes wrong between the server and its browsers, on stderr: a line each, few at a time."""

import logging
import sys
import threading
import time
import traceback
from collections.abc import Callable

from scanloom.commands.terminal import printable

# A hostile browser can make a thousand reasons a second, and has many addresses.
_EVERY_S = 10.0
_MOST_CHARACTERS = 300
# Browsers open connections ahead and drop them, and go without a word.
_PARTINGS = ("opening handshake failed", "keepalive ping failed")


def _on_stderr(line: str) -> None:
    sys.stderr.write(f"{line}\n")
    sys.stderr.flush()


class ErrorLog:
    """Tells the first at once, then one in ten seconds with the number of those left out. Safe for
    threads."""

    def __init__(
        self,
        write: Callable[[str], None] = _on_stderr,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._write, self._clock = write, clock
        self._lock = threading.Lock()
        self._due_s = -float("inf")
        self._left_out = 0

    def tell(self, who: str, what: str) -> None:
        """``who`` did, or met, ``what``."""
        with self._lock:
            now_s = self._clock()
            if now_s < self._due_s:
                self._left_out += 1
                return
            self._due_s = now_s + _EVERY_S
            left_out, self._left_out = self._left_out, 0
        before = f" ({left_out} more before it)" if left_out else ""
        self._write(f"{printable(f'{who}: {what}')[:_MOST_CHARACTERS]}{before}")


def websockets_logger(error_log: ErrorLog) -> logging.Logger:
    """A log for websockets, whose errors are told without their traceback."""
    log = logging.Logger("connections", logging.ERROR)
    log.addHandler(_OneLine(error_log))
    return log


class _OneLine(logging.Handler):
    def __init__(self, error_log: ErrorLog) -> None:
        super().__init__(logging.ERROR)
        self._error_log = error_log

    def emit(self, record: logging.LogRecord) -> None:
        if record.msg in _PARTINGS:
            return
        who = client_address(getattr(record, "websocket", None))
        error = record.exc_info[1] if record.exc_info else None
        what = record.getMessage().partition("\n")[0]
        self._error_log.tell(who, f"{what}: {error_summary(error)}" if error else what)


def error_summary(error: BaseException) -> str:
    """An error, and the line of code that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({frames[-1].filename.rpartition('/')[2]}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{where}"


def client_address(connection: object) -> str:
    """Whose connection it is."""
    address = getattr(connection, "remote_address", None)
    return f"browser at {address[0]}:{address[1]}" if address else "a browser"
