"""The guard in front of a real server: what it turns away, and that the server outlives it."""

import http.client
import json
import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from urllib.parse import quote

import pytest
import viser
import websockets.asyncio.server
import websockets.exceptions

from scanloom.server.security import Guard, guard_for, guarded, is_loopback
from tests.app.viser_client import connect

Headers = tuple[tuple[str, str], ...]
SOCKET: Headers = (
    ("Upgrade", "websocket"),
    ("Connection", "Upgrade"),
    ("Sec-WebSocket-Key", "AAAAAAAAAAAAAAAAAAAAAA=="),
    ("Sec-WebSocket-Version", "13"),
    ("Sec-WebSocket-Protocol", f"viser-v{viser.__version__}"),
)


@contextmanager
def serving(guard: Guard, host: str = "127.0.0.1") -> Iterator[viser.ViserServer]:
    with guarded(guard):
        server = viser.ViserServer(host=host, port=0, verbose=False)
    try:
        yield server
    finally:
        server.stop()


class Answer:
    def __init__(self, response: http.client.HTTPResponse) -> None:
        self.status = response.status
        self.headers = response.headers
        self.text = "" if response.status == 101 else response.read().decode()


def ask(port: int, path: str = "/", *headers: tuple[str, str], host: str = "127.0.0.1") -> Answer:
    """What the server answers; the Host header is the right one unless ``headers`` have one."""
    connection = http.client.HTTPConnection(host, port, timeout=10)
    try:
        connection.putrequest("GET", path, skip_host=True, skip_accept_encoding=True)
        if not any(name == "Host" for name, _ in headers):
            connection.putheader("Host", f"127.0.0.1:{port}")
        for name, value in headers:
            connection.putheader(name, value.encode("latin-1"))
        connection.endheaders()
        return Answer(connection.getresponse())
    finally:
        connection.close()


@pytest.fixture(scope="module")
def own() -> Iterator[int]:
    """The port of a server for this machine alone."""
    with serving(guard_for("127.0.0.1")) as server:
        yield server.get_port()


@pytest.fixture(scope="module")
def guard() -> Guard:
    """The guard of a server that the network can reach."""
    return guard_for("0.0.0.0")


@pytest.fixture(scope="module")
def shared(guard: Guard) -> Iterator[int]:
    """The port of a server that asks for a token."""
    with serving(guard) as server:
        yield server.get_port()


def test_without_the_token_nothing_is_served(shared: int) -> None:
    for path in ("/", "/index.html", "/go?view=x", "/?token=", "/?token=wrong", "/%2e%2e/x"):
        assert ask(shared, path).status == 403, path
    assert ask(shared, "/", *SOCKET).status == 403
    assert ask(shared, "/?token=wrong", *SOCKET).status == 403


def test_the_token_is_changed_for_a_cookie(shared: int, guard: Guard) -> None:
    welcome = ask(shared, f"/?token={guard.token}")
    assert (welcome.status, welcome.headers["Location"]) == (302, "/")
    cookie, *rules = welcome.headers["Set-Cookie"].split("; ")
    assert rules == ["HttpOnly", "SameSite=Lax", "Path=/"]
    page = ask(shared, "/", ("Cookie", cookie))
    assert page.status == 200
    assert page.headers["Content-Type"].startswith("text/html")
    assert guard.token is not None
    assert guard.token not in page.text
    assert ask(shared, "/", ("Cookie", cookie), *SOCKET).status == 101


def test_the_token_goes_out_of_the_address_of_who_has_the_cookie(shared: int, guard: Guard) -> None:
    assert ask(shared, f"/?token={guard.token}", ("Cookie", guard.cookie)).status == 302


def test_a_link_with_the_token_stays_a_link(shared: int, guard: Guard) -> None:
    welcome = ask(shared, f"/go?token={guard.token}&view={quote('a&b=c#d')}")
    assert welcome.headers["Location"] == "/go?view=a%26b%3Dc%23d"


def test_the_token_leads_to_no_other_site(shared: int, guard: Guard) -> None:
    for path in ("//evil.example/", "/\\evil.example", "//evil.example/go"):
        assert ask(shared, f"{path}?view=x&token={guard.token}").headers["Location"] == "/"


def test_the_cookie_is_found_among_others(shared: int, guard: Guard) -> None:
    for cookies, status in {
        f"theme=dark; {guard.cookie}; other=1": 200,
        f"theme=dark;{guard.cookie}": 200,
        f"theme=dark; other={guard.token}": 403,
        f"x{guard.cookie}": 403,
        f"{guard.cookie}x": 403,
        guard.cookie.partition("=")[0]: 403,
        ";;=;": 403,
        "café=é": 403,
    }.items():
        assert ask(shared, "/", ("Cookie", cookies)).status == status, cookies


