"""What a browser keeps for itself, asked for without a thread that waits for the answer."""

import secrets
from collections.abc import Callable, Sequence

import viser
from viser import _messages as messages

# The answers by key, None for a key that the browser does not have, or does not tell.
Answers = dict[str, str | None]


def ask(
    client: viser.ClientHandle, keys: Sequence[str], on_answer: Callable[[Answers], None]
) -> None:
    """Ask a browser for what it keeps under some keys.

    ``on_answer`` is called once, on the server's event loop, when all answers are there, and must
    not wait. A browser that never answers is never heard of again, and nothing waits for it.
    """
    connection = client._websock_connection
    key_of = {secrets.token_hex(16): key for key in keys}
    answers: Answers = {}

    def take(_: object, message: messages.LocalStorageGetItemResponseMessage) -> None:
        key = key_of.pop(message.request_uuid, None)
        if key is None:
            return
        answers[key] = None if message.error is not None else message.value
        if not key_of:
            connection.unregister_handler(messages.LocalStorageGetItemResponseMessage, take)
            on_answer(answers)

    connection.register_handler(messages.LocalStorageGetItemResponseMessage, take)
    for request, key in list(key_of.items()):
        connection.queue_message(
            messages.LocalStorageGetItemRequestMessage(key=key, request_uuid=request)
        )
    client.flush()
