"""A browser's part of viser's protocol, for tests and benchmarks: no page, no picture, exact times.

``connect`` speaks to a server as a browser does: it tells its camera, keeps the widgets that it is
sent, and answers from a storage of its own. Every message is kept with the time of its arrival.
"""

import json
import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

import msgspec.msgpack
import numpy as np
import viser
import websockets.exceptions
import websockets.sync.client
import zstandard

from tests.patience import ENOUGH_S

# So often a condition is looked at without a message.
_LOOK_S = 0.05
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, -5.0, 2.0),
    "fov": 1.0,
    "near": 0.1,
    "far": 1000.0,
    "image_height": 720,
    "image_width": 1280,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}


@dataclass(frozen=True, slots=True)
class Received:
    """One message and when it came (``time.perf_counter``). ``bytes``: of the frame it came in."""

    message: dict[str, Any]
    arrived_s: float
    bytes: int

    @property
    def type(self) -> str:
        """The name of the message's class in viser."""
        return str(self.message["type"])


@dataclass(slots=True)
class Widget:
    """A widget as the browser knows it. ``value`` is None for one that has none."""

    uuid: str
    type: str
    container_uuid: str
    props: dict[str, Any]
    value: Any = None
    tabs: dict[str, str] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """What is written on or beside it."""
        return str(self.props.get("label") or "")


