"""The search for a mount, done once for the same scans and images.

It is most of an alignment, and a hundred tests align the same few recordings. What is kept goes by
the content of all that the search is given, so that a change of what precedes it is seen.
"""

import hashlib
import pickle
from collections.abc import Callable
from typing import Any

from fusion_core.alignment.mount import MountEstimate, estimate_mount


class KeptMounts:
    """Stands for ``estimate_mount``. What it raises is not kept."""

    def __init__(self) -> None:
        self._found: dict[bytes, tuple[MountEstimate, int]] = {}

    def __call__(
        self, *given: Any, on_step: Callable[[], None] = lambda: None, **named: Any
    ) -> MountEstimate:
        key = hashlib.sha256(pickle.dumps((given, sorted(named.items())))).digest()
        if key in self._found:
            estimate, steps = self._found[key]
            for _ in range(steps):
                on_step()
            return estimate
        steps = 0

        def count() -> None:
            nonlocal steps
            steps += 1
            on_step()

        estimate = estimate_mount(*given, on_step=count, **named)
        self._found[key] = estimate, steps
        return estimate
