"""Odometry's noise model, learned while the robot drives.

Odometry errors differ between robots by orders of magnitude, so that no fixed value suits all. The
standard deviation of a step is taken to be proportional to the step (Thrun, Burgard, Fox 2005,
5.4), by a factor for translation and one for rotation, which are estimated from the differences
between odometry and scan matching.
"""

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.planar_poses import compose_poses, relative_pose

# The size of a step in metres and in radians, of its distance in metres, its rotation in radians
# and a constant: wheels slip when they start, a straight step turns a little, and a rotation on the
# spot moves a little. They correspond to the α of Thrun et al. 2005, 5.4; set by hand.
_SIZE_M, _SIZE_RAD = (1.0, 0.05, 0.02), (0.15, 1.0, 0.005)
# Errors of successive steps are correlated (wheels of two sizes, a late stamp), so that the
# differences are summed over a window of steps. Empirical.
_WINDOW_STEPS = 10
# Weight of the initial factors, in windows, and the most windows of the running mean, since the
# floor may change. Empirical.
_WINDOWS_INITIAL, _WINDOWS_MAX = 2.0, 30.0
# In standard deviations: the usual bound beyond which a difference is a slip or a false match.
_OUTLIER_SIGMAS = 3.0
# A match with less than this fraction of the information does not measure the error. Empirical.
_GAIN_MIN = 0.1
# Factor of the deviation in a match's prior: an overconfident prior is worse than a weak one.
_PRIOR_FACTOR = 2.0
# Odometry of wheels is not better than this, however well it agrees for a while. Empirical.
_RELATIVE_SIGMA_MIN = 0.03


class OdometryNoiseModel:
    """Standard deviations of odometry's steps.

    ``sigma_m_per_m``, ``sigma_rad_per_rad``: before anything is learned. A step is (3,) x, y, yaw
    of a scan in the frame of the scan before it.
    """

    def __init__(self, sigma_m_per_m: float, sigma_rad_per_rad: float) -> None:
        self._variances = np.array([sigma_m_per_m**2, sigma_rad_per_rad**2])
        self._variances_min = np.minimum(_RELATIVE_SIGMA_MIN**2, self._variances)
        self._windows = np.full(2, _WINDOWS_INITIAL)
        # Over the window: the motion by both, the steps' squared sizes, and the matches' weights.
        self._sum_by_odometry, self._sum_by_scans = np.zeros(3), np.zeros(3)
        self._squared_sizes, self._gains, self._steps = np.zeros(2), np.zeros(3), 0

    @property
    def relative_sigmas(self) -> FloatArray:
        """(2,) standard deviation of a metre in metres, and of a radian in radians."""
        sigmas: FloatArray = np.sqrt(self._variances)
        return sigmas

    def prior_sigma(self, step: FloatArray) -> FloatArray:
        """(2,) deviation of a step in metres and radians, as a prior of a match."""
        sigma: FloatArray = _PRIOR_FACTOR * self.relative_sigmas * _size_of_step(step)
        return sigma

    def sigma(self, step: FloatArray) -> FloatArray:
        """(2,) standard deviation of a step in metres and radians."""
        return self.prior_sigma(step) / _PRIOR_FACTOR

    def is_refuted(self, step: FloatArray, error: FloatArray, information: FloatArray) -> bool:
        """Whether the error of a step is an outlier; arguments as in ``update``."""
        sigma, gain = self._gain(step, information)
        return bool((np.abs(error) > _OUTLIER_SIGMAS * sigma * np.maximum(gain, _GAIN_MIN)).any())

    def update(self, step: FloatArray, error: FloatArray, information: FloatArray) -> None:
        """Learn from a scan that was matched.

        ``error``: (3,) from the step's end to where the scan was placed, in the scan's axes.
        ``information``: (3, 3) of the match without the prior.
        """
        self._sum_by_odometry = compose_poses(self._sum_by_odometry, step)
        self._sum_by_scans = compose_poses(self._sum_by_scans, compose_poses(step, error))
        self._squared_sizes += _size_of_step(step) ** 2
        self._gains += self._gain(step, information)[1]
        self._steps += 1
        if self._steps < _WINDOW_STEPS:
            return
        difference = relative_pose(self._sum_by_odometry, self._sum_by_scans)
        is_observed = self._gains > _GAIN_MIN * self._steps
        for kind, axes in ((0, (0, 1)), (1, (2,))):
            observed = [axis for axis in axes if is_observed[axis]]
            if not observed:
                continue
            variance = float(np.mean([difference[axis] ** 2 for axis in observed]))
            variance /= self._squared_sizes[kind]
            variance = min(variance, _OUTLIER_SIGMAS**2 * self._variances[kind])
            # A running mean over the last windows.
            self._windows[kind] = min(self._windows[kind] + 1.0, _WINDOWS_MAX)
            self._variances[kind] += (variance - self._variances[kind]) / self._windows[kind]
        self._variances = np.maximum(self._variances, self._variances_min)
        self.discard_window()

    def discard_window(self) -> None:
        """Reset the sums, as after a scan that was not matched."""
        self._sum_by_odometry, self._sum_by_scans = np.zeros(3), np.zeros(3)
        self._squared_sizes, self._gains, self._steps = np.zeros(2), np.zeros(3), 0

    def _gain(self, step: FloatArray, information: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(3,) deviations of the step's x, y, yaw, and the match's weight against the prior."""
        sigma = self.prior_sigma(step)[[0, 0, 1]]
        of_match = np.diag(information)
        return sigma, of_match / (of_match + sigma**-2.0)


def _size_of_step(step: FloatArray) -> FloatArray:
    """(2,) metres and radians to which the step's error is proportional."""
    distance_m, rotation_rad = float(np.hypot(step[0], step[1])), abs(float(step[2]))
    per_m, per_rad, constant = _SIZE_M
    size_m = per_m * distance_m + per_rad * rotation_rad + constant
    per_m, per_rad, constant = _SIZE_RAD
    return np.array([size_m, per_rad * rotation_rad + per_m * distance_m + constant])