class ViserClient:
    """One connection. What arrives is kept by a thread of its own, so times are those of arrival.

    ``widgets`` and ``commands`` by uuid, ``storage`` as the browser's local storage.
    """

    def __init__(self, socket: websockets.sync.client.ClientConnection, storage: dict[str, str]):
        self.widgets: dict[str, Widget] = {}
        self.commands: dict[str, str] = {}
        self.storage = storage
        self.closed_with: websockets.exceptions.ConnectionClosed | None = None
        self._presses = 0
        self._socket = socket
        self._arrived: queue.Queue[Received | None] = queue.Queue()
        self._changed = threading.Condition()
        self._reader = threading.Thread(target=self._read, name="viser client", daemon=True)
        self._reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave."""
        self._socket.close()
        self._reader.join(5.0)

    def receive(self, timeout: float = ENOUGH_S) -> Received:
        """The next message that was not taken yet. Raises TimeoutError where none comes."""
        try:
            received = self._arrived.get(timeout=timeout)
        except queue.Empty:
            raise TimeoutError(f"no message within {timeout} s") from None
        if received is None:
            self._arrived.put(None)
            raise ConnectionError(f"the server closed the connection: {self.closed_with}")
        return received

    def drain(self) -> list[Received]:
        """What has arrived and was not taken yet."""
        taken = []
        while not self._arrived.empty() and (received := self._arrived.get()) is not None:
            taken.append(received)
        return taken

    def wait_for(
        self, predicate: Callable[[Received], bool], timeout: float = ENOUGH_S
    ) -> Received:
        """The next message that fits; those before it are dropped. Raises as ``receive``."""
        deadline = time.monotonic() + timeout
        while True:
            received = self.receive(max(deadline - time.monotonic(), 0.0))
            if predicate(received):
                return received

    def wait_until(self, condition: Callable[[], bool], timeout: float = ENOUGH_S) -> None:
        """Wait until a condition holds: of the widgets, or of the server, which does not tell of
        every change. Raises TimeoutError where it does not."""
        deadline = time.monotonic() + timeout
        with self._changed:
            while not self._changed.wait_for(condition, _LOOK_S):
                if time.monotonic() > deadline:
                    raise TimeoutError(f"not so within {timeout} s")

    def send(self, message: Mapping[str, Any]) -> float:
        """Send a message of viser's protocol, by its ``type``; return when it was sent."""
        data = msgspec.msgpack.encode(message)
        sent_s = time.perf_counter()
        self._socket.send(data)
        return sent_s

    def send_bytes(self, data: bytes) -> None:
        """Send anything at all."""
        self._socket.send(data)

    def find(self, label: str, *, within: str | None = None, timeout: float = ENOUGH_S) -> Widget:
        """The one widget with this label, once it is there.

        ``within``: the label of a folder or tab around it, where one label has several widgets.
        """

        def found() -> list[Widget]:
            return [
                widget
                for widget in self.widgets.values()
                if widget.label == label and (within is None or within in self.around(widget))
            ]

        try:
            self.wait_until(lambda: bool(found()), timeout)
        except TimeoutError:
            known = sorted({widget.label for widget in self.widgets.values()})
            raise LookupError(f"no widget {label!r} among {known}") from None
        with self._changed:
            widgets = found()
            if len(widgets) > 1:
                widgets = [widget for widget in widgets if self._is_in_sight(widget)]
        if len(widgets) > 1:
            raise LookupError(
                f"{len(widgets)} widgets in sight are called {label!r}: name what is around"
            )
        return widgets[0]

    def set_value(self, label: str, value: Any, *, within: str | None = None) -> float:
        """Change a widget as a person would; return when the message was sent."""
        widget = self.find(label, within=within)
        widget.value = value
        return self.update(widget.uuid, {"value": value})

    def click(self, label: str, *, within: str | None = None) -> float:
        """Press a button; return when the message was sent."""
        return self.update(self.find(label, within=within).uuid, {"value": True})

    def press(self, name: str, value: str) -> float:
        """Press one of the page's own buttons; return when the message was sent."""
        self._presses += 1
        action = {"kind": "press", "name": name, "value": value, "number": self._presses}
        return self.set_value("page events", json.dumps({"actions": [action]}))

    def point(self, picture: str, kind: str, x_px: float, y_px: float) -> float:
        """Move, click or drag on one of the page's pictures; return when the message was sent."""
        self._presses += 1
        event = {"kind": kind, "picture": picture, "x_px": x_px, "y_px": y_px}
        event["number"] = self._presses
        events = {"actions": [event]} if kind == "click" else {"pointer": event}
        return self.set_value("page events", json.dumps(events))

    def update(self, uuid: str, updates: Any) -> float:
        """Send a widget's update as it stands; return when it was sent."""
        return self.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates})

    def trigger(self, label: str, *, timeout: float = ENOUGH_S) -> float:
        """Run a command of the palette, as its key does; return when the message was sent."""
        self.wait_until(lambda: label in self.commands.values(), timeout)
        with self._changed:
            uuids = [uuid for uuid, known in self.commands.items() if known == label]
        return self.send({"type": "CommandTriggerMessage", "uuid": uuids[-1]})

    def shows_picture(self, name: str) -> bool:
        """Whether a picture that answers to the pointer is in sight."""
        with self._changed:
            return any(
                f'data-picture="{name}"' in str(widget.props.get("content"))
                and bool(widget.props["visible"])
                for widget in self.widgets.values()
            )

    def _is_in_sight(self, widget: Widget) -> bool:
        """Whether a widget and all that it stands in are visible."""
        seen: Widget | None = widget
        while seen is not None:
            if not seen.props.get("visible", True):
                return False
            seen = next((w for w in self.widgets.values() if w.uuid == seen.container_uuid), None)
        return True

    def around(self, widget: Widget) -> set[str]:
        """Labels of the folders and tabs that a widget stands in."""
        labels = set()
        uuid = widget.container_uuid
        while uuid != "root":
            for container in self.widgets.values():
                if container.uuid == uuid or uuid in container.tabs:
                    labels.add(container.tabs.get(uuid, container.label))
                    uuid = container.container_uuid
                    break
            else:
                break
        return labels

    def _read(self) -> None:
        try:
            while True:
                data = self._socket.recv()
                arrived_s = time.perf_counter()
                assert isinstance(data, bytes), "viser sends binary messages only"
                for message in unpacked(data):
                    self._take(message)
                    self._arrived.put(Received(message, arrived_s, len(data)))
        except websockets.exceptions.ConnectionClosed as closed:
            self.closed_with = closed
        finally:
            self._arrived.put(None)
            with self._changed:
                self._changed.notify_all()

    def _take(self, message: dict[str, Any]) -> None:
        kind, uuid = message["type"], message.get("uuid", "")
        if kind == "LocalStorageGetItemRequestMessage":
            self.send(
                {
                    "type": "LocalStorageGetItemResponseMessage",
                    "value": self.storage.get(message["key"]),
                    "error": None,
                    "request_uuid": message["request_uuid"],
                }
            )
        elif kind == "LocalStorageSetItemMessage":
            self.storage[message["key"]] = message["value"]
        elif kind == "LocalStorageRemoveItemMessage":
            self.storage.pop(message["key"], None)
        with self._changed:
            if kind == "GuiUpdateMessage":
                self._update(message)
            elif kind == "GuiRemoveMessage":
                self.widgets.pop(uuid, None)
            elif kind == "RegisterCommandMessage":
                self.commands[uuid] = message["props"]["label"]
            elif kind == "CommandUpdateMessage" and "label" in message["updates"]:
                self.commands[uuid] = message["updates"]["label"]
            elif kind == "RemoveCommandMessage":
                self.commands.pop(uuid, None)
            elif kind.startswith("Gui") and "props" in message:
                self.widgets[uuid] = Widget(
                    uuid=uuid,
                    type=kind,
                    container_uuid=message.get("container_uuid", "root"),
                    props=message["props"],
                    value=message.get("value"),
                    tabs=_tabs(message["props"]),
                )
            self._changed.notify_all()

    def _update(self, message: dict[str, Any]) -> None:
        widget = self.widgets.get(message["uuid"])
        if widget is None:
            return
        for name, value in message["updates"].items():
            if name == "value":
                widget.value = value
            else:
                widget.props[name] = value
        widget.tabs = _tabs(widget.props)


