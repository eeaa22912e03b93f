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

# How cautious a candidate's translation is: the mean variance of the result's, over that of a
# further prior about the guess.
_CAUTIONS = np.array([0.0, *np.geomspace(0.03, 300.0, 25), np.inf])
# Shares of the way from the guess's rotation to the result's.
_ROTATION_SHARES = np.linspace(1.0, 0.2, 9)


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A pose that might replace the guess. ``error``: (6,) from the guess. ``note``: how much of
    the way it goes, for people; "" where all of it. ``risk``: of being worse, by what."""

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


def turn_to(posterior: PosePosterior, view: SceneView, error: FloatArray) -> FloatArray:
    """(6,) the best error with the translation of another, searched for from its rotation."""
    free = np.concatenate([np.eye(3), np.zeros((3, 3))])
    within = free.T @ (view.metric / view.levels[-1].sigma_rad ** 2 + posterior.precision) @ free
    values, vectors = np.linalg.eigh(within)
    basis: FloatArray = free @ (vectors / np.sqrt(values))
    return search_pose(posterior, view.levels[-1:], [basis], error)


def make_candidates(
    mean: FloatArray, covariance: FloatArray, metric: FloatArray
) -> list[Candidate]:
    """The mean, and poses between it and the guess, which are worse than the guess in fewer cases.

    A translation t = (I + c V / v)⁻¹ μ of a caution c is the mean of N(μ, V) with a further prior
    about the guess, of the variance v / c where v is the mean of V's: what is least certain stays
    nearest to the guess. The rotation is what belongs to that translation, or a share of it.
    """
    V, moved = covariance[3:, 3:], mean[3:]
    found = []
    for caution in _CAUTIONS:
        if np.isinf(caution):
            translation = np.zeros(3)
        else:
            translation = np.linalg.solve(np.eye(3) + 3.0 * caution / np.trace(V) * V, moved)
        rotation = mean[:3] + covariance[:3, 3:] @ np.linalg.solve(V, translation - moved)
        for share in _ROTATION_SHARES:
            error = np.concatenate([share * rotation, translation])
            risk = _risks(error, mean, covariance, metric)
            note = _words_of_shares(_length_ratio(translation, moved), float(share))
            found.append(Candidate(error=error, note=note, risk=risk))
    return found


def _length_ratio(part: FloatArray, whole: FloatArray) -> float:
    return float(np.linalg.norm(part) / max(float(np.linalg.norm(whole)), 1e-300))


def _words_of_shares(translation: float, rotation: float) -> str:
    """How much of the way from the guess to the best pose a candidate goes."""
    if translation >= 1.0 and rotation >= 1.0:
        return ""
    if translation <= 0.0:
        return f"Translation stays at the guess; rotation goes {rotation:.0%} of the way."
    return f"Translation goes {translation:.0%} and rotation {rotation:.0%} of the way."


def _measures(metric: FloatArray) -> list[tuple[str, FloatArray]]:
    """What a pose may be worse in: names, and (6, 6) squared distances."""
    rotation, translation = np.diag([1.0] * 3 + [0.0] * 3), np.diag([0.0] * 3 + [1.0] * 3)
    return [("image", metric), ("rotation", rotation), ("translation", translation)]


def _risks(
    moved: FloatArray, mean: FloatArray, covariance: FloatArray, metric: FloatArray
) -> dict[str, float]:
    return {name: risk_of_worse(moved, mean, covariance, by) for name, by in _measures(metric)}


def best_candidate(
    candidates: Sequence[Candidate],
    mean: FloatArray,
    covariance: FloatArray,
    metric: FloatArray,
    worse_risk_max: float,
) -> Candidate | None:
    """Of the candidates that are hardly worse, the one whose expected squared distance from the
    truth is the least part of the guess's, on average in the image, in rotation and in translation.
    """
    safe = [c for c in candidates if max(c.risk.values()) <= worse_risk_max]
    if not safe:
        return None
    measures = [by for _, by in _measures(metric)]
    guess = [squared_in_metric(mean, by) + float(np.trace(by @ covariance)) for by in measures]
    return min(
        safe,
        key=lambda candidate: sum(
            squared_in_metric(candidate.error - mean, by) / of_guess
            for by, of_guess in zip(measures, guess, strict=True)
        ),
    )


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
