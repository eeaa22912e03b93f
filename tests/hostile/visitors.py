"""Hostile clients, and how long another browser's page takes beside them.

Each opens connections to a server at ``http://host:port`` and holds them for a ``with`` block.
"""

import http.client
import random
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from urllib.parse import urlsplit

import msgspec.msgpack
import viser
import websockets.sync.client

from tests.app.viser_client import CAMERA, Received, connect, unpacked

# The one that a session builds last.
LAST_WIDGET = "Save to the output folder"
_PATIENCE_S = 120.0


def place_of(address: str) -> tuple[str, int]:
    """Host and port of an address."""
    parts = urlsplit(address)
    assert parts.hostname is not None
    assert parts.port is not None
    return parts.hostname, parts.port


def upgrade_request(address: str) -> bytes:
    """The request of a page for its socket."""
    host, port = place_of(address)
    return (
        f"GET / HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
        f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n"
    ).encode()


def frame_of(payload: bytes) -> bytes:
    """A browser's binary frame of the socket, masked by zeros."""
    size = len(payload)
    if size < 126:
        head = bytes([0x82, 0x80 | size])
    elif size < 2**16:
        head = bytes([0x82, 0x80 | 126]) + size.to_bytes(2, "big")
    else:
        head = bytes([0x82, 0x80 | 127]) + size.to_bytes(8, "big")
    return head + bytes(4) + payload


@contextmanager
def open_silent_sockets(address: str, count: int) -> Iterator[None]:
    """Pages that read everything and answer no request."""
    host, port = place_of(address)
    camera = msgspec.msgpack.encode(CAMERA)
    with ExitStack() as stack:
        for _ in range(count):
            page = websockets.sync.client.connect(
                f"ws://{host}:{port}",
                subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]  # a plain string
                compression=None,
                max_queue=None,
                ping_interval=None,
                max_size=None,
                proxy=None,
            )
            stack.callback(page.close)
            page.send(camera)
        yield


@contextmanager
def open_unreading_sockets(address: str, count: int) -> Iterator[list[socket.socket]]:
    """Pages that get a session, ask for pictures, and then read nothing any more."""
    with ExitStack() as stack:
        yield [_unreading(address, stack) for _ in range(count)]


def _unreading(address: str, stack: ExitStack) -> socket.socket:
    """A page that answers what it is asked of its storage, and no more."""
    page = stack.enter_context(socket.socket())
    # As little as the system allows.
    page.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    page.settimeout(_PATIENCE_S)
    page.connect(place_of(address))
    page.sendall(upgrade_request(address) + frame_of(msgspec.msgpack.encode(CAMERA)))
    read = page.makefile("rb", buffering=0)
    while read.readline() not in (b"\r\n", b""):
        pass
    asked = 0
    while asked < 2:
        for message in unpacked(_payload_of_frame(read.read)):
            if message["type"] == "LocalStorageGetItemRequestMessage":
                asked += 1
                answer = {
                    "type": "LocalStorageGetItemResponseMessage",
                    "value": None,
                    "error": None,
                    "request_uuid": message["request_uuid"],
                }
                page.sendall(frame_of(msgspec.msgpack.encode(answer)))
    return page


def _payload_of_frame(read: Callable[[int], bytes]) -> bytes:
    """The next frame that a server sent."""

    def exactly(size: int) -> bytes:
        data = b""
        while len(data) < size:
            more = read(size - len(data))
            if not more:
                raise ConnectionError("the server closed the connection")
            data += more
        return data

    size = exactly(2)[1] & 0x7F
    if size > 125:
        size = int.from_bytes(exactly(2 if size == 126 else 8), "big")
    return exactly(size)


@contextmanager
def open_mute_connections(address: str, count: int, said: bytes = b"") -> Iterator[None]:
    """Connections that say ``said``, such as half a request, and no more; they read nothing."""
    with ExitStack() as stack:
        for _ in range(count):
            connection = stack.enter_context(socket.create_connection(place_of(address), 10.0))
            connection.sendall(said)
        yield


