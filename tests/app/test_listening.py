"""Where the server may listen: known before viser is asked, which would wait for ever."""

import errno
import socket
from pathlib import Path

import pytest

from fusion_core.model.errors import SettingsError
from scanloom.cli import main
from scanloom.server.listening import LAST_PORT, free_port


@pytest.fixture
def taken() -> int:
    """A port that somebody listens on, for as long as the test lasts."""
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        yield listening.getsockname()[1]


def test_a_free_port_is_taken_as_it_is(taken: int) -> None:
    found = free_port("127.0.0.1", taken)
    assert taken < found <= LAST_PORT
    assert free_port("127.0.0.1", found) == found
    assert free_port("127.0.0.1", 0) == 0


def test_where_the_last_port_is_taken_there_is_none() -> None:
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", LAST_PORT))
        listening.listen()
        with pytest.raises(SettingsError, match="--port 65535: it is taken"):
            free_port("127.0.0.1", LAST_PORT)


def test_a_port_of_the_system_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def bind(*_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("scanloom.server.listening.socket.socket.bind", bind, raising=False)
    with pytest.raises(SettingsError, match=r"--port 80: .*Permission denied.*a higher one"):
        free_port("127.0.0.1", 80)


@pytest.mark.parametrize("host", ["8.8.8.8", "no.such.host.invalid", "..", "a" * 300, "a\x00b"])
def test_an_address_that_is_not_ours_is_refused_in_one_line(host: str) -> None:
    with pytest.raises(SettingsError) as refused:
        free_port(host, 0)
    assert "Name an address of this machine" in str(refused.value)
    assert len(str(refused.value)) < 300


@pytest.mark.parametrize(
    ("args", "code", "words"),
    [
        (["--port", "99999"], 2, "--port must be at most 65535, got 99999"),
        (["--port", "-1"], 2, "--port must be 0 or more, got -1"),
        (["--host", ".."], 1, "--host ..: cannot be listened on"),
        (["--root", "{file}"], 1, "is no folder"),
        (["-o", "{file}"], 1, "is not a folder"),
    ],
)
def test_a_server_that_cannot_be_says_so_in_one_line(
    args: list[str],
    code: int,
    words: str,
    small_scene: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "a file"
    file.write_text("mine")
    given = [arg.format(file=file) for arg in args]
    assert main(["view", str(small_scene), *given]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert words in err
    assert file.read_text() == "mine"
