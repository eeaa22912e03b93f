"""Who may talk to the server: the guard in front of viser's pages and socket.

viser has no authentication and checks no Origin. It looks ``serve`` up in websockets when it
starts, so for that moment ``serve`` is one that asks the guard first. On a loopback address the
Host and the Origin are checked; on any other a token as well, given once in the address and then
kept in a cookie.
"""

import hashlib
import hmac
import json
import re
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http import HTTPStatus
from ipaddress import ip_address
from typing import Any
from urllib.parse import parse_qs, urlencode

import viser
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from scanloom.server.connections import require_viser_version

LINK_KEY = "link"
# Longer than any person's view. A whole request line may have 8192 bytes in websockets.
_MAX_LINK = 6_000
# A second one of these would leave open which of the two was meant.
_SINGLE_HEADERS = ("Host", "Origin", "Cookie", "Upgrade")
_HOST = re.compile(r"[A-Za-z0-9._-]{1,255}(:[0-9]{1,5})?|\[[0-9A-Fa-f:.]{2,45}\](:[0-9]{1,5})?")


@dataclass(frozen=True, slots=True, kw_only=True)
class Guard:
    """Which requests pass. ``hosts``: names by which the server may be called, without port; empty
    for any. ``token``: None where the address is loopback alone."""

    hosts: frozenset[str]
    token: str | None

    def answer(self, request: Request) -> Response | None:
        """The answer to a request that goes no further, None for one that passes."""
        if any(len(request.headers.get_all(name)) > 1 for name in _SINGLE_HEADERS):
            return _plain(HTTPStatus.BAD_REQUEST, "A header came twice.")
        host = request.headers.get("Host", "")
        if not _HOST.fullmatch(host) or (self.hosts and _name(host) not in self.hosts):
            return _plain(
                HTTPStatus.FORBIDDEN,
                "This server has another name. Open the address that it printed.",
            )
        origin = request.headers.get("Origin")
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return _plain(HTTPStatus.FORBIDDEN, "Pages of other sites may not talk to this server.")
        if self.token is None:
            return None
        if _same(_asked(request, "token"), self.token):
            return self._welcome(request)
        if self._has_cookie(request):
            return None
        return _plain(
            HTTPStatus.FORBIDDEN, "Open the address that the server printed: it holds the token."
        )

    @property
    def cookie(self) -> str:
        """Name and value of the cookie that holds the token.

        Browsers send the cookies of all ports of a host: each server's has a name of its own.
        """
        assert self.token is not None, "asked only where there is a token"
        return f"scanloom_{hashlib.sha256(self.token.encode()).hexdigest()[:8]}={self.token}"

    def _has_cookie(self, request: Request) -> bool:
        cookies = request.headers.get("Cookie", "").split(";")
        return any(_same(cookie.strip(), self.cookie) for cookie in cookies)

    def _welcome(self, request: Request) -> Response:
        """Hand the cookie out, and take the token out of the address bar; a link stays one."""
        view = _asked(request, "view")
        to_link = _path(request) == "/go" and view is not None
        location = f"/go?{urlencode({'view': view})}" if to_link else "/"
        response = _plain(HTTPStatus.FOUND, "Go on.")
        response.headers["Location"] = location
        # Lax, not Strict: else the first click on a link in somebody's mail would be turned away.
        response.headers["Set-Cookie"] = f"{self.cookie}; HttpOnly; SameSite=Lax; Path=/"
        return response


def guard_for(host: str) -> Guard:
    """The guard of a server that listens on ``host``."""
    called = _called(host)
    if is_loopback(host):
        return Guard(hosts=frozenset({"localhost", "127.0.0.1", "[::1]", called}), token=None)
    # Listening everywhere, it may be called by any of the machine's names.
    everywhere = host in ("0.0.0.0", "::", "")  # compared, not bound
    hosts = frozenset() if everywhere else frozenset({called})
    return Guard(hosts=hosts, token=secrets.token_urlsafe(24))


def is_loopback(host: str) -> bool:
    """Whether nobody but this machine can reach an address."""
    if host.lower() == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


