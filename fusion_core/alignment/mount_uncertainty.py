"""Deviations of the mount from the data: how it moves when parts of the recording are left out
(``two_way_covariance``)."""

from collections.abc import Sequence

import numpy as np

from fusion_core.alignment.mount_refinement import IN_PLANE, PlaneFit
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.model.two_way_covariance import frame_blocks, two_way_covariance

# An optimum that fewer points agree on by less than this many standard errors is as good.
_RIVAL_SE = 2.0


def choose_optimum(fits: Sequence[PlaneFit]) -> tuple[PlaneFit, FloatArray]:
    """The optimum that most points agree on, and how far (4,) from it by IN_PLANE others are on
    which as many do: not significantly fewer, compared place by place."""
    noise = min(fit.noise for fit in fits)
    places = np.unique(np.concatenate([fit.place for fit in fits]))
    agreeing = np.array([_agreement_by_place(fit, noise, places) for fit in fits])
    best = int(agreeing.sum(axis=1).argmax())
    apart = np.zeros(IN_PLANE.size)
    for fit, own in zip(fits, agreeing, strict=True):
        fewer = agreeing[best] - own
        if fewer.sum() < _RIVAL_SE * np.sqrt(fewer.size) * np.std(fewer):
            apart = np.maximum(apart, np.abs(fit.values - fits[best].values)[IN_PLANE])
    return fits[best], apart


def _agreement_by_place(fit: PlaneFit, noise: float, places: IntArray) -> FloatArray:
    """(P,) points that agree within the noise, each counted by its likelihood."""
    likelihood = np.exp(-0.5 * (fit.residuals / noise) ** 2)
    index = np.searchsorted(places, fit.place)
    sums: FloatArray = np.bincount(index, weights=likelihood, minlength=places.size).astype(float)
    return sums


def in_plane_covariance(fit: PlaneFit, free: BoolArray) -> FloatArray | None:
    """(4, 4) covariance of IN_PLANE, zero where not ``free``; None where the frames and places are
    too few to tell. That of the depths' stretch is counted in."""
    unknown = np.flatnonzero(np.append(free, True))
    scores = fit.scores[:, unknown]
    found = two_way_covariance(
        scores,
        fit.information[:, unknown[:, None], unknown[None, :]],
        fit.prior[np.ix_(unknown, unknown)],
        frame_blocks(scores, fit.frame),
        fit.place,
    )
    if found is None:
        return None
    covariance = np.zeros((IN_PLANE.size + 1, IN_PLANE.size + 1))
    covariance[np.ix_(unknown, unknown)] = found
    return covariance[:-1, :-1]
