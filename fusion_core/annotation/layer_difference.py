"""What would have to change in one layer to make it another."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from fusion_core.annotation.action import CaptureChange
from fusion_core.annotation.aligned_layers import align_layers
from fusion_core.model.labels import NO_LABEL, CaptureLabels, Label

_NAMES = {int(label): label.name.lower() for label in Label} | {NO_LABEL: None}


def differing_samples(
    ours: Iterable[CaptureLabels], theirs: Iterable[CaptureLabels]
) -> Iterator[CaptureChange]:
    """The samples of each capture that the layers label differently, with our label before and
    theirs after; NO_LABEL where there is none. Raises ScanLoomError as ``align_layers``."""
    for block in align_layers({"ours": ours, "theirs": theirs}):
        differs = block.codes[0] != block.codes[1]
        for capture, samples in block:
            own = differs[samples]
            if own.any():
                before, after = (
                    CaptureLabels(
                        capture=capture,
                        row=block.row[samples][own],
                        column=block.column[samples][own],
                        label=codes[samples][own].astype(np.int64),
                    )
                    for codes in block.codes
                )
                yield CaptureChange(before=before, after=after)


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferenceCounts:
    """How many samples go from one label to another; None stands for no label.

    ``captures``: in how many captures.
    """

    samples: dict[tuple[str | None, str | None], int]
    captures: int

    @classmethod
    def of(cls, changes: Iterable[CaptureChange]) -> Self:
        """Of all changes."""
        counts: Counter[tuple[int, int]] = Counter()
        captures = 0
        for change in changes:
            captures += 1
            pairs = zip(change.before.label.tolist(), change.after.label.tolist(), strict=True)
            counts.update(pairs)
        named = {
            (_NAMES[before], _NAMES[after]): count
            for (before, after), count in sorted(counts.items())
        }
        return cls(samples=named, captures=captures)

    @property
    def added(self) -> int:
        """Samples that only the other layer labels."""
        return sum(count for (before, _), count in self.samples.items() if before is None)

    @property
    def missing(self) -> int:
        """Samples that only our layer labels."""
        return sum(count for (_, after), count in self.samples.items() if after is None)

    @property
    def altered(self) -> int:
        """Samples that both label, but not alike."""
        return sum(self.samples.values()) - self.added - self.missing

    def to_json(self) -> dict[str, Any]:
        """Counts, and each pair of labels with its samples."""
        return {
            "added": self.added,
            "altered": self.altered,
            "missing": self.missing,
            "captures": self.captures,
            "samples": [
                {"before": before, "after": after, "samples": count}
                for (before, after), count in self.samples.items()
            ],
        }
