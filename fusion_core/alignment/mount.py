"""The mount of the rig on the LiDAR, estimated once from the whole recording.

The LiDAR's plane does not meet the image in a row: what lies Delta z below the camera at depth z
appears Delta z f / z below the centre. So the offset u of the rows gives the yaw (Xu 2024's idea,
over the whole recording), and from there the mount is refined where LiDAR points, projected into
the image, agree best with the depth found there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from fusion_core.alignment.mount_cost import (
    MIN_POINTS,
    MountCost,
    MountObservation,
    MountSettings,
)
from fusion_core.alignment.recorded_mount import find_refusal
from fusion_core.alignment.time import parabola_offset
from fusion_core.model.conventions import FloatArray, wrap_angle
from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.rig import Mount

# Beyond these standard deviations (in the order of MOUNT_PARAMETERS) a value is not observable: its
# error would change the noise classes and repairs that use it. Set by hand.
_OBSERVABLE_SD = np.array([np.deg2rad(1.5), 0.15, 0.10, 0.10, np.deg2rad(2.0), 25.0])
# Weak priors keep what the data do not show near zero: a rig is compact and nearly level. Set by
# hand.
_PRIOR_SD = np.array([np.deg2rad(10.0), 1.0, 0.15, 0.15, np.deg2rad(5.0), 80.0])
# How far a recorded mount, from a CAD drawing or a calibration, may be off. It has no clock offset.
_RECORDED_SD = np.array([np.deg2rad(0.3), 0.01, 0.01, 0.01, np.deg2rad(0.3), 80.0])
# One standard deviation of a prior weighs as much as this many blocks of frames.
_PRIOR_BLOCKS = 20.0
# What systematic causes (occlusion, furniture edges, slanted walls) left as error in simulated
# rooms; no recording's own scatter shows it.
_MIN_SD = np.array([np.deg2rad(0.3), 0.05, 0.02, 0.015, np.deg2rad(1.0), 5.0])
# Minima of the height profile and yaws that are refined: each costs hundreds of evaluations.
_MAX_STARTS = 3
_MAX_RIVAL_YAWS = 3
# Yaws nearer than this count as one; set by hand.
_SAME_YAW_RAD = np.deg2rad(5.0)
# Heights nearer than this are one: three steps of the height profile.
_SAME_HEIGHT_M = 0.15
# Steps of the search and of the finite differences: large against a pixel, small against a mode.
_STEP = np.array([np.deg2rad(0.6), 0.04, 0.04, 0.04, np.deg2rad(0.8), 20.0])
# Costs per point that differ by less are equal; set by hand.
_RIVAL_COST = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class MountEstimate:
    """The mount, and how far the recording supports it.

    ``agreement``: fraction of visible points within the tolerance; ``visible``: fraction of points
    in front of a camera that fall on a valid depth; ``delta_z_profile``: (K, 2) Delta z and cost.
    ``refusal``: why a recorded mount is not used, as part of a sentence, "" where there is none.
    """

    mount: Mount
    agreement: float
    visible: float
    is_confident: bool
    is_from_recorded: bool
    delta_z_profile: FloatArray
    refusal: str = ""


def estimate_mount(
    frames: Sequence[MountObservation],
    settings: MountSettings,
    *,
    yaw_rad: float,
    recorded: Mount | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> MountEstimate:
    """Refine the mount from the yaw of the recording's offset u.

    Where the LiDAR's plane follows no single row, the rows can favour a wrong yaw: other yaws are
    tried as well, and taken only where they agree significantly better.
    ``recorded``: extrinsics that the recording itself gives; used as a prior where they explain
    what is seen (``find_refusal``), unless too few points agree and another mount explains them
    significantly. ``on_step`` is called before each mount that is tried, and may raise to end the
    search.

    Raises AlignmentFailed where there are too few frames or points.
    """
    if len(frames) < 4 or sum(frame.points_m.shape[0] for frame in frames) < MIN_POINTS:
        raise AlignmentFailed(
            f"the mount needs 4 paired depth images with {MIN_POINTS} LiDAR points, got "
            f"{len(frames)}.",
            advice="Use a longer recording.",
        )
    cost = MountCost(frames, settings, on_step)
    highest_m = min(settings.delta_z_max_m, -cost.lowest_surface_m() - settings.clearance_m)
    heights_m = np.arange(
        settings.delta_z_min_m, max(highest_m, settings.delta_z_min_m + 0.1), 0.05
    )
    refusal = "" if recorded is None else find_refusal(cost, recorded, settings, yaw_rad)
    recorded_fit = None
    if recorded is not None and not refusal:
        centre = recorded.vector()
        recorded_fit = _minimize(_add_prior(cost, centre, _RECORDED_SD, np.inf), centre)
    fits: list[FloatArray] = []
    if (
        recorded_fit is None
        or cost.agreement_and_visibility(recorded_fit)[0] < settings.min_agreement
    ):
        fits = _fit_without_recorded(cost, yaw_rad, heights_m, highest_m)
        best, is_yaw_ambiguous = _choose_fit(cost, fits, yaw_rad)
        if recorded_fit is not None:
            refusal = _reason_to_prefer_free_fit(cost, recorded_fit, best, settings)
    is_recorded_used = recorded_fit is not None and not refusal
    if recorded_fit is not None and is_recorded_used:
        best, is_yaw_ambiguous = recorded_fit, False
    prior_sd = _RECORDED_SD if is_recorded_used else _PRIOR_SD
    min_sd = np.minimum(_MIN_SD, _RECORDED_SD) if is_recorded_used else _MIN_SD
    sd = np.maximum(_sandwich_sd(cost, best, prior_sd), min_sd)
    if not is_recorded_used:
        level = [np.concatenate([best[:1], [height], best[2:]]) for height in heights_m]
        for rival in _find_rival_heights(cost, [*fits, *level], best):
            sd = np.maximum(sd, np.abs(rival - best))
            sd[[1, 4]] = np.inf
    elif cost.tallies_per_frame(best)[:, 2].sum() < MIN_POINTS:
        # The recording does not constrain it: it is used as recorded.
        sd[:] = np.inf
    if is_yaw_ambiguous:
        sd[0] = np.inf
    # Pairs need only the sum of yaw and delay, which is known even where neither alone is.
    is_yaw_observable = bool(sd[0] <= _OBSERVABLE_SD[0])
    sd = _widen_for_clock_offset(sd, cost.turn_rates_rad_s, prior_sd[5], settings)
    mount = Mount.from_vector(
        best,
        tuple(
            float(value) if value <= limit else None
            for value, limit in zip(sd, _OBSERVABLE_SD, strict=True)
        ),
    )
    agreement, visible = cost.agreement_and_visibility(best)
    return MountEstimate(
        mount=mount,
        agreement=agreement,
        visible=visible,
        is_confident=bool(agreement >= settings.min_agreement and is_yaw_observable),
        is_from_recorded=is_recorded_used,
        delta_z_profile=_delta_z_profile(cost, best, heights_m)[:, 1:],
        refusal=refusal,
    )


def _fit_without_recorded(
    problem: MountCost, yaw_rad: float, heights_m: FloatArray, highest_m: float
) -> list[FloatArray]:
    """Refined mounts, starting from the rows' yaw and from the yaws that rival it."""
    fits = []
    for yaw in [yaw_rad, *_find_rival_yaws(problem.subsampled(), yaw_rad, heights_m[::3])]:
        centre = _level_mount(yaw)
        cost = _add_prior(problem, centre, _PRIOR_SD, highest_m)
        # The best start is enough to compare a rival; the rows' own yaw gets several.
        count = _MAX_STARTS if yaw == yaw_rad else 1
        for start in _local_minima(_delta_z_profile(problem, centre, heights_m), centre, count):
            fits.append(_minimize(cost, start))
    return fits


