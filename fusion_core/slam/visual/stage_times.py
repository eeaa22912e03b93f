"""How long each stage of a run takes."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager


class StageTimes:
    """``seconds``: wall-clock time of each stage so far. A stage runs on one thread at a time."""

    def __init__(self, stages: Sequence[str]) -> None:
        self.seconds = dict.fromkeys(stages, 0.0)

    @contextmanager
    def measure(self, stage: str) -> Iterator[None]:
        """Add the time of a block."""
        start_s = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] += time.perf_counter() - start_s
