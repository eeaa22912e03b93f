"""Access control for viser's pages and socket.

viser has no authentication and does not check the Origin. It looks up ``serve`` in websockets when
it starts; for that moment ``serve`` is replaced by one that checks each request first. On a
loopback address Host and Origin are checked; on any other address also a token, which is given once
in the URL and then kept in a cookie.
"""

import hashlib
import hmac
import re
import secrets
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from http import HTTPStatus
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlencode

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from scanloom.server.connections import require_viser_version
from scanloom.server.pages import LINK_PATH, own_page, path_of, query_value, text_response

SocketHandler = Callable[[ServerConnection], Awaitable[None]]
# Duplicates of these would be ambiguous.
_SINGLE_HEADERS = ("Host", "Origin", "Cookie", "Upgrade")
_HOST = re.compile(r"[A-Za-z0-9._-]{1,255}(:[0-9]{1,5})?|\[[0-9A-Fa-f:.]{2,45}\](:[0-9]{1,5})?")


@dataclass(frozen=True, slots=True, kw_only=True)
class Guard:
    """Which requests are allowed.

    ``hosts``: accepted names of the Host header, without port; empty: any. ``token``: None on a
    loopback address.
    """

    hosts: frozenset[str]
    token: str | None

    def check(self, request: Request) -> Response | None:
        """The response to a request that is refused or redirected, None if it is allowed."""
        if any(len(request.headers.get_all(name)) > 1 for name in _SINGLE_HEADERS):
            return text_response(HTTPStatus.BAD_REQUEST, "A header came twice.")
        host = request.headers.get("Host", "")
        if not _HOST.fullmatch(host) or (self.hosts and _without_port(host) not in self.hosts):
            return text_response(
                HTTPStatus.FORBIDDEN,
                "This server has another name. Open the address that it printed.",
            )
        origin = request.headers.get("Origin")
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return text_response(
                HTTPStatus.FORBIDDEN, "Pages of other sites may not talk to this server."
            )
        if self.token is None:
            return None
        if _is_equal(query_value(request, "token"), self.token):
            return self._set_cookie_response(request)
        if self._has_cookie(request):
            return None
        return text_response(
            HTTPStatus.FORBIDDEN, "Open the address that the server printed: it holds the token."
        )

    @property
    def cookie(self) -> str:
        """Name and value of the cookie that holds the token.

        Browsers send a host's cookies to all of its ports, so each server uses another name.
        """
        assert self.token is not None, "only a guard with a token has a cookie"
        return f"scanloom_{hashlib.sha256(self.token.encode()).hexdigest()[:8]}={self.token}"

    def _has_cookie(self, request: Request) -> bool:
        cookies = request.headers.get("Cookie", "").split(";")
        return any(_is_equal(cookie.strip(), self.cookie) for cookie in cookies)

    def _set_cookie_response(self, request: Request) -> Response:
        """Set the cookie, and redirect to the URL without the token; a link to a view is kept."""
        view = query_value(request, "view")
        to_link = path_of(request) == LINK_PATH and view is not None
        location = f"{LINK_PATH}?{urlencode({'view': view})}" if to_link else "/"
        response = text_response(HTTPStatus.FOUND, "Go on.")
        response.headers["Location"] = location
        # Lax, not Strict: a link that is opened from an e-mail must send the cookie.
        response.headers["Set-Cookie"] = f"{self.cookie}; HttpOnly; SameSite=Lax; Path=/"
        return response


def guard_for(host: str) -> Guard:
    """The guard of a server that listens on ``host``."""
    called = _host_name(host)
    if is_loopback(host):
        return Guard(hosts=frozenset({"localhost", "127.0.0.1", "[::1]", called}), token=None)
    # A server on all interfaces is reached by any of the machine's names.
    everywhere = host in ("0.0.0.0", "::", "")  # compared, not bound
    hosts = frozenset() if everywhere else frozenset({called})
    return Guard(hosts=hosts, token=secrets.token_urlsafe(24))


def is_loopback(host: str) -> bool:
    """Whether an address can be reached from this machine only."""
    if host.lower() == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


@contextmanager
def guarded(
    guard: Guard, sockets: Mapping[str, SocketHandler] | None = None, **overrides: Any
) -> Iterator[None]:
    """Have ``guard`` check every request of servers that are started within the block.

    ``sockets``: handlers of WebSockets at paths of their own; all others are viser's.
    ``overrides``: options of websockets' ``serve`` that replace those of viser.
    """
    module: Any = websockets.asyncio.server
    original = module.serve

    def serve(handler: Any, *args: Any, process_request: Any = None, **options: Any) -> Any:
        return original(
            _by_path(sockets or {}, require_viser_version(handler, viser.__version__)),
            *args,
            process_request=_with_guard(guard, process_request),
            **options | overrides,
        )

    module.serve = serve
    try:
        yield
    finally:
        module.serve = original


def _by_path(sockets: Mapping[str, SocketHandler], other: SocketHandler) -> SocketHandler:
    async def handle(connection: ServerConnection) -> None:
        path = "" if connection.request is None else path_of(connection.request)
        await sockets.get(path, other)(connection)

    return handle


def _with_guard(guard: Guard, pages: Callable[..., Any] | None) -> Callable[..., Any]:
    def process(connection: Any, request: Request) -> Response | None:
        response = guard.check(request)
        if response is None:
            if request.headers.get("Upgrade", "").lower() == "websocket":
                return None
            response = own_page(request) or _viser_page(connection, request)
        response.headers["Content-Security-Policy"] = _content_security_policy(request)
        response.headers["Referrer-Policy"] = "no-referrer"
        response.headers["X-Content-Type-Options"] = "nosniff"
        return response

    def _viser_page(connection: Any, request: Request) -> Response:
        missing = text_response(HTTPStatus.NOT_FOUND, "There is no such page.")
        try:
            return missing if pages is None else pages(connection, request) or missing
        except OSError:
            # A path that the file system rejects, such as one that is too long.
            return missing

    return process


def _content_security_policy(request: Request) -> str:
    """The Content-Security-Policy: no external sources or destinations, no embedding in frames.

    viser's page is one file that contains its scripts, styles, images and fonts.
    """
    host = "".join(request.headers.get_all("Host")[:1])
    # In some browsers 'self' does not include the WebSocket.
    sockets = f"ws://{host} wss://{host}" if _HOST.fullmatch(host) else ""
    return (
        "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob:; "
        "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; worker-src blob:; "
        f"connect-src 'self' data: blob: {sockets}; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )


def _is_equal(given: str | None, secret: str) -> bool:
    """Whether two texts are equal, compared in constant time."""
    # websockets decodes non-ASCII bytes as surrogates.
    return given is not None and hmac.compare_digest(
        given.encode("utf-8", "surrogatepass"), secret.encode()
    )


def _without_port(host: str) -> str:
    """A Host header without its port."""
    if host.startswith("["):
        return host.partition("]")[0].lower() + "]"
    return host.partition(":")[0].lower()


def _host_name(host: str) -> str:
    """An address as a browser writes it in the Host header: IPv6 compressed, in brackets."""
    try:
        address = ip_address(host)
    except ValueError:
        return host.lower()
    return f"[{address.compressed}]" if address.version == 6 else address.compressed
