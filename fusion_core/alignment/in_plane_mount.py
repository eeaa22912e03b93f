"""The mount's place in the LiDAR's plane with its deviations, and with the clock offset where the
recording shows that."""

from dataclasses import dataclass

import numpy as np

from fusion_core.alignment.mount_cost import MountCost
from fusion_core.alignment.mount_refinement import IN_PLANE, ScanLines, refine_in_plane
from fusion_core.alignment.mount_settings import MountPriors
from fusion_core.alignment.mount_uncertainty import choose_optimum, in_plane_covariance
from fusion_core.model.conventions import FloatArray

OBSERVABLE_SD = np.array([np.deg2rad(1.5), 0.15, 0.10, 0.10, np.deg2rad(2.0), 25.0])
"""Beyond these standard deviations (in the order of MOUNT_PARAMETERS) a value is not observable:
its error would change the noise classes and repairs that use it. Set by hand."""

CLOCK = 5
"""Of MOUNT_PARAMETERS, the clock offset."""

_NOT_FORWARD = np.array([0, 3, CLOCK])


@dataclass(frozen=True, slots=True, kw_only=True)
class InPlaneMount:
    """A mount (6,), its deviations, infinite where unknown, and how a delay turns its yaw."""

    values: FloatArray
    sd: FloatArray
    yaw_per_delay_rad_s: float

    def agreement(self, problem: MountCost) -> float:
        return problem.agreement_and_visibility(self.values)[0]


def fit_in_plane(
    problem: MountCost, lines: ScanLines, starts: list[FloatArray], priors: MountPriors
) -> InPlaneMount:
    """The best of the optima in the LiDAR's plane, with the first start's height and pitch.

    The clock offset is part of it where the recording shows it. Otherwise it stays as the priors
    have it, the stamps are believed, and the yaw is that which belongs to them: what pairs need.
    """
    sd = np.full(starts[0].size, np.inf)
    for free in (np.ones(IN_PLANE.size, dtype=bool), IN_PLANE != CLOCK):
        refined = []
        for start in starts:
            begin = start.copy()
            begin[CLOCK] = priors.centre[CLOCK]
            refined.append(refine_in_plane(lines, begin, priors, free))
        fits = [fit for fit in refined if fit is not None]
        if not fits:
            return InPlaneMount(values=starts[0], sd=sd, yaw_per_delay_rad_s=0.0)
        best, apart = choose_optimum(fits)
        covariance = in_plane_covariance(best, free)
        if covariance is None:
            continue
        sd[IN_PLANE] = np.where(free, np.maximum(np.sqrt(np.diag(covariance)), apart), np.inf)
        if sd[CLOCK] <= OBSERVABLE_SD[CLOCK]:
            break
    # Delay and yaw follow from turns: an error of the turn rates grows with the delay.
    rate_sd = float(np.sqrt(np.mean(problem.turn_rate_sd_rad_s**2)))
    delay_ms = abs(float(best.values[CLOCK]))
    spread = max(float(np.std(problem.velocities[:, 2])), 1e-6)
    sd[0] = np.hypot(sd[0], 1e-3 * delay_ms * rate_sd)
    sd[CLOCK] = np.hypot(sd[CLOCK], delay_ms * rate_sd / spread)
    return InPlaneMount(values=best.values, sd=sd, yaw_per_delay_rad_s=best.yaw_per_delay_rad_s)


def moved_by_height(
    lines: ScanLines, found: InPlaneMount, rival: FloatArray, priors: MountPriors
) -> FloatArray:
    """(6,) how far yaw, left and clock offset of the optimum at a ``rival``'s (6,) height and pitch
    lie from those of a mount; 0 where there is no such optimum. Forward is 0: how it moves with the
    height is in the spread of the heights' bootstrap."""
    moved = np.zeros(rival.size)
    free = np.isfinite(found.sd[IN_PLANE])
    fit = refine_in_plane(lines, rival, priors, free) if free.any() else None
    if fit is not None:
        moved[_NOT_FORWARD] = np.abs(fit.values - found.values)[_NOT_FORWARD]
    return moved
