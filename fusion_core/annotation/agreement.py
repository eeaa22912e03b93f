"""How far layers agree, with intervals: percent, κ, α, runs, confusion, by class and by layer."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Self

import numpy as np

from fusion_core.annotation.agreement_counts import CLASSES, AgreementCounts
from fusion_core.annotation.aligned_layers import AlignedLabels
from fusion_core.annotation.coefficients import (
    cohen_kappa,
    fleiss_kappa,
    krippendorff_alpha,
    matched_iou,
    one_vs_rest,
    panoptic_quality,
    percent_agreement,
    sample_iou,
)
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.labels import Label

RESAMPLES = 1000
_CONFIDENCE = 0.95
# Set by hand: of resamples that leave a coefficient undefined, more than this give no interval.
_UNDEFINED_MAX = 0.05

NO_PAIRS = "no sample is decided by two layers"
NOT_COMPLETE = "no sample is decided by all layers"
ONE_CLASS = "all decisions are of one class"
NO_RUNS = "neither layer has a run of it"
NO_MATCH = "no runs match"


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A coefficient with its 95 % interval.

    ``value`` is None where it is not defined, and ``undefined`` says why. ``low`` and ``high`` are
    None then too, for a single capture, and where it is not defined in more than 5 % of the
    resamples.
    """

    value: float | None
    low: float | None = None
    high: float | None = None
    undefined: str = ""

    @classmethod
    def of(cls, sums: FloatArray, captures: int, why_undefined: str) -> Self:
        """``sums``: (1 + B,) the coefficient, then the same of each resample; NaN where it is not
        defined. The interval's ends are percentiles of the resamples (Efron 1979)."""
        value, resamples = sums[0], sums[1:]
        if np.isnan(value):
            return cls(value=None, undefined=why_undefined)
        defined = resamples[~np.isnan(resamples)]
        if captures < 2 or not defined.size or defined.size < (1 - _UNDEFINED_MAX) * resamples.size:
            return cls(value=float(value))
        tail = (1.0 - _CONFIDENCE) / 2.0
        low, high = np.quantile(defined, (tail, 1.0 - tail))
        return cls(value=float(value), low=float(low), high=float(high))

    def to_json(self) -> dict[str, Any]:
        """Value, ends of the interval, and why it is not defined, where it is not."""
        shown: dict[str, Any] = {"value": self.value, "low": self.low, "high": self.high}
        return shown | ({"undefined": self.undefined} if self.undefined else {})


