"""Limits on the server's connections: their number, their messages, and the time without a read.

websockets creates a ``ClientConnection`` for each request of a page or socket. A connection is
pending until its browser has answered the server's first request
(``scanloom.page.browser_storage``). When too many are pending, the oldest is closed, so that idle
clients cannot lock others out.
"""

import asyncio
from collections.abc import Callable
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.protocol import State
from websockets.typing import Data

from scanloom.server.error_log import ErrorLog, client_address
from scanloom.server.message_filter import check_message

# Set by hand: room for background tabs. The page (3 MB) stays in memory until it is read.
_MAX_PENDING_PER_HOST = 32
# Half of Linux's default limit of 1024 open files; recordings need some, too.
_MAX_CONNECTIONS = 512
# Set by hand. The keepalive pings of websockets cannot detect a stalled reader, as they are queued
# behind the unread data.
_READ_TIMEOUT_S = 30.0


class Connections:
    """The open connections of a server. To be used on its event loop only."""

    def __init__(self, error_log: ErrorLog) -> None:
        self.error_log = error_log
        # Oldest first; a dict serves as an ordered set.
        self._pending: dict[ClientConnection, None] = {}
        self._ready: set[ClientConnection] = set()

    def __len__(self) -> int:
        return len(self._pending) + len(self._ready)

    def create(self, *args: Any, **options: Any) -> "ClientConnection":
        """The ``create_connection`` of websockets' ``serve``."""
        return ClientConnection(self, *args, **options)

    def add(self, connection: "ClientConnection") -> None:
        """Register a new connection; the oldest pending one is aborted if there are too many."""
        self._pending[connection] = None
        of_one = [other for other in self._pending if other.host == connection.host]
        if len(of_one) > _MAX_PENDING_PER_HOST:
            self._abort(of_one[0])
        elif len(self) > _MAX_CONNECTIONS:
            self._abort(next(iter(self._pending)))

    def mark_ready(self, connection: "ClientConnection") -> None:
        """Mark a connection as no longer pending: its browser has answered."""
        if self._pending.pop(connection, self) is None:
            self._ready.add(connection)

    def discard(self, connection: "ClientConnection") -> None:
        """Forget a closed connection."""
        self._pending.pop(connection, None)
        self._ready.discard(connection)

    def _abort(self, connection: "ClientConnection") -> None:
        self.discard(connection)
        connection.transport.abort()


class ClientConnection(ServerConnection):
    """A connection that filters incoming messages, and closes if its client stops reading."""

    def __init__(self, connections: Connections, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._connections = connections
        self._read_timer: asyncio.TimerHandle | None = None
        self._takes_any_message = False
        self.host = ""

    def take_any_message(self) -> None:
        """Receive what is no message of viser's: its handler checks it. It is not pending."""
        self._takes_any_message = True
        self._connections.mark_ready(self)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        peer = transport.get_extra_info("peername")
        self.host = str(peer[0]) if peer else ""
        self._connections.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._connections.discard(self)
        self._cancel_read_timer()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._start_read_timer()

    def resume_writing(self) -> None:
        self._cancel_read_timer()
        super().resume_writing()

    async def recv(self, decode: bool | None = None) -> Data:  # type: ignore[override]  # one of three overloads
        """The next message that viser accepts. Invalid ones are dropped and logged."""
        while True:
            data = await super().recv(decode)
            if self._takes_any_message:
                return data
            check = check_message(data)
            if check.problem:
                self._connections.error_log.report(
                    client_address(self), f"sent {check.problem}; it is left out."
                )
            elif check.is_accepted:
                if check.is_storage_response:
                    self._connections.mark_ready(self)
                return data

    def _start_read_timer(self) -> None:
        size = self.transport.get_write_buffer_size()
        self._read_timer = self.loop.call_later(_READ_TIMEOUT_S, self._abort_if_unread, size)

    def _abort_if_unread(self, size_before: int) -> None:
        """Abort the connection unless its client has read something meanwhile."""
        if self.transport.get_write_buffer_size() != size_before:
            self._start_read_timer()
            return
        if self.protocol.state is State.OPEN:
            self._connections.error_log.report(client_address(self), "reads nothing; disconnected.")
        self.transport.abort()

    def _cancel_read_timer(self) -> None:
        if self._read_timer is not None:
            self._read_timer.cancel()
            self._read_timer = None


def require_viser_version(handler: Callable[[Any], Any], version: str) -> Callable[[Any], Any]:
    """``handler`` for pages of this version of viser only; others are asked to reload.

    viser checks the version, too, but prints what the client sent to stdout, which belongs to the
    command.
    """

    async def handle(connection: ServerConnection) -> None:
        client_version = (
            (connection.subprotocol or "viser-vunknown").removeprefix("viser-v").strip()
        )
        if client_version == version:
            await handler(connection)
        else:
            # The message of viser, which its page displays. A close reason has at most 123 bytes.
            await connection.close(
                1002, f"Version mismatch. Client: {client_version[:20]}, Server: {version}"
            )

    return handle