def _reason_to_prefer_free_fit(
    problem: MountCost, stated: FloatArray, free: FloatArray, settings: MountSettings
) -> str:
    """Why the fit of a recorded mount, under which too few points agree, is not to be used: the
    points agree under a free fit, which is significantly better; "" where that is not so.

    Points that fall on no valid depth do not contradict a mount: walls agree at other heights, too.
    """
    agreement, visible = problem.agreement_and_visibility(stated)
    free_agreement, _ = problem.agreement_and_visibility(free)
    least = settings.min_agreement
    if min(visible, free_agreement) < least or not _is_significantly_better(problem, free, stated):
        return ""
    return (
        f"{agreement:.0%} of the visible points agree under it, and {free_agreement:.0%} under the "
        "mount that fits them best"
    )


def _is_significantly_better(problem: MountCost, fit: FloatArray, other: FloatArray) -> bool:
    """Whether a fit costs significantly less than another (paired over blocks, 3 sigma)."""
    gain = problem.block_costs(other) - problem.block_costs(fit)
    return bool(np.mean(gain) > 3.0 * np.std(gain) / np.sqrt(gain.size))


def _angle_between_rad(first_rad: float, second_rad: float) -> float:
    return float(np.abs(wrap_angle(first_rad - second_rad)))


def _level_mount(yaw_rad: float) -> FloatArray:
    """A mount of which only the yaw is known."""
    values = np.zeros(6)
    values[0] = yaw_rad
    return values


