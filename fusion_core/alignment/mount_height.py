"""Delta z and pitch, which only edges show: where the LiDAR's plane meets what the camera sees over
or under.

A grid of both is scored by the agreement of points and depth, with the sight line held: the camera
moves forward or back so that upright surfaces keep their place. As in the wide search, a point
above or below the image, or on a hole, is dear: of the heights that explain a recording, the one
that shows most of it is used. Costs that still fall at an end of the heights tell none: then it is
the best within.

That says nothing of how well the height is known: walls alone would state the one that brings most
of them into the image. So the deviations come from a cost in which a point that cannot be compared
costs what a point usually does. They are those of a bootstrap over places along the curve, which
look much the same from frame to frame, each replicate with a prior whose centre is drawn from the
prior: where the data show nothing, the replicates spread as far as the prior does.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.alignment.mount_cost import MountCost
from fusion_core.alignment.mount_search import prior_weight
from fusion_core.alignment.mount_settings import MountPriors, MountSettings
from fusion_core.model.conventions import FloatArray, read_only

_HEIGHT_STEP_M = 0.05
_PITCH_STEP_RAD = np.deg2rad(1.0)
# The pitches of a broad prior are tried as far as this many of its deviations.
_PITCH_MAX_SD = 2.0
_REPLICATES = 200
_SEED = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightSamples:
    """Bootstrap of what stands out of the LiDAR's plane.

    ``best``: (6,) the mount to use. ``least``: (6,) the one of the least cost where what cannot be
    compared is not dear; ``mounts``: (B, 6) that of each replicate. ``is_height_known``: whether
    the costs do not fall to an end of the heights, and there are places to draw from: one has no
    spread.
    ``range_m``: the median distance ahead of the points between the sides of the images, at which
    the sight line was held.
    """

    best: FloatArray
    least: FloatArray
    mounts: FloatArray
    is_height_known: bool
    range_m: float

    def __post_init__(self) -> None:
        read_only(self.best)
        read_only(self.least)
        read_only(self.mounts)

    def sd(self) -> FloatArray:
        """(6,) how far the replicates lie from the best; that of Delta z infinite where it is not
        known, and elsewhere at least that of a value within a step of the grid."""
        squares = np.mean((self.mounts - self.best) ** 2, axis=0)
        squares[1] += _HEIGHT_STEP_M**2 / 12.0 if self.is_height_known else np.inf
        deviations: FloatArray = np.sqrt(squares)
        return deviations


def keep_sight(
    values: FloatArray, range_m: float, delta_z_m: float, pitch_rad: float
) -> FloatArray:
    """(6,) a mount of another height and pitch under which an upright surface ``range_m`` ahead
    stays where it is."""
    # The LiDAR's plane there is seen so far below the horizon; with the former pitch: so far.
    depression = np.arctan2(delta_z_m, range_m)
    before = depression - pitch_rad + values[4]
    moved = values.copy()
    moved[1], moved[4] = delta_z_m, pitch_rad
    moved[2] += range_m * (1.0 - np.cos(depression) / np.cos(before))
    return moved


def pitches_of(priors: MountPriors) -> FloatArray:
    """The pitches to try: one where the prior is sharper than a step."""
    half = int(_PITCH_MAX_SD * priors.sd[4] / _PITCH_STEP_RAD)
    pitches: FloatArray = priors.centre[4] + _PITCH_STEP_RAD * np.arange(-half, half + 1)
    return pitches


def heights_to_try(lowest_surface_m: float, settings: MountSettings) -> FloatArray:
    """The heights that the settings and the lowest surface seen, at this height over the rig,
    allow."""
    lowest_m = settings.delta_z_min_m
    highest_m = min(settings.delta_z_max_m, -lowest_surface_m - settings.clearance_m)
    return np.arange(lowest_m, max(highest_m, lowest_m + 0.1), _HEIGHT_STEP_M)


def sample_heights(
    problem: MountCost, values: FloatArray, heights_m: FloatArray, priors: MountPriors
) -> HeightSamples:
    """The bootstrap around a mount (6,) whose place in the LiDAR's plane is known."""
    seen = problem.is_in_front(values)
    names, of_place = np.unique(problem.places()[seen], return_inverse=True)
    places = names.size
    group = np.full(problem.points.shape[0], -1, dtype=np.int64)
    group[seen] = of_place
    range_m = _median_range_ahead_m(problem.points[seen], float(values[0]))
    mounts = np.array(
        [
            keep_sight(values, range_m, float(height), float(pitch))
            for height in heights_m
            for pitch in pitches_of(priors)
        ]
    )
    weight_of_prior = prior_weight(problem)

    def prior_cost(held: MountPriors) -> FloatArray:
        cost: FloatArray = weight_of_prior * held.squares(mounts)[:, [1, 4]].sum(axis=1)
        return cost

    tallies = np.array([problem.tallies_per_group(one, group, places)[:, :3] for one in mounts])
    costs, counts, on_depth = np.moveaxis(tallies, -1, 0)
    total, own_prior = np.maximum(counts.sum(axis=1), 1.0), prior_cost(priors)
    mean_costs = costs.sum(axis=1) / total + own_prior
    usual_cost = _usual_cost(tallies[mean_costs.argmin()], problem.no_depth_cost)
    costs = costs + (counts - on_depth) * (usual_cost - problem.no_depth_cost)
    rng = np.random.default_rng(_SEED)
    samples = []
    for _ in range(_REPLICATES):
        weight = rng.multinomial(places, np.full(places, 1.0 / places))
        mean = costs @ weight / np.maximum(counts @ weight, 1.0)
        drawn = priors.with_drawn_height_and_pitch(rng)
        samples.append(mounts[(mean + prior_cost(drawn)).argmin()])
    least = (costs.sum(axis=1) / total + own_prior).argmin()
    return HeightSamples(
        best=mounts[_inner_minimum(mean_costs, heights_m.size)],
        least=mounts[least],
        mounts=np.array(samples),
        is_height_known=places > 1
        and mounts[mean_costs.argmin(), 1] not in (heights_m[0], heights_m[-1]),
        range_m=range_m,
    )


def _inner_minimum(costs: FloatArray, heights: int) -> int:
    """Index of the least of (heights x pitches) costs at a height whose neighbours cost no less;
    of the least of all where there is none: where costs still fall at a bound, they tell no
    height."""
    by_height = costs.reshape(heights, -1)
    least = by_height.min(axis=1)
    is_minimum = np.zeros(heights, dtype=bool)
    is_minimum[1:-1] = least[1:-1] <= np.minimum(least[:-2], least[2:])
    if is_minimum.any():
        costs = np.where(is_minimum[:, None], by_height, np.inf)
    return int(costs.argmin())


def _usual_cost(tallies: FloatArray, no_depth_cost: float) -> float:
    """Mean cost of the points on valid depth, 0 without one, by the tallies (P, 3) of a mount."""
    cost, count, on_depth = tallies.sum(axis=0)
    return float((cost - no_depth_cost * (count - on_depth)) / max(on_depth, 1.0))


def _median_range_ahead_m(points_m: FloatArray, yaw_rad: float) -> float:
    """Of (N, 2) points, 1 m where there are none."""
    ahead_m = points_m @ [np.cos(yaw_rad), np.sin(yaw_rad)]
    return float(np.median(ahead_m)) if ahead_m.size else 1.0