Named = dict[str, Estimate]
"""Estimates by the coefficient's name."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairAgreement:
    """Of two layers. ``confusion``: (C, C) samples by the class in ``first`` and in ``second``.

    ``coefficients``: percent, cohen_kappa, and of runs panoptic_quality and matched_iou.
    ``by_class``: for each class against all others cohen_kappa, sample_iou and those of runs.
    """

    first: str
    second: str
    confusion: IntArray
    coefficients: Named
    by_class: dict[str, Named]

    def to_json(self) -> dict[str, Any]:
        """As nested dictionaries."""
        return {
            "first": self.first,
            "second": self.second,
            "samples": int(self.confusion.sum()),
            "confusion": self.confusion.tolist(),
            **_named_json(self.coefficients),
            "by_class": {name: _named_json(found) for name, found in self.by_class.items()},
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LayerAgreement:
    """Of one layer with all others together. ``labels``: how many of each name.

    ``coefficients``: percent, and cohen_kappa between it and the others taken for one rater.
    """

    labels: dict[str, int]
    coefficients: Named

    def to_json(self) -> dict[str, Any]:
        """As nested dictionaries."""
        return {"labels": self.labels, **_named_json(self.coefficients)}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Agreement:
    """Of all layers. ``captures``: those that any layer has labels in. ``complete_samples``: what
    all layers decided on, of which alone Fleiss' κ speaks.

    ``coefficients``: percent (of all pairs), fleiss_kappa, krippendorff_alpha; ``by_class``: the
    last two for each class against all others.
    """

    captures: int
    complete_samples: int
    coefficients: Named
    by_class: dict[str, Named]
    layers: dict[str, LayerAgreement]
    pairs: tuple[PairAgreement, ...]

    def to_json(self) -> dict[str, Any]:
        """As nested dictionaries."""
        return {
            "classes": [_class_name(code) for code in CLASSES],
            "captures": self.captures,
            "complete_samples": self.complete_samples,
            **_named_json(self.coefficients),
            "by_class": {name: _named_json(found) for name, found in self.by_class.items()},
            "layers": {name: layer.to_json() for name, layer in self.layers.items()},
            "pairs": [pair.to_json() for pair in self.pairs],
        }


def measure_agreement(
    blocks: Iterable[AlignedLabels], *, resamples: int = RESAMPLES, seed: int = 0
) -> Agreement:
    """Compare two layers or more. UNSURE counts as no label.

    Raises ScanLoomError for less than two layers, and where none has a label.
    """
    names: tuple[str, ...] = ()

    def named() -> Iterable[AlignedLabels]:
        nonlocal names
        for block in blocks:
            names = block.layers
            yield block

    try:
        counts = AgreementCounts.of(named())
    except ValueError as error:
        raise ScanLoomError("none of the layers has a label to compare.") from error
    if len(names) < 2:
        raise ScanLoomError(
            "agreement needs two layers or more.", advice="Name another layer beside it."
        )
    captures = len(counts.labels)
    sums = counts.resampled(resamples, seed)
    return _Measure(names, captures, sums).agreement()


class _Measure:
    """Agreement out of sums, (1 + B, ...): over all captures, and over each resample."""

    def __init__(self, names: tuple[str, ...], captures: int, sums: AgreementCounts) -> None:
        self._names = names
        self._captures = captures
        self._sums = sums
        self._places = list(combinations(range(len(names)), 2))

    def agreement(self) -> Agreement:
        sums = self._sums
        all_pairs = sums.pairs.sum(axis=1)
        ordered_pairs = len(self._places)
        return Agreement(
            captures=self._captures,
            complete_samples=round(float(sums.complete[0].sum()) / ordered_pairs),
            coefficients={
                "percent": self._coefficient(percent_agreement, all_pairs, NO_PAIRS),
                "fleiss_kappa": self._coefficient(fleiss_kappa, sums.complete, NOT_COMPLETE),
                "krippendorff_alpha": self._coefficient(
                    krippendorff_alpha, sums.coincidences, NO_PAIRS
                ),
            },
            by_class={
                _class_name(code): {
                    "fleiss_kappa": self._coefficient(
                        fleiss_kappa, one_vs_rest(sums.complete, code), NOT_COMPLETE
                    ),
                    "krippendorff_alpha": self._coefficient(
                        krippendorff_alpha, one_vs_rest(sums.coincidences, code), NO_PAIRS
                    ),
                }
                for code in CLASSES
            },
            layers={name: self._layer(number) for number, name in enumerate(self._names)},
            pairs=tuple(self._pair(pair) for pair in range(len(self._places))),
        )

    def _layer(self, layer: int) -> LayerAgreement:
        own = [
            self._sums.pairs[:, pair] if first == layer else _swapped(self._sums.pairs[:, pair])
            for pair, (first, second) in enumerate(self._places)
            if layer in (first, second)
        ]
        counts = self._sums.labels[0, layer]
        pooled = np.sum(own, axis=0)
        return LayerAgreement(
            labels={
                label.name.lower(): int(count) for label, count in zip(Label, counts, strict=True)
            },
            coefficients={
                "percent": self._coefficient(percent_agreement, pooled, NO_PAIRS),
                "cohen_kappa": self._coefficient(cohen_kappa, pooled, NO_PAIRS),
            },
        )

    def _pair(self, pair: int) -> PairAgreement:
        first, second = self._places[pair]
        pairs, runs = self._sums.pairs[:, pair], self._sums.runs[:, pair]
        return PairAgreement(
            first=self._names[first],
            second=self._names[second],
            confusion=np.rint(pairs[0]).astype(np.int64),
            coefficients={
                "percent": self._coefficient(percent_agreement, pairs, NO_PAIRS),
                "cohen_kappa": self._coefficient(cohen_kappa, pairs, NO_PAIRS),
                **self._runs(runs.sum(axis=1)),
            },
            by_class={
                _class_name(code): {
                    "cohen_kappa": self._coefficient(
                        cohen_kappa, one_vs_rest(pairs, code), NO_PAIRS
                    ),
                    "sample_iou": self._estimate(sample_iou(pairs, code), NO_RUNS),
                    **self._runs(runs[:, code]),
                }
                for code in CLASSES
            },
        )

    def _coefficient(
        self, compute: Callable[[FloatArray], FloatArray], pairs: FloatArray, without_pairs: str
    ) -> Estimate:
        return self._estimate(compute(pairs), ONE_CLASS if pairs[0].sum() else without_pairs)

    def _runs(self, runs: FloatArray) -> Named:
        columns = np.moveaxis(runs, -1, 0)
        return {
            "panoptic_quality": self._estimate(panoptic_quality(*columns), NO_RUNS),
            "matched_iou": self._estimate(matched_iou(*columns[:2]), NO_MATCH),
        }

    def _estimate(self, sums: FloatArray, why_undefined: str) -> Estimate:
        return Estimate.of(sums, self._captures, why_undefined)


def _swapped(pairs: FloatArray) -> FloatArray:
    return np.swapaxes(pairs, -2, -1)


def _class_name(code: int) -> str:
    return Label(code).name.lower()


def _named_json(estimates: Named) -> dict[str, Any]:
    return {name: estimate.to_json() for name, estimate in estimates.items()}
