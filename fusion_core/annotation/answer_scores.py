"""Recall and precision of a person's labels against known answers, class by class."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fusion_core.annotation.agreement import NO_PAIRS, RESAMPLES, Estimate
from fusion_core.annotation.agreement_counts import CLASSES, AgreementCounts
from fusion_core.annotation.aligned_layers import AlignedLabels
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import ScanLoomError

NEVER_KNOWN = "no known answer is of this class"
NEVER_SAID = "this class was never said"


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassScore:
    """Of one class: ``known`` samples are of it, ``said`` were labelled so. ``recall``: which
    fraction of the known ones was; ``precision``: which fraction of the said ones is."""

    noise_class: NoiseClass
    known: int
    said: int
    recall: Estimate
    precision: Estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class AnswerScore:
    """Of ``samples`` that both layers decided on, in ``captures``. ``percent``: the fraction that
    is right."""

    samples: int
    captures: int
    percent: Estimate
    classes: tuple[ClassScore, ...]


def score_answers(
    blocks: Iterable[AlignedLabels], *, resamples: int = RESAMPLES, seed: int = 0
) -> AnswerScore:
    """Score the second of two layers against the first, whose labels are taken to be right.

    UNSURE counts as no label. Intervals are over captures that both decided on. Raises
    ScanLoomError where no sample is decided by both.
    """
    shared = [both for block in blocks if (both := _both_decided(block)) is not None]
    if not shared:
        raise ScanLoomError(
            "no known answer has a label of this review.",
            advice="Label some of the runs that have one.",
        )
    counts = AgreementCounts.of(shared)
    captures = len(counts.labels)
    # (1 + B, C, C) samples by the known class and by the one that was said.
    pairs = counts.resampled(resamples, seed).pairs[:, 0]
    right, known, said = np.einsum("bcc->bc", pairs), pairs.sum(axis=2), pairs.sum(axis=1)
    total = pairs.sum(axis=(1, 2))

    def estimate(numerator: FloatArray, denominator: FloatArray, why_undefined: str) -> Estimate:
        fraction = np.full(numerator.shape, np.nan)
        np.divide(numerator, denominator, out=fraction, where=denominator > 0.0)
        return Estimate.of(fraction, captures, why_undefined)

    return AnswerScore(
        samples=round(float(total[0])),
        captures=captures,
        percent=estimate(right.sum(axis=1), total, NO_PAIRS),
        classes=tuple(
            ClassScore(
                noise_class=code,
                known=round(float(known[0, code])),
                said=round(float(said[0, code])),
                recall=estimate(right[:, code], known[:, code], NEVER_KNOWN),
                precision=estimate(right[:, code], said[:, code], NEVER_SAID),
            )
            for code in CLASSES
        ),
    )


def _both_decided(block: AlignedLabels) -> AlignedLabels | None:
    """The samples of a block that both layers decided on, with no capture without any; None where
    there is none."""
    if len(block.layers) != 2:
        raise ValueError("known answers and one layer of labels are needed")
    own = np.isin(block.codes, CLASSES).all(axis=0)
    if not own.any():
        return None
    numbers, capture = np.unique(block.capture[own], return_inverse=True)
    return AlignedLabels(
        layers=block.layers,
        captures=tuple(block.captures[number] for number in numbers),
        capture=capture,
        row=block.row[own],
        column=block.column[own],
        codes=block.codes[:, own],
    )
