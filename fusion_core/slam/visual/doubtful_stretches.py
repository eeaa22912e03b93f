"""Stretches of a trajectory that something in the images contradicts.

What no image contradicts is not named. Depths that are all off by the same factor belong to a
world, and a trajectory, that are as much larger, which look the same to the last pixel: without
another measure the images do not show it. Depths that are late against colour contradict the
motion only by what the camera moves meanwhile, mostly below the noise of depth.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fusion_core.model.conventions import Float32Array, IntArray
from fusion_core.slam.visual.local_map import LocalMap
from fusion_core.slam.visual.tracked_frame import TrackedFrame


@dataclass(frozen=True, slots=True, kw_only=True)
class DoubtfulStretch:
    """Images whose poses are doubtful: up to ``share`` of an image says so, and what of it,
    ``says``, which follows "up to n %"."""

    first_stamp_ns: int
    last_stamp_ns: int
    share: float
    says: str

    @property
    def reason(self) -> str:
        """For people."""
        return f"up to {100.0 * self.share:.0f} % {self.says}"


PoseContradiction = Callable[[Float32Array, TrackedFrame, LocalMap], float | None]
"""Part of an image that contradicts its pose, by its depth image and its features, compared with
the reference keyframe of the local map; None where they cannot be compared."""


class PoseCheck:
    """Compares every ``check_images``-th image with the reference keyframe of its local map.

    A pose is doubtful where more than ``share_max`` of an image contradicts it. ``gap_images``,
    ``says``: see ``join_doubts``.
    """

    def __init__(
        self,
        contradiction: PoseContradiction,
        *,
        check_images: int,
        share_max: float,
        gap_images: int,
        says: str,
    ) -> None:
        self._contradiction = contradiction
        self._check_images, self._share_max = check_images, share_max
        self._gap_images, self._says = gap_images, says
        # By the image's number.
        self._shares: dict[int, float] = {}

    def check(
        self, image: int, depth_m: Float32Array, tracked: TrackedFrame, local: LocalMap
    ) -> None:
        """Compare an image, if its turn has come."""
        if image % self._check_images:
            return
        share = self._contradiction(depth_m, tracked, local)
        if share is not None:
            self._shares[image] = share

    def doubtful(self, stamps_ns: IntArray) -> tuple[DoubtfulStretch, ...]:
        """What was found, neighbouring comparisons joined."""
        return join_doubts(
            self._shares,
            stamps_ns,
            self._share_max,
            self._check_images,
            self._gap_images,
            self._says,
        )


def join_doubts(
    shares: Mapping[int, float],
    stamps_ns: IntArray,
    share_max: float,
    step: int,
    gap: int,
    says: str,
) -> tuple[DoubtfulStretch, ...]:
    """Stretches of images whose share is above ``share_max``.

    ``shares``: of every ``step``-th image by its number; each speaks for the images since the one
    before. ``gap``: images between two doubtful ones that do not part a stretch.
    """
    stretches: list[DoubtfulStretch] = []
    last = -step - gap - 1
    for image, found in sorted(shares.items()):
        if found <= share_max:
            continue
        first_ns, share = int(stamps_ns[max(image - step + 1, 0)]), found
        if image - last <= step + gap:
            before = stretches.pop()
            first_ns, share = before.first_stamp_ns, max(share, before.share)
        stretches.append(
            DoubtfulStretch(
                first_stamp_ns=first_ns,
                last_stamp_ns=int(stamps_ns[image]),
                share=share,
                says=says,
            )
        )
        last = image
    return tuple(stretches)
