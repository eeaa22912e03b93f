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


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A pose that might replace the guess. ``error``: (6,) from the guess. ``held``: directions of
    translation that stay at it. ``risk``: of being worse, by what."""

    error: FloatArray
    held: int
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


def make_candidates(
    posterior: PosePosterior, view: SceneView, error: FloatArray, covariance: FloatArray
) -> list[Candidate]:
    """The result, and the same with the least certain one, two and all directions of translation
    at the guess."""
    _, directions = np.linalg.eigh(covariance[3:, 3:])
    found = []
    for held in range(4):
        fixed = np.zeros((6, held))
        fixed[3:] = directions[:, 3 - held :]
        moved = error
        if held:
            # The mean given that these do not move, and the minimum about it.
            gain = covariance @ fixed @ np.linalg.inv(fixed.T @ covariance @ fixed)
            moved = error - gain @ (fixed.T @ error)
            free = np.zeros((6, 6 - held))
            free[:3, :3] = np.eye(3)
            free[3:, 3:] = directions[:, : 3 - held]
            inner = _step_basis_within(view, posterior, free)
            moved = search_pose(posterior, view.levels[-1:], [inner], moved)
            # Exactly at the guess, not nearly.
            moved[3:] = free[3:, 3:] @ (free[3:, 3:].T @ moved[3:])
        found.append(
            Candidate(error=moved, held=held, risk=_risks(moved, error, covariance, view.metric))
        )
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
