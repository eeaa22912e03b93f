"""The wide search for a mount of which only the rows' yaw is known: where points and depth agree.

Its cost is made for the search: it sees through nothing, counts what leaves the image, and has few
minima. What it finds is near the truth, and is refined afterwards.
"""

from collections.abc import Callable

import numpy as np

from fusion_core.alignment.mount_cost import MountCost
from fusion_core.alignment.mount_settings import MountPriors
from fusion_core.model.conventions import FloatArray, wrap_angle

# One standard deviation of a prior weighs as much as this many blocks of frames.
_PRIOR_BLOCKS = 20.0

# Minima of the height profile and yaws that are refined: each costs hundreds of evaluations.
_MAX_STARTS = 3
_MAX_RIVAL_YAWS = 3
# What is compared sees at least this fraction of the points that another sees.
_LEAST_IN_FRONT = 0.5
# Yaws nearer than this count as one; set by hand.
_SAME_YAW_RAD = np.deg2rad(5.0)
# Steps of the search: large against a pixel, small against a mode.
_STEP = np.array([np.deg2rad(0.6), 0.04, 0.04, 0.04, np.deg2rad(0.8), 20.0])


def search_mounts(
    problem: MountCost, priors: MountPriors, heights_m: FloatArray
) -> list[FloatArray]:
    """Mounts no higher than ``heights_m`` that agree best, starting from the priors' yaw and from
    the yaws that rival it."""
    fits = []
    yaw_rad = float(priors.centre[0])
    rivals = _find_rival_yaws(problem.subsampled(), priors.centre, heights_m[::3])
    for yaw in [yaw_rad, *rivals]:
        turned = priors.with_yaw(yaw)
        centre = turned.centre
        cost = _add_prior(problem, turned, float(heights_m[-1]))
        # The best start is enough to compare a rival; the rows' own yaw gets several.
        count = _MAX_STARTS if yaw == yaw_rad else 1
        for start in _local_minima(delta_z_profile(problem, centre, heights_m), centre, count):
            fits.append(_minimize(cost, start))
    return fits


def choose_mount(
    problem: MountCost, fits: list[FloatArray], yaw_rad: float
) -> tuple[FloatArray, bool]:
    """The best fit near the rows' yaw, unless another is significantly better; and whether it is
    not significantly better than all that have another yaw.

    A fit counts where at least half as many points lie in front of a camera as at the best one:
    far from the LiDAR, a camera looks away from most of what could contradict it.
    """
    in_front = np.array([problem.tallies_per_frame(fit)[:, 1].sum() for fit in fits])
    sees_enough = in_front >= _LEAST_IN_FRONT * in_front.max()
    fits = [fit for fit, enough in zip(fits, sees_enough, strict=True) if enough]
    near = [fit for fit in fits if have_same_yaw(fit[0], yaw_rad)]
    best = min(near or fits, key=problem.mean_cost)
    cheapest = min(fits, key=problem.mean_cost)
    if not have_same_yaw(cheapest[0], best[0]) and is_significantly_better(problem, cheapest, best):
        best = cheapest
    rivals = [fit for fit in fits if not have_same_yaw(fit[0], best[0])]
    return best, not all(is_significantly_better(problem, best, rival) for rival in rivals)


def have_same_yaw(first_rad: float, second_rad: float) -> bool:
    """Whether two mounts with these yaws count as one."""
    return bool(np.abs(wrap_angle(first_rad - second_rad)) < _SAME_YAW_RAD)


def is_significantly_better(problem: MountCost, fit: FloatArray, other: FloatArray) -> bool:
    """Whether a fit costs significantly less than another (paired over blocks, 3 sigma)."""
    gain = problem.block_costs(other) - problem.block_costs(fit)
    return bool(np.mean(gain) > 3.0 * np.std(gain) / np.sqrt(gain.size))


def prior_weight(problem: MountCost) -> float:
    """The cost of a squared deviation from a prior, in units of its variance."""
    return 1.0 / (2.0 * problem.blocks * _PRIOR_BLOCKS)


def delta_z_profile(problem: MountCost, centre: FloatArray, heights_m: FloatArray) -> FloatArray:
    """(K, 3): best yaw, Delta z, cost, over a grid of Delta z with the yaw free by 3 degrees."""
    rows = []
    for delta_z in heights_m:
        best = (np.inf, 0.0)
        for yaw in centre[0] + np.deg2rad([-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]):
            values = centre.copy()
            values[:2] = yaw, delta_z
            best = min(best, (problem.mean_cost(values), float(yaw)))
        rows.append([best[1], float(delta_z), best[0]])
    return np.array(rows)


def _turned_to(values: FloatArray, yaw_rad: float) -> FloatArray:
    turned = values.copy()
    turned[0] = yaw_rad
    return turned


def _add_prior(
    problem: MountCost, priors: MountPriors, highest_m: float
) -> Callable[[FloatArray], float]:
    weight = prior_weight(problem)

    def cost(values: FloatArray) -> float:
        if values[1] > highest_m:
            return 1.0 + float(values[1] - highest_m)
        return problem.mean_cost(values) + weight * float(np.sum(priors.squares(values)))

    return cost


def _find_rival_yaws(problem: MountCost, centre: FloatArray, heights_m: FloatArray) -> list[float]:
    """The best few yaws all around, more than 5 degrees from the centre's and from each other.

    A yaw counts where at least half as many points lie in front of a camera as at the best one.
    """
    yaw_rad = float(centre[0])
    yaws = yaw_rad + np.deg2rad(np.arange(-180.0, 180.0, 2.0))
    costs = np.full(yaws.size, np.inf)
    in_front = np.zeros(yaws.size)
    for index, yaw in enumerate(yaws):
        for height in heights_m:
            values = _turned_to(centre, float(yaw))
            values[1] = height
            tallies = problem.tallies_per_frame(values).sum(axis=0)
            in_front[index] = tallies[1]
            costs[index] = min(costs[index], tallies[0] / max(tallies[1], 1.0))
    costs[in_front < _LEAST_IN_FRONT * in_front.max()] = np.inf
    found: list[float] = []
    for index in np.argsort(costs):
        yaw = float(yaws[index])
        if not np.isfinite(costs[index]) or len(found) == _MAX_RIVAL_YAWS:
            break
        if not any(have_same_yaw(yaw, other) for other in [yaw_rad, *found]):
            found.append(yaw)
    return found


def _local_minima(profile: FloatArray, centre: FloatArray, count: int) -> list[FloatArray]:
    """The ``count`` lowest local minima of the profile."""
    cost = np.concatenate([[np.inf], profile[:, 2], [np.inf]])
    minima = np.flatnonzero((cost[1:-1] <= cost[:-2]) & (cost[1:-1] <= cost[2:]))
    starts = []
    for index in minima[np.argsort(profile[minima, 2])][:count]:
        start = centre.copy()
        start[:2] = profile[index, :2]
        starts.append(start)
    return starts


def _minimize(cost: Callable[[FloatArray], float], start: FloatArray) -> FloatArray:
    from scipy.optimize import minimize

    simplex = np.vstack([start, start + np.diag(2.0 * _STEP)])
    # The pixels make the cost piecewise constant at the finest scale: no gradients.
    result = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "maxfev": 400,
            "xatol": 1e-3,
            "fatol": 1e-5,
            "adaptive": True,
        },
    )
    found: FloatArray = result.x
    return found
