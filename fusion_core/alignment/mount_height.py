"""Delta z and pitch, which only edges show: where the LiDAR's plane meets what the camera sees over
or under.

A grid of both is scored by the agreement of points and depth, with the sight line held: the camera
moves forward or back so that upright surfaces keep their place. Which heights explain the recording
as well is found by a bootstrap over places along the curve and blocks of frames (Owen 2007, the
pigeonhole bootstrap), each replicate with a prior whose centre is drawn from the prior: where the
data show nothing, the replicates spread as far as the prior does.
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

    ``best``: (6,) the best mount of the grid; ``mounts``: (B, 6) the best of each replicate;
    ``is_height_known``: whether ``best`` is not at the end of the heights, and there are blocks of
    frames to draw from: one has no spread. ``range_m``: the median distance ahead of the points
    between the sides of the images, at which the sight line was held.
    """

    best: FloatArray
    mounts: FloatArray
    is_height_known: bool
    range_m: float

    def __post_init__(self) -> None:
        read_only(self.best)
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


def heights_to_try(problem: MountCost, settings: MountSettings) -> FloatArray:
    """The heights that the settings and the lowest surface seen allow."""
    lowest_m = settings.delta_z_min_m
    highest_m = min(settings.delta_z_max_m, -problem.lowest_surface_m() - settings.clearance_m)
    return np.arange(lowest_m, max(highest_m, lowest_m + 0.1), _HEIGHT_STEP_M)


def sample_heights(
    problem: MountCost, values: FloatArray, heights_m: FloatArray, priors: MountPriors
) -> HeightSamples:
    """The bootstrap around a mount (6,) whose place in the LiDAR's plane is known."""
    seen = problem.is_in_front(values)
    places, of_place = np.unique(problem.places()[seen], return_inverse=True)
    block = problem.frame_of_point * problem.blocks // problem.frames
    cells = places.size * problem.blocks
    group = np.full(problem.points.shape[0], -1, dtype=np.int64)
    group[seen] = of_place * problem.blocks + block[seen]
    range_m = _median_range_ahead_m(problem.points[seen], float(values[0]))
    mounts = np.array(
        [
            keep_sight(values, range_m, float(height), float(pitch))
            for height in heights_m
            for pitch in pitches_of(priors)
        ]
    )
    tallies = np.array([problem.tallies_per_group(one, group, cells)[:, :2] for one in mounts])
    costs, counts = tallies[..., 0], tallies[..., 1]
    z = (mounts - priors.centre)[:, [1, 4]] / priors.sd[[1, 4]]
    weight_of_prior = prior_weight(problem)
    rng = np.random.default_rng(_SEED)

    def best_of(weight: FloatArray, centre: FloatArray) -> FloatArray:
        mean = costs @ weight / np.maximum(counts @ weight, 1.0)
        chosen: FloatArray = mounts[
            (mean + weight_of_prior * ((z - centre) ** 2).sum(axis=1)).argmin()
        ]
        return chosen

    samples = []
    for _ in range(_REPLICATES):
        of_places = _drawn(rng, places.size)
        weight = np.outer(of_places, _drawn(rng, problem.blocks)).ravel()
        samples.append(best_of(weight, rng.normal(size=2)))
    best = best_of(np.ones(cells), np.zeros(2))
    return HeightSamples(
        best=best,
        mounts=np.array(samples),
        is_height_known=problem.blocks > 1 and best[1] not in (heights_m[0], heights_m[-1]),
        range_m=range_m,
    )


def _median_range_ahead_m(points_m: FloatArray, yaw_rad: float) -> float:
    """Of (N, 2) points, 1 m where there are none."""
    ahead_m = points_m @ [np.cos(yaw_rad), np.sin(yaw_rad)]
    return float(np.median(ahead_m)) if ahead_m.size else 1.0


def _drawn(rng: np.random.Generator, count: int) -> FloatArray:
    """How often each of ``count`` is drawn in as many draws with replacement."""
    return rng.multinomial(count, np.full(count, 1.0 / count)).astype(np.float64)