def connect(
    url: str,
    cookie: str | None = None,
    *,
    storage: dict[str, str] | None = None,
    with_camera: bool = True,
    version: str = viser.__version__,
) -> ViserClient:
    """Connect to a server as a page of its own would.

    ``url``: http or ws, without a path. ``storage``: what the browser has kept. A server takes a
    client for connected once it knows its camera, which ``with_camera`` sends.
    """
    place = url.split("://", 1)[-1].split("/", 1)[0]
    headers = {} if cookie is None else {"Cookie": cookie}
    socket = websockets.sync.client.connect(
        f"ws://{place}",
        origin=f"http://{place}",  # type: ignore[arg-type]  # a plain string of websockets' type
        subprotocols=[f"viser-v{version}"],  # type: ignore[list-item]  # the same
        additional_headers=headers,
        compression=None,
        max_size=None,
        proxy=None,
    )
    client = ViserClient(socket, {} if storage is None else storage)
    if with_camera:
        client.send(CAMERA)
    return client


def unpacked(data: bytes) -> list[dict[str, Any]]:
    """The messages of one frame from the server, arrays as numpy arrays.

    Sizes (2 x 8 bytes), compressed messages, then the arrays' buffers, each on 8 bytes.
    """
    size = int.from_bytes(data[8:16], "little")
    window = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(data[16 : 16 + size]))
    buffers: list[bytes] = []
    at = 16 + size
    for length in window["binaryBufferLengths"]:
        at += -at % 8
        buffers.append(data[at : at + length])
        at += length
    return [_with_arrays(message, buffers) for message in window["messages"]]


def _with_arrays(value: Any, buffers: list[bytes]) -> Any:
    if isinstance(value, dict):
        if "__binary_index" in value:
            return np.frombuffer(buffers[value["__binary_index"]], dtype=value["dtype"])
        return {name: _with_arrays(inner, buffers) for name, inner in value.items()}
    if isinstance(value, list):
        return [_with_arrays(inner, buffers) for inner in value]
    return value


def _tabs(props: Mapping[str, Any]) -> dict[str, str]:
    """Labels of a tab group's tabs, by the uuid of what they hold."""
    # An update brings one before the other.
    ids, labels = props.get("_tab_container_ids", ()), props.get("_tab_labels", ())
    return dict(zip(ids, labels, strict=False))
