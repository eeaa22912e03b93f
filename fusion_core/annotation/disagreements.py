"""Where layers contradict each other, and what most of them say."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from fusion_core.annotation.agreement_counts import CLASSES
from fusion_core.annotation.aligned_layers import AlignedLabels, CodeArray
from fusion_core.annotation.runs import number_runs
from fusion_core.model.conventions import BoolArray, IntArray
from fusion_core.model.labels import Capture, CaptureLabels, Label


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Disagreement:
    """A run of samples of which the layers say the same, and not all the same class.

    ``row``, ``column``: (N,). ``said``: each layer's label, None where it has none.
    """

    capture: Capture
    row: IntArray
    column: IntArray
    said: dict[str, Label | None]


def disagreements(blocks: Iterable[AlignedLabels]) -> Iterator[Disagreement]:
    """The runs on which at least two layers decided differently, in the order of their captures.

    UNSURE contradicts nothing; where others disagree, it is among what is said.
    """
    for block in blocks:
        votes = _count_votes(block.codes)
        contested = (votes > 0).sum(axis=0) > 1
        said, pattern = np.unique(block.codes[:, contested], axis=1, return_inverse=True)
        of_sample = np.full(block.capture.shape, -1)
        of_sample[contested] = pattern
        run = number_runs(block, of_sample, contested)
        order = np.flatnonzero(contested)[np.argsort(run[contested], kind="stable")]
        for samples in np.split(order, np.flatnonzero(np.diff(run[order])) + 1):
            if samples.size:
                codes = said[:, of_sample[samples[0]]].tolist()
                yield Disagreement(
                    capture=block.captures[block.capture[samples[0]]],
                    row=block.row[samples],
                    column=block.column[samples],
                    said={
                        name: Label(code) if code >= 0 else None
                        for name, code in zip(block.layers, codes, strict=True)
                    },
                )


def adjudicate(
    blocks: Iterable[AlignedLabels], *, least_decisions: int = 1
) -> Iterator[CaptureLabels]:
    """The class that more than half of the deciding layers gave, for each sample that has one.

    Samples without such a majority are left out, and so are those that less than
    ``least_decisions`` layers decided on, and captures without any. UNSURE decides nothing.
    """
    for block in blocks:
        votes = _count_votes(block.codes)
        decisions = votes.sum(axis=0)
        winner = votes.argmax(axis=0)
        settled: BoolArray = 2 * votes.max(axis=0) > decisions
        settled &= decisions >= least_decisions
        for capture, samples in block:
            own = settled[samples]
            if own.any():
                yield CaptureLabels(
                    capture=capture,
                    row=block.row[samples][own],
                    column=block.column[samples][own],
                    label=winner[samples][own],
                )


def _count_votes(codes: CodeArray) -> IntArray:
    """(C, N) how many layers gave each class. ``codes``: (L, N)."""
    return np.stack([(codes == code).sum(axis=0) for code in CLASSES])
