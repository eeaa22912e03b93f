"""The angle of a turning axis at any instant, from samples of its encoder."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import NS_PER_S, FloatArray, IntArray, read_only
from fusion_core.model.errors import CalibrationFailed

# An encoder that reports less often than this is not interpolated across the gap.
_GAP_MAX_S = 0.5


@dataclass(frozen=True, slots=True)
class AxisAngles:
    """Samples of an axis: (J,) rising stamps and (J,) angles without jumps of a whole turn."""

    stamps_ns: IntArray
    angles_rad: FloatArray

    def __post_init__(self) -> None:
        if self.stamps_ns.shape != self.angles_rad.shape or self.stamps_ns.size == 0:
            raise ValueError(f"one angle a stamp, got {self.angles_rad.shape}")
        read_only(self.stamps_ns)
        read_only(self.angles_rad)

    def at(self, stamps_ns: IntArray) -> FloatArray:
        """(N,) angles at instants, linear in time between samples; NaN before the first and after
        the last sample, and in gaps of more than half a second."""
        after = np.clip(np.searchsorted(self.stamps_ns, stamps_ns), 1, self.stamps_ns.size - 1)
        if self.stamps_ns.size == 1:
            return np.where(stamps_ns == self.stamps_ns[0], self.angles_rad[0], np.nan)
        start, end = self.stamps_ns[after - 1], self.stamps_ns[after]
        fraction = (stamps_ns - start) / (end - start)
        angle = self.angles_rad[after - 1] * (1.0 - fraction) + self.angles_rad[after] * fraction
        known = (fraction >= 0.0) & (fraction <= 1.0) & (end - start <= _GAP_MAX_S * NS_PER_S)
        return np.where(known, angle, np.nan)


def make_axis_angles(stamps_ns: IntArray, angles_rad: FloatArray) -> AxisAngles:
    """Samples in any order, wrapped or not; NaN is left out, of equal stamps the last counts.

    Raises CalibrationFailed where no sample has an angle.
    """
    known = np.isfinite(angles_rad)
    if not known.any():
        raise CalibrationFailed("no sample of the axis has an angle.")
    order = np.argsort(stamps_ns[known], kind="stable")
    stamps, angles = stamps_ns[known][order], angles_rad[known][order]
    last = np.append(np.diff(stamps) > 0, True)
    # Between two samples an axis turns by less than half a turn.
    return AxisAngles(stamps[last], np.unwrap(angles[last]))
