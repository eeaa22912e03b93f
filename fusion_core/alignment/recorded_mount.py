"""Whether a mount that a recording states explains what its sensors saw."""

from dataclasses import replace

import numpy as np

from fusion_core.alignment.agreement import Agreement, MountSettings
from fusion_core.model.conventions import FloatArray, wrap_angle
from fusion_core.model.rig import Mount

# A recorded yaw this near to that of the rows speaks for a mount.
SAME_YAW_RAD = np.deg2rad(5.0)
# Turned by each of these a right mount would be wrong, but for a room that repeats itself.
_TURNS_RAD = np.deg2rad(np.arange(10.0, 360.0, 10.0))
# The usual level of a test: a wrong mount is better than all but so many others by chance.
_CHANCE = 0.05


def refusal_of(
    problem: Agreement, recorded: Mount, settings: MountSettings, yaw_rad: float | None
) -> str:
    """Why a recorded mount is not to be used, as part of a sentence; "" where it is.

    It is where points agree under it. Where too few do, its yaw must be that of the rows
    (``yaw_rad``, where they were searched), and more points in front of the camera must agree than
    do by chance: than where the same camera is turned to look elsewhere.
    """
    agreement, _ = problem.agreement(recorded.vector())
    if agreement >= settings.min_agreement:
        return ""
    if yaw_rad is not None:
        apart_rad = float(np.abs(wrap_angle(recorded.yaw_rad - yaw_rad)))
        if apart_rad >= SAME_YAW_RAD:
            return (
                f"it looks {np.rad2deg(apart_rad):.1f} deg past where scans and images fit best, "
                f"and {agreement:.0%} of the visible points agree"
            )
    in_front, accord = _in_accord(problem, recorded.vector())
    apart_m = float(np.linalg.norm(recorded.T_lidar_rig[:3, 3]))
    where = f"it puts the camera {apart_m:.3g} m from the LiDAR, where"
    if accord == 0:
        return f"{where} of {in_front:.0f} points in front of it none agrees with the depth"
    turned = [
        _in_accord(problem, replace(recorded, yaw_rad=recorded.yaw_rad + turn).vector())
        for turn in _TURNS_RAD
    ]
    # A camera that is turned to where the LiDAR is blind cannot be compared.
    shares = [other / count for count, other in turned if count >= 0.5 * in_front]
    as_good = sum(share >= accord / in_front for share in shares)
    if as_good > _CHANCE * len(shares):
        return (
            f"{where} {accord / in_front:.0%} of the points in front of it agree with the depth, "
            f"no more than by chance: turned elsewhere as many do in {as_good} of {len(shares)} "
            "directions"
        )
    return ""


def _in_accord(problem: Agreement, values: FloatArray) -> tuple[float, float]:
    """Points in front of the camera, and those of them that agree."""
    _, in_front, _, accord = problem.frame_tallies(values).sum(axis=0)
    return float(in_front), float(accord)
