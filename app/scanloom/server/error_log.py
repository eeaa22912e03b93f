"""A rate-limited error log of the server on stderr, one line an error."""

import logging
import sys
import threading
import time
import traceback
from collections.abc import Callable

from fusion_core.model.names import printable

# A hostile browser can cause thousands of errors a second, from many addresses.
_MIN_INTERVAL_S = 10.0
_MAX_LINE_CHARACTERS = 300
# Usual for browsers: they open spare connections, and disconnect without a closing handshake.
_EXPECTED_DISCONNECTS = ("opening handshake failed", "keepalive ping failed")


def _on_stderr(line: str) -> None:
    sys.stderr.write(f"{line}\n")
    sys.stderr.flush()


class ErrorLog:
    """Prints the first error at once, then one in ten seconds with the number of those skipped.

    Thread-safe.
    """

    def __init__(
        self,
        write: Callable[[str], None] = _on_stderr,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._write, self._clock = write, clock
        self._lock = threading.Lock()
        self._due_s = -float("inf")
        self._skipped_count = 0

    def report(self, source: str, message: str) -> None:
        """Log an error. ``source``: the browser, or the part of the server."""
        with self._lock:
            now_s = self._clock()
            if now_s < self._due_s:
                self._skipped_count += 1
                return
            self._due_s = now_s + _MIN_INTERVAL_S
            skipped, self._skipped_count = self._skipped_count, 0
        before = f" ({skipped} more before it)" if skipped else ""
        self._write(f"{printable(f'{source}: {message}')[:_MAX_LINE_CHARACTERS]}{before}")


def websockets_logger(error_log: ErrorLog) -> logging.Logger:
    """A logger for websockets, whose errors are printed without a traceback."""
    log = logging.Logger("connections", logging.ERROR)
    log.addHandler(_ErrorLogHandler(error_log))
    return log


class _ErrorLogHandler(logging.Handler):
    def __init__(self, error_log: ErrorLog) -> None:
        super().__init__(logging.ERROR)
        self._error_log = error_log

    def emit(self, record: logging.LogRecord) -> None:
        if record.msg in _EXPECTED_DISCONNECTS:
            return
        source = client_address(getattr(record, "websocket", None))
        error = record.exc_info[1] if record.exc_info else None
        message = record.getMessage().partition("\n")[0]
        text = f"{message}: {error_summary(error)}" if error else message
        self._error_log.report(source, text)


def error_summary(error: BaseException) -> str:
    """An error in one line, with the line of code that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({frames[-1].filename.rpartition('/')[2]}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{where}"


def client_address(connection: object) -> str:
    """The address of a connection's browser, for messages."""
    address = getattr(connection, "remote_address", None)
    return f"browser at {address[0]}:{address[1]}" if address else "a browser"
