"""Pairs of poses of a trajectory that are one step apart: a time, a distance, or some frames."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fusion_core.model.conventions import NS_PER_S, FloatArray, IntArray
from fusion_core.model.errors import ScanLoomError, SettingsError

StepUnit = Literal["s", "m", "frames"]

STEP_TOLERANCE = 0.1
"""How far a pair may be from the step, as a fraction of it: pairs across gaps are left out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """``delta`` seconds, metres along the reference's path, or poses of the estimate.

    Raises SettingsError for a step that is not positive, or not a whole number of frames.
    """

    delta: float = 1.0
    unit: StepUnit = "s"

    def __post_init__(self) -> None:
        if not 0.0 < self.delta < np.inf:
            raise SettingsError(f"the step must be positive and finite, got {self.delta:g}.")
        if self.unit == "frames" and self.delta != round(self.delta):
            raise SettingsError(f"a step in frames must be a whole number, got {self.delta:g}.")

    def __str__(self) -> str:
        return f"{self.delta:g} {self.unit}"


def pairs_of_step(stamps_ns: IntArray, path_m: FloatArray, step: Step) -> tuple[IntArray, IntArray]:
    """First and second index, (P,) each, of all pairs of poses that are one step apart.

    Each pose is paired with the later one that is nearest to a step after it, if that is within
    a tenth of a step. ``stamps_ns``: (K,) ascending; ``path_m``: (K,) distance travelled at each.

    Raises ScanLoomError where there is no pair.
    """
    count = stamps_ns.size
    if step.unit == "frames":
        # A step longer than the trajectory gives no pair; the bound keeps int() small.
        offset = int(min(step.delta, count))
        first = np.arange(count - offset)
        second = first + offset
    else:
        place = (stamps_ns - stamps_ns[0]) / NS_PER_S if step.unit == "s" else path_m
        first, second = _nearest_pairs(place, step.delta)
    if first.size == 0:
        raise ScanLoomError(
            f"No two of the {count} poses compared are {step} apart.",
            advice="Choose another step.",
        )
    return first, second


def _nearest_pairs(place: FloatArray, delta: float) -> tuple[IntArray, IntArray]:
    target = place + delta
    # Of equal values, as while the robot stands, the first is taken.
    after = np.minimum(np.searchsorted(place, target), place.size - 1)
    before = np.searchsorted(place, place[np.maximum(after - 1, 0)])
    is_before = np.abs(place[before] - target) <= np.abs(place[after] - target)
    second = np.where(is_before, before, after)
    near = np.abs(place[second] - target) <= STEP_TOLERANCE * delta
    return np.flatnonzero(near), second[near]
