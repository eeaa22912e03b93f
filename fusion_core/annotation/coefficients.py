"""Coefficients of agreement, each from a matrix of pairs of decisions.

A pair is two layers' decisions on one sample; ``pairs[..., c, k]`` counts those of class c in the
first and k in the second. Leading axes are independent of each other. A coefficient that is not
defined, since there is no pair or no second class, is NaN.
"""

from typing import Any

import numpy as np

from fusion_core.model.conventions import FloatArray


def percent_agreement(pairs: FloatArray) -> FloatArray:
    """(...) fraction of the pairs that agree. ``pairs``: (..., C, C)."""
    return _divide(_trace(pairs), pairs.sum(axis=(-2, -1)))


def cohen_kappa(pairs: FloatArray) -> FloatArray:
    """(...) κ = (p_o - p_e) / (1 - p_e) of two raters (Cohen 1960, eq. 1), each with its own
    fractions of the classes. ``pairs``: (..., C, C), rows the first rater.
    """
    total = pairs.sum(axis=(-2, -1))
    # By counts, of which the sums are exact: κ without a second class is then exactly 0 / 0.
    by_chance = (pairs.sum(axis=-1) * pairs.sum(axis=-2)).sum(axis=-1)
    return _divide(total * _trace(pairs) - by_chance, total * total - by_chance)


def fleiss_kappa(pairs: FloatArray) -> FloatArray:
    """(...) κ of any number of raters who all decided on each sample (Fleiss 1971, eqs. 3-7).

    ``pairs``: (..., C, C) over all pairs of raters, in either order. Their fraction that agrees is
    Fleiss' mean P_i, and the classes' fractions in them are his p_j.
    """
    return cohen_kappa(pairs + np.swapaxes(pairs, -2, -1))


def krippendorff_alpha(coincidences: FloatArray) -> FloatArray:
    """(...) nominal α = 1 - (n - 1) Σ o_ck / Σ n_c n_k, both over c < k (Krippendorff 2011,
    "Computing Krippendorff's Alpha-Reliability", part C).

    ``coincidences``: (..., C, C), symmetric: a sample that m layers decided on adds each of its
    ordered pairs with weight 1 / (m - 1).
    """
    of_class = coincidences.sum(axis=-1)
    total = of_class.sum(axis=-1)
    expected = (of_class * (total[..., np.newaxis] - of_class)).sum(axis=-1)
    observed = total - _trace(coincidences)
    return 1.0 - _divide((total - 1.0) * observed, expected)


def one_vs_rest(pairs: FloatArray, chosen: int) -> FloatArray:
    """(..., 2, 2) the matrix with all classes but ``chosen`` taken for one."""
    own = pairs[..., chosen, chosen]
    first = pairs[..., chosen, :].sum(axis=-1) - own
    second = pairs[..., :, chosen].sum(axis=-1) - own
    rest = pairs.sum(axis=(-2, -1)) - own - first - second
    return np.stack([np.stack([own, first], -1), np.stack([second, rest], -1)], -2)


def sample_iou(pairs: FloatArray, chosen: int) -> FloatArray:
    """(...) samples that both raters gave a class, over those that either did."""
    binary = one_vs_rest(pairs, chosen)
    own = binary[..., 0, 0]
    return _divide(own, own + binary[..., 0, 1] + binary[..., 1, 0])


def panoptic_quality(
    iou_sum: FloatArray, matched: FloatArray, only_first: FloatArray, only_second: FloatArray
) -> FloatArray:
    """(...) Σ IoU / (matched + (only_first + only_second) / 2) (Kirillov 2019, eq. 1).

    ``iou_sum`` is over the matched segments. Two segments match where their intersection over union
    exceeds 1/2; at most one can.
    """
    return _divide(iou_sum, matched + 0.5 * (only_first + only_second))


def matched_iou(iou_sum: FloatArray, matched: FloatArray) -> FloatArray:
    """(...) mean intersection over union of the matched segments (Kirillov 2019, eq. 2)."""
    return _divide(iou_sum, matched)


def _trace(pairs: FloatArray) -> FloatArray:
    trace: FloatArray = np.trace(pairs, axis1=-2, axis2=-1)
    return trace


def _divide(numerator: Any, denominator: Any) -> FloatArray:
    """NaN where the denominator is 0."""
    numerator, denominator = np.broadcast_arrays(numerator, denominator)
    result = np.full(numerator.shape, np.nan)
    np.divide(numerator, denominator, out=result, where=denominator != 0)
    return result
