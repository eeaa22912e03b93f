"""Pose prediction for each scan: by odometry where it is known, else by constant velocity."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.planar_poses import compose_poses, relative_pose
from fusion_core.slam.odometry_noise import OdometryNoiseModel

# Without odometry, a robot is taken to move by up to this fraction of its highest speed; set by
# hand.
_USUAL_SPEED_FRACTION = 1.0 / 3.0
# A stamp may be off by one period of this rate; set by hand.
_STAMP_RATE_HZ = 30.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prediction:
    """A scan's expected pose in the local frame, before it is matched.

    ``pose``: (3,) by odometry where ``has_odometry``, else by constant velocity.
    ``pose_by_velocity``: (3,) by the latter in any case. ``step``: (3,) from the last scan to
    ``pose``. ``sigma``: (2,) of the step, in metres and radians, as a prior of the match.
    ``uncertainty``: (2,) what the step adds to the error of a pose that is not matched.
    ``is_plausible``: odometry measured a step that the robot can have made.
    """

    pose: FloatArray
    pose_by_velocity: FloatArray
    step: FloatArray
    sigma: FloatArray
    uncertainty: FloatArray
    has_odometry: bool
    is_plausible: bool


class PosePredictor:
    """Predicts each scan's pose from the scans before it."""

    def __init__(
        self, odometry_noise: OdometryNoiseModel, velocity_sigma: FloatArray, speed_max: FloatArray
    ) -> None:
        """``velocity_sigma``: (2,) metres and radians. ``speed_max``: (2,) m/s and rad/s."""
        self._odometry_noise = odometry_noise
        self._velocity_sigma, self._speed_max = velocity_sigma, speed_max
        # Of the last two scans, the later one at the end.
        self._stamps_ns: list[int] = []
        self._poses: list[FloatArray] = []
        self._pose_odom_last: FloatArray | None = None

    def predict(self, stamp_ns: int, pose_odom_scan: FloatArray | None) -> Prediction:
        """The first scan lies where odometry has it, else at the origin."""
        if not self._poses:
            pose = np.zeros(3) if pose_odom_scan is None else pose_odom_scan.astype(np.float64)
            return Prediction(
                pose=pose,
                pose_by_velocity=pose,
                step=np.zeros(3),
                sigma=np.zeros(2),
                uncertainty=np.zeros(2),
                has_odometry=True,
                is_plausible=True,
            )
        last = self._poses[-1]
        since_s = (stamp_ns - self._stamps_ns[-1]) / 1e9
        by_velocity = self._constant_velocity(stamp_ns)
        if pose_odom_scan is None or self._pose_odom_last is None:
            return Prediction(
                pose=by_velocity,
                pose_by_velocity=by_velocity,
                step=relative_pose(last, by_velocity),
                sigma=self._velocity_sigma,
                uncertainty=_USUAL_SPEED_FRACTION * self._speed_max * since_s,
                has_odometry=False,
                is_plausible=False,
            )
        by_odometry = compose_poses(last, relative_pose(self._pose_odom_last, pose_odom_scan))
        step = relative_pose(last, by_odometry)
        return Prediction(
            pose=by_odometry,
            pose_by_velocity=by_velocity,
            step=step,
            sigma=self._odometry_noise.prior_sigma(step),
            uncertainty=self._odometry_noise.sigma(step),
            has_odometry=True,
            is_plausible=self._is_plausible(step, since_s),
        )

    def update(
        self, stamp_ns: int, pose_local_scan: FloatArray, pose_odom_scan: FloatArray | None
    ) -> None:
        """Add a placed scan: its pose, and its pose by odometry."""
        self._stamps_ns = [*self._stamps_ns[-1:], stamp_ns]
        self._poses = [*self._poses[-1:], pose_local_scan]
        self._pose_odom_last = pose_odom_scan

    def _constant_velocity(self, stamp_ns: int) -> FloatArray:
        last = self._poses[-1]
        if len(self._poses) < 2:
            return last
        ratio = (stamp_ns - self._stamps_ns[-1]) / (self._stamps_ns[-1] - self._stamps_ns[-2])
        # After a gap between scans, it is unknown whether the robot kept moving.
        return compose_poses(last, min(ratio, 1.0) * relative_pose(self._poses[-2], last))

    def _is_plausible(self, step: FloatArray, since_s: float) -> bool:
        """Whether the robot can have moved so far in the time: odometry that is reset jumps."""
        m_s, rad_s = self._speed_max.tolist()
        return bool(
            np.hypot(step[0], step[1]) < m_s / _STAMP_RATE_HZ + m_s * since_s
            and abs(step[2]) < rad_s / _STAMP_RATE_HZ + rad_s * since_s
        )
