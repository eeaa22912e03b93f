"""The poses of a camera's images as visual SLAM holds them: each relative to a keyframe, so that
what later moves the keyframe moves the image as well."""

from dataclasses import dataclass, field

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.slam.visual.visual_map import VisualMap

JUMP_M = 0.5
"""A larger step between neighbouring images is named in the report."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LostStretch:
    """Neighbouring images without a pose: from ``first`` to ``last`` (indices), and why."""

    first: int
    last: int
    first_stamp_ns: int
    last_stamp_ns: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Jump:
    """A step above JUMP_M between neighbouring images that have poses."""

    first_stamp_ns: int
    second_stamp_ns: int
    step_m: float


@dataclass(slots=True, eq=False)
class ImageTrajectory:
    """Of each image: its stamp, its reference keyframe (-1: lost), its pose relative to it, and the
    information of that (6, 6), None where it is lost or begins the map."""

    stamps_ns: list[int] = field(default_factory=list)
    references: list[int] = field(default_factory=list)
    T_reference_camera: list[FloatArray] = field(default_factory=list)
    information: list[FloatArray | None] = field(default_factory=list)
    losses: dict[int, str] = field(default_factory=dict)

    def append(
        self,
        stamp_ns: int,
        reference: int,
        T_reference_camera: FloatArray,
        information: FloatArray | None,
    ) -> None:
        self.stamps_ns.append(stamp_ns)
        self.information.append(information)
        self.references.append(reference)
        self.T_reference_camera.append(T_reference_camera)

    def append_lost(self, stamp_ns: int, reason: str) -> None:
        self.losses[len(self.stamps_ns)] = reason
        self.append(stamp_ns, -1, np.full((4, 4), np.nan), None)

    def last_tracked(self) -> int:
        """The newest image that has a pose."""
        return next(i for i in reversed(range(len(self.references))) if self.references[i] >= 0)

    def pose_of(self, image: int, visual_map: VisualMap) -> FloatArray:
        """(4, 4) T_map_camera of an image that has a pose."""
        T_map_camera: FloatArray = (
            visual_map.pose_of(self.references[image]) @ self.T_reference_camera[image]
        )
        return T_map_camera

    def poses(self, visual_map: VisualMap) -> FloatArray:
        """(N, 4, 4) T_map_camera, NaN where lost."""
        if not self.stamps_ns:
            return np.empty((0, 4, 4))
        of_keyframes = [visual_map.pose_of(k.index) for k in visual_map.keyframes]
        T_map_reference = np.stack([*of_keyframes, np.full((4, 4), np.nan)])
        poses: FloatArray = T_map_reference[self.references] @ np.stack(self.T_reference_camera)
        return poses


def find_lost_stretches(stamps_ns: IntArray, losses: dict[int, str]) -> tuple[LostStretch, ...]:
    stretches: list[LostStretch] = []
    for index in sorted(losses):
        first = index
        reason = losses[index]
        if stretches and stretches[-1].last == index - 1:
            # The first reason is that of the loss; the later ones follow from it.
            first, reason = stretches[-1].first, stretches[-1].reason
            stretches.pop()
        stretches.append(
            LostStretch(
                first=first,
                last=index,
                first_stamp_ns=int(stamps_ns[first]),
                last_stamp_ns=int(stamps_ns[index]),
                reason=reason,
            )
        )
    return tuple(stretches)


def find_jumps(stamps_ns: IntArray, poses: FloatArray, is_tracked: BoolArray) -> tuple[Jump, ...]:
    placed = np.flatnonzero(is_tracked)
    steps_m = np.linalg.norm(np.diff(poses[placed, :3, 3], axis=0), axis=1)
    return tuple(
        Jump(
            first_stamp_ns=int(stamps_ns[placed[i]]),
            second_stamp_ns=int(stamps_ns[placed[i + 1]]),
            step_m=float(steps_m[i]),
        )
        for i in np.flatnonzero(steps_m > JUMP_M)
    )
