"""Plausible beam counts and angles of a 2D LiDAR's sweep.

Memory and time grow with the beams and angles that a file claims, so implausible ones are rejected.
"""

from math import isfinite, tau

# The finest 2D LiDARs have 25,200 beams a turn (0.014 degrees); a hundredth of a degree has 36,000.
MAX_BEAMS = 40_000
# Drivers round the step between beams, to two digits by up to 5 %, and with it the whole sweep.
MAX_SWEEP_RAD = 1.05 * tau
# 0.1 mm at a distance of 1 km: finer than any beam.
_MIN_STEP_RAD = 1e-7

_SET_ANGLES = "Set the scanner's angles, in radians, in its driver."


def is_full_circle(beams: int, angle_increment_rad: float) -> bool:
    """Whether the last beam is next to the first one, to within a beam and a half: also where one
    direction is measured twice, and where one is missing."""
    step_rad = abs(angle_increment_rad)
    return abs(step_rad * beams - tau) <= 1.5 * step_rad


class ImplausibleSweep(ValueError):
    """``problem`` names the beams or angles that no scanner has, ``advice`` what to do."""

    def __init__(self, problem: str, advice: str) -> None:
        super().__init__(problem)
        self.problem = problem
        self.advice = advice


def require_plausible_sweep(beams: int, angle_min_rad: float, angle_increment_rad: float) -> None:
    """Raise ImplausibleSweep unless a scanner can have this number of beams at these angles."""
    if beams < 1:
        raise ImplausibleSweep(
            "the scan has no ranges", "Check the scanner and the driver that recorded it."
        )
    if beams > MAX_BEAMS:
        raise ImplausibleSweep(
            f"the scan claims {beams} beams, more than {MAX_BEAMS}",
            "The message is damaged; leave the topic out.",
        )
    if not (isfinite(angle_min_rad) and isfinite(angle_increment_rad)) or not angle_increment_rad:
        raise ImplausibleSweep(
            f"angle_min {angle_min_rad} and angle_increment {angle_increment_rad} give no angles",
            _SET_ANGLES,
        )
    step_rad = abs(angle_increment_rad)
    if step_rad < _MIN_STEP_RAD:
        raise ImplausibleSweep(
            f"angle_increment {angle_increment_rad:g} rad is finer than any scanner's, "
            f"{_MIN_STEP_RAD:g} rad",
            _SET_ANGLES,
        )
    # A single beam has a step, too.
    widest_rad = step_rad * max(beams - 1, 1)
    if widest_rad > MAX_SWEEP_RAD:
        raise ImplausibleSweep(
            f"angle_increment {angle_increment_rad:g} rad over {beams} beams spans "
            f"{widest_rad / tau:.4g} turns",
            _SET_ANGLES,
        )
    if abs(angle_min_rad) > MAX_SWEEP_RAD:
        raise ImplausibleSweep(f"angle_min {angle_min_rad:g} rad is beyond a turn", _SET_ANGLES)
