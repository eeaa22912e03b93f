"""Laser odometry: each scan matched by PL-ICP (Li 2022 §2.3, eq. 4) to a keyframe.

Li 2022 §3.1 matches each scan to the one before, so the error of every match accumulates, even at
standstill: ``PUBLISHED``. Against keyframes only one match per keyframe accumulates.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from fusion_core.model.conventions import FloatArray, wrap_angle
from fusion_core.model.errors import MissingStream, RegistrationFailed
from fusion_core.model.planar_poses import PosePrior, compose_poses, relative_pose
from fusion_core.model.progress import Progress, silent
from fusion_core.model.sensors import LaserScan
from fusion_core.motion.keyframe_chain import KeyframeChain
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from fusion_core.motion.steps import rotate_covariance, steps_between, subtract_poses
from fusion_core.registration.pl_icp import (
    PlIcpSettings,
    ReferenceScan,
    ScanMatch,
    match_to_reference,
)
from fusion_core.settings import StageSettings, setting

# Set by hand: averaging four steps halves the noise, and at 10 Hz they span only 0.4 s.
_VELOCITY_STEPS = 4


class LaserOdometrySettings(StageSettings):
    """Settings of ``laser_odometry``."""

    reference: Literal["keyframe", "previous_scan"] = setting(
        "keyframe",
        "What a scan is matched with: a keyframe, fused with the prediction, or the scan before, "
        "by the match alone (Li 2022)",
    )
    keyframe_distance_m: float = setting(
        1.0,
        "Distance at which a new keyframe is taken",
        unit="m",
        ge=1e-6,
        le=10.0,
        formerly="key_step_m",
    )
    keyframe_rotation_rad: float = setting(
        1.0,
        "Rotation at which a new keyframe is taken",
        unit="rad",
        ge=1e-6,
        le=float(np.pi),
        formerly="key_turn_rad",
    )
    keyframe_inlier_ratio: float = setting(
        0.7,
        "Inlier ratio below which a scan becomes the new keyframe",
        ge=0.0,
        le=1.0,
        formerly="key_inlier_share",
    )
    inlier_ratio_sufficient: float = setting(
        0.5,
        "Inlier ratio at which the match from the prediction is accepted without a search",
        ge=1e-6,
        le=1.0,
        formerly="inlier_share_sure",
    )
    prediction_sigma_m: float = setting(
        0.05,
        "Standard deviation of the predicted translation, fused with the match",
        unit="m",
        ge=1e-6,
        le=10.0,
    )
    prediction_sigma_rad: float = setting(
        0.1,
        "Standard deviation of the predicted rotation, fused with the match",
        unit="rad",
        ge=1e-6,
        le=10.0,
    )
    sigma_inflation: float = setting(
        1.75,
        "Factor on the standard deviation of a match, for errors beyond range noise",
        ge=1.0,
        le=10.0,
        formerly="noise_factor",
    )
    innovation_max_m: float = setting(
        0.5,
        "Greatest distance of a match from the prediction; above it the match is rejected",
        unit="m",
        ge=1e-6,
        le=10.0,
        formerly="surprise_m",
    )
    innovation_max_rad: float = setting(
        0.7,
        "Greatest rotation of a match from the prediction; above it the match is rejected",
        unit="rad",
        ge=1e-6,
        le=float(np.pi),
        formerly="surprise_rad",
    )
    unmatched_scans_max: int = setting(
        5,
        "Consecutive scans without a match after which a new segment starts",
        unit="scans",
        ge=0,
        le=10_000,
        formerly="patience",
    )
    beams_min: int = setting(30, "Fewest valid beams of a scan", unit="beams", ge=6, le=10_000)
    search_translation_m: float = setting(
        0.5,
        "Half width of the search along x and y where the prediction leads to no match",
        unit="m",
        ge=0.0,
        le=10.0,
    )
    search_rotation_rad: float = setting(
        0.5, "Half width of that search in rotation", unit="rad", ge=0.0, le=float(np.pi)
    )


PUBLISHED = LaserOdometrySettings(reference="previous_scan")


def laser_odometry(
    scans: Iterable[LaserScan],
    settings: LaserOdometrySettings | None = None,
    predicted: PosePrior | None = None,
    progress: Progress = silent,
) -> OdometryTrajectory:
    """The LiDAR's trajectory from its scans, whose stamps increase.

    ``predicted``: poses of another source, such as wheel odometry, whose steps give the initial
    guess and the gate of each match; without it, constant velocity. A scan without a match takes
    the predicted pose. Along unobservable directions, as in a corridor, a match keeps the
    prediction, and its covariance is large.

    Raises MissingStream where there is no scan.
    """
    odometry = _LaserOdometry(settings or LaserOdometrySettings(), predicted)
    for count, scan in enumerate(scans, start=1):
        odometry.add(scan)
        progress(count, None, "laser odometry")
    return odometry.trajectory()


@dataclass(eq=False)
class _Keyframe:
    """A scan at its pose, prepared as a reference on first use."""

    scan: LaserScan
    pose: FloatArray
    settings: PlIcpSettings

    @cached_property
    def reference(self) -> ReferenceScan:
        return ReferenceScan.of(
            self.scan.ranges_m,
            angle_min_rad=self.scan.angle_min_rad,
            angle_increment_rad=self.scan.angle_increment_rad,
            settings=self.settings,
        )


class _LaserOdometry:
    def __init__(self, settings: LaserOdometrySettings, predicted: PosePrior | None) -> None:
        self._settings = settings
        self._predicted = predicted
        self._is_scan_to_scan = settings.reference == "previous_scan"
        self._icp = PlIcpSettings(
            beams_min=settings.beams_min,
            inlier_ratio_sufficient=settings.inlier_ratio_sufficient,
            search_translation_m=settings.search_translation_m,
            search_rotation_rad=settings.search_rotation_rad,
        )
        self._stamps_ns: list[int] = []
        self._chain = KeyframeChain()
        self._keyframe: _Keyframe | None = None
        self._last: _Keyframe | None = None
        self._misses = 0
        self._prior: FloatArray | None = None

    def add(self, scan: LaserScan) -> None:
        """Place the next scan."""
        prior = None if self._predicted is None else self._predicted(scan.stamp_ns)
        pose = self._predict_pose(scan.stamp_ns, prior)
        self._prior = prior
        self._stamps_ns.append(scan.stamp_ns)
        if np.count_nonzero(scan.ranges_m > 0.0) < self._settings.beams_min:
            self._add_unmatched(pose, "too few beams")
            return
        if self._keyframe is None:
            self._start_segment(scan, pose)
            return
        match = self._match(self._keyframe, scan, pose)
        if isinstance(match, str) and self._last is not None:
            # The scan before may still overlap where the keyframe no longer does.
            keyframe = self._last
            self._set_keyframe(keyframe)
            match = self._match(keyframe, scan, pose)
        if isinstance(match, str):
            if self._misses >= self._settings.unmatched_scans_max:
                self._start_segment(scan, pose, match)
            else:
                self._add_unmatched(pose, match)
            return
        self._accept_match(scan, match, pose)

    def _predict_pose(self, stamp_ns: int, prior: FloatArray | None) -> FloatArray:
        poses = self._chain.poses
        if not poses:
            return np.zeros(3)
        last = poses[-1]
        if prior is not None and self._prior is not None:
            return compose_poses(last, relative_pose(self._prior, prior))
        back = self._count_matched_steps()
        if back == 0:
            # After a failed match the velocity is unknown.
            return last.copy()
        # Translation from the mean velocity of several steps: along a corridor, the error of one
        # step would be repeated in each prediction. Rotation is always observable and changes
        # faster: that of the last step is used.
        stamps_ns = self._stamps_ns
        steps = steps_between(np.array(poses[-1 - back :]))
        since_ns = stamp_ns - stamps_ns[-1]
        # Over a pause in the scans the motion is not extrapolated beyond one step.
        fraction = min(since_ns / (stamps_ns[-1] - stamps_ns[-2]), 1.0)
        extrapolated_ns = min(since_ns, int(np.diff(stamps_ns[-1 - back :]).max()))
        step = steps.sum(axis=0) * (extrapolated_ns / (stamps_ns[-1] - stamps_ns[-1 - back]))
        step[2] = fraction * steps[-1, 2]
        return compose_poses(last, step)

    def _count_matched_steps(self) -> int:
        """Number of matched steps in a row before the next scan, at most _VELOCITY_STEPS."""
        matched = self._chain.matched
        back = 0
        while back < min(_VELOCITY_STEPS, len(matched) - 1) and matched[-1 - back]:
            back += 1
        return back

    def _match(
        self, keyframe: _Keyframe, scan: LaserScan, predicted: FloatArray
    ) -> ScanMatch | str:
        """The match to a keyframe, or why there is none."""
        guess = relative_pose(keyframe.pose, predicted)
        try:
            match = match_to_reference(
                keyframe.reference,
                scan.ranges_m,
                angle_min_rad=scan.angle_min_rad,
                angle_increment_rad=scan.angle_increment_rad,
                guess=guess,
            )
        except RegistrationFailed:
            return "no match"
        away = match.pose_first_second - guess
        # The prediction's error grows with each scan that had no match.
        gate_factor = 1 + self._misses
        is_far = np.hypot(away[0], away[1]) > gate_factor * self._settings.innovation_max_m
        if is_far or abs(wrap_angle(away[2])) > gate_factor * self._settings.innovation_max_rad:
            return "a match far from what was predicted"
        return match

    def _accept_match(self, scan: LaserScan, match: ScanMatch, predicted: FloatArray) -> None:
        assert self._keyframe is not None, "a match has a keyframe"
        settings = self._settings
        noise = match.covariance * settings.sigma_inflation**2
        step = match.pose_first_second
        if not self._is_scan_to_scan:
            predicted_step = relative_pose(self._keyframe.pose, predicted)
            step = self._fuse_with_prediction(step, noise, predicted_step)
        pose = compose_poses(self._keyframe.pose, step)
        # The covariance of the match alone: the prediction is another source's information.
        self._chain.append(pose, rotate_covariance(float(step[2]), noise), matched=True)
        self._misses = 0
        self._last = _Keyframe(scan, pose, self._icp)
        if (
            self._is_scan_to_scan
            or np.hypot(step[0], step[1]) > settings.keyframe_distance_m
            or abs(step[2]) > settings.keyframe_rotation_rad
            or match.inlier_ratio < settings.keyframe_inlier_ratio
        ):
            self._set_keyframe(self._last)

    def _fuse_with_prediction(
        self, step: FloatArray, noise: FloatArray, predicted: FloatArray
    ) -> FloatArray:
        """The Kalman update of the prediction by a match (Li 2022 (6), (7) with covariances).

        Along poorly observable directions the match's error would otherwise become velocity and
        grow from scan to scan.
        """
        sigmas = (self._settings.prediction_sigma_m,) * 2 + (self._settings.prediction_sigma_rad,)
        prediction_covariance = np.diag(np.square(sigmas))
        gain = prediction_covariance @ np.linalg.inv(prediction_covariance + noise)
        supported: FloatArray = predicted + gain @ subtract_poses(step, predicted)
        supported[2] = wrap_angle(supported[2])
        return supported

    def _add_unmatched(self, pose: FloatArray, reason: str) -> None:
        self._misses += 1
        self._chain.append_unmatched(pose, reason)

    def _start_segment(self, scan: LaserScan, pose: FloatArray, reason: str = "") -> None:
        self._set_keyframe(_Keyframe(scan, pose, self._icp))
        self._chain.start_segment(pose, reason)
        self._misses = 0

    def _set_keyframe(self, keyframe: _Keyframe) -> None:
        self._keyframe, self._last = keyframe, None
        self._chain.keyframe += 1

    def trajectory(self) -> OdometryTrajectory:
        """The trajectory over all scans so far."""
        if not self._stamps_ns:
            raise MissingStream("laser odometry needs a scan.")
        return self._chain.to_trajectory(
            "laser", self._stamps_ns, is_scan_to_scan=self._is_scan_to_scan
        )
