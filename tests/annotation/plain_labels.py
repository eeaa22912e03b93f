"""What the journal should hold: dictionaries and lists, without numbers, links or a database."""

from collections import defaultdict
from dataclasses import dataclass, field
from random import Random
from typing import Literal

from fusion_core.annotation.identity import Author
from fusion_core.annotation.store import LabelStore
from fusion_core.model.errors import LabelStoreError
from fusion_core.model.labels import NO_LABEL, Capture, Label
from tests.annotation.samples import CAPTURES, labels

Sample = tuple[Capture, int, int]
Changes = dict[Sample, tuple[int, int]]
"""Before and after."""


@dataclass(frozen=True)
class Operation:
    """What a person does. ``codes``: what they label, empty for undo and redo."""

    kind: Literal["do", "undo", "redo"]
    layer: str
    annotator: str
    codes: dict[Sample, int] = field(default_factory=dict)

    def apply(self, store: LabelStore) -> int | None:
        """The number of the action; None where there is none, or where it is refused."""
        if self.kind == "do":
            by_capture: dict[Capture, dict[tuple[int, int], int]] = defaultdict(dict)
            for (capture, row, column), code in self.codes.items():
                by_capture[capture][row, column] = code
            given = [labels(capture, codes) for capture, codes in by_capture.items()]
            action = store.label(self.layer, given, Author(self.annotator))
        else:
            call = store.undo if self.kind == "undo" else store.redo
            try:
                action = call(self.layer, self.annotator)
            except LabelStoreError:
                return None
        return None if action is None else action.id


class PlainLabels:
    """Labels in force by layer, and what each annotator has done and undone there."""

    def __init__(self) -> None:
        self.actions = 0
        self.labels: dict[str, dict[Sample, int]] = defaultdict(dict)
        self._done: dict[tuple[str, str], list[Changes]] = defaultdict(list)
        self._undone: dict[tuple[str, str], list[Changes]] = defaultdict(list)

    def apply(self, operation: Operation) -> int | None:
        """As ``Operation.apply``."""
        labels, key = self.labels[operation.layer], (operation.layer, operation.annotator)
        source, target = self._done[key], self._undone[key]
        if operation.kind == "do":
            changes = {
                sample: (labels.get(sample, NO_LABEL), code)
                for sample, code in operation.codes.items()
                if labels.get(sample, NO_LABEL) != code
            }
            if not changes:
                return None
            source.append(changes)
            target.clear()
        else:
            if operation.kind == "redo":
                source, target = target, source
            if not source:
                return None
            undo = operation.kind == "undo"
            left = {sample: change[undo] for sample, change in source[-1].items()}
            if any(labels.get(sample, NO_LABEL) != code for sample, code in left.items()):
                return None
            target.append(source.pop())
            changes = {
                sample: (after, before) if undo else (before, after)
                for sample, (before, after) in target[-1].items()
            }
        labels.update({sample: after for sample, (_, after) in changes.items()})
        self.actions += 1
        return self.actions

    def in_force(self, layer: str) -> dict[Sample, int]:
        """All labels of a layer."""
        return {sample: code for sample, code in self.labels[layer].items() if code != NO_LABEL}


def random_operation(random: Random) -> Operation:
    """One of a person who works fast, and often thinks better of it."""
    kind = random.choice(["do", "do", "do", "undo", "redo"])
    codes = {}
    for _ in range(random.choice([1, 1, 3, 12]) if kind == "do" else 0):
        capture = random.choice(CAPTURES)
        place = random.randrange(capture.rows), random.randrange(capture.columns)
        codes[capture, *place] = random.choice([NO_LABEL, *map(int, Label)])
    return Operation(kind, random.choice("ab"), random.choice(["anna", "ben"]), codes)
