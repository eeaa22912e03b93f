"""The connections of the server: how many may wait, what they may send, how long they may not read.

websockets makes one ``ClientConnection`` for each connection, page or socket. It waits until its
browser has
answered what the server asks first (``scanloom.server.browser_storage``): until then it costs
little, and where too many wait, the one that has waited longest goes. No browser's silence costs
another one anything.
"""

import asyncio
from collections.abc import Callable
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.protocol import State
from websockets.typing import Data

from scanloom.server.error_log import ErrorLog, client_address
from scanloom.server.message_filter import check_message

# Pages that load and tabs that were opened in the background. A page that is not read is kept in
# memory, 3 MB each.
_MOST_WAITING_OF_ONE = 32
# Below the 1024 files that a process may usually have open; recordings take some, too.
_MOST = 512
# A browser that has taken nothing off the wire for so long is gone, or reads nothing. websockets'
# own pings wait behind what is not read.
_MOST_UNREAD_S = 30.0


class Connections:
    """All connections of a server, for its event loop alone."""

    def __init__(self, error_log: ErrorLog) -> None:
        self.error_log = error_log
        # The longest waiting first.
        self._waiting: dict[ClientConnection, None] = {}
        self._settled: set[ClientConnection] = set()

    def __len__(self) -> int:
        return len(self._waiting) + len(self._settled)

    def make(self, *args: Any, **options: Any) -> "ClientConnection":
        """A connection, for websockets."""
        return ClientConnection(self, *args, **options)

    def enter(self, visit: "ClientConnection") -> None:
        """A connection was opened; another may have to go for it."""
        self._waiting[visit] = None
        of_one = [other for other in self._waiting if other.host == visit.host]
        if len(of_one) > _MOST_WAITING_OF_ONE:
            self._end(of_one[0])
        elif len(self) > _MOST:
            self._end(next(iter(self._waiting)))

    def settle(self, visit: "ClientConnection") -> None:
        """A browser has answered: it waits no longer."""
        if self._waiting.pop(visit, self) is None:
            self._settled.add(visit)

    def leave(self, visit: "ClientConnection") -> None:
        """A connection is closed."""
        self._waiting.pop(visit, None)
        self._settled.discard(visit)

    def _end(self, visit: "ClientConnection") -> None:
        self.leave(visit)
        visit.transport.abort()


class ClientConnection(ServerConnection):
    """A connection that hands on what a browser may send, and ends where nothing is read."""

    def __init__(self, connections: Connections, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._connections = connections
        self._unread: asyncio.TimerHandle | None = None
        self.host = ""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        peer = transport.get_extra_info("peername")
        self.host = str(peer[0]) if peer else ""
        self._connections.enter(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._connections.leave(self)
        self._stop_watching()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._watch()

    def resume_writing(self) -> None:
        self._stop_watching()
        super().resume_writing()

    async def recv(self, decode: bool | None = None) -> Data:  # type: ignore[override]  # one of three overloads
        """The next message that viser can take. Others are left out; some are told of."""
        while True:
            data = await super().recv(decode)
            judged = check_message(data)
            if judged.problem:
                self._connections.error_log.report(
                    client_address(self), f"sent {judged.problem}; it is left out."
                )
            elif judged.is_wanted:
                if judged.answers:
                    self._connections.settle(self)
                return data

    def _watch(self) -> None:
        size = self.transport.get_write_buffer_size()
        self._unread = self.loop.call_later(_MOST_UNREAD_S, self._look, size)

    def _look(self, size_before: int) -> None:
        """End the connection unless something was read since."""
        if self.transport.get_write_buffer_size() != size_before:
            self._watch()
            return
        if self.protocol.state is State.OPEN:
            self._connections.error_log.report(client_address(self), "reads nothing; disconnected.")
        self.transport.abort()

    def _stop_watching(self) -> None:
        if self._unread is not None:
            self._unread.cancel()
            self._unread = None


def require_viser_version(handler: Callable[[Any], Any], version: str) -> Callable[[Any], Any]:
    """``handler`` for pages of this version of viser alone; others are told to load again.

    viser tells them, too, but on stdout, which belongs to the command, with what they sent.
    """

    async def handle(connection: ServerConnection) -> None:
        theirs = (connection.subprotocol or "viser-vunknown").removeprefix("viser-v").strip()
        if theirs == version:
            await handler(connection)
        else:
            # The words of viser, which its page shows. A reason has 123 bytes at most.
            await connection.close(
                1002, f"Version mismatch. Client: {theirs[:20]}, Server: {version}"
            )

    return handle