def _add_prior(
    problem: MountCost, centre: FloatArray, spread: FloatArray, highest_m: float
) -> Callable[[FloatArray], float]:
    weight = 1.0 / (2.0 * problem.blocks * _PRIOR_BLOCKS)

    def cost(values: FloatArray) -> float:
        if values[1] > highest_m:
            return 1.0 + float(values[1] - highest_m)
        prior = float(np.sum(((values - centre) / spread) ** 2))
        return problem.mean_cost(values) + weight * prior

    return cost


def _find_rival_yaws(problem: MountCost, yaw_rad: float, heights_m: FloatArray) -> list[float]:
    """The best few yaws all around, more than 5 degrees from ``yaw_rad`` and from each other.

    A yaw counts where at least half as many points lie in front of a camera as at the best one.
    """
    yaws = yaw_rad + np.deg2rad(np.arange(-180.0, 180.0, 2.0))
    costs = np.full(yaws.size, np.inf)
    in_front = np.zeros(yaws.size)
    for index, yaw in enumerate(yaws):
        for height in heights_m:
            values = _level_mount(float(yaw))
            values[1] = height
            tallies = problem.tallies_per_frame(values).sum(axis=0)
            in_front[index] = tallies[1]
            costs[index] = min(costs[index], tallies[0] / max(tallies[1], 1.0))
    costs[in_front < 0.5 * in_front.max()] = np.inf
    found: list[float] = []
    for index in np.argsort(costs):
        yaw = float(yaws[index])
        if not np.isfinite(costs[index]) or len(found) == _MAX_RIVAL_YAWS:
            break
        if min(_angle_between_rad(yaw, other) for other in [yaw_rad, *found]) > _SAME_YAW_RAD:
            found.append(yaw)
    return found


def _choose_fit(
    problem: MountCost, fits: list[FloatArray], yaw_rad: float
) -> tuple[FloatArray, bool]:
    """The best fit near the rows' yaw, unless another is significantly better; and whether the two
    cannot be distinguished."""
    near = [fit for fit in fits if _angle_between_rad(fit[0], yaw_rad) < _SAME_YAW_RAD]
    best = min(near or fits, key=problem.mean_cost)
    rival = min(fits, key=problem.mean_cost)
    if _angle_between_rad(rival[0], best[0]) < _SAME_YAW_RAD:
        return best, False
    return (rival, False) if _is_significantly_better(problem, rival, best) else (best, True)


def frame_yaw_offset_rad(frame: MountObservation, mount: Mount, settings: MountSettings) -> float:
    """How far one frame's own best yaw lies from the mount's: its check against the recording.

    The sum of what the frame shows and of a prior of ``frame_yaw_sd_deg`` around the mount: a
    plain wall fits at any yaw and must not pull. What remains is the turn that stamps do not
    explain (a clock offset, a scan that is not instantaneous).
    """
    problem = MountCost([frame], settings)
    sd_rad = np.deg2rad(settings.frame_yaw_sd_deg)
    offsets = np.linspace(-3.0, 3.0, 25) * sd_rad
    # Four neighbouring beams count as one observation; the loss is 1/16 of a log likelihood.
    costs = 4.0 * problem.costs_at_yaws(mount, mount.yaw_rad + offsets)
    costs += 0.5 * (offsets / sd_rad) ** 2
    best = int(costs.argmin())
    return float(offsets[best] + parabola_offset(costs, best) * (offsets[1] - offsets[0]))


def _delta_z_profile(problem: MountCost, centre: FloatArray, heights_m: FloatArray) -> FloatArray:
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
    simplex = np.vstack([start, start + np.diag(2.0 * _STEP)])
    # The pixels make the cost piecewise constant at the finest scale: no gradients.
    result = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "maxfev": 700,
            "xatol": 1e-4,
            "fatol": 1e-6,
            "adaptive": True,
        },
    )
    found: FloatArray = result.x
    return found


