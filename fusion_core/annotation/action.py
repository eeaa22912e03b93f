"""An action of the journal, and what it changed."""

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np

from fusion_core.annotation.identity import LabelSource
from fusion_core.model.labels import Capture, CaptureLabels

ActionKind = Literal["do", "undo", "redo"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Action:
    """What one person did at once.

    ``id`` counts from 1 without gaps, in the order of the commits. ``target``: the action that an
    undo takes back, or the undo that a redo takes back. ``version``: that of the tool.
    ``captures``, ``samples``: where labels changed, and how many.
    """

    id: int
    layer: str
    kind: ActionKind
    target: int | None
    time_utc: datetime
    annotator: str
    source: LabelSource
    settings_sha256: str
    version: str
    comment: str
    captures: tuple[Capture, ...]
    samples: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CaptureChange:
    """The labels of the samples of one capture before and after an action; NO_LABEL where a sample
    is not labelled."""

    before: CaptureLabels
    after: CaptureLabels

    def __post_init__(self) -> None:
        old, new = self.before, self.after
        same = np.array_equal(old.row, new.row) and np.array_equal(old.column, new.column)
        if old.capture != new.capture or not same:
            raise ValueError("before and after are of the same samples")

    @property
    def capture(self) -> Capture:
        """Whose samples they are."""
        return self.after.capture

    @property
    def inverse(self) -> "CaptureChange":
        """The change back."""
        return CaptureChange(before=self.after, after=self.before)
