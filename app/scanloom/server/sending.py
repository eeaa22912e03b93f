"""Waking the sender of a browser's messages from other threads, without fail."""

import asyncio
import threading
from typing import Any


class LoopEvent(asyncio.Event):
    """An event that only its event loop's thread sets; to others' ``set`` it is deaf.

    viser sets the event of new messages in the thread that queues one, and then, at the end of an
    atomic block if there is one, on the event loop. asyncio's own is not made for the former: if it
    comes between the loop's look at the event and its wait, the event counts as set, and neither it
    nor any later one wakes the loop. The browser would hear nothing more. The latter suffices.
    """

    def __init__(self) -> None:
        super().__init__()
        self._thread = threading.get_ident()

    def set(self) -> None:
        """Set it, on the event loop; elsewhere do nothing."""
        if threading.get_ident() == self._thread:
            super().set()


def send_without_fail(connection: Any) -> None:
    """Have all messages queued for a new connection of viser's be sent. To be called on the event
    loop, before any is."""
    connection.get_message_buffer().message_event = LoopEvent()
