"""Timed transforms of a topic, whose outliers are dropped before they enter a transform tree."""

from array import array
from dataclasses import dataclass, field

import numpy as np

from fusion_core.model.conventions import NS_PER_S, BoolArray, FloatArray, IntArray
from fusion_core.model.isolated_poses import find_isolated_poses
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import Transform
from fusion_core.model.stamps import within_recording
from fusion_core.model.transform_tree import TransformTree
from fusion_core.workflows.stamp_filter import warn_once


@dataclass(slots=True)
class _Samples:
    """The samples of one pair of frames: stamps, log times, and 16 numbers per pose."""

    stamps_ns: "array[int]" = field(default_factory=lambda: array("q"))
    received_ns: "array[int]" = field(default_factory=lambda: array("q"))
    poses: "array[float]" = field(default_factory=lambda: array("d"))


class TimedTransforms:
    """Collects the poses of one topic, in the order of its log."""

    def __init__(self) -> None:
        self._pairs: dict[tuple[str, str], _Samples] = {}

    def add(self, sample: Transform, received_ns: int | None) -> None:
        """``received_ns``: None where there is no log."""
        samples = self._pairs.setdefault((sample.parent, sample.child), _Samples())
        samples.stamps_ns.append(sample.stamp_ns)
        samples.received_ns.append(sample.stamp_ns if received_ns is None else received_ns)
        samples.poses.frombytes(sample.T_parent_child.tobytes())

    def add_inliers_to(self, tree: TransformTree, topic: str, recording: Recording) -> None:
        """Add the inliers to a tree; outliers are left out with a warning of the recording."""
        for (parent, child), samples in self._pairs.items():
            stamps_ns, received_ns = np.array(samples.stamps_ns), np.array(samples.received_ns)
            poses = np.frombuffer(samples.poses).reshape(-1, 4, 4)
            far = ~within_recording(stamps_ns, received_ns)
            lone = _find_lone_jumps(stamps_ns, poses[:, :3, 3], ~far)
            for left_out, why in ((far, "stamped far from the others"), (lone, "lone jumps")):
                if left_out.any():
                    count, first_s = left_out.sum(), stamps_ns[left_out.argmax()] / NS_PER_S
                    warn_once(
                        recording,
                        f"{topic}: {count} of {left_out.size} poses of {child} "
                        f"are left out, as they are {why}; the first: at {first_s:.3f} s",
                    )
            for index in np.flatnonzero(~far & ~lone).tolist():
                sample = Transform(
                    stamp_ns=int(stamps_ns[index]),
                    parent=parent,
                    child=child,
                    T_parent_child=poses[index].copy(),
                )
                tree.add(sample, static=False)


def _find_lone_jumps(
    stamps_ns: IntArray, positions_m: FloatArray, candidates: BoolArray
) -> BoolArray:
    """(N,) the lone jumps among the ``candidates`` of (N,) samples in any order; of equal stamps
    the last counts, as in a tree."""
    lone = np.zeros(stamps_ns.size, dtype=np.bool_)
    chosen = np.flatnonzero(candidates)
    chosen = chosen[np.argsort(stamps_ns[chosen], kind="stable")]
    chosen = chosen[np.append(np.diff(stamps_ns[chosen]) > 0, True)[: chosen.size]]
    lone[chosen] = find_isolated_poses(stamps_ns[chosen], positions_m[chosen])
    return lone
