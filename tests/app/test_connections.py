"""Connections to a real server: those that wait, those that do not read, and what they send."""

import json
import secrets
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from types import SimpleNamespace

import msgspec.msgpack
import pytest
import viser
import websockets.exceptions
import websockets.sync.client
from hypothesis import given
from hypothesis import strategies as st
from viser import _messages as messages

from scanloom.client_session import STORED_VIEW
from scanloom.server import connections as connections_module
from scanloom.server.connections import Connections
from scanloom.server.error_log import ErrorLog, websockets_logger
from scanloom.server.message_filter import MAX_MESSAGE_BYTES, check_message
from scanloom.server.security import guard_for, guarded
from scanloom.server.workbench import ServeOptions, Workbench
from tests.app.viser_client import CAMERA, connect
from tests.hostile.visitors import (
    LAST_WIDGET,
    frame_of,
    malformed_messages,
    open_mute_connections,
    open_silent_sockets,
    place_of,
    upgrade_request,
)
from tests.patience import ENOUGH_S

ROOT = Path(__file__).parents[2]


class Served:
    """A guarded server without any session, and what is said of its browsers."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        # Each line is due.
        error_log = ErrorLog(self.lines.append, iter(range(0, 10**6, 100)).__next__)
        self.connections = Connections(error_log)
        with guarded(
            guard_for("127.0.0.1"),
            create_connection=self.connections.create,
            max_size=MAX_MESSAGE_BYTES,
            logger=websockets_logger(error_log),
        ):
            self.server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        self.address = f"http://127.0.0.1:{self.server.get_port()}"
        self.arrived: list[int] = []
        self.server.on_client_connect(self._arrive)

    async def _arrive(self, client: viser.ClientHandle) -> None:
        self.arrived.append(client.client_id)

    def until(self, condition: object) -> None:
        """Wait until a condition of the server holds."""
        assert callable(condition)
        pause = threading.Event()
        for _ in range(int(ENOUGH_S / 0.01)):
            if condition():
                return
            pause.wait(0.01)
        pytest.fail("not so in time")


@pytest.fixture
def served() -> Iterator[Served]:
    serving = Served()
    yield serving
    serving.server.stop()


def answer(request_uuid: str = "x") -> bytes:
    return msgspec.msgpack.encode(
        {
            "type": "LocalStorageGetItemResponseMessage",
            "value": None,
            "error": None,
            "request_uuid": request_uuid,
        }
    )


def test_of_those_who_wait_the_longest_waiting_goes(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections_module, "_MAX_PENDING_PER_HOST", 3)
    with ExitStack() as stack:
        ready = stack.enter_context(connect(served.address))
        ready.send_bytes(answer())
        served.until(lambda: len(served.connections._ready) == 1)
        every = []
        for count in range(1, 6):
            every.append(stack.enter_context(connect(served.address)))
            served.until(lambda: len(served.arrived) == count + 1)  # noqa: B023  # called at once
        for gone in every[:2]:
            with suppress(ConnectionError):
                while True:
                    gone.receive()
            assert gone.closed_with is not None
        assert len(served.connections._pending) == 3
        assert all(client.closed_with is None for client in (ready, *every[2:]))
    served.until(lambda: len(served.connections) == 0)


def test_where_no_more_fit_nobody_who_has_answered_goes(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections_module, "_MAX_CONNECTIONS", 2)
    with ExitStack() as stack:
        two = [stack.enter_context(connect(served.address)) for _ in range(2)]
        for client in two:
            client.send_bytes(answer())
        served.until(lambda: len(served.connections._ready) == 2)
        with pytest.raises((OSError, EOFError, websockets.exceptions.WebSocketException)):
            connect(served.address)
        assert all(client.closed_with is None for client in two)


@pytest.mark.parametrize("said", [b"", b"GET / HTTP/1.1\r\nHost: x"], ids=["nothing", "half"])
def test_connections_that_say_nothing_keep_no_page_from_anybody(
    served: Served, said: bytes
) -> None:
    many = 2 * connections_module._MAX_PENDING_PER_HOST
    with open_mute_connections(served.address, many, said), connect(served.address):
        served.until(lambda: len(served.arrived) == 1)
        assert len(served.connections) <= connections_module._MAX_PENDING_PER_HOST
    assert served.lines == []


def test_who_reads_nothing_is_cut_off(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections_module, "_READ_TIMEOUT_S", 0.05)
    with socket.socket() as page:
        page.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        page.connect(place_of(served.address))
        page.sendall(upgrade_request(served.address) + frame_of(msgspec.msgpack.encode(CAMERA)))
        served.until(lambda: len(served.arrived) == 1)
        (client,) = served.server.get_clients().values()
        with connect(served.address) as other:
            served.until(lambda: len(served.arrived) == 2)
            # More than the system keeps for it.
            client.gui.add_html(secrets.token_hex(8_000_000))
            client.flush()
            served.until(lambda: list(served.server.get_clients()) == served.arrived[1:])
            assert other.closed_with is None
    (line,) = served.lines
    assert "reads nothing; disconnected" in line


@pytest.mark.parametrize(("size", "stays"), [(100, False), (99, True), (150, True)])
def test_who_reads_something_stays(size: int, stays: bool) -> None:
    """100 bytes were unread at the last look. What was added since may be more than was read."""
    happened: list[str] = []
    connection = SimpleNamespace(
        transport=SimpleNamespace(
            get_write_buffer_size=lambda: size, abort=lambda: happened.append("cut off")
        ),
        protocol=SimpleNamespace(state=None),
        _start_read_timer=lambda: happened.append("watched on"),
    )
    connections_module.ClientConnection._abort_if_unread(connection, 100)  # type: ignore[arg-type]  # as far as it is needed
    assert happened == (["watched on"] if stays else ["cut off"])


@pytest.mark.parametrize(
    ("name", "data"), [pytest.param(*each, id=each[0]) for each in malformed_messages()]
)
def test_a_malformed_message_changes_nothing(name: str, data: bytes) -> None:
    check = check_message(data)
    if name == "an answer that was not asked for":
        assert check.is_accepted
        return
    assert not check.is_accepted
    if name not in ("a message of the server's", "an upload", "a tunnel"):
        assert check.problem


@given(data=st.binary(max_size=200))
def test_arbitrary_bytes_are_never_accepted(data: bytes) -> None:
    assert not check_message(data).is_accepted


VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=5)
    | st.binary(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=6,
)


@given(name=st.sampled_from(sorted(CAMERA)), value=VALUES)
def test_what_is_let_in_is_what_viser_reads(name: str, value: object) -> None:
    """A camera with one value changed: let in, viser makes a message of it without a word."""
    data = msgspec.msgpack.encode(CAMERA | {name: value})
    if check_message(data).is_accepted:
        message = messages.Message.deserialize(data)
        assert isinstance(message, messages.ViewerCameraMessage)
        assert message.image_height >= 0


def test_a_page_of_another_version_is_reported_and_stdout_keeps_silent(
    served: Served, capfd: pytest.CaptureFixture[str]
) -> None:
    with connect(served.address, version="0.0", with_camera=False) as client:
        with pytest.raises(ConnectionError):
            client.receive()
        assert isinstance(client.closed_with, websockets.exceptions.ConnectionClosedError)
        assert client.closed_with.rcvd is not None
        assert client.closed_with.rcvd.code == 1002
        assert "Version mismatch" in client.closed_with.rcvd.reason
    assert capfd.readouterr().out == ""


def test_no_message_prints_a_traceback(small_scene: Path) -> None:
    command = [sys.executable, "-m", "scanloom", "view", str(small_scene), "--json", "--port=0"]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as server:
        try:
            assert server.stdout is not None
            address = json.loads(server.stdout.readline())["address"]
            for _, data in malformed_messages():
                with connect(address, storage={}) as client:
                    client.find("Preset")
                    with suppress(websockets.exceptions.ConnectionClosed):
                        client.send_bytes(data)
            with connect(address, storage={}) as client:
                client.find(LAST_WIDGET)
            server.send_signal(signal.SIGINT)
            rest, errors = server.communicate(timeout=ENOUGH_S)
        finally:
            server.kill()
    assert (server.returncode, rest) == (0, "")
    assert "Traceback" not in errors
    lines = errors.splitlines()
    assert 1 <= len(lines) < 10
    assert all(line.startswith("browser at 127.0.0.1:") for line in lines)
    assert errors.replace("\n", "").isprintable()


def test_beside_forty_silent_pages_another_has_its_session_at_once(
    small_scene: Path, tmp_path: Path
) -> None:
    storage: dict[str, str] = {}
    options = ServeOptions(recordings=[small_scene], port=0, output_root=tmp_path)
    with (
        Workbench(options) as workbench,
        open_silent_sockets(workbench.address, 40),
        connect(workbench.address, storage=storage) as client,
    ):
        client.wait_until(lambda: STORED_VIEW in storage)
        # It waited for none of them, and none has a session.
        assert len(workbench.sessions) == 1
