"""What agreement is computed from: counts that add up over captures.

The samples of one capture depend on each other, so intervals come from resampling whole captures:
each resample is another weighted sum of the same counts.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from itertools import combinations
from typing import Self

import numpy as np

from fusion_core.annotation.aligned_layers import AlignedLabels, CodeArray
from fusion_core.annotation.runs import number_runs
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.model.labels import Label

CLASSES = tuple(NoiseClass)
"""What a decision may be: UNSURE and a missing label are gaps, which no coefficient counts."""

_RESAMPLES_AT_ONCE = 64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AgreementCounts:
    """Counts of G captures, or of G sums over captures.

    L layers, P pairs of them in the order of ``itertools.combinations``, C classes:

    * ``labels``: (G, L, C + 1) labels of each class in a layer, those of UNSURE last.
    * ``pairs``: (G, P, C, C) samples by the class in the pair's first and second layer.
    * ``complete``: (G, C, C) the sum of ``pairs`` over samples that all layers decided on.
    * ``coincidences``: (G, C, C) Krippendorff's: all pairs of a sample that m layers decided on, in
      both orders, with weight 1 / (m - 1).
    * ``runs``: (G, P, C, 4) of the runs in the samples that both layers decided on: the sum of
      matched runs' intersection over union, and how many are matched, only in the first layer, only
      in the second.
    """

    labels: FloatArray
    pairs: FloatArray
    complete: FloatArray
    coincidences: FloatArray
    runs: FloatArray

    @classmethod
    def of(cls, blocks: Iterable[AlignedLabels]) -> Self:
        """Those of each capture. Raises ValueError where there is no block."""
        counted = [
            (
                count_labels(block.codes, block.capture, len(block.captures)),
                *count_pairs(block.codes, block.capture, len(block.captures)),
                _count_runs(block),
            )
            for block in blocks
        ]
        if not counted:
            raise ValueError("there is nothing to compare")
        return cls(
            **{
                field.name: np.concatenate(parts)
                for field, parts in zip(fields(cls), zip(*counted, strict=True), strict=True)
            }
        )

    def resampled(self, resamples: int, seed: int) -> Self:
        """First the sum over all captures, then the sums over ``resamples`` draws of as many
        captures, with replacement."""
        captures = len(self.labels)
        sums: dict[str, list[FloatArray]] = {field.name: [] for field in fields(self)}
        for weights in _bootstrap_weights(captures, resamples, seed):
            for name, parts in sums.items():
                counts = getattr(self, name)
                total = weights @ counts.reshape(captures, -1)
                parts.append(total.reshape(len(weights), *counts.shape[1:]))
        return type(self)(**{name: np.concatenate(parts) for name, parts in sums.items()})


def count_labels(codes: CodeArray, group: IntArray, groups: int) -> FloatArray:
    """(groups, L, C + 1) labels by class, UNSURE last. ``codes``: (L, N). ``group``: (N,)."""
    counts = np.zeros((groups, len(codes), len(Label)))
    for layer, own in enumerate(codes):
        labelled = own >= 0
        place = group[labelled] * len(Label) + own[labelled]
        counts[:, layer] = np.bincount(place, minlength=groups * len(Label)).reshape(groups, -1)
    return counts


def count_pairs(
    codes: CodeArray, group: IntArray, groups: int, size: int = len(CLASSES)
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """``pairs``, ``complete`` and ``coincidences`` of the samples of each group.

    ``codes``: (L, N) classes from 0 to ``size`` - 1; any other number is a gap. ``group``: (N,)
    from 0 to groups - 1.
    """
    decided = _is_decision(codes, size)
    decisions = decided.sum(axis=0)
    weight = 1.0 / np.maximum(decisions - 1, 1)
    is_complete = decisions == len(codes)
    pairs = []
    complete, one_order = np.zeros((2, groups, size, size))
    for first, second in combinations(range(len(codes)), 2):
        both = decided[first] & decided[second]
        place = group[both] * size + codes[first, both]
        place = place * size + codes[second, both]

        def count(weights: FloatArray | None, place: IntArray = place) -> FloatArray:
            counts = np.bincount(place, weights, minlength=groups * size * size)
            return counts.reshape(groups, size, size).astype(np.float64)

        pairs.append(count(None))
        complete += count(is_complete[both].astype(np.float64))
        one_order += count(weight[both])
    if not pairs:
        return np.zeros((groups, 0, size, size)), complete, one_order
    return np.stack(pairs, axis=1), complete, one_order + np.swapaxes(one_order, 1, 2)


def _is_decision(codes: CodeArray, size: int = len(CLASSES)) -> BoolArray:
    return (codes >= 0) & (codes < size)


def _count_runs(block: AlignedLabels) -> FloatArray:
    layers, groups = len(block.layers), len(block.captures)
    decided = _is_decision(block.codes)
    pairs = list(combinations(range(layers), 2))
    counts = np.zeros((groups, len(pairs), len(CLASSES), 4))
    for pair, (first, second) in enumerate(pairs):
        both = decided[first] & decided[second]
        of_first, of_second = (
            _RunsOfLayer(block, block.codes[layer].astype(np.int64), both)
            for layer in (first, second)
        )
        _match_runs(of_first, of_second, both, counts[:, pair])
    return counts


class _RunsOfLayer:
    """The runs of one layer: ``number`` (N,), and (R,) size, class and capture of each."""

    def __init__(self, block: AlignedLabels, codes: IntArray, within: BoolArray) -> None:
        self.number = number_runs(block, codes, within)
        numbers, first = np.unique(self.number[within], return_index=True)
        self.size = np.bincount(self.number[within], minlength=numbers.size)
        self.kind = codes[within][first]
        self.capture = block.capture[within][first]


def _match_runs(
    first: _RunsOfLayer, second: _RunsOfLayer, both: BoolArray, counts: FloatArray
) -> None:
    """Add to ``counts`` (G, C, 4). Runs match where they are of one class and their intersection is
    more than half of their union, so that no run has two partners (Kirillov 2019, §4.1)."""
    count = max(second.size.size, 1)
    overlaps, shared = np.unique(
        first.number[both] * count + second.number[both], return_counts=True
    )
    one, other = np.divmod(overlaps, count)
    iou = shared / (first.size[one] + second.size[other] - shared)
    matched = (first.kind[one] == second.kind[other]) & (iou > 0.5)
    of_match = first.capture[one[matched]], first.kind[one[matched]]
    np.add.at(counts[..., 0], of_match, iou[matched])
    np.add.at(counts[..., 1], of_match, 1)
    for runs, partners, column in ((first, one, 2), (second, other, 3)):
        alone = np.ones(runs.size.shape, dtype=np.bool_)
        alone[partners[matched]] = False
        np.add.at(counts[..., column], (runs.capture[alone], runs.kind[alone]), 1)


def _bootstrap_weights(captures: int, resamples: int, seed: int) -> Iterator[FloatArray]:
    """How often each capture counts: (1, G) once each, then (b, G) for each draw."""
    yield np.ones((1, captures))
    rng = np.random.default_rng(seed)
    for start in range(0, resamples, _RESAMPLES_AT_ONCE):
        draws = min(_RESAMPLES_AT_ONCE, resamples - start)
        drawn = rng.integers(captures, size=(draws, captures))
        drawn += captures * np.arange(draws)[:, np.newaxis]
        counts = np.bincount(drawn.ravel(), minlength=draws * captures)
        yield counts.reshape(draws, captures).astype(np.float64)