def test_two_servers_of_one_host_have_cookies_of_their_own(guard: Guard) -> None:
    other = guard_for("0.0.0.0")
    assert other.token != guard.token
    assert other.cookie.partition("=")[0] != guard.cookie.partition("=")[0]


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "http://127.0.0.1",
        "http://127.0.0.1:1",
        "ftp://127.0.0.1:{port}",
        "http://127.0.0.1:{port}.evil.example",
        "http://evil@127.0.0.1:{port}",
        "http://[bad",
        "null",
        "",
    ],
)
@pytest.mark.parametrize("upgrade", [(), SOCKET], ids=["page", "socket"])
def test_pages_of_other_sites_are_refused(own: int, origin: str, upgrade: Headers) -> None:
    answer = ask(own, "/", ("Origin", origin.format(port=own)), *upgrade)
    assert answer.status == 403


def test_a_foreign_origin_is_refused_with_the_cookie_too(shared: int, guard: Guard) -> None:
    foreign = (("Cookie", guard.cookie), ("Origin", "http://evil.example"))
    assert ask(shared, "/", *foreign, *SOCKET).status == 403
    assert ask(shared, f"/?token={guard.token}", *foreign).status == 403


def test_the_servers_own_page_may_talk_to_it(own: int) -> None:
    for scheme in ("http", "https"):
        origin = ("Origin", f"{scheme}://127.0.0.1:{own}")
        assert ask(own, "/", origin).status == 200
        assert ask(own, "/", origin, *SOCKET).status == 101


@pytest.mark.parametrize("upgrade", [(), SOCKET], ids=["page", "socket"])
def test_a_name_that_was_pointed_here_is_refused(own: int, upgrade: Headers) -> None:
    """DNS rebinding: the attacker's name leads to the loopback address."""
    for host in ("evil.example", f"evil.example:{own}", "127.0.0.1.evil.example", "[::2]", ""):
        hosted = (("Host", host), ("Origin", f"http://{host}"))
        assert ask(own, "/", *hosted, *upgrade).status == 403, host


def test_the_machines_own_names_are_served(own: int) -> None:
    for host in ("localhost", f"LocalHost:{own}", "127.0.0.1", f"[::1]:{own}"):
        assert ask(own, "/", ("Host", host)).status == 200, host


def test_no_host_and_odd_hosts_are_refused_where_any_name_will_do(
    shared: int, guard: Guard
) -> None:
    cookie = ("Cookie", guard.cookie)
    assert ask(shared, "/", cookie, ("Host", "lab-7.example:8080")).status == 200
    for host in ("", "a b", "a;script-src *", "a\xe9", "[", "x" * 300):
        assert ask(shared, "/", cookie, ("Host", host)).status == 403, host


def test_headers_that_come_twice_are_refused(shared: int, guard: Guard) -> None:
    here = ("Host", f"127.0.0.1:{shared}")
    cookie = ("Cookie", guard.cookie)
    assert ask(shared, "/", cookie, here, ("Host", "evil.example")).status == 400
    assert ask(shared, "/", cookie, here, here).status == 400
    assert ask(shared, "/", cookie, cookie).status == 400
    own_origin = ("Origin", f"http://127.0.0.1:{shared}")
    assert ask(shared, "/", cookie, own_origin, ("Origin", "null"), *SOCKET).status == 400
    assert ask(shared, "/", cookie, ("Upgrade", "h2c"), *SOCKET).status == 400


def test_the_page_of_a_link_leaves_the_view_and_goes_on(own: int) -> None:
    page = ask(own, "/go?view=abc_-1")
    assert page.status == 200
    assert "localStorage.setItem('viser-user:link', \"abc_-1\")" in page.text
    assert "location.replace('/')" in page.text


@pytest.mark.parametrize(
    "view", ["</script><script>alert(1)</script>", "<!--<script>", '";alert(1)//', "\\", "\u2028é'"]
)
def test_a_view_cannot_leave_its_quotes(own: int, view: str) -> None:
    page = ask(own, f"/go?view={quote(view)}").text
    assert page.count("<script>") == page.count("</script>") == 1
    found = re.search(r"setItem\('viser-user:link', (\".*\")\);location", page)
    assert found is not None
    assert json.loads(found[1]) == view
    assert "<" not in found[1]
    assert found[1].isascii()


