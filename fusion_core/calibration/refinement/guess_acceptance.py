"""Whether a refined pose may replace the guess: by parts of the image that it was not found by, by
the other ends of the search, and by the risk of being worse.

The rules are those of ``guess_refinement``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from fusion_core.calibration.pose_error import apply_pose_error
from fusion_core.calibration.refinement.alignment_evidence import (
    EDGES,
    INTENSITY,
    EvidenceLevel,
)
from fusion_core.calibration.refinement.guess_uncertainty import risk_of_worse
from fusion_core.calibration.refinement.pose_search import PosePosterior, search_pose
from fusion_core.calibration.refinement.scene_view import SceneView
from fusion_core.model.conventions import BoolArray, FloatArray

# Shares of the way from the guess's translation to the result's.
_SHARES = (0.75, 0.5, 0.25)


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A pose that might replace the guess. ``error``: (6,) from the guess. ``note``: what of the
    translation stays at the guess, for people; "" where nothing does. ``risk``: of being worse, by
    what."""

    error: FloatArray
    note: str
    risk: dict[str, float]


def rival_odds(
    posterior: PosePosterior, level: EvidenceLevel, others: FloatArray, error: FloatArray
) -> float:
    """How probable the best of the searches that ended elsewhere is, relative to the result."""
    lowest = min((posterior.cost(other, level) for other in others), default=np.inf)
    return float(np.exp(min(0.0, posterior.cost(error, level) - lowest)))


def held_out_gains(
    view: SceneView, T_guess: FloatArray, results: FloatArray, parts: Sequence[BoolArray]
) -> dict[str, tuple[float, ...]]:
    """For each family the nats that each part gains by the result of the others."""
    level = view.levels[-1]

    def held_out(T: FloatArray, part: BoolArray) -> FloatArray:
        # What pairs elsewhere have in common tells these, or does not.
        tables = level.chosen(~part).tables(T)
        each_block = level.chosen(part).block_information(T, tables, part.size)
        return np.asarray(each_block.sum(axis=1), dtype=np.float64)

    gains = [
        held_out(apply_pose_error(T_guess, result), part) - held_out(T_guess, part)
        for part, result in zip(parts, results, strict=True)
    ]
    return {
        points.family: tuple(float(gain[number]) for gain in gains)
        for number, points in enumerate(view.cloud.families)
    }


def find_objection(
    gains: dict[str, tuple[float, ...]],
    rival: float,
    worse_risk_max: float,
) -> str:
    """Why no result may replace the guess, whatever its covariance; empty where nothing speaks
    against it."""
    if rival > worse_risk_max:
        return f"another pose is {rival:.0%} as probable as the best: the scene is ambiguous"
    if np.sum(list(gains.values())) <= 0.0:
        return "what parts of the image show does not help the others"
    what = {INTENSITY: "intensity and grey value", EDGES: "depth steps and image edges"}
    for family, of_parts in gains.items():
        if _clearly_gains(-np.array(of_parts)):
            return f"{what[family]} agree less where they were held out"
    return ""


def _clearly_gains(of_parts: FloatArray) -> bool:
    """Whether the mean gain of the parts is above 0, by Student's t with 5 % of error."""
    mean, sd = float(np.mean(of_parts)), float(np.std(of_parts, ddof=1))
    limit = float(student.ppf(0.95, of_parts.size - 1)) * sd / np.sqrt(of_parts.size)
    return mean > float(limit)


def turn_to(
    posterior: PosePosterior,
    view: SceneView,
    mean: FloatArray,
    covariance: FloatArray,
    translation: FloatArray,
) -> FloatArray:
    """(6,) the best error with this translation (3,), from where (mean, covariance) has it."""
    apart = translation - mean[3:]
    turned = covariance[:3, 3:] @ np.linalg.solve(covariance[3:, 3:], apart)
    start = np.concatenate([mean[:3] + turned, translation])
    free = np.concatenate([np.eye(3), np.zeros((3, 3))])
    basis = _step_basis_within(view, posterior, free)
    return search_pose(posterior, view.levels[-1:], [basis], start)


def make_candidates(
    posterior: PosePosterior, view: SceneView, mean: FloatArray, covariance: FloatArray
) -> list[Candidate]:
    """The mean, and the same with less of its translation: with the least certain one, two and all
    directions at the guess, and with a part of the way alone, which is worse than the guess in
    fewer cases than all of it."""
    variance, moved = covariance[3:, 3:], mean[3:]
    _, directions = np.linalg.eigh(variance)
    wanted = [("", moved)]
    for held, words in enumerate(("One direction", "Two directions"), start=1):
        fixed = directions[:, 3 - held :]
        gain = variance @ fixed @ np.linalg.inv(fixed.T @ variance @ fixed)
        rest = moved - gain @ (fixed.T @ moved)
        # Exactly at the guess, not nearly.
        rest = rest - fixed @ (fixed.T @ rest)
        wanted.append((f"{words} of translation stayed at the guess.", rest))
    wanted.append(("All directions of translation stayed at the guess.", np.zeros(3)))
    for share in _SHARES:
        part = f"Translation goes {share:.0%} of the way from the guess to the best pose."
        wanted.append((part, share * moved))
    found = []
    for note, translation in wanted:
        error = turn_to(posterior, view, mean, covariance, translation) if note else mean
        risk = _risks(error, mean, covariance, view.metric)
        found.append(Candidate(error=error, note=note, risk=risk))
    return found


def _step_basis_within(view: SceneView, posterior: PosePosterior, free: FloatArray) -> FloatArray:
    """(6, k) steps of the finest level within the span of ``free`` (6, k)."""
    sigma = view.levels[-1].sigma_rad
    within = free.T @ (view.metric / sigma**2 + posterior.precision) @ free
    values, vectors = np.linalg.eigh(within)
    basis: FloatArray = free @ (vectors / np.sqrt(values))
    return basis


def _risks(
    moved: FloatArray, mean: FloatArray, covariance: FloatArray, metric: FloatArray
) -> dict[str, float]:
    rotation, translation = np.diag([1.0] * 3 + [0.0] * 3), np.diag([0.0] * 3 + [1.0] * 3)
    return {
        name: risk_of_worse(moved, mean, covariance, by)
        for name, by in (("image", metric), ("rotation", rotation), ("translation", translation))
    }


def best_candidate(
    candidates: Sequence[Candidate],
    mean: FloatArray,
    covariance: FloatArray,
    metric: FloatArray,
    worse_risk_max: float,
) -> Candidate | None:
    """The candidate nearest to the mean in the image among those that are hardly worse."""
    safe = [c for c in candidates if max(c.risk.values()) <= worse_risk_max]
    if not safe:
        return None
    return min(safe, key=lambda candidate: squared_in_metric(candidate.error - mean, metric))


def squared_in_metric(error: FloatArray, metric: FloatArray) -> float:
    """eᵀ M e."""
    return float(error @ metric @ error)


def describe_risk(
    candidates: Sequence[Candidate], error: FloatArray, covariance: FloatArray, view: SceneView
) -> str:
    """Why none of the candidates is taken, as part of a sentence."""
    move = np.degrees(np.sqrt(squared_in_metric(error, view.metric)))
    sd = np.degrees(np.sqrt(np.trace(view.metric @ covariance)))
    risk = min(max(candidate.risk.values()) for candidate in candidates)
    return (
        f"the best pose found is {move:.2f}° from the guess in the image and uncertain by "
        f"{sd:.2f}°; it is worse than the guess with a probability of {risk:.0%}"
    )
