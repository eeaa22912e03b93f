"""Poses matched to keyframes, and the drift that accumulates from one keyframe to the next."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.motion.odometry_trajectory import OdometryTrajectory, mask_unmeasured
from fusion_core.motion.steps import rotate_covariance, steps_between


class KeyframeChain:
    """A trajectory that grows pose by pose. ``keyframe`` counts the keyframes so far."""

    def __init__(self) -> None:
        self.keyframe = 0
        self.poses: list[FloatArray] = []
        self.matched: list[bool] = []
        self._noise: list[FloatArray] = []
        self._keyframes: list[int] = []
        self._reasons: Counter[str] = Counter()

    def append(self, pose: FloatArray, noise: FloatArray, *, matched: bool) -> None:
        """Append a pose and the covariance of its match, in its own axes."""
        self.poses.append(pose)
        self.matched.append(matched)
        self._noise.append(noise)
        self._keyframes.append(self.keyframe)

    def append_unmatched(self, pose: FloatArray, reason: str) -> None:
        """Append a pose without a match, and count the reason."""
        self._reasons[reason] += 1
        self.append(pose, np.full((3, 3), np.nan), matched=False)

    def start_segment(self, pose: FloatArray, reason: str = "") -> None:
        """Append the first keyframe, or one that is not connected to those before.

        It is the origin of its segment, so without error; the step to it is not measured.
        """
        if reason:
            self._reasons[reason] += 1
        self.append(pose, np.zeros((3, 3)), matched=False)

    def to_trajectory(
        self,
        name: str,
        stamps_ns: Sequence[int],
        *,
        scale_sigma: float = 0.0,
        is_scan_to_scan: bool = False,
    ) -> OdometryTrajectory:
        """The poses at (N,) stamps.

        ``scale_sigma``: standard deviation of the scale, in m/m, which matches do not observe.
        ``is_scan_to_scan``: each pose was matched to the one before, so that a step is one match
        and all of it accumulates.
        """
        noise = np.array(self._noise)
        matched = np.array(self.matched, dtype=np.bool_)
        # A step is measured where its end was matched and its start has a covariance.
        measured = matched[1:] & np.isfinite(noise[:-1]).all(axis=(1, 2))
        poses = np.array(self.poses)
        steps = steps_between(poses)
        at_start = noise.copy()
        at_start[1:] = rotate_covariance(-steps[:, 2], noise[1:])
        if is_scan_to_scan:
            single = at_start[1:]
            drift = single.copy()
        else:
            single = noise[:-1] + at_start[1:]
            drift = _drift_covariances(single, np.array(self._keyframes, dtype=np.int64))
        # The error of the scale is the same in every step: a random walk over steps of 1 m.
        distance_m = np.hypot(steps[:, 0], steps[:, 1])
        drift[:, :2, :2] += (scale_sigma**2 * distance_m)[:, np.newaxis, np.newaxis] * np.eye(2)
        notes = []
        if reasons := [f"{count} {why}" for why, count in sorted(self._reasons.items())]:
            missed = int(np.count_nonzero(~measured))
            notes.append(f"{name}: {missed} steps not measured: {', '.join(reasons)}.")
        return OdometryTrajectory(
            name=name,
            stamps_ns=np.array(stamps_ns, dtype=np.int64),
            poses_odom_lidar=poses,
            step_covariance=mask_unmeasured(single, measured),
            drift_covariance=mask_unmeasured(drift, measured),
            measured=measured,
            notes=tuple(notes),
        )


def _drift_covariances(single: FloatArray, keyframe: IntArray) -> FloatArray:
    """(N - 1, 3, 3) the contribution of each step to the drift.

    One match per keyframe accumulates, so it is divided among the steps since that keyframe. A
    step's match covariance is the mean of its two poses', whose sum is ``single``. ``keyframe``:
    (N,) of each pose.
    """
    if not len(single):
        return single.copy()
    _, member, count = np.unique(keyframe[1:], return_inverse=True, return_counts=True)
    shared: FloatArray = 0.5 * single / count[member][:, np.newaxis, np.newaxis]
    return shared
