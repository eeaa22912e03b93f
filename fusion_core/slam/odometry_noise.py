"""How far a robot's odometry is to be believed, learned as it drives.

One robot's wheels turn it by a tenth of a degree too much, the next one's by ten degrees, and no
setting is right for both. The error of a step is taken to grow with the step, by a share that is
the robot's own; what the scans say about each step teaches it.
"""

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.planar_poses import compose_poses, relative_pose

# What a step is, beside its own length and turn: wheels slip a little when the robot stands, and
# who drives straight on turns a little, who turns moves a little.
_STILL_M, _STILL_RAD = 0.02, 0.005
_METRE_OF_RAD, _RAD_OF_METRE = 0.05, 0.15
# Steps err together (wheels of two sizes, a late stamp), which shows over so many.
_STEPS_OF_WINDOW = 10
# Before anything is known, the shares stand for so many windows.
_WINDOWS_OF_GUESS = 2.0
# And the last so many count: the floor may change under the wheels.
_WINDOWS_MEMORY = 30.0
# Beyond three deviations it is a slip or a false match, and teaches no more than that.
_OUTLIER = 3.0
# Of a scan that hardly tells, the error is not known.
_GAIN_MIN = 0.1
_SAFETY = 2.0
_SHARE_MIN = 0.03


class OdometryNoiseModel:
    """The doubt of odometry's steps; ``share_m`` and ``share_rad`` are where learning starts."""

    def __init__(self, share_m: float, share_rad: float) -> None:
        self._squares = np.array([share_m**2, share_rad**2])
        self._floor = np.minimum(_SHARE_MIN**2, self._squares)
        self._windows = np.full(2, _WINDOWS_OF_GUESS)
        self._begin_window()

    def _begin_window(self) -> None:
        self._by_odometry, self._by_scans = np.zeros(3), np.zeros(3)
        self._sizes, self._gains, self._steps = np.zeros(2), np.zeros(3), 0

    @property
    def relative_sigmas(self) -> FloatArray:
        """(2,) the error of a metre in metres and of a radian in radians, one deviation."""
        shares: FloatArray = np.sqrt(self._squares)
        return shares

    def sigma(self, step: FloatArray) -> FloatArray:
        """(2,) deviation in metres and radians of ``step``, (3,) x, y, yaw in its own axes."""
        sigma: FloatArray = _SAFETY * self.relative_sigmas * _size(step)
        return sigma

    def error(self, step: FloatArray) -> FloatArray:
        """(2,) what is likely to be wrong with a step, in metres and radians."""
        return self.sigma(step) / _SAFETY

    def is_refuted(self, step: FloatArray, error: FloatArray, information: FloatArray) -> bool:
        """Whether the scan says that the step is off by more than three deviations.

        The arguments are those of ``learn``.
        """
        sigma, gain = self._gain(step, information)
        return bool((np.abs(error) > _OUTLIER * sigma * np.maximum(gain, _GAIN_MIN)).any())

    def _gain(self, step: FloatArray, information: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(3,) deviations of the step's x, y, yaw, and the scan's part in what came out."""
        sigma = self.sigma(step)[[0, 0, 1]]
        told = np.diag(information)
        return sigma, told / (told + sigma**-2.0)

    def update(self, step: FloatArray, error: FloatArray, information: FloatArray) -> None:
        """Take in what a scan says of a step.

        ``error``: (3,) from the step to where the scan was placed, in the scan's axes.
        ``information``: (3, 3) of the scan alone.
        """
        self._by_odometry = compose_poses(self._by_odometry, step)
        self._by_scans = compose_poses(self._by_scans, compose_poses(step, error))
        self._sizes += _size(step) ** 2
        self._gains += self._gain(step, information)[1]
        self._steps += 1
        if self._steps < _STEPS_OF_WINDOW:
            return
        away = relative_pose(self._by_odometry, self._by_scans)
        is_seen = self._gains > _GAIN_MIN * self._steps
        for kind, axes in ((0, (0, 1)), (1, (2,))):
            seen = [axis for axis in axes if is_seen[axis]]
            if not seen:
                continue
            square = float(np.mean([away[axis] ** 2 for axis in seen])) / self._sizes[kind]
            square = min(square, _OUTLIER**2 * self._squares[kind])
            self._windows[kind] = min(self._windows[kind] + 1.0, _WINDOWS_MEMORY)
            self._squares[kind] += (square - self._squares[kind]) / self._windows[kind]
        self._squares = np.maximum(self._squares, self._floor)
        self._begin_window()

    def discard_window(self) -> None:
        """A scan was lost: what odometry said meanwhile has no counterpart."""
        self._begin_window()


def _size(step: FloatArray) -> FloatArray:
    """(2,) how much of a step it is, in metres and in radians."""
    way_m, turn_rad = float(np.hypot(step[0], step[1])), abs(float(step[2]))
    return np.array(
        [
            way_m + _METRE_OF_RAD * turn_rad + _STILL_M,
            turn_rad + _RAD_OF_METRE * way_m + _STILL_RAD,
        ]
    )