def _sandwich_sd(problem: MountCost, values: FloatArray, spread: FloatArray) -> FloatArray:
    """(6,) standard deviations, inf where unknown, by the sandwich estimator H^-1 G H^-1.

    G is the covariance of the gradients of blocks of frames, H the Hessian of their mean with the
    prior's. A single block has no covariance: nothing is known then.
    """
    count = values.size
    if problem.blocks < 2:
        return np.full(count, np.inf)
    steps = np.diag(_STEP)
    ahead = [problem.block_costs(values + step) for step in steps]
    behind = [problem.block_costs(values - step) for step in steps]
    middle = problem.block_costs(values)
    gradients = np.stack(
        [(a - b) / (2.0 * h) for a, b, h in zip(ahead, behind, _STEP, strict=True)]
    )
    hessian = np.zeros((count, count))
    for i in range(count):
        hessian[i, i] = np.mean(ahead[i] - 2.0 * middle + behind[i]) / _STEP[i] ** 2
        for j in range(i):
            corners = (
                problem.mean_cost(values + steps[i] + steps[j])
                - problem.mean_cost(values + steps[i] - steps[j])
                - problem.mean_cost(values - steps[i] + steps[j])
                + problem.mean_cost(values - steps[i] - steps[j])
            )
            hessian[i, j] = hessian[j, i] = corners / (4.0 * _STEP[i] * _STEP[j])
    scale = np.diag(_STEP)
    # In units of the steps, so that metres, radians and milliseconds compare.
    curvature = scale @ hessian @ scale + np.diag(
        (_STEP / spread) ** 2 / (problem.blocks * _PRIOR_BLOCKS)
    )
    # The prior's centre is uncertain by its own spread: without data that is the result.
    prior = (_STEP / spread) ** 2 / (problem.blocks * _PRIOR_BLOCKS) ** 2
    noise = np.cov(scale @ gradients) / problem.blocks + np.diag(prior)
    eigenvalues, vectors = np.linalg.eigh(curvature)
    flat = eigenvalues < 1e-4 * max(float(eigenvalues.max()), 1e-12)
    back = (vectors / np.where(flat, 1.0, eigenvalues)) @ vectors.T
    variance = np.diag(back @ noise @ back)
    # A direction without curvature is not observable, whatever the gradients say.
    loose = (np.abs(vectors[:, flat]) > 0.3).any(axis=1)
    # The finite steps cannot resolve better than a fraction of themselves.
    sd: FloatArray = np.maximum(np.sqrt(variance), 0.25) * _STEP
    sd[loose] = np.inf
    return sd


def _widen_for_clock_offset(
    sd: FloatArray, rates_rad_s: FloatArray, delay_spread_ms: float, settings: MountSettings
) -> FloatArray:
    """The standard deviations of yaw and clock offset, widened for their ambiguity: only changes of
    the turn rate separate the two (as the slope of a line through the frames' yaws over their turn
    rates, each yaw off by ``frame_yaw_sd_deg``)."""
    changes_rad_s = np.std(rates_rad_s) * np.sqrt(rates_rad_s.size)
    delay_ms = 1e3 * np.deg2rad(settings.frame_yaw_sd_deg) / max(float(changes_rad_s), 1e-6)
    widened = sd.copy()
    widened[5] = max(sd[5], delay_ms)
    delay_s = 1e-3 * min(widened[5], delay_spread_ms)
    widened[0] = np.hypot(sd[0], np.mean(rates_rad_s) * delay_s)
    return widened


def _find_rival_heights(
    problem: MountCost, fits: list[FloatArray], best: FloatArray
) -> list[FloatArray]:
    """The fits with another Delta z that explain the recording as well (paired over blocks,
    2 sigma)."""
    reference = problem.block_costs(best)
    rivals = []
    for fit in fits:
        if abs(fit[1] - best[1]) < _SAME_HEIGHT_M:
            continue
        difference = problem.block_costs(fit) - reference
        margin = 2.0 * np.std(difference) / np.sqrt(difference.size)
        if np.mean(difference) < max(margin, _RIVAL_COST):
            rivals.append(fit)
    return rivals
