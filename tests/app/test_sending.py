"""Messages that threads queue are sent, however they fall on the event loop's steps."""

import asyncio
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest
from viser import _messages as messages
from viser.infra._async_message_buffer import AsyncMessageBuffer

from scanloom.server.sending import send_without_fail
from tests.patience import ENOUGH_S

MESSAGES = 300


@dataclass
class Connection:
    """What is known of viser's connections here."""

    buffer: AsyncMessageBuffer

    def get_message_buffer(self) -> AsyncMessageBuffer:
        return self.buffer


@contextmanager
def frequent_switches() -> Iterator[None]:
    """Threads take turns after few steps."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        yield
    finally:
        sys.setswitchinterval(before)


def test_the_event_is_set_on_the_loop_alone() -> None:
    async def on_loop() -> None:
        buffer = AsyncMessageBuffer(asyncio.get_running_loop(), persistent_messages=False)
        send_without_fail(Connection(buffer))
        event = buffer.message_event
        thread = threading.Thread(target=event.set)
        thread.start()
        thread.join()
        assert not event.is_set()
        event.set()
        assert event.is_set()

    asyncio.run(on_loop())


@pytest.mark.parametrize("is_atomic", [False, True])
def test_each_message_of_a_thread_arrives(is_atomic: bool) -> None:
    arrived = threading.Semaphore(0)

    async def send(buffer: AsyncMessageBuffer) -> None:
        sent = 0
        async for window in buffer.window_generator(0):
            sent += len(window)
            arrived.release(len(window))
            if sent == MESSAGES:
                return

    def queue(buffer: AsyncMessageBuffer) -> None:
        for _ in range(MESSAGES):
            if is_atomic:
                buffer.atomic_start()
            buffer.push(messages.RunJavascriptMessage(source=""))
            if is_atomic:
                buffer.atomic_end()
            # The next one comes while the loop is about to wait for it.
            assert arrived.acquire(timeout=ENOUGH_S)

    async def on_loop() -> None:
        loop = asyncio.get_running_loop()
        buffer = AsyncMessageBuffer(loop, persistent_messages=False, window_duration_sec=0.0)
        send_without_fail(Connection(buffer))
        await asyncio.gather(send(buffer), asyncio.to_thread(queue, buffer))

    with frequent_switches():
        asyncio.run(on_loop())