@dataclass(frozen=True, slots=True, kw_only=True)
class PageTimes:
    """Seconds from the start until the page was there, its last widget, and the first picture of
    its scene."""

    page_s: float
    widgets_s: float
    scene_s: float


def seconds_to_page(address: str, cookie: str | None = None) -> PageTimes:
    """How long a new browser takes to get its page. The recording should be aligned already."""
    begun_s = time.perf_counter()
    host, port = place_of(address)
    asking = http.client.HTTPConnection(host, port, timeout=_PATIENCE_S)
    asking.request("GET", "/", headers={} if cookie is None else {"Cookie": cookie})
    answer = asking.getresponse()
    answer.read()
    asking.close()
    assert answer.status == 200
    page_s = time.perf_counter() - begun_s
    with connect(address, cookie, storage={}) as client:
        client.find(LAST_WIDGET, timeout=_PATIENCE_S)
        widgets_s = time.perf_counter() - begun_s
        client.wait_for(is_drawing, _PATIENCE_S)
        return PageTimes(page_s=page_s, widgets_s=widgets_s, scene_s=time.perf_counter() - begun_s)


def is_drawing(received: Received) -> bool:
    """Whether a message brings the scene's points, which are added empty."""
    return received.type == "SceneNodeUpdateMessage" and "points" in received.message.get(
        "updates", {}
    )


def malformed_messages() -> list[tuple[str, bytes]]:
    """What no page sends, each with its name: bytes that are no message, and messages that are
    wrong in one thing."""

    def packed(**values: object) -> bytes:
        return msgspec.msgpack.encode(values)

    nested: object = 1
    for _ in range(500):
        nested = [nested]
    camera = dict(CAMERA)
    return [
        ("nothing", b""),
        ("noise", random.Random(0).randbytes(64)),
        ("a cut message", msgspec.msgpack.encode(CAMERA)[:-3]),
        ("a number", msgspec.msgpack.encode(7)),
        ("a list", msgspec.msgpack.encode([1, 2])),
        ("brackets", b"\x91" * 10_000),
        ("no type", packed(uuid="x")),
        ("type a list", packed(type=["x"])),
        ("unknown type", packed(type="Surprise", x=1)),
        ("steering the terminal", packed(type="\x1b[31m[red]" + "x" * 10_000)),
        ("a message of the server's", packed(type="RunJavascriptMessage", source="alert(1)")),
        ("a value too many", packed(**camera, extra=1)),
        ("a value too few", packed(type="GuiUpdateMessage", uuid="x")),
        ("uuid a list", packed(type="GuiUpdateMessage", uuid=["x"], updates={"value": 1})),
        ("updates a list", packed(type="GuiUpdateMessage", uuid="x", updates=[1])),
        ("command a map", packed(type="CommandTriggerMessage", uuid={"a": 1})),
        ("wxyz too short", packed(**camera | {"wxyz": (1.0, 0.0)})),
        ("wxyz of text", packed(**camera | {"wxyz": "abcd"})),
        ("wxyz nested", packed(**camera | {"wxyz": nested})),
        ("camera nowhere", packed(**camera | {"position": (float("nan"),) * 3})),
        ("camera far", packed(**camera | {"far": float("inf")})),
        ("picture of no size", packed(**camera | {"image_height": -1})),
        ("picture too large", packed(**camera | {"image_height": 2**63})),
        (
            "a click nowhere",
            packed(
                type="SceneNodeClickMessage",
                name="/none",
                instance_index=2**63,
                ray_origin=(0.0,) * 3,
                ray_direction=(0.0,) * 3,
                screen_pos=(0.0, 0.0),
                modifier="hyper",
            ),
        ),
        (
            "an answer that was not asked for",
            packed(
                type="LocalStorageGetItemResponseMessage", value="x", error=None, request_uuid="x"
            ),
        ),
        (
            "an answer that is none",
            packed(type="LocalStorageGetItemResponseMessage", value=5, error=6, request_uuid=[7]),
        ),
        ("an upload", packed(type="FileTransferStartUpload", part_count=2**40)),
        ("a tunnel", packed(type="ShareUrlRequest")),
        ("very long", b"\xc6" + (300_000).to_bytes(4, "big") + bytes(300_000)),
    ]
