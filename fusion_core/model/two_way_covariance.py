"""Covariance of an optimum from the data: how it moves when parts of a recording are left out.

Neighbouring frames share errors of time, and neighbouring beams those of a surface, which all
frames see alike. So points are not counted one by one, but in blocks of frames and in places along
the curve, and the two variances are joined as Cameron, Gelbach and Miller (2011) join those of two
groupings: of the one plus of the other, minus what both count. Each is a jackknife, which knows
that a block may hold most of the evidence.

With few blocks this errs on the safe side where points share nothing. On the mounts of a dozen
frames and places, five parameters, with the points' signs flipped at random, it states 2.6 times
the variance: the jackknives' leverage makes 1.5 of it, the floor in each direction 1.3, Student's
factor 1.3. What is unbiased there (Bell and McCaffrey 2002) is too bold where errors are shared,
and so few blocks do not tell which of the two they are.
"""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray

# What correlates by less than this many standard errors counts as independent.
_CORRELATION_SE = 2.0
# At least so many blocks of frames: fewer say nothing of a deviation.
_LEAST_BLOCKS = 4
# Of a scaled information matrix: below, rounding decides.
_LEAST_EIGENVALUE = 1e-6
# The variance of Student's t exists from three degrees of freedom on.
_LEAST_DEGREES = 3.0


def two_way_covariance(
    scores: FloatArray,
    information: FloatArray,
    prior: FloatArray,
    block: IntArray,
    place: IntArray,
) -> FloatArray | None:
    """(K, K) covariance of the optimum of N points, whose errors are shared within a block of
    frames and within a place along the curve.

    ``scores``: (N, K) gradients of the log likelihoods, ``information``: (N, K, K) their
    curvatures, ``prior``: (K, K) that of the prior. None where blocks and places are too few.
    """
    parts = []
    for label in (_label(block), _label(place), _label(block, place)):
        part = _jackknife(scores, information, prior, label)
        if part is None:
            return None
        parts.append(part)
    in_time, in_place, in_both = parts
    # The prior's centre is as uncertain as the prior says.
    back = np.linalg.inv(prior + information.sum(axis=0))
    return _at_least(in_time + in_place - in_both, in_both) + back @ prior @ back


def frame_blocks(scores: FloatArray, frame: IntArray) -> IntArray:
    """(N,) block of each point: runs of frames so long that their scores no longer correlate."""
    frames, order = np.unique(frame, return_inverse=True)
    sums = np.zeros((frames.size, scores.shape[1]))
    np.add.at(sums, order, scores)
    length = min(correlation_length(sums), max(1, frames.size // _LEAST_BLOCKS))
    return order // length


def correlation_length(series: FloatArray) -> int:
    """The first lag at which the rows of a (F, K) series do not correlate significantly, at most a
    quarter of them."""
    centred = series - series.mean(axis=0)
    variance = (centred**2).mean(axis=0)
    known = variance > 0.0
    if not known.any():
        return 1
    count = series.shape[0]
    limit = _CORRELATION_SE / np.sqrt(count * int(known.sum()))
    for lag in range(1, count // _LEAST_BLOCKS + 1):
        products = (centred[lag:] * centred[:-lag]).mean(axis=0)
        if float(np.mean(products[known] / variance[known])) <= limit:
            return lag
    longest: int = max(1, count // _LEAST_BLOCKS)
    return longest


def shared_grouping(residuals: FloatArray, groupings: Sequence[IntArray]) -> IntArray:
    """The (N,) grouping within which the residuals correlate most; each point by itself where they
    correlate significantly within none."""
    correlated = [_correlation_se(residuals, _label(grouping)) for grouping in groupings]
    most = int(np.argmax(correlated))
    if correlated[most] <= _CORRELATION_SE:
        return np.arange(residuals.size, dtype=np.int64)
    return groupings[most]


def _correlation_se(residuals: FloatArray, label: IntArray) -> float:
    """Sum of the products of all pairs within groups, in its standard errors were none correlated;
    0 where every group has one point."""
    sums, squares, fourths = (np.bincount(label, residuals**power) for power in (1, 2, 4))
    sd = np.sqrt(2.0 * float((squares**2 - fourths).sum()))
    return float((sums**2 - squares).sum()) / sd if sd > 0.0 else 0.0


def _label(*groupings: IntArray) -> IntArray:
    """(N,) number of each combination."""
    _, label = np.unique(np.stack(groupings), axis=1, return_inverse=True)
    return label.ravel()


def _jackknife(
    scores: FloatArray, information: FloatArray, prior: FloatArray, label: IntArray
) -> FloatArray | None:
    """Covariance by leaving out each group of points, with Student's factor for how few they are.

    To first order: one Newton step from the optimum of all.
    """
    count = int(label.max(initial=0)) + 1
    size = scores.shape[1]
    score = np.zeros((count, size))
    own = np.zeros((count, size, size))
    np.add.at(score, label, scores)
    np.add.at(own, label, information)
    total = prior + information.sum(axis=0)
    if not _is_positive(total) or not _is_positive(total - own):
        # Without one of the groups nothing is known of some direction.
        return None
    weight = np.einsum("gii->g", np.linalg.solve(total, own))
    effective = float(weight.sum() ** 2 / max((weight**2).sum(), 1e-300))
    degrees = effective - 1.0
    if degrees < _LEAST_DEGREES:
        return None
    moves = np.linalg.solve(total - own, score[..., None])[..., 0]
    moves -= moves.mean(axis=0)
    covariance: FloatArray = moves.T @ moves * (count - 1) / count
    return covariance * degrees / (degrees - 2.0)


def _is_positive(information: FloatArray) -> bool:
    """Whether all of the (..., K, K) matrices are positive definite, whatever their units."""
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", information), 0.0))
    if not (scale > 0.0).all():
        return False
    eigenvalues = np.linalg.eigvalsh(information / scale[..., :, None] / scale[..., None, :])
    return bool((eigenvalues > _LEAST_EIGENVALUE).all())


def _at_least(covariance: FloatArray, least: FloatArray) -> FloatArray:
    """``covariance``, raised to ``least`` in each direction where it is below."""
    eigenvalues, vectors = np.linalg.eigh(least)
    root = (vectors * np.sqrt(np.maximum(eigenvalues, 1e-300))) @ vectors.T
    whiten = np.linalg.pinv(root)
    ratios, directions = np.linalg.eigh(whiten @ covariance @ whiten)
    raised = (directions * np.maximum(ratios, 1.0)) @ directions.T
    found: FloatArray = root @ raised @ root
    return found
