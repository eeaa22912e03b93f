"""Asynchronous requests for items of a browser's local storage."""

import secrets
import threading
from collections.abc import Callable, Sequence

import viser
from viser import _messages as messages
from viser.infra import WebsockClientConnection

# Value by key; None where the browser has none or does not send it.
Answers = dict[str, str | None]


def request_items(
    client: viser.ClientHandle, keys: Sequence[str], on_answer: Callable[[Answers], None]
) -> None:
    """As ``request_from`` of the connection of a browser that has drawn a picture already."""
    request_from(client._websock_connection, keys, on_answer)
    client.flush()


def request_from(
    connection: WebsockClientConnection, keys: Sequence[str], on_answer: Callable[[Answers], None]
) -> None:
    """Request the items of some keys.

    ``on_answer`` is called once all answers have arrived, on the server's event loop, which it must
    not block. No thread waits for a browser that never answers.
    """
    key_of = {secrets.token_hex(16): key for key in keys}
    answers: Answers = {}

    def on_response(_: object, message: messages.LocalStorageGetItemResponseMessage) -> None:
        key = key_of.pop(message.request_uuid, None)
        if key is None:
            return
        answers[key] = None if message.error is not None else message.value
        if not key_of:
            connection.unregister_handler(messages.LocalStorageGetItemResponseMessage, on_response)
            on_answer(answers)

    connection.register_handler(messages.LocalStorageGetItemResponseMessage, on_response)
    for request, key in list(key_of.items()):
        connection.queue_message(
            messages.LocalStorageGetItemRequestMessage(key=key, request_uuid=request)
        )


def call_when_taken_in(
    client: viser.ClientHandle, action: Callable[[], None], timeout_s: float
) -> None:
    """Call ``action`` in a thread of its own once the browser has taken in all that it was sent
    before, or after ``timeout_s``. A browser answers messages in their order."""
    once = threading.Lock()

    def act() -> None:
        if once.acquire(blocking=False):
            action()

    def on_answer(_: Answers) -> None:
        threading.Thread(target=act, name="taken in", daemon=True).start()

    timer = threading.Timer(timeout_s, act)
    timer.daemon = True
    timer.start()
    request_items(client, ("",), on_answer)
