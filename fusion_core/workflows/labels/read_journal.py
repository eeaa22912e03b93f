"""What the journal tells: the last actions, and what there is by class, layer and annotator."""

from collections import deque
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from fusion_core.annotation.action import Action
from fusion_core.annotation.store import LabelStore
from fusion_core.model.progress import Progress
from fusion_core.workflows.labels.open_store import open_labels

# Set by hand: a longer time between two actions is a break, not work.
_LONGEST_PAUSE = timedelta(minutes=2)
_SEARCH_FACTOR = 8


def last_actions(
    recording: Path, address: str | None, layer: str | None, last: int, progress: Progress
) -> dict[str, Any]:
    """The last actions, of one layer or of all, newest last, as JSON. Raises as ``open_labels``,
    and LabelStoreError where there is no such layer."""
    with open_labels(recording, address, create=False, progress=progress) as store:
        name = None if layer is None else store.layer(layer).name
        actions = _newest(store, name, last)
        return {"store": store.place, "actions": [_action_json(action) for action in actions]}


def label_statistics(recording: Path, address: str | None, progress: Progress) -> dict[str, Any]:
    """Labels in force by layer and class; actions, samples, time and rate by annotator and layer;
    as JSON. Raises as ``open_labels``.

    Only what a person labelled has a rate: their actions per minute of work, in which gaps of more
    than two minutes are left out.
    """
    with open_labels(recording, address, create=False, progress=progress) as store:
        work: dict[tuple[str, str], _Work] = {}
        for action in store.actions():
            work.setdefault((action.annotator, action.layer), _Work()).add(action)
        return {
            "store": store.place,
            "layers": {
                layer: {label.name.lower(): count for label, count in store.counts(layer).items()}
                for layer in store.layers
            },
            "annotators": [
                {"annotator": annotator, "layer": layer, **done.to_json()}
                for (annotator, layer), done in sorted(work.items())
            ],
        }


def _newest(store: LabelStore, layer: str | None, last: int) -> list[Action]:
    """Read from the end: a journal may have a million actions."""
    head = store.head()
    span = last
    while True:
        after = max(0, head - span)
        found = deque(store.actions(layer, after), maxlen=last)
        if len(found) == last or after == 0:
            return list(found)
        span *= _SEARCH_FACTOR


def _action_json(action: Action) -> dict[str, Any]:
    return {
        "id": action.id,
        "time_utc": action.time_utc.isoformat(timespec="seconds"),
        "annotator": action.annotator,
        "layer": action.layer,
        "kind": action.kind,
        "target": action.target,
        "source": action.source,
        "samples": action.samples,
        "captures": len(action.captures),
        "version": action.version,
        "settings_sha256": action.settings_sha256,
        "comment": action.comment,
    }


@dataclass(slots=True)
class _Work:
    """What one annotator did in one layer."""

    actions: int = 0
    by_hand: int = 0
    samples: int = 0
    worked: timedelta = field(default_factory=timedelta)
    first: datetime | None = None
    last: datetime | None = None

    def add(self, action: Action) -> None:
        self.actions += 1
        self.samples += action.samples
        if action.source == "human":
            self.by_hand += 1
            if self.last is not None:
                pause = action.time_utc - self.last
                # Clocks of several machines differ: a pause may be negative.
                if timedelta() < pause <= _LONGEST_PAUSE:
                    self.worked += pause
        self.first = self.first or action.time_utc
        self.last = action.time_utc

    def to_json(self) -> dict[str, Any]:
        minutes = self.worked / timedelta(minutes=1)
        return {
            "actions": self.actions,
            "samples": self.samples,
            "first_utc": None if self.first is None else self.first.isoformat(timespec="seconds"),
            "last_utc": None if self.last is None else self.last.isoformat(timespec="seconds"),
            "minutes": minutes,
            "actions_per_minute": self.by_hand / minutes if minutes else None,
        }
