"""Lines on stderr: the first at once, the next when it is due, none with a traceback."""

import logging

from scanloom.server.error_log import ErrorLog, error_summary, websockets_logger


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_the_first_is_reported_at_once_and_the_rest_are_counted() -> None:
    lines: list[str] = []
    clock = Clock()
    error_log = ErrorLog(lines.append, clock)
    for now_s in (0.0, 1.0, 9.9, 10.0, 10.1, 25.0):
        clock.now_s = now_s
        error_log.report("browser", f"at {now_s}")
    assert lines == [
        "browser: at 0.0",
        "browser: at 10.0 (2 more before it)",
        "browser: at 25.0 (1 more before it)",
    ]


def test_a_line_is_one_line_and_steers_no_terminal() -> None:
    lines: list[str] = []
    ErrorLog(lines.append).report("a\nb", "\x1b[31m" + "x" * 10_000)
    (line,) = lines
    assert line.isprintable()
    assert len(line) < 400


def test_a_librarys_error_is_reported_without_its_traceback() -> None:
    lines: list[str] = []
    log = websockets_logger(ErrorLog(lines.append))
    try:
        raise ZeroDivisionError("by zero")
    except ZeroDivisionError:
        log.error("opening handshake failed", exc_info=True)
        log.warning("nothing much")
        log.error("handler failed", exc_info=True)
    (line,) = lines
    assert line.startswith("a browser: handler failed: ZeroDivisionError: by zero (test_error_log")
    assert not logging.getLogger().handlers or log.parent is None


def test_an_error_that_was_never_raised_has_no_place() -> None:
    assert error_summary(KeyError("x")) == "KeyError: 'x'"
