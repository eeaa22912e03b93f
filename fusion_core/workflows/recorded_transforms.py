"""The transforms of a recording in one tree, by frame names without leading slashes."""

from collections.abc import Iterator
from itertools import islice

from fusion_core.model.recording import Recording
from fusion_core.model.sensors import Transform, TransformBatch
from fusion_core.model.transform_tree import TransformTree
from fusion_core.workflows.timed_transforms import TimedTransforms

# Latching publishers repeat the static transforms; this many messages hold any tree of frames.
_STATIC_MESSAGES_MAX = 500


def frame_name(frame_id: str) -> str:
    """A frame's name as tf2 has it: ROS 1 allowed a leading slash for the same frame."""
    return frame_id.lstrip("/")


class RecordedTransforms:
    """The static transforms of a recording and, once they are read, timed ones.

    ``tree``: for look-ups between any two frames. ``tf_static``: the topic, None where there is
    none.
    """

    def __init__(self, recording: Recording, tf_static: str | None) -> None:
        self.tree = TransformTree(samples_per_pair=None)
        self._recording = recording
        self._static_parents: dict[str, str] = {}
        if tf_static is not None:
            for sample, _ in self._read(tf_static, _STATIC_MESSAGES_MAX):
                self.tree.add(sample, static=True)
                self._static_parents[sample.child] = sample.parent

    def root_of(self, frame: str) -> str:
        """The frame that is reached by following static parents; of a cycle any of its frames."""
        seen = {frame}
        while frame in self._static_parents and self._static_parents[frame] not in seen:
            frame = self._static_parents[frame]
            seen.add(frame)
        return frame

    def add_timed(self, topic: str, *, without: frozenset[str] = frozenset()) -> frozenset[str]:
        """Add the transforms of a topic to the tree, without outliers, which cost a warning.

        Transforms from or to a frame of ``without`` are left out. Returns those that there are.
        """
        timed = TimedTransforms()
        left_out: set[str] = set()
        for sample, received_ns in self._read(topic, None):
            excluded = without & {sample.parent, sample.child}
            left_out |= excluded
            if not excluded:
                timed.add(sample, received_ns)
        timed.add_inliers_to(self.tree, topic, self._recording)
        return frozenset(left_out)

    def _read(self, topic: str, messages_max: int | None) -> Iterator[tuple[Transform, int | None]]:
        """Each transform with the log time of its message, None where there is no log."""
        for message in islice(self._recording.messages([topic]), messages_max):
            if isinstance(message.value, TransformBatch):
                for sample in message.value.transforms:
                    named = Transform(
                        stamp_ns=sample.stamp_ns,
                        parent=frame_name(sample.parent),
                        child=frame_name(sample.child),
                        T_parent_child=sample.T_parent_child.copy(),
                    )
                    yield named, message.received_ns
