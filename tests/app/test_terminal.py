"""Progress on stderr, with and without a terminal."""

import io
import sys

import pytest

from scanloom.commands.terminal import progress_on_stderr


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_elsewhere_each_kind_of_work_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_on_stderr() as progress:
        for done in range(100):
            progress(done, 100, "pairs")
            progress(done, None, "ma\x1bps")
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == ("", "pairs\nma\\x1bps\n")


def test_a_terminal_has_a_bar_for_each_kind(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    terminal = Terminal()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("sys.stderr", terminal)
    with progress_on_stderr() as progress:
        progress(0, None, "[index]")
        progress(3, 12, "frames")
        progress(12, 12, "frames")
        sys.stdout.write("a result\n")
    shown = terminal.getvalue()
    assert "[index]" in shown
    assert "12/12" in shown
    assert capsys.readouterr().out == "a result\n"


def test_work_that_fails_under_a_bar_still_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr", Terminal())

    def work() -> None:
        with progress_on_stderr() as progress:
            progress(0, 1, "frames")
            raise OSError("gone")

    with pytest.raises(OSError, match="gone"):
        work()
