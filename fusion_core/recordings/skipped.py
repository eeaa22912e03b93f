"""Messages that iteration skips: counted, and reported in one warning for each topic."""

import threading
from dataclasses import dataclass, field

from fusion_core.model.errors import RecordingError


@dataclass(slots=True)
class _Skipped:
    warning: int
    first_problem: str
    indexes: set[int] = field(default_factory=set)


class SkippedMessages:
    """Keeps ``warnings`` up to date; reading the same message again counts once."""

    def __init__(self, warnings: list[str]) -> None:
        self._warnings = warnings
        self._topics: dict[str, _Skipped] = {}
        self._lock = threading.Lock()

    def add(self, topic: str, index: int, count: int, error: RecordingError) -> None:
        """Message ``index`` of the ``count`` of a topic cannot be read."""
        with self._lock:
            skipped = self._topics.get(topic)
            if skipped is None:
                skipped = _Skipped(warning=len(self._warnings), first_problem=str(error))
                self._topics[topic] = skipped
                self._warnings.append("")
            skipped.indexes.add(index)
            self._warnings[skipped.warning] = (
                f"{topic}: {len(skipped.indexes)} of {count} messages are left out; "
                f"the first: {skipped.first_problem}"
            )