def test_links_without_a_view_say_so(own: int) -> None:
    for path in ("/go", "/go?view=", "/go?view=a&view=b", "/go?other=1", f"/go?view={'a' * 6001}"):
        assert ask(own, path).status == 400, path
    assert ask(own, f"/go?view={'a' * 6000}").status == 200


def test_a_request_line_beyond_all_bounds_harms_nobody(own: int) -> None:
    with pytest.raises(http.client.RemoteDisconnected):
        ask(own, f"/go?view={'a' * 20_000}")
    assert ask(own).status == 200


@pytest.mark.parametrize(
    "path",
    [
        "/../../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/..%2f..%2fetc%2fpasswd",
        "/..\\..\\etc\\passwd",
        "//etc/passwd",
        "/%00",
        "/go/",
        "/" + "a" * 300,
        "//[bad",
    ],
)
def test_paths_lead_nowhere_else(own: int, path: str) -> None:
    assert ask(own, path).status == 404


def test_pages_carry_safe_headers(own: int, shared: int) -> None:
    for answer in (
        ask(own),
        ask(own, "/go?view=x"),
        ask(own, "/missing"),
        ask(shared),
        ask(own, "/", ("Host", "a"), ("Host", "b")),
    ):
        policy = answer.headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "*" not in policy
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert f" ws://127.0.0.1:{own} " in ask(own).headers["Content-Security-Policy"]
    assert ask(own, "/go?view=x").headers["Cache-Control"] == "no-store"


@pytest.mark.parametrize(
    "message",
    [b"", b"no msgpack", b"\x81\xa4type\xa7Unknown", b"\x80", b"\x91" * 5000],
    ids=["empty", "garbage", "unknown", "untyped", "nested"],
)
def test_a_message_that_is_none_ends_its_own_connection_only(own: int, message: bytes) -> None:
    address = f"http://127.0.0.1:{own}"
    with connect(address) as other, connect(address) as client:
        client.send_bytes(message)
        client.wait_until(lambda: client.closed_with is not None)
        other.wait_for(lambda received: received.type == "ReplayDoneMessage")
        assert other.closed_with is None


def test_a_message_of_60_mb_ends_its_own_connection_only(own: int) -> None:
    address = f"http://127.0.0.1:{own}"
    with connect(address) as client:
        with suppress(websockets.exceptions.ConnectionClosed):
            client.send_bytes(bytes(60_000_000))
        client.wait_until(lambda: client.closed_with is not None, 20.0)
        closed = client.closed_with
        assert closed is not None
        assert closed.rcvd is not None
        assert closed.rcvd.code == 1009
    with connect(address) as client:
        client.wait_for(lambda received: received.type == "ReplayDoneMessage")


def test_ipv6_loopback_is_served_under_its_name() -> None:
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        pytest.skip("this machine has no IPv6 loopback")
    guard = guard_for("::1")
    assert guard.token is None
    with serving(guard, "::1") as server:
        port = server.get_port()
        host = ("Host", f"[::1]:{port}")
        assert ask(port, "/", host, host="::1").status == 200
        assert ask(port, "/", ("Host", f"[::2]:{port}"), host="::1").status == 403
        origin = ("Origin", f"http://[::1]:{port}")
        assert ask(port, "/", host, origin, *SOCKET, host="::1").status == 101


def test_servers_started_later_are_not_guarded() -> None:
    original = websockets.asyncio.server.serve
    with guarded(guard_for("127.0.0.1")):
        assert websockets.asyncio.server.serve is not original
    assert websockets.asyncio.server.serve is original
    with pytest.raises(KeyError), guarded(guard_for("127.0.0.1")):
        raise KeyError
    assert websockets.asyncio.server.serve is original


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.0.1", "::1", "localhost", "LOCALHOST"])
def test_a_loopback_address_needs_no_token(host: str) -> None:
    assert is_loopback(host)
    assert guard_for(host).token is None
    assert guard_for(host).hosts


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "", "192.168.1.5", "lab-7", "127.0.0.1.x", "0"])
def test_any_other_address_needs_one(host: str) -> None:
    token = guard_for(host).token
    assert token is not None
    assert len(token) >= 32


def test_an_address_is_called_as_browsers_write_it() -> None:
    assert guard_for("2001:DB8:0::0001").hosts == {"[2001:db8::1]"}
    assert guard_for("Lab-7").hosts == {"lab-7"}
    assert guard_for("0.0.0.0").hosts == frozenset()
