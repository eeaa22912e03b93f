"""Whether a mount that a recording states explains what its sensors saw."""

from dataclasses import replace

import numpy as np

from fusion_core.alignment.mount_cost import MIN_POINTS, MountCost
from fusion_core.alignment.mount_settings import MountSettings
from fusion_core.model.conventions import FloatArray, wrap_angle
from fusion_core.model.rig import Mount

# Tolerance between a recorded yaw and that of the rows; set by hand.
_SAME_YAW_RAD = np.deg2rad(5.0)
# Turned by each of these a right mount becomes wrong, unless the room repeats itself.
_TURNS_RAD = np.deg2rad(np.arange(10.0, 360.0, 10.0))
# Significance level: the fraction of turned mounts that may agree as well as the recorded one.
_CHANCE = 0.05


def find_refusal(
    problem: MountCost, recorded: Mount, settings: MountSettings, yaw_rad: float | None
) -> str:
    """Why a recorded mount is not to be used, as part of a sentence; "" where it is.

    It is used where enough points agree under it. Where too few do, three tests must pass: its yaw
    is that of the rows (``yaw_rad``, None where they were not searched); the camera is nearer to
    the LiDAR than the longest measured range; and more points agree than by chance, which is how
    many agree with the same camera turned elsewhere. A camera that hardly sees the LiDAR's plane,
    with fewer than MIN_POINTS on a valid depth, is not tested.
    """
    totals = _totals(problem, recorded)
    agreement = problem.agreement_of(totals)
    if agreement >= settings.min_agreement:
        return ""
    if yaw_rad is not None:
        apart_rad = float(np.abs(wrap_angle(recorded.yaw_rad - yaw_rad)))
        if apart_rad >= _SAME_YAW_RAD:
            return (
                f"it looks {np.rad2deg(apart_rad):.1f} deg past where scans and images fit best, "
                f"and {agreement:.0%} of the visible points agree"
            )
    apart_m = float(np.linalg.norm(recorded.T_lidar_rig[:3, 3]))
    if apart_m > problem.max_range_m:
        return (
            f"it puts the camera {apart_m:.4g} m from the LiDAR, which sees no farther than "
            f"{problem.max_range_m:.4g} m"
        )
    visible = totals[2]
    if visible < MIN_POINTS:
        return ""
    turned = [
        _totals(problem, replace(recorded, yaw_rad=recorded.yaw_rad + turn)) for turn in _TURNS_RAD
    ]
    # A camera that is turned to where the LiDAR is blind cannot be compared.
    fractions = [problem.agreement_of(other) for other in turned if other[2] >= 0.5 * visible]
    as_good = sum(fraction >= agreement for fraction in fractions)
    if agreement > 0.0 and as_good <= _CHANCE * len(fractions):
        return ""
    return (
        f"it puts the camera {apart_m:.4g} m from the LiDAR, and {agreement:.0%} of the visible "
        f"points agree, no more than by chance: turned elsewhere as many do in {as_good} of "
        f"{len(fractions)} directions"
    )


def _totals(problem: MountCost, mount: Mount) -> FloatArray:
    """(5,) tallies of a mount over all frames."""
    totals: FloatArray = problem.tallies_per_frame(mount.vector()).sum(axis=0)
    return totals
