"""Where a stream of a recording is silent for longer than it usually is."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.recording import Recording, Role

GAP_RATIO_MIN = 3.0
"""A gap is longer than this many median intervals: two lost messages in a row."""

# The median of fewer intervals is no estimate of the rate.
_INTERVALS_MIN = 3
# Several senders at rates of their own, or sent once: no interval is usual.
_WITHOUT_RATE: frozenset[Role] = frozenset({"tf", "tf_static", "other"})


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamGaps:
    """``count`` gaps, the longest of ``longest_s`` from ``longest_at_s`` after the recording's
    start; the silence before a stream's first message and after its last counts, too. Both are 0
    without a gap."""

    count: int
    longest_s: float = 0.0
    longest_at_s: float = 0.0


def stream_gaps(recording: Recording) -> dict[str, StreamGaps]:
    """The gaps of each topic that has a rate, by log times; nothing is decoded."""
    start_ns, end_ns = recording.start_ns, recording.end_ns
    if start_ns is None or end_ns is None:
        return {}
    found = {}
    for topic in recording.topics:
        if topic.role in _WITHOUT_RATE or topic.count <= _INTERVALS_MIN:
            continue
        # Files may hold what was logged at one time in any order.
        times_ns = np.sort(recording.received_ns(topic.name))
        usual_ns = float(np.median(np.diff(times_ns)))
        if usual_ns <= 0.0:
            continue
        edges_ns = np.concatenate([[start_ns], times_ns, [end_ns]])
        intervals_ns = np.diff(edges_ns)
        longest = int(np.argmax(intervals_ns))
        count = int((intervals_ns > GAP_RATIO_MIN * usual_ns).sum())
        found[topic.name] = StreamGaps(count=0)
        if count:
            found[topic.name] = StreamGaps(
                count=count,
                longest_s=float(intervals_ns[longest]) / NS_PER_S,
                longest_at_s=float(edges_ns[longest] - start_ns) / NS_PER_S,
            )
    return found
