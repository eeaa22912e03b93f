"""A filter for messages stamped out of order, by one rule for every stage.

A message whose stamp contradicts the order or the times of the log, as after a jump of the clock,
is left out; the others stay (``fusion_core.model.stamps``).
"""

from collections.abc import Iterator

import numpy as np

from fusion_core.model.conventions import NS_PER_S, BoolArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.recording import Message, Recording
from fusion_core.model.stamps import plausible_stamps


class StampFilter:
    """Passes on the messages that are stamped in order, and warns of the others.

    ``strictly``: of equal stamps of a topic only the first is kept, since no sensor measures twice
    at one instant.
    """

    def __init__(self, recording: Recording, *, strictly: bool = True) -> None:
        self._recording, self._strictly = recording, strictly
        self._kept: dict[str, BoolArray] = {}

    def accepted(self, messages: Iterator[Message]) -> Iterator[Message]:
        """The messages that are in order."""
        for message in messages:
            if self.is_in_order(message.topic, message.index):
                yield message

    def is_in_order(self, topic: str, index: int) -> bool:
        """Whether the ``index``-th message of a topic is in order."""
        return bool(self.in_order(topic)[index])

    def in_order(self, topic: str) -> BoolArray:
        """(count,) which messages of a topic are in order."""
        if topic not in self._kept:
            self._kept[topic] = self._find_in_order(topic)
        return self._kept[topic]

    def require_most_in_order(self, topic: str) -> None:
        """Raise RecordingError where more than half of a topic's messages are left out."""
        kept = self.in_order(topic)
        left_out = np.count_nonzero(~kept)
        if 2 * left_out > kept.size:
            raise RecordingError(
                f"{left_out} of {kept.size} messages of {topic} are stamped out of order.",
                file=self._recording.path,
                advice="Check the clock that stamps them, or name another topic.",
            )

    def _find_in_order(self, topic: str) -> BoolArray:
        stamps_ns, received_ns = (
            self._recording.stamps_ns(topic),
            self._recording.received_ns(topic),
        )
        kept = plausible_stamps(stamps_ns, received_ns, strictly=self._strictly)
        left_out = np.flatnonzero(~kept)
        if left_out.size:
            first = int(left_out[0])
            warn_once(
                self._recording,
                f"{topic}: {left_out.size} of {kept.size} messages are left out, as they are "
                f"stamped out of order; the first: {first}, at {stamps_ns[first] / NS_PER_S:.3f} s",
            )
        return kept


def warn_once(recording: Recording, warning: str) -> None:
    """Add a warning, unless an earlier pass over the recording has."""
    if warning not in recording.warnings:
        recording.warnings.append(warning)
