"""How long a test waits for a state: far longer than a busy machine takes to reach it."""

import time
from collections.abc import Callable

# Reached only where something is broken.
ENOUGH_S = 240.0


def comes_true(condition: Callable[[], bool]) -> bool:
    """Whether a condition holds, now or in time."""
    deadline_s = time.monotonic() + ENOUGH_S
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(0.005)
    return True