@contextmanager
def guarded(guard: Guard, **instead: Any) -> Iterator[None]:
    """Servers that are started within ask ``guard`` before they answer anything.

    ``instead``: options of websockets' ``serve`` that go over those of viser.
    """
    module: Any = websockets.asyncio.server
    original = module.serve

    def serve(handler: Any, *args: Any, process_request: Any = None, **options: Any) -> Any:
        return original(
            require_viser_version(handler, viser.__version__),
            *args,
            process_request=_asking(guard, process_request),
            **options | instead,
        )

    module.serve = serve
    try:
        yield
    finally:
        module.serve = original


def _asking(guard: Guard, pages: Callable[..., Any] | None) -> Callable[..., Any]:
    def process(connection: Any, request: Request) -> Response | None:
        response = guard.answer(request)
        if response is None:
            if request.headers.get("Upgrade", "").lower() == "websocket":
                return None
            response = _go(request) if _path(request) == "/go" else _page(connection, request)
        response.headers["Content-Security-Policy"] = _policy(request)
        response.headers["Referrer-Policy"] = "no-referrer"
        response.headers["X-Content-Type-Options"] = "nosniff"
        return response

    def _page(connection: Any, request: Request) -> Response:
        missing = _plain(HTTPStatus.NOT_FOUND, "There is no such page.")
        try:
            return missing if pages is None else pages(connection, request) or missing
        except OSError:
            # A name that the file system cannot have, such as one too long for it.
            return missing

    return process


def _policy(request: Request) -> str:
    """What a page may do: nothing from elsewhere, nothing to elsewhere, in nobody's frame.

    viser's page is one file with its scripts, styles, pictures and fonts inside.
    """
    host = "".join(request.headers.get_all("Host")[:1])
    # Not every browser takes 'self' for the socket too.
    sockets = f"ws://{host} wss://{host}" if _HOST.fullmatch(host) else ""
    return (
        "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob:; "
        "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; worker-src blob:; "
        f"connect-src 'self' data: blob: {sockets}; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )


def _go(request: Request) -> Response:
    """A link's page: leaves the view where the workbench looks for it, and goes there."""
    view = _asked(request, "view")
    if view is None or len(view) > _MAX_LINK:
        return _plain(HTTPStatus.BAD_REQUEST, "This link holds no view. Copy it again, whole.")
    # In a script, "<" could end the script; JSON may spell it out.
    value = json.dumps(view).replace("<", "\\u003c")
    page = (
        "<!doctype html><meta charset=utf-8><title>ScanLoom</title><script>"
        f"localStorage.setItem('viser-user:{LINK_KEY}', {value});"
        "location.replace('/');</script>"
    )
    return _answer(HTTPStatus.OK, "text/html; charset=utf-8", page)


def _path(request: Request) -> str:
    return request.path.partition("?")[0]


def _asked(request: Request, name: str) -> str | None:
    """What the address says of ``name``, None unless it says one thing."""
    values = parse_qs(request.path.partition("?")[2]).get(name, [])
    return values[0] if len(values) == 1 else None


def _same(given: str | None, secret: str) -> bool:
    """Whether two texts are equal, in a time that does not tell how far they are."""
    # websockets hands bytes beyond ASCII on as surrogates.
    return given is not None and hmac.compare_digest(
        given.encode("utf-8", "surrogatepass"), secret.encode()
    )


def _plain(status: HTTPStatus, text: str) -> Response:
    return _answer(status, "text/plain; charset=utf-8", f"{text}\n")


def _answer(status: HTTPStatus, kind: str, text: str) -> Response:
    body = text.encode()
    headers = Headers()
    headers["Content-Type"] = kind
    headers["Content-Length"] = str(len(body))
    headers["Cache-Control"] = "no-store"
    return Response(status, status.phrase, headers, body)


def _name(host: str) -> str:
    """A Host header without its port."""
    if host.startswith("["):
        return host.partition("]")[0].lower() + "]"
    return host.partition(":")[0].lower()


def _called(host: str) -> str:
    """The name by which a browser calls an address: IPv6 in brackets and as short as it goes."""
    try:
        address = ip_address(host)
    except ValueError:
        return host.lower()
    return f"[{address.compressed}]" if address.version == 6 else address.compressed
